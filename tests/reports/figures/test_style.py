"""Colours of figures: told apart by colour-blind readers, and the same in every picture."""

import json
import re
from itertools import combinations

import matplotlib as mpl
import numpy as np
import pytest
from numpy.typing import NDArray

from eitbench.hardware.live.page import page
from eitbench.reports.figures.style import COLOURS, CONDUCTIVITY_MAP, CONTRAST_MAP, marker
from eitbench.reports.page.report import _colour_maps

Array = NDArray[np.float64]
# Linear RGB as seen without red or green cones. Source: Machado, Oliveira and Fernandes,
# IEEE Transactions on Visualization and Computer Graphics 15(6), 2009, severity 1.
EYES = {
    "all cones": np.eye(3),
    "no red": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
         [-0.003882, -0.048116, 1.051998]]
    ),
    "no green": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
         [-0.011820, 0.042940, 0.968881]]
    ),
}  # fmt: skip


def lab(rgb: Array, eyes: str) -> Array:
    """CIELAB (n, 3) of sRGB colours (n, 3) from 0 to 1, D65."""
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    seen = np.clip(linear @ EYES[eyes].T, 0, 1)
    to_xyz = np.array(
        [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    )
    xyz = seen @ to_xyz.T / np.array([0.9505, 1.0, 1.089])
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    x, y, z = f.T
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=1)


@pytest.mark.parametrize("eyes", EYES)
def test_no_two_lines_have_colours_that_look_alike(eyes: str) -> None:
    colours = lab(np.array([mpl.colors.to_rgb(colour) for colour in COLOURS]), eyes)
    assert min(float(np.linalg.norm(a - b)) for a, b in combinations(colours, 2)) > 15
    pairs = [(COLOURS[k % len(COLOURS)], marker(k)) for k in range(60)]
    assert len(set(pairs)) == 60


@pytest.mark.parametrize("eyes", EYES)
def test_colour_maps_tell_low_from_high_in_all_eyes(eyes: str) -> None:
    steps = np.linspace(0, 1, 11)
    absolute, signed = (
        lab(mpl.colormaps[name](steps)[:, :3], eyes) for name in (CONDUCTIVITY_MAP, CONTRAST_MAP)
    )
    assert (np.diff(absolute[:, 0]) > 0).all()  # lightness rises
    assert np.linalg.norm(signed[0] - signed[-1]) > 30
    assert signed[5, 0] == max(signed[:, 0])  # white as the background


def test_report_and_live_view_have_the_colours_of_the_figures() -> None:
    html, _ = page()
    shown = re.search(r'id="colours">(.*?)</script>', html)
    assert shown is not None
    table = mpl.colormaps[CONDUCTIVITY_MAP](range(256), bytes=True)[:, :3]
    assert json.loads(shown[1]) == table.tolist()
    assert _colour_maps()["value"] == bytes(table.ravel()).hex()
