"""Readings of the published rows, against the physics of what they pretend."""

import numpy as np
import pytest

from eitbench.benchmark.metrics.image_metrics import image_figures
from eitbench.benchmark.studies.readings import (
    AXES,
    published_readings,
    renumbered,
    scaled_to,
    wrong_frames,
)
from eitbench.benchmark.tuning.selection import selected_parameters
from eitbench.methods import Problem, create
from eitbench.methods.method import reconstructed
from eitbench.methods.problem import no_split
from eitbench.scenarios import forward_model, load, load_suite, sensor

PUBLISHED = {"noser": {"rie": 1.2130}}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("taken_for", "axes"),
    [
        (lambda e: (e + 4) % 16, "turned by 90 degrees"),
        (lambda e: (e - 4) % 16, "turned by 270 degrees"),
        (lambda e: (e + 8) % 16, "turned by 180 degrees"),
        (lambda e: (3 - e) % 16, "columns reversed"),
        (lambda e: 15 - e, "exchanged"),
    ],
)
def test_renumbered_electrodes_measure_the_image_that_lies_so(taken_for: object, axes: str) -> None:
    """On a square with four electrodes a side, a shift by four is a turn by 90 degrees."""
    foam = sensor("foam16")
    image = np.ones((1, *foam.image_shape))
    image[0, 10:30, 45:60] = 0.3
    model = forward_model(foam)
    assert callable(taken_for)
    rows = renumbered(foam.pattern.table, taken_for(np.arange(16)))
    frames = model.voltages(image)[:, rows]
    np.testing.assert_allclose(frames, model.voltages(AXES[axes](image)), rtol=1e-9)


def test_the_factor_gives_the_rie_that_was_asked_for() -> None:
    rng = np.random.default_rng(3)
    truth = 1 + rng.random((5, 20))
    change = rng.standard_normal((5, 20))
    factor = scaled_to(1.3, truth - 1, change, truth)
    assert factor is not None
    errors = np.linalg.norm(truth - 1 - factor * change, axis=1) / np.linalg.norm(truth, axis=1)
    assert errors.mean() == pytest.approx(1.3, rel=1e-9)
    assert scaled_to(1.3, truth - 1, np.zeros_like(change), truth) is None


@pytest.mark.slow
def test_the_plain_reading_is_the_benchmark_s_own_and_axes_leave_its_rie_near() -> None:
    table = published_readings(PUBLISHED, samples=3)
    scenario = load_suite("paper").scenarios[0]
    data = load(scenario, "test", 3)
    truth = data.conductivity
    assert truth is not None
    method = create("noser", **(selected_parameters(scenario, "noser") or {}))
    problem = Problem(data.sensor, data.references[0], no_split)
    method.fit(problem)
    images = reconstructed(method, problem, data).astype(np.float64)
    expected = image_figures(truth, images, data.sensor.data_range)
    plain = table.iloc[0]
    for name, values in expected.items():
        assert plain[name] == pytest.approx(values.mean(), rel=1e-12)
    # Leaving out the background changes the error, and not the correlation.
    without = table.query("frames == 'as they are' and axes == 'as they are' and not background")
    assert np.allclose(without[without["sign"] > 0]["cc"], plain["cc"])
    assert (without["rie"] > 5 * plain["rie"]).all()
    fitted = table[table["strength"] != 1.0]
    np.testing.assert_allclose(fitted["rie"], PUBLISHED["noser"]["rie"], rtol=1e-9)
    assert set(table["axes"]) == set(AXES)
    assert len(set(table["frames"])) == len(list(wrong_frames(data, truth)))
