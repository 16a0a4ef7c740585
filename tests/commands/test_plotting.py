"""An image is drawn as it lies on the sensor: in millimetres, right way up, truth beside it."""

import numpy as np
import pytest

from eitbench.plotting import plot
from eitbench.scenarios.catalogue import sensor
from eitbench.scenarios.errors import InputError


def test_an_image_lies_as_its_sensor_does() -> None:
    foam = sensor("foam16")
    image = np.ones(foam.image_shape)
    image[:10, :20] = 0.5  # at the lower left: y up to 12.5 mm, x up to 25 mm
    figure = plot(image, "foam16", truth=np.full(foam.image_shape, 0.2))
    truth, estimate, _ = figure.axes
    assert [axes.get_title() for axes in (truth, estimate)] == ["truth", "estimate"]
    (drawn,) = estimate.images
    assert drawn.origin == "lower"
    np.testing.assert_allclose(drawn.get_extent(), [0, 100, 0, 100])
    assert (drawn.norm.vmin, drawn.norm.vmax) == (0.2, 1.0)
    assert truth.images[0].norm.vmin == 0.2
    numbers = {text.get_text(): text.get_position() for text in estimate.texts}
    assert len(numbers) == 16
    assert numbers["0"] == pytest.approx((12.5, 5))  # on the lower side, inside
    assert numbers["4"] == pytest.approx((95, 12.5))
    bars = [line for line in estimate.lines if line.get_linewidth() == 3]
    np.testing.assert_allclose(np.ptp(np.asarray(bars[0].get_xdata())), 10)


def test_a_notebook_shows_it_whatever_its_settings() -> None:
    shown = plot(
        np.ones((80, 80)), "ohmc16" if sensor("ohmc16").image_shape == (80, 80) else "foam16"
    )
    assert getattr(shown, "_repr_png_")().startswith(b"\x89PNG")  # noqa: B009


def test_a_stack_of_images_is_refused() -> None:
    with pytest.raises(
        InputError, match=r"shape \(80, 80\), but the estimate has shape \(2, 80, 80\)"
    ):
        plot(np.ones((2, 80, 80)), "foam16")
