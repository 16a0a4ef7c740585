"""The design of tactile acuity: its lattice, its pairs, and what it refuses."""

from dataclasses import replace

import numpy as np
import pytest

from eitbench.scenarios.catalogue import sensor
from eitbench.scenarios.phantoms.acuity import Acuity
from eitbench.scenarios.phantoms.phantom import rasterise
from eitbench.scenarios.phantoms.regions import Circle
from eitbench.scenarios.sensors.outlines import rectangle
from eitbench.scenarios.sensors.sensor import even_electrodes
from eitbench.scenarios.suites.scenario import SimulatedScenario, SplitNoise
from eitbench.scenarios.suites.suite import load_suite


@pytest.mark.parametrize("name", ["foam16", "ohmc16"])
def test_every_touch_lies_inside_with_room_among_frames_without_one(name: str) -> None:
    nominal, acuity = sensor(name), Acuity()
    design = acuity.design(nominal)
    x0, y0, x1, y1 = nominal.outline.bounds
    side = min(x1 - x0, y1 - y0)
    around = np.linspace(0, 2 * np.pi, 360)
    for phantom in design:
        for press in phantom.inclusions:
            assert isinstance(press.region, Circle)
            reach = press.region.radius + 0.02 * side
            x = press.region.pose.x + 0.999 * reach * np.cos(around)
            y = press.region.pose.y + 0.999 * reach * np.sin(around)
            assert nominal.outline.contains(x, y).all()
    untouched = [k for k, p in enumerate(design) if p.family == "no-touch"]
    assert len(untouched) == acuity.untouched
    # Any first part holds its share of them.
    assert np.diff(untouched).max() <= np.ceil(len(design) / acuity.untouched)


def test_pairs_are_as_far_apart_as_they_say_and_around_their_place() -> None:
    nominal, acuity = sensor("foam16"), Acuity()
    places = acuity.places(nominal)
    pairs = [p for p in acuity.design(nominal) if p.family == "pair"]
    assert pairs
    for pair in pairs:
        of = pair.parameters
        a, b = (np.array([press.region.pose.x, press.region.pose.y]) for press in pair.inclusions)
        assert np.hypot(*(a - b)) == pytest.approx(of["probe_distance_mm"] / 1e3)
        assert (a + b) / 2 == pytest.approx(np.array(places[int(of["place"])]))
        # Both press, each at its place.
        image = rasterise(pair, nominal)
        x, y = nominal.pixel_centres
        for centre in (a, b):
            nearest = np.unravel_index(np.hypot(x - centre[0], y - centre[1]).argmin(), x.shape)
            assert image[nearest] < 0.6 * nominal.background


def test_a_design_decides_number_and_hash_of_the_test_split_alone() -> None:
    scenario = load_suite("acuity").scenarios[0]
    assert isinstance(scenario, SimulatedScenario)
    assert scenario.acuity is not None
    assert scenario.test == len(scenario.acuity.design(scenario.nominal_sensor))
    other = SimulatedScenario.model_validate(
        scenario.model_dump() | {"acuity": scenario.acuity.model_dump() | {"radius": 0.05}}
    )
    assert other.clean_parameters("test") != scenario.clean_parameters("test")
    assert other.clean_parameters("train") == scenario.clean_parameters("train")
    levels = [s for s in load_suite("acuity").scenarios if isinstance(s, SimulatedScenario)]
    assert len({str(one.clean_parameters("test")) for one in levels}) == 1
    assert len({one.data_hash("test") for one in levels}) == 3


def test_noise_that_is_not_given_and_a_sensor_without_room_are_one_sentence() -> None:
    scenario = load_suite("acuity").scenarios[0]
    with pytest.raises(ValueError, match="give the SNR of your frames in dB"):
        scenario.model_validate(scenario.model_dump() | {"noise": SplitNoise().model_dump()})
    with pytest.raises(ValueError, match="at least three rising numbers"):
        Acuity(pressures=(2e3, 1e3, 3e3))
    with pytest.raises(ValueError, match="holds up to 60000 Pa"):
        Acuity(pair_pressure=1e5)
    with pytest.raises(ValueError, match="at least one diameter apart"):
        Acuity(radius=0.06, distances=(0.1, 0.2, 0.3))
    with pytest.raises(ValueError, match=r"greater than or equal to 0\.02"):
        Acuity(step=0.001)
    outline = rectangle(0.05, 0.015)
    narrow = replace(
        sensor("foam16"), outline=outline, name="narrow",
        electrodes=even_electrodes(outline, 16, 0.003, 1e-3),
    )  # fmt: skip
    with pytest.raises(ValueError, match="'narrow' is 15 mm wide, and its foam, 10 mm thick"):
        Acuity().places(narrow)
    with pytest.raises(ValueError, match="has room for 1 places of a touch"):
        Acuity(radius=0.45, distances=(0.91, 0.93, 0.95)).places(sensor("foam16"))
