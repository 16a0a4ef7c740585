"""Networks on a skin whose background is not 1 S/m.

With b times the conductivity and contact impedances over b, all voltages are over b (the equations
of the complete electrode model are linear in them), so that images have to be b times the others.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.support.small_sensors import suite_of

from eitbench.methods import Problem, create
from eitbench.methods.learned.image_networks import ImageNetworkMethod
from eitbench.methods.method import Method
from eitbench.methods.training import TrainingRequest, train
from eitbench.methods.weights import weight_files
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.data.datasets import Dataset, load
from eitbench.scenarios.suites.scenario import SimulatedScenario, SplitNoise

B = 0.4
SKIN = """
name = "skin"
background = {background}
image_shape = [16, 16]
conductivity_range = [0.1, 1.0]
[outline]
rectangle_mm = [100, 100]
[electrodes]
count = 16
width_mm = 10
contact_impedance = {impedance}
[pattern]
offset = 3
"""


def scenario(folder: Path, background: float) -> SimulatedScenario:
    """The same touches on a skin with this background, with noise."""
    path = folder / f"skin-{background}.toml"
    path.write_text(SKIN.format(background=background, impedance=1e-3 / background))
    noise = SplitNoise(train="mixture", validation="mixture", test=50.0)
    return SimulatedScenario(
        name="skin", sensor=str(path), families=("circle",), noise=noise, train=256, validation=32,
        test=8,
    )  # fmt: skip


def fitted(name: str, weights: Path, data: Dataset) -> Method:
    method = create(name, weights=str(weights))
    method.fit(Problem(data.sensor, data.references[0], lambda split, limit: data))
    return method


@pytest.fixture
def skins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[SimulatedScenario]:
    monkeypatch.setattr(weight_files, "user_weights", lambda: tmp_path / "weights")
    monkeypatch.setattr(weight_files, "packaged_weights", lambda: tmp_path / "packaged")
    monkeypatch.setattr("eitbench.methods.training.job.user_weights", weight_files.user_weights)
    monkeypatch.setattr(ImageNetworkMethod, "recipe", replace(ImageNetworkMethod.recipe, batch=16))
    return [scenario(tmp_path, background) for background in (1.0, B)]


def test_the_same_touches_have_voltages_over_the_background(
    skins: list[SimulatedScenario],
) -> None:
    one, other = (load(of) for of in skins)
    assert one.conductivity is not None
    assert other.conductivity is not None
    np.testing.assert_allclose(other.conductivity, B * one.conductivity, rtol=1e-12)
    np.testing.assert_allclose(other.voltages, one.voltages / B, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["dnn", "phydnn", "fno", "learned-proximal", "learned-gn"])
def test_trained_networks_give_images_of_the_background(
    name: str, skins: list[SimulatedScenario], tmp_path: Path
) -> None:
    images: list[Array] = []
    for n, of in enumerate(skins):
        suite = tmp_path / f"suite{n}"
        suite.mkdir()
        path = suite_of(suite, of)
        if name == "learned-gn":
            train(TrainingRequest("dnn", path, epochs=2, out=suite / "dnn"))
        operator = "fem" if name == "phydnn" else None
        made = train(TrainingRequest(name, path, epochs=2, out=suite / name, operator=operator))
        data = load(of)
        found = fitted(name, made.weights, data).reconstruct(data.voltages)
        images.append(found / data.sensor.background)
    contrast = np.abs(images[0] - 1).max()
    assert contrast > 0.01
    np.testing.assert_allclose(images[1], images[0], rtol=0, atol=1e-3 * contrast)
