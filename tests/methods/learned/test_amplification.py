"""Frames amplified before they go through a network, and contrasts weakened after."""

from __future__ import annotations

import numpy as np
import pytest

from eitbench.methods.method import Method
from eitbench.methods.problem import Problem, no_split
from eitbench.methods.registry import create
from eitbench.scenarios import sensor
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.sensors.sensor import Sensor

OHMC, FOAM = sensor("ohmc16"), sensor("foam16")
A = 4.0
WEAK = 0.03
"""Contrast of a weak touch."""


def touched(skin: Sensor, contrast: float) -> Array:
    """Conductivity (H, W) of a skin with a disc of so much less than the background."""
    x, y = skin.pixel_centres
    middle = (x.min() + x.max()) / 2, (y.min() + y.max()) / 2
    disc = np.hypot(x - middle[0] - 0.02, y - middle[1] - 0.01) < 0.012
    return np.where(disc & skin.mask, 1 - contrast, 1.0) * skin.background


def frames(skin: Sensor, contrast: float) -> tuple[Array, Array]:
    """Frame (1, M) of it without noise, and the frame (M,) of the untouched skin."""
    model = forward_model(skin)
    return model.voltages(touched(skin, contrast))[None], model.voltages(model.background)


def fitted(name: str, skin: Sensor, **parameters: object) -> Method:
    """The method, for the nominal skin."""
    method = create(name, **parameters)
    method.fit(Problem(skin, frames(skin, 0.0)[1], no_split))
    return method


@pytest.mark.parametrize(
    ("name", "skin"),
    [
        ("dnn", OHMC), ("learned-gn", OHMC), ("coarse-to-fine", OHMC), ("latent-flow", OHMC),
        ("network-ensemble", OHMC), ("dnn-heteroscedastic", FOAM),
    ],
)  # fmt: skip
def test_frames_are_amplified_and_contrasts_and_spreads_weakened(name: str, skin: Sensor) -> None:
    frame, untouched = frames(skin, 0.1)
    amplified = untouched + A * (frame - untouched)
    method, plain = fitted(name, skin, amplification=A), fitted(name, skin)
    image, expected = (of.reconstruct(f) for of, f in ((method, frame), (plain, amplified)))
    contrast = (expected - skin.background) / A
    np.testing.assert_allclose(image - skin.background, contrast, rtol=0, atol=2e-6)
    assert np.abs(contrast[0][skin.mask]).max() > 0.005
    if type(method).states_uncertainty():
        about, wide = method.uncertainty(frame), plain.uncertainty(amplified)
        if about.ndim == 4:  # draws
            about, wide = about - skin.background, wide - skin.background
        assert np.abs(wide).max() > 0.005
        np.testing.assert_allclose(about, wide / A, rtol=0, atol=2e-6)


@pytest.mark.parametrize("name", ["dnn", "phydnn", "learned-gn", "coarse-to-fine", "latent-flow"])
def test_a_weak_touch_is_noise_to_a_network_until_it_is_amplified(name: str) -> None:
    """Without noise; networks of `ohmc16` were trained with 40 dB of it."""
    frame, _ = frames(OHMC, WEAK)
    truth = touched(OHMC, WEAK) - OHMC.background
    shown, likeness = [], []
    for amplification in (1.0, 8.0):
        method = fitted(name, OHMC, amplification=amplification)
        image = method.reconstruct(frame)[0] - OHMC.background
        shown.append(image[truth < 0].mean() / truth.min())
        likeness.append(np.corrcoef(image[OHMC.mask], truth[OHMC.mask])[0, 1])
    assert shown[0] < 0.05
    assert shown[1] > 3 * shown[0]
    assert likeness[0] < 0.15
    assert likeness[1] > 0.5


@pytest.mark.parametrize("amplification", [0.0, -1.0, np.nan, np.inf])
def test_an_amplification_is_above_zero(amplification: float) -> None:
    with pytest.raises(InputError, match="'amplification' is a number above 0"):
        fitted("dnn", OHMC, amplification=amplification)
