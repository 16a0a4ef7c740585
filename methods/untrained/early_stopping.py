"""Early stopping of untrained networks, by the windowed moving variance of their images."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class MovingVariance:
    """Keeps the mean of the window of successive images that vary least.

    A network fits the image first and the noise later; in between, its images stand still. So the
    window with the least variance is the place to stop, and it is known when a later window has
    not come below it for `patience` images. Nothing but the images is looked at.

    Source: Wang et al., "Early Stopping for Deep Image Prior", TMLR 2023, algorithm 1. They return
    the window's first image; the mean is as good or better here, and free.

    Attributes:
        image: (H, W) the mean over the best window so far, over all images while there is no full
            window yet.
        position: number of images seen when that window was complete.
    """

    image: Array

    def __init__(self, window: int, patience: int) -> None:
        self.position = 0
        self._window, self._patience = window, patience
        self._images: deque[Array] = deque()
        self._least = np.inf
        self._seen = 0

    def stops(self, image: Array) -> bool:
        """Take in the next image (H, W); return True if it is time to stop."""
        if not self._images:
            self._total, self._squares = np.zeros_like(image), 0.0
        self._images.append(image)
        self._total += image
        self._squares += float(np.vdot(image, image))
        self._seen += 1
        if len(self._images) > self._window:
            oldest = self._images.popleft()
            self._total -= oldest
            self._squares -= float(np.vdot(oldest, oldest))
        mean = self._total / len(self._images)
        full = len(self._images) == self._window
        variance = self._squares / len(self._images) - float(np.vdot(mean, mean))
        if not full or variance < self._least:
            self.image, self.position = mean, self._seen
            self._least = variance if full else np.inf
        return self._seen - self.position >= self._patience
