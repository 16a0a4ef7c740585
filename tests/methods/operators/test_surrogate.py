"""The surrogate: a network that starts as the Jacobian, and weights that are verified."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.support.small_sensors import PAIRS, foam, round_board
from torch import Tensor

from eitbench.methods import operator
from eitbench.methods.operators.surrogate import Surrogate, SurrogateNetwork
from eitbench.methods.weights import weight_files
from eitbench.methods.weights.weight_files import sensor_key, user_weights
from eitbench.scenarios.catalogue import sensor
from eitbench.scenarios.errors import DataCorruptError, InputError
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.sensors.patterns import (
    DrivePattern,
    averaging,
    independent,
    offset_pattern,
)
from eitbench.scenarios.sensors.sensor import Sensor, even_electrodes
from eitbench.scenarios.storage.array_file import write_arrays

ABOUT = {"train_s": "12.5", "device": "abacus"}


def reversed_board() -> Sensor:
    """A round board that drives some pairs only, measures them reversed and reports magnitudes."""
    return round_board(senses=[(b, a) for a, b in PAIRS])


def network(s: Sensor, spread: float = 0.0) -> SurrogateNetwork:
    """An untrained network, its parameters moved by noise of a standard deviation `spread`."""
    torch.manual_seed(0)
    made = SurrogateNetwork(s)
    reference, jacobian = forward_model(s).linearise(forward_model(s).background)
    std = np.abs(jacobian).sum((1, 2))
    values = (reference - std / 3, std, reference, jacobian)
    made.start_from(*(torch.from_numpy(v) for v in values))
    with torch.no_grad():
        for parameter in made.parameters():
            parameter.add_(spread * torch.randn_like(parameter))
    return made


def install(s: Sensor, weights: SurrogateNetwork, folder: Path | None = None) -> Path:
    path = (folder or user_weights()) / Surrogate.files.file_name(s)
    Surrogate.files.save(path, s, weights.state_dict(), ABOUT)
    return path


def images(s: Sensor, count: int, dtype: torch.dtype = torch.float64) -> Tensor:
    rng = np.random.default_rng(1)
    sigma = s.background * rng.uniform(0.3, 1.2, (count, *s.image_shape))
    return torch.from_numpy(np.where(s.mask, sigma, s.background)).to(dtype)


@pytest.fixture(autouse=True)
def _own_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EITBENCH_CACHE", str(tmp_path / "cache"))


@pytest.fixture
def no_packaged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder in place of the packaged weights."""
    monkeypatch.setattr(weight_files, "packaged_weights", lambda: tmp_path / "packaged")
    return tmp_path / "packaged"


@pytest.mark.parametrize("make", [foam, reversed_board])
def test_an_untrained_network_is_the_jacobian(make: Callable[[], Sensor]) -> None:
    s = make()
    install(s, network(s))
    sigma = images(s, 3)
    linear = operator("jacobian", s).voltages(sigma)
    if s.pattern.magnitudes:
        linear = linear.abs()
    # Weights are stored in float32.
    torch.testing.assert_close(operator("surrogate", s).voltages(sigma), linear, rtol=1e-5, atol=0)


def test_half_of_the_measurements_are_independent_and_give_the_others() -> None:
    pattern = offset_pattern(16, 3)
    first, owner, sign = independent(pattern)
    assert len(first) == 104
    frame = forward_model(foam()).voltages(images(foam(), 1)[0].numpy())
    np.testing.assert_allclose(frame[first][owner] * sign, frame, rtol=1e-9)


def test_measurements_without_partner_reversed_or_repeated_follow_their_own() -> None:
    #            0             1 (reversed 0) 2 (alone)     3 (0 again)   4 (1 again)
    table = [[0, 1, 4, 5], [5, 4, 0, 1], [2, 3, 6, 7], [0, 1, 4, 5], [4, 5, 0, 1]]
    pattern = DrivePattern(np.array(table))
    first, owner, sign = independent(pattern)
    frame = forward_model(replace(foam(), pattern=pattern)).voltages(images(foam(), 1)[0].numpy())
    np.testing.assert_allclose(frame[first][owner] * sign, frame, rtol=1e-9)
    assert 2 in first
    assert len(first) < len(table)
    magnitudes = independent(replace(pattern, magnitudes=True))
    np.testing.assert_allclose(np.abs(frame)[magnitudes[0]][magnitudes[1]], np.abs(frame))
    assert (magnitudes[2] == 1).all()


@pytest.mark.parametrize("make", [foam, reversed_board])
def test_averages_keep_the_signal_and_halve_the_noise(make: Callable[[], Sensor]) -> None:
    s = make()
    first, owner, _ = independent(s.pattern)
    frame = forward_model(s).voltages(images(s, 1)[0].numpy())
    np.testing.assert_allclose(frame @ averaging(s.pattern), frame[first], rtol=1e-9)
    noise = np.random.default_rng(0).standard_normal((4000, s.n_measurements))
    variance = np.var(noise @ averaging(s.pattern), axis=0)
    np.testing.assert_allclose(variance, 1 / np.bincount(owner), rtol=0.12)


@pytest.mark.parametrize("make", [foam, reversed_board])
def test_reciprocity_holds_whatever_the_weights(make: Callable[[], Sensor]) -> None:
    s = make()
    install(s, network(s, spread=0.3))
    frames = operator("surrogate", s).voltages(images(s, 4).numpy())
    pairs = s.pattern.reciprocal_pairs()
    assert len(pairs) > 0
    signs = s.pattern.reciprocal_signs(pairs)
    assert np.array_equal(frames[:, pairs[:, 1]], frames[:, pairs[:, 0]] * signs)
    assert frames.std(0).min() > 0
    if s.pattern.magnitudes:
        assert frames.min() >= 0


