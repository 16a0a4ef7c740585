"""Regressions of the place on unit frames: of presses of the skin itself, and of other skins."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from eitbench.methods.place_method import PlaceMethod, PlaceProblem
from eitbench.methods.places.kernel_ridge import gaussians, kernel_ridge, linear
from eitbench.methods.registry import register_place_method
from eitbench.scenarios.arrays import Array, unit_frames
from eitbench.scenarios.data.transfer import Presses
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.similarity import Similarity, fit_similarity

_SOURCE = "Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006"
FEWEST = 3
"""Labelled presses that a regression or a similarity needs."""


def middle(problem: PlaceProblem) -> Array:
    """The mean place (2,) of the labelled presses [m], or that of the sensor without any."""
    if len(problem.labelled):
        return np.asarray(problem.labelled.places.mean(axis=0))
    return problem.physics.sensor.outline.centre


@register_place_method("one-place")
class OnePlace(PlaceMethod):
    """Guessing: the middle of the labelled presses, whatever the frame."""

    expected_failures: ClassVar = {"learns": "it guesses"}

    def fit(self, problem: PlaceProblem) -> None:
        """Take the mean place."""
        self._problem, self._place = problem, middle(problem)

    def locate(self, differences: Array) -> Array:
        """Say the same place (n, 2) for all."""
        return np.tile(self._place, (len(self._problem.unit(differences)), 1))


class Regression(PlaceMethod):
    """A kernel ridge regression of labelled presses, which says the middle where there are none."""

    source: ClassVar[str] = _SOURCE
    linear: ClassVar[bool]

    def fit(self, problem: PlaceProblem) -> None:
        """Choose kernel and ridge by leave-one-out, among the labelled presses alone."""
        self._problem, labelled = problem, problem.labelled
        place = middle(problem)
        self._places: Callable[[Array], Array] = lambda x: np.tile(place, (len(x), 1))
        if len(labelled) >= FEWEST:
            x = problem.unit(labelled.differences)
            kernels = [linear] if self.linear else gaussians(x)
            self._places = kernel_ridge(x, labelled.places, kernels)

    def locate(self, differences: Array) -> Array:
        """Places (n, 2) [m]."""
        return self._places(self._problem.unit(differences))


@register_place_method("ridge")
class Ridge(Regression):
    """Ridge regression of the place on unit frames, learned from presses of the skin alone."""

    linear = True


@register_place_method("kernel-ridge")
class GaussianKernelRidge(Regression):
    """Kernel ridge regression of the place, learned from presses of the skin alone."""

    linear = False


@register_place_method("kernel-ridge-skins")
@dataclass
class KernelRidgeOfSkins(PlaceMethod):
    """Kernel ridge regression learned from other skins; labelled presses register and correct it.

    Kernel and ridge are chosen by leaving out one skin after the other. The correction is a kernel
    ridge regression of what the registered places lack.

    Attributes:
        presses: learned from, of each skin.
    """

    source: ClassVar[str] = _SOURCE
    presses: int = 100

    def fit(self, problem: PlaceProblem) -> None:
        """Learn from the other skins, then from the labelled presses."""
        self._problem = problem
        seen, skins = learned_from(problem.others, self.presses)
        kernels = gaussians(seen.differences)
        learned = kernel_ridge(seen.differences, seen.places, kernels, skins)
        self._places = corrected(learned, problem)

    def locate(self, differences: Array) -> Array:
        """Places (n, 2) [m]; in the coordinates of the sensor where too few are labelled."""
        return self._places(self._problem.unit(differences))


def learned_from(skins: Mapping[str, Presses], count: int) -> tuple[Presses, list[slice]]:
    """Presses of all skins with unit frames, and the rows of each skin.

    Args:
        skins: by name.
        count: most presses of each, spread evenly over the time of its recording.

    Raises:
        InputError: there is none.
    """
    if not skins:
        raise InputError("There are no other skins to learn from: name some (`others`).")
    parts, rows, start = [], [], 0
    for skin in skins.values():
        spread = np.linspace(0, len(skin) - 1, min(count, len(skin))).round().astype(np.intp)
        parts.append(skin[spread])
        rows.append(slice(start, start + len(spread)))
        start += len(spread)
    frames = unit_frames(np.concatenate([part.differences for part in parts]))
    return Presses(frames, np.concatenate([part.places for part in parts])), rows


def registered(places: Callable[[Array], Array], problem: PlaceProblem) -> Similarity:
    """The similarity from `places`, a function of unit frames, to the labelled presses.

    The identity where there are none, or too few, or where nothing is determined by them.
    """
    labelled, found = problem.labelled, None
    if len(labelled):
        found = fit_similarity(places(problem.unit(labelled.differences)), labelled.places)
    return Similarity(1.0, np.eye(2), np.zeros(2)) if found is None else found


def corrected(places: Callable[[Array], Array], problem: PlaceProblem) -> Callable[[Array], Array]:
    """A function from unit frames to `places`, registered and corrected by labelled presses."""
    register, labelled = registered(places, problem), problem.labelled
    if len(labelled) < FEWEST:
        return places
    x = problem.unit(labelled.differences)
    rest = kernel_ridge(x, labelled.places - register(places(x)), gaussians(x))
    return lambda frames: np.asarray(register(places(frames)) + rest(frames))
