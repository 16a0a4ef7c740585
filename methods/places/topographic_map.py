"""The map from places to frames of one skin, found from presses that nobody has labelled.

Frames of one press each depend on two numbers, so that those of a skin lie near a surface of two
dimensions, however its board, cuts and layers distort it. A generative topographic mapping finds
the surface: a smooth function from the places of a grid to frames, and noise whose covariance is
that of what it leaves unexplained. It is fitted by expectation and maximisation: the probability of
every place for every frame, then the function and the noise that fit these best. That the presses
are spread evenly over a disc is part of the model and keeps the surface from folding. A rough
guess of each place starts it, and stays a weak prior; labelled presses have their places.

Sources: Bishop, Svensen and Williams, GTM: The generative topographic mapping, Neural Computation
10 (1998) 215; for even spreading, Sinkhorn and Knopp, Pacific J. Math. 21 (1967) 343.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.linalg import solve_triangular
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.distance import cdist

from eitbench.methods.place_method import PlaceMethod, PlaceProblem
from eitbench.methods.places.kernel_ridge import KernelRidge, gaussian, gaussians, kernel_ridge
from eitbench.methods.places.regressions import FEWEST, learned_from, middle
from eitbench.methods.registry import register_place_method
from eitbench.scenarios.arrays import Array, unit_frames
from eitbench.scenarios.similarity import Similarity, fit_similarity

Guess = Callable[[Array], Array]

# Lengths are multiples of the disc's radius. The settings were chosen by trial on eight of the
# thirteen `cam09` skins; 07, 08, 10, 15 and 18 chose nothing.
NODES_ACROSS = 21
STEPS = 16
SMOOTHNESS = 0.4
"""Length over which the frames of neighbouring places are alike."""
RIDGE = 0.1
"""Variance of a node's mean frame over that of the function, at the mean number of presses."""
GUESS = 0.5
"""Standard deviation of the guess as a prior of the place."""
TEMPERATURE = 0.5
"""Power of the likelihood: the noise of the values of one press is not Gaussian."""
EVENNESS = 0.5
"""Power of the factor that makes the density of places even, once a step."""
LABELLED = 20.0
"""Presses that one labelled press counts for: about as many as have their place at the start."""
FLOOR = 0.05
"""Variance of a value that is always noise, as a share of the value's mean square."""
PRESSES_OF_A_SKIN = 60
ELSEWHERE = 1.5
"""Distance of a labelled place from the centre of the others, in radii of their disc, that only
other coordinates explain."""
_SAME = Similarity(1.0, np.eye(2), np.zeros(2))


@dataclass(frozen=True)
class PressedDisc:
    """The disc over which presses are spread evenly, in any coordinates.

    Attributes:
        centre: (2,) [m].
        radius: [m].
    """

    centre: tuple[float, float]
    radius: float

    def relative(self, places: Array) -> Array:
        """Places (n, 2) as multiples of the radius from the centre."""
        return np.asarray((places - self.centre) / self.radius)

    def absolute(self, relative: Array) -> Array:
        """Return the places (n, 2) [m] of what `relative` made of them."""
        return np.asarray(self.centre + self.radius * relative)


def disc_of(places: Array) -> PressedDisc:
    """The disc from which `places` (n, 2) [m] were drawn evenly: a little over the smallest around.

    Source: Badoiu and Clarkson, SODA 2003, for the smallest circle, to a thousandth.
    """
    try:
        hull = places[ConvexHull(places).vertices]
    except QhullError:  # they are on a line
        hull = places
    centre = hull.mean(axis=0)
    for step in range(2, 1000):
        centre = centre + (hull[np.hypot(*(hull - centre).T).argmax()] - centre) / step
    farthest = float(np.hypot(*(hull - centre).T).max())
    return PressedDisc((float(centre[0]), float(centre[1])), farthest * (1 + 1 / len(places)))


def _disc_of_both(seen: Array, labelled: Array) -> PressedDisc:
    """The disc of places of other skins (n, 2) and labelled ones (k, 2) [m].

    Those of other skins are the sensor's, labelled ones this skin's robot's, which may count from
    elsewhere: then the labelled ones alone say where the centre is.
    """
    of_others = disc_of(seen)
    if not len(labelled) or np.hypot(*of_others.relative(labelled).T).max() < ELSEWHERE:
        return disc_of(np.concatenate([seen, labelled]))
    own = disc_of(labelled)
    return PressedDisc(own.centre, max(own.radius, of_others.radius))


def compressed(differences: Array) -> Array:
    """Frames (n, M) of unit rms from signed square roots: the largest values do not rule."""
    frames = unit_frames(differences)
    return unit_frames(np.sign(frames) * np.sqrt(np.abs(frames)))