def test_gradients_are_those_of_differences() -> None:
    s = foam((6, 7))
    install(s, network(s, spread=0.1))
    f = operator("surrogate", s)
    sigma = images(s, 2).requires_grad_()
    assert torch.autograd.gradcheck(lambda x: f.voltages(x)[:, ::13], (sigma,))


def test_precision_follows_the_input_and_batch_equals_single() -> None:
    s = foam((16, 16))
    install(s, network(s, spread=0.1))
    f = operator("surrogate", s)
    sigma = images(s, 300)
    double = f.voltages(sigma)
    assert double.dtype == torch.float64
    singles = torch.cat([f.voltages(one[None]) for one in sigma[250:262]])
    torch.testing.assert_close(singles, double[250:262], rtol=1e-12, atol=1e-12)
    single_precision = f.voltages(sigma.float())
    assert single_precision.dtype == torch.float32
    torch.testing.assert_close(single_precision.double(), double, rtol=1e-4, atol=1e-4)


def test_a_sensor_with_other_priors_finds_the_same_weights() -> None:
    s = foam()
    install(s, network(s))
    other = replace(s, conductivity_range=(0.5, 3.0), data_range=7.0)
    assert other != s
    f = operator("surrogate", other)
    assert (f.train_s, f.trained_on) == (12.5, "abacus")
    for changed in (
        replace(s, background=2.0),
        replace(s, image_shape=(10, 11)),
        replace(s, pattern=offset_pattern(16, 4)),
        replace(s, electrodes=even_electrodes(s.outline, 16, 0.011, 1e-3, start=0.0125)),
    ):
        assert sensor_key(changed) != sensor_key(s)


def test_the_users_own_weights_come_before_the_packaged(no_packaged: Path) -> None:
    s = foam()
    sigma = images(s, 1)
    install(s, network(s), no_packaged)
    packaged = operator("surrogate", s).voltages(sigma)
    own = install(s, network(s, spread=0.1))
    assert not torch.equal(operator("surrogate", s).voltages(sigma), packaged)
    own.unlink()
    assert torch.equal(operator("surrogate", s).voltages(sigma), packaged)


def test_without_weights_one_sentence_says_how_to_train_them() -> None:
    with pytest.raises(InputError, match=r"'foam16'.*12 x 12.*`eitbench train surrogate --suite"):
        operator("surrogate", foam())


def test_truncated_altered_or_foreign_files_are_named(no_packaged: Path) -> None:
    s = foam()
    path = install(s, network(s))
    whole = path.read_bytes()
    changed = bytearray(whole)
    changed[-5] ^= 1
    header = bytearray(whole)
    header[3] = 255
    for content in (b"", whole[:6], whole[:-1], whole[:200], bytes(changed), bytes(header)):
        path.write_bytes(content)
        with pytest.raises(DataCorruptError, match=rf"{path.name} is damaged.*train again"):
            operator("surrogate", s)
    write_arrays(path, {"x": np.zeros(2)}, {})
    with pytest.raises(InputError, match="for another sensor"):
        operator("surrogate", s)
    replace(Surrogate.files, name="dnn").save(path, s, {"x": torch.zeros(2)}, ABOUT)
    with pytest.raises(InputError, match="holds weights of 'dnn', not of 'surrogate'"):
        Surrogate.files.load(s)
    with pytest.raises(InputError, match=r"not of 'surrogate'. Name another file, or train with"):
        Surrogate.files.load(s, path)
    Surrogate.files.save(path, s, {"x": torch.zeros(2)}, ABOUT)
    with pytest.raises(DataCorruptError, match="does not hold the weights of a surrogate"):
        operator("surrogate", s)
    Surrogate.files.save(path, s, network(s).state_dict(), {})
    with pytest.raises(DataCorruptError, match="does not hold the weights of a surrogate"):
        operator("surrogate", s)
    path.unlink()
    packaged = no_packaged / path.name
    packaged.parent.mkdir()
    packaged.write_bytes(whole[:-1])
    with pytest.raises(DataCorruptError, match="Install eitbench again"):
        operator("surrogate", s)


def test_packaged_weights_are_far_better_than_the_jacobian() -> None:
    """On other phantoms than it was trained on: discs of many conductivities, sizes and places."""
    s = sensor("foam16")
    x, y = s.pixel_centres
    rng = np.random.default_rng(5)
    sigma = np.ones((24, 80, 80))
    for image in sigma:
        centre, radius = rng.uniform(0.02, 0.08, 2), rng.uniform(0.008, 0.02)
        image[np.hypot(x - centre[0], y - centre[1]) < radius] = rng.uniform(0.1, 0.8)
    learned = operator("surrogate", s)
    assert isinstance(learned, Surrogate)
    assert learned.train_s > 0
    path = weight_files.packaged_weights() / Surrogate.files.file_name(s)
    assert path.stat().st_size < 10e6
    exact = forward_model(s).voltages(sigma)
    errors = {
        name: np.mean(((operator(name, s).voltages(sigma) - exact) / exact.std(0)) ** 2)
        for name in ("surrogate", "jacobian")
    }
    assert errors["surrogate"] < errors["jacobian"] / 6.3
    curve = json.loads(path.with_suffix(".json").read_text())
    assert curve["command"].startswith("eitbench train surrogate --suite paper")
    assert min(epoch["validation"] for epoch in curve["curve"]) == float(curve["validation_mse"])
