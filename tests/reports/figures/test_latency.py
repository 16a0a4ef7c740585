"""The figure of latencies: what the newest live image shows at a time."""

import warnings

import numpy as np
import pandas as pd
import pytest

from eitbench.reports.figures.latency import latency_figure


def images(strength: list[float], delay_s: float) -> pd.DataFrame:
    """Images of two touches, shown every 0.1 s, of the second touch a little later."""
    rows = [
        {
            "method": "noser", "pressure_kpa": 2.0, "ideal": ideal, "touch": touch,
            "after_onset_s": 0.1 * k - 0.5 + delay_s * touch, "after_release_s": 0.1 * k - 2.5,
            "strength": value,
        }
        for ideal in (True, False)
        for touch in (0, 1)
        for k, value in enumerate(strength)
    ]  # fmt: skip
    return pd.DataFrame(rows)


def test_an_image_is_seen_until_the_next_one_is_shown() -> None:
    figure = latency_figure(images([0.0] * 6 + [1.0] * 40, 0.02), 0.1)
    solid = figure.axes[0].lines[0]
    time_s, shown = np.asarray(solid.get_xdata()), np.asarray(solid.get_ydata())
    assert time_s[[0, -1]] == pytest.approx([-0.1, 0.35])
    assert (shown[time_s < 0.0999] == 0).all()
    assert (shown[(time_s > 0.1001) & (time_s < 0.1199)] == 50).all()  # one of two touches
    assert (shown[time_s > 0.1201] == 100).all()
    assert len(figure.axes) == 3


def test_a_method_without_images_of_touches_is_drawn_without_a_warning() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        latency_figure(images([0.0] * 5 + [np.nan] * 40, 0.0), 0.1).canvas.draw()
