"""What became of the frames of one batch."""

import numpy as np
from numpy.typing import NDArray

from eitbench.benchmark.store import Batch
from eitbench.benchmark.worker import Failure, Images


class Outcome:
    """Collects the frames of one batch in order, good and bad."""

    def __init__(self) -> None:
        self._images: list[Images | None] = []
        self._status: list[str] = []
        self._message: list[str] = []
        self._ms: list[float] = []

    def __len__(self) -> int:
        return len(self._status)

    def images(self, images: Images, mask: NDArray[np.bool_], seconds: float) -> None:
        """Add reconstructed frames that took `seconds` together."""
        for image in images:
            good = bool(np.isfinite(image[mask]).all())
            self._images.append(image if good else None)
            self._status.append("ok" if good else "invalid-output")
            self._message.append("" if good else "returned values that are not finite")
            self._ms.append(seconds * 1e3 / len(images))

    def fail(self, count: int, failure: Failure) -> "Outcome":
        """Add `count` frames that were lost to `failure`."""
        self._images += [None] * count
        self._status += [failure.status] * count
        self._message += [failure.message] * count
        self._ms += [float("nan")] * count
        return self

    def batch(self, start: int, image_shape: tuple[int, int]) -> Batch:
        """All of it, with NaN where there is no image."""
        estimates = np.full((len(self), *image_shape), np.nan, dtype=np.float32)
        for estimate, image in zip(estimates, self._images, strict=True):
            if image is not None:
                estimate[:] = image
        return Batch(start, estimates, self._status, self._message, np.array(self._ms))
