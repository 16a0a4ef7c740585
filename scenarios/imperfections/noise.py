"""Measurement noise: white, Gaussian, relative to each frame, drawn from a named key."""

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from eitbench.scenarios.arrays import Array
from eitbench.scenarios.seeds import generator

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


def touch_snr_db(touch: ArrayLike, clean: ArrayLike, snr_db: ArrayLike) -> Array:
    """SNR (n,) of the touch [dB]: rms of what a touch changes over rms of the noise of its frame.

    Args:
        touch: (n, M) change of the frames without noise by the touch.
        clean: (n, M) these frames.
        snr_db: (n,) SNR of the frames, NaN where they are clean.
    """
    size = np.mean(np.square(touch), axis=1) / np.mean(np.square(clean), axis=1)
    with np.errstate(divide="ignore"):  # a frame without a touch has none
        return np.asarray(snr_db + 10 * np.log10(size))


def measured_frames(
    clean: ArrayLike, noise: Noise, *, scenario: str, split: str
) -> tuple[Array, Array]:
    """Frames 0..n-1 of a split as measured, and the SNR of each.

    The key of a frame's noise is ("noise", scenario, split, level, sample), so that every method
    sees the same bits whatever the number of samples (trust rule 1 of CONTRIBUTING).

    Returns:
        Voltages (n, M) and SNR (n,) [dB], NaN where a frame is clean.
    """
    frames = np.array(clean, dtype=np.float64)
    snr = np.full(len(frames), np.nan)
    if noise == "clean":
        return frames, snr
    for sample in range(len(frames)):
        rng = generator("noise", scenario, split, noise, sample)
        level = np.nan if noise == "mixture" else float(noise)
        if noise == "mixture" and rng.random() < MIXTURE_SHARE:
            level = rng.uniform(*MIXTURE_SNR_DB)
        if not np.isnan(level):
            frames[sample] = add_noise(frames[sample], level, rng)
        snr[sample] = level
    return frames, snr


def measured_reference(clean: ArrayLike, noise: Noise, *, scenario: str) -> Array:
    """The reference frame (M,) as measured, one for all splits of a scenario.

    A mixture leaves it clean: one noisy reference would repeat the same error in every sample,
    which is the opposite of augmentation.
    """
    frame = np.array(clean, dtype=np.float64)
    if noise in ("clean", "mixture"):
        return frame
    return add_noise(frame, float(noise), generator("noise", scenario, "reference", noise))
