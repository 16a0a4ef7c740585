"""Measurement noise: white, Gaussian, relative to each frame, drawn from a named key."""

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from eitbench.scenarios.arrays import Array
from eitbench.scenarios.seeds import Axis, generator

# SNR in dB, no noise, or the published training mixture.
Noise = float | Literal["clean", "mixture"]

# The mixture: this share of the samples is noisy, at an SNR uniform in this range [dB].
MIXTURE_SHARE = 0.5
MIXTURE_SNR_DB = (30.0, 60.0)


def add_noise(frame: ArrayLike, snr_db: float, rng: np.random.Generator) -> Array:
    """`frame` (M,) plus white Gaussian noise of standard deviation rms(frame) 10^(-snr_db/20)."""
    clean = np.asarray(frame, dtype=np.float64)
    rms = np.sqrt(np.mean(clean**2))
    noise = rms * 10 ** (-snr_db / 20) * rng.standard_normal(clean.shape)
    return np.asarray(clean + noise)


def snr_of_touch(touch: ArrayLike, frames: ArrayLike, snr_db: float) -> Array:
    """SNR (n,) of the touch [dB]: rms of what a touch changes over rms of the noise of its frame.

    Args:
        touch: (n, M) change of the frames by the touch.
        frames: (n, M) that noise is added to.
        snr_db: of the frames; NaN where they are clean.
    """
    size = np.mean(np.square(touch), axis=1) / np.mean(np.square(frames), axis=1)
    with np.errstate(divide="ignore"):  # a frame without a touch has none
        return np.asarray(snr_db + 10 * np.log10(size))


def distance_of_touch(modelled: ArrayLike, seen: ArrayLike) -> Array:
    """How far a model is from what a board sees, in dB (n,) of the touch; greater is nearer.

    It is the rms of what the touch changes, as it is seen, over that of the model's error in it.

    Args:
        modelled: (n, M) change of the frames by the touch, by the model that methods are given,
            in the units of the board.
        seen: (n, M) the change without noise.
    """
    error = np.mean(np.square(np.subtract(seen, modelled)), axis=1)
    # Data of the model itself, and frames without a touch.
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(10 * np.log10(np.mean(np.square(seen), axis=1) / error))


def session_snr_db(
    noise: Noise, *, scenario: str, split: str, session: int, key: bytes = b""
) -> float:
    """SNR [dB] of all that is measured in a session, its reference frame too; NaN if it is clean.

    A mixture is drawn from the axes ("noise", scenario, split, "mixture", "session", session), of
    a hidden set with its secret `key`.
    """
    if noise == "clean":
        return np.nan
    if noise != "mixture":
        return float(noise)
    rng = generator("noise", scenario, split, noise, "session", session, key=key)
    return rng.uniform(*MIXTURE_SNR_DB) if rng.random() < MIXTURE_SHARE else np.nan


def measured(frame: ArrayLike, snr_db: float, *axes: Axis, key: bytes = b"") -> Array:
    """`frame` (M,) as measured at `snr_db`, with noise drawn from ("noise", *axes).

    Axes name a sample or the reference frame of a session, so that every method sees the same bits
    whatever the number of samples (trust rule 1 of CONTRIBUTING).
    """
    if np.isnan(snr_db):
        return np.array(frame, dtype=np.float64)
    return add_noise(frame, snr_db, generator("noise", *axes, key=key))
