"""GREIT's figures of merit, against EIDORS and images whose answers are known."""

import json
from pathlib import Path

import numpy as np
import pytest

from eitbench.benchmark.metrics.greit import greit_figures, mean_magnitude, noise_figure, spread

DATA = Path(__file__).parent / "data"
EIDORS = json.loads((DATA / "greit_eidors.json").read_text())  # written by greit_eidors.m beside it


def test_figures_of_merit_are_those_of_eidors() -> None:
    x, y = np.meshgrid(*[np.linspace(-1, 1, 32)] * 2, indexing="ij")
    target = np.array([[0, 0.3, -0.55, 0.1, -0.2], [0, 0.2, 0.4, -0.75, -0.35]]).T
    width = np.array([[0.2, 0.15, 0.25, 0.12, 0.3], [0.2, 0.3, 0.15, 0.12, 0.2]]).T
    images = []
    for k, offset in enumerate([0, -0.05, 0.1, 0, 0.04]):
        a, b = target[k] + [offset, -offset]
        blob = np.exp(-(((x - a) / width[k, 0]) ** 2) - ((y - b) / width[k, 1]) ** 2)
        images.append(blob - 0.1 * (k + 1) * np.exp(-((x + b) ** 2 + (y - a) ** 2) / 0.1))
    found = greit_figures(np.array(images), target, x, y, x**2 + y**2 <= 1, 4 / 32**2)
    for name in (
        "amplitude", "position_error", "resolution", "shape_deformation", "ringing"
    ):  # fmt: skip
        assert getattr(found, name) == pytest.approx(EIDORS[name], rel=1e-10, abs=1e-12), name


def test_the_noise_figure_is_that_of_eidors() -> None:
    m, n, area = np.arange(1, 209.0), np.arange(1, 65.0), np.array(EIDORS["area"])
    matrix = np.cos(np.outer(n, m)) / (1 + np.abs(3 * n[:, None] - m))
    untouched, change = 2 + np.sin(m), 0.1 * np.exp(-(((m - 90) / 20) ** 2))
    noise = 0.01 * untouched.std(ddof=1) * np.eye(208)
    found = noise_figure(
        mean_magnitude(change[None]),
        spread(noise),
        mean_magnitude(area * (matrix @ change)[None]),
        spread(area * (matrix @ noise).T),
    )
    assert found == pytest.approx(EIDORS["noise_figure"], rel=1e-10)


def test_a_disc_has_the_figures_of_a_disc() -> None:
    axis = (np.arange(200) + 0.5) / 100 - 1
    x, y = np.meshgrid(axis, axis)
    mask = x**2 + y**2 < 1
    disc = ((x - 0.3) ** 2 + y**2 < 0.2**2).astype(float)
    figures = greit_figures(disc[None], np.array([[0.35, 0.0]]), x, y, mask, 1e-4)
    assert figures.position_error == pytest.approx([0.05], abs=1e-3)  # drawn nearer to the centre
    assert figures.resolution == pytest.approx([0.2], rel=1e-2)
    assert figures.shape_deformation < 0.01
    assert figures.ringing == [0]
    nothing = greit_figures(np.zeros((1, 200, 200)), np.zeros((1, 2)), x, y, mask, 1e-4)
    assert np.isnan([nothing.amplitude, nothing.resolution, nothing.ringing]).all()
