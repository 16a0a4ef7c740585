"""Similarities of the plane: from the coordinates of images or methods to those of a robot."""

import json
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from eitbench.scenarios.arrays import Array

_WEISZFELD_STEPS = 30


@dataclass(frozen=True, eq=False)
class Similarity:
    """x -> scale * turn @ x + shift in the plane.

    Attributes:
        scale: > 0.
        turn: (2, 2) rotation, or rotation with reflection.
        shift: (2,) [m].
    """

    scale: float
    turn: Array
    shift: Array

    def __call__(self, points: ArrayLike) -> Array:
        """Map `points` (n, 2) [m]."""
        return np.asarray(self.scale * np.asarray(points, float) @ self.turn.T + self.shift)

    def inverse(self, points: ArrayLike) -> Array:
        """Map `points` (n, 2) [m] back."""
        return np.asarray((np.asarray(points, float) - self.shift) @ self.turn / self.scale)

    def to_json(self) -> str:
        """Return JSON that `from_json` reads without loss."""
        return json.dumps([self.scale, self.turn.tolist(), self.shift.tolist()])

    @classmethod
    def from_json(cls, text: str) -> "Similarity":
        """Read what `to_json` wrote.

        Raises:
            ValueError, TypeError: it is no similarity.
        """
        try:
            scale, turn, shift = json.loads(text)
            found = cls(float(scale), np.array(turn, float), np.array(shift, float))
        except (OverflowError, RecursionError) as error:
            raise ValueError("it is no similarity") from error
        sound = found.turn.shape == (2, 2) and found.shift.shape == (2,)
        if not (
            sound
            and 0 < found.scale < math.inf
            and np.isfinite(found.shift).all()
            and np.allclose(found.turn @ found.turn.T, np.eye(2), atol=1e-9)
        ):
            raise ValueError("it is no similarity")
        return found


def fit_similarity(source: ArrayLike, target: ArrayLike) -> Similarity | None:
    """Fit the similarity, with or without reflection, that maps `source` best onto `target`.

    It makes the sum of distances least over points (n, 2) [m], not that of their squares: a method
    that loses some contacts altogether keeps the registration of those it finds. Rows with NaN are
    left out. None where fewer than three points are left, or where they determine no similarity.

    Source: Umeyama, IEEE Trans. Pattern Anal. 13 (1991) 376, eqs. 40-43, without the constraint on
    the determinant, so that reflections are allowed; repeated with the points weighted by their
    inverse distances (Weiszfeld's iteration).
    """
    x, y = np.asarray(source, float), np.asarray(target, float)
    known = np.isfinite(x).all(axis=1) & np.isfinite(y).all(axis=1)
    x, y = x[known], y[known]
    if len(x) < 3:
        return None
    weights = np.ones(len(x))
    # Points that lie this close count alike: a distance of zero must not weigh infinitely.
    close = 0.01 * float(np.sqrt(np.mean((y - y.mean(axis=0)) ** 2)))
    fitted = _weighted_similarity(x, y, weights)
    for _ in range(_WEISZFELD_STEPS):
        if fitted is None:
            break
        weights = 1 / np.maximum(np.hypot(*(fitted(x) - y).T), close)
        fitted = _weighted_similarity(x, y, weights)
    return fitted


def registered_in_parts(found: ArrayLike, places: ArrayLike, parts: int = 5) -> Array:
    """Return distances (n,) [m] of points `found` (n, 2) [m] from their `places` (n, 2) [m].

    Point k belongs to part k modulo `parts`, and is mapped by the similarity that fits the points
    of all other parts. NaN where nothing was found or nothing fits.
    """
    x, y = np.asarray(found, float), np.asarray(places, float)
    part, distance = np.arange(len(y)) % parts, np.full(len(y), np.nan)
    for k in range(parts):
        if register := fit_similarity(x[part != k], y[part != k]):
            distance[part == k] = np.hypot(*(register(x[part == k]) - y[part == k]).T)
    return distance


def _weighted_similarity(x: Array, y: Array, weights: Array) -> Similarity | None:
    w = (weights / weights.sum())[:, None]
    x_mean, y_mean = (w * x).sum(axis=0), (w * y).sum(axis=0)
    if np.abs(x - x_mean).max() <= 1e-9 * max(np.abs(x).max(), np.abs(y - y_mean).max()):
        return None  # always the same point, but for rounding
    u, singular, vt = np.linalg.svd((w * (y - y_mean)).T @ (x - x_mean))
    # A second singular value of zero leaves open whether to reflect.
    if singular[1] <= 1e-12 * singular[0] or singular[0] == 0:
        return None
    turn = u @ vt
    scale = float(singular.sum() / (w * (x - x_mean) ** 2).sum())
    return Similarity(scale, turn, y_mean - scale * turn @ x_mean)