class TopographicMap:
    """The surface of a skin's frames, and the places of frames on it, relative to the disc.

    Args:
        frames: (n, M) of presses with unknown places, any scale.
        guesses: (n, 2) of their places.
        labelled: (l, M) frames with known places (l, 2); there may be none.
    """

    def __init__(self, frames: Array, guesses: Array, labelled: Array, places: Array) -> None:
        axis = np.linspace(-1, 1, NODES_ACROSS)
        square = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
        self._nodes = square[np.hypot(*square.T) <= 1]
        self._scale = np.sqrt(np.mean(frames**2, axis=0)) + 1e-12
        x, known = frames / self._scale, labelled / self._scale
        kernel = gaussian(SMOOTHNESS, self._nodes, self._nodes)
        near = _shares(-self._distances(places) / (axis[1] - axis[0]) ** 2)
        prior = -self._distances(guesses) / (2 * GUESS**2)
        self._density = np.ones(len(self._nodes))
        shares = _shares(-self._distances(guesses) / (2 * (0.6 * GUESS) ** 2))
        for _ in range(STEPS):
            counts = shares.sum(axis=0) + LABELLED * near.sum(axis=0) + 1e-6
            means = (shares.T @ x + LABELLED * near.T @ known) / counts[:, None]
            damped = kernel + RIDGE * np.diag(counts.mean() / counts)
            surface = kernel @ np.linalg.solve(damped, means)
            rest = x - shares @ surface
            noise = rest.T @ rest / len(x) + FLOOR * np.eye(x.shape[1])
            self._root = np.linalg.cholesky(noise)
            self._surface = self._white(surface)
            likelihood = np.exp(_from_largest(self._fit(x) + prior))
            each = likelihood @ self._density
            expected = (likelihood / each[:, None]).sum(axis=0) * self._density
            self._density *= (len(x) / len(self._nodes) / (expected + 1e-3)) ** EVENNESS
            self._density /= self._density.mean()
            shares = likelihood * self._density
            shares /= shares.sum(axis=1, keepdims=True)

    def locate(self, frames: Array, guesses: Array) -> Array:
        """Mean places (n, 2) of frames (n, M), with guesses (n, 2) of them."""
        prior = np.log(self._density) - self._distances(guesses) / (2 * GUESS**2)
        return np.asarray(_shares(self._fit(frames / self._scale) + prior) @ self._nodes)

    def _distances(self, places: Array) -> Array:
        return cdist(places, self._nodes, "sqeuclidean")

    def _white(self, x: Array) -> Array:
        return np.asarray(solve_triangular(self._root, x.T, lower=True).T)

    def _fit(self, x: Array) -> Array:
        """Logarithm of the tempered likelihood (n, nodes) of scaled frames, up to a constant."""
        white, surface = self._white(x), self._surface
        return np.asarray(TEMPERATURE * (white @ surface.T - 0.5 * np.sum(surface**2, axis=1)))


def _from_largest(logarithms: Array) -> Array:
    return np.asarray(logarithms - logarithms.max(axis=1, keepdims=True))


def _shares(logarithms: Array) -> Array:
    """Rows that sum to 1, proportional to the exponential of `logarithms` (n, k)."""
    parts = np.exp(_from_largest(logarithms))
    return np.asarray(parts / parts.sum(axis=1, keepdims=True))


def spread(places: Array, over: Array) -> Array:
    """`places` (n, 2) at the radii where `over` (k, 2) would fill the unit disc evenly.

    Regressions that know little say places near the middle.
    """
    centre = np.median(over, axis=0)
    ordered = np.sort(np.hypot(*(over - centre).T))
    radii = np.hypot(*(places - centre).T)
    rank = (np.searchsorted(ordered, radii) + 0.5) / (len(ordered) + 1)
    return np.asarray((places - centre) * (np.sqrt(rank) / np.maximum(radii, 1e-12))[:, None])


def _regression(frames: Array, places: Array, blocks: Sequence[slice] = ()) -> KernelRidge:
    """Kernel ridge of one width: it only starts the map."""
    return kernel_ridge(frames, places, gaussians(frames)[1:2], blocks)


@register_place_method("topographic-map")
class TopographicMapOfSkin(PlaceMethod):
    """Generative topographic mapping of unlabelled presses, placed by labelled ones of the skin."""

    source: ClassVar[str] = "Bishop, Svensen and Williams, Neural Computation 10 (1998) 215"

    def fit(self, problem: PlaceProblem) -> None:
        """Guess the place of every unlabelled press, and fit the map to all of them."""
        self._problem, labelled = problem, problem.labelled
        self._map = None
        if (guess := self._guess(problem)) is None:
            self._place = middle(problem)
            return
        self._guessed, self._disc = guess
        frames = compressed(problem.unit(problem.unlabelled))
        known = compressed(labelled.differences), self._disc.relative(labelled.places)
        self._map = TopographicMap(frames, self._guessed(frames), *known)

    def locate(self, differences: Array) -> Array:
        """Places (n, 2) [m]; all the same where there is nothing to guess from."""
        frames = compressed(self._problem.unit(differences))
        if self._map is None:
            return np.tile(self._place, (len(frames), 1))
        return self._disc.absolute(self._map.locate(frames, self._guessed(frames)))

    def _guess(self, problem: PlaceProblem) -> tuple[Guess, PressedDisc] | None:
        """Return a function from compressed frames to places relative to the disc, and the disc."""
        labelled = problem.labelled
        if len(labelled) < FEWEST:
            return None
        disc = disc_of(labelled.places)
        return _regression(compressed(labelled.differences), disc.relative(labelled.places)), disc


@register_place_method("topographic-map-skins")
class TopographicMapOfSkins(TopographicMapOfSkin):
    """Generative topographic mapping of unlabelled presses, which other skins start.

    Without labelled presses it has the coordinates of the sensor, so far as the map keeps them.
    """

    def _guess(self, problem: PlaceProblem) -> tuple[Guess, PressedDisc] | None:
        labelled = problem.labelled
        if not problem.others:
            return super()._guess(problem)
        seen, blocks = learned_from(problem.others, PRESSES_OF_A_SKIN)
        learned = _regression(compressed(seen.differences), seen.places, blocks)
        disc = _disc_of_both(seen.places, labelled.places)
        if len(labelled) < FEWEST:
            over = disc.relative(learned(compressed(problem.unlabelled)))
            return lambda frames: spread(disc.relative(learned(frames)), over), disc
        x = compressed(labelled.differences)
        register = fit_similarity(learned(x), labelled.places) or _SAME
        rest = _regression(x, labelled.places - register(learned(x)))
        return lambda frames: disc.relative(register(learned(frames)) + rest(frames)), disc
