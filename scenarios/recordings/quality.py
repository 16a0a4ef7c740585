"""How good a recording is: reciprocity, repeat noise, drift and size of the signal."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from eitbench.scenarios.errors import InputError
from eitbench.scenarios.patterns import DrivePattern
from eitbench.scenarios.recordings.descriptors import Recording


def reciprocity_error(frames: ArrayLike, pattern: DrivePattern) -> NDArray[np.float64]:
    """Relative reciprocity error (...) of `frames` (..., M): ||v' - s v|| / ||v||.

    v' and v are the values of reciprocal measurements, s = -1 where one of them is reversed. An
    ideal linear sensor gives 0; noise, stray currents and unlike channels do not.

    Raises:
        InputError: frames of another length, or a pattern without reciprocal measurements.
    """
    values = np.asarray(frames, dtype=np.float64)
    if values.ndim == 0 or values.shape[-1] != pattern.n_measurements:
        raise InputError(f"Frames need {pattern.n_measurements} values, got shape {values.shape}.")
    pairs = pattern.reciprocal_pairs()
    if len(pairs) == 0:
        raise InputError("The pattern measures nothing twice, so reciprocity says nothing.")
    first = values[..., pairs[:, 0]]
    difference = values[..., pairs[:, 1]] - pattern.reciprocal_signs(pairs) * first
    return np.asarray(np.linalg.norm(difference, axis=-1) / np.linalg.norm(first, axis=-1))


@dataclass(frozen=True)
class Quality:
    """Figures of one recording.

    All but `reciprocity` are taken value by value, relative to the reference's value, and the
    median over the M values is given: a few saturated channels would rule every mean.

    Attributes:
        signal: rms change of touched frames against the reference.
        noise: standard deviation from frame to frame within one state; NaN without repeats.
        spread: standard deviation of all frames of one state, so noise and drift together; NaN
            without repeats.
        reciprocity: relative reciprocity error of the reference; NaN if nothing is measured twice.
    """

    signal: float
    noise: float
    spread: float
    reciprocity: float


def quality(recording: Recording, pattern: DrivePattern) -> Quality:
    """The figures of `recording`, measured with `pattern`."""
    reference, samples = recording.reference, recording.samples
    touched = samples["touched"].to_numpy(dtype=bool)
    steps = [np.empty((0, len(reference)))]
    variances = []
    if "state" in samples:
        state = samples["state"].to_numpy()
        for label in np.unique(state):
            frames = recording.voltages[state == label]
            if len(frames) > 1:
                steps.append(np.diff(frames, axis=0))
                variances.append(frames.var(axis=0, ddof=1))

    def typical(deviations: NDArray[np.float64]) -> float:
        """The median over the values of rms(deviations (k, M)) relative to the reference."""
        if len(deviations) == 0:
            return float("nan")
        used = reference != 0
        rms = np.sqrt(np.mean(deviations[:, used] ** 2, axis=0))
        return float(np.median(rms / np.abs(reference[used])))

    twice = len(pattern.reciprocal_pairs()) > 0
    return Quality(
        signal=typical(recording.voltages[touched] - reference),
        # The difference of two frames has twice the variance of one.
        noise=typical(np.concatenate(steps) / np.sqrt(2)),
        spread=typical(np.sqrt(np.array(variances))),
        reciprocity=float(reciprocity_error(reference, pattern)) if twice else float("nan"),
    )
