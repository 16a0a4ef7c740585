"""Physics-informed networks: their equations at exact solutions, and images fitted to voltages."""

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from tests.support.small_sensors import clean_problem, foam, round_board, touch

from eitbench.methods.untrained.pinn import Pinn
from eitbench.methods.untrained.weak_form import WeakForm
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.sensors.sensor import Sensor

Array = NDArray[np.float64]


def relative(s: Sensor, sigma: Array) -> torch.Tensor:
    return torch.from_numpy(sigma / s.background).float()


def pressed(s: Sensor) -> Array:
    """A touch in the middle of the sensor."""
    x, y = s.pixel_centres
    return touch(s, (float(x.mean()), float(y.mean())))


@pytest.mark.parametrize("sensor", [foam((16, 16)), round_board()])
def test_exact_potentials_satisfy_the_equations_of_their_image_alone(sensor: Sensor) -> None:
    model = forward_model(sensor)
    equations = WeakForm(model)
    touched = pressed(sensor)
    potentials = equations.potentials(touched)
    change = model.voltages(touched) - model.voltages(model.background)
    differences, residual = equations.of(relative(sensor, touched), potentials)
    assert residual == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(differences.numpy(), change, atol=1e-4 * np.abs(change).max())
    others = {"the untouched sensor": model.background, "a weaker touch": 0.9 * touched + 0.1}
    for other, image in others.items():
        assert equations.of(relative(sensor, image), potentials)[1] > 1e-5, other


def test_the_residual_is_the_squared_error_of_the_potentials_in_energy() -> None:
    """For the untouched sensor r = G e but for the electrodes, which make it smaller."""
    s = foam((16, 16))
    equations = WeakForm(forward_model(s))
    wrong = 0.01 * torch.randn(
        len(equations.points), 16, generator=torch.Generator().manual_seed(0)
    )
    untouched = torch.ones(s.image_shape)
    residuals = [float(equations.of(untouched, scale * wrong)[1]) for scale in (1.0, 2.0)]
    assert residuals[1] == pytest.approx(4 * residuals[0], rel=1e-3)
    assert equations.of(untouched, torch.zeros_like(wrong))[1] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("sensor", [foam((12, 12)), round_board()])
@pytest.mark.parametrize("part", [0, 1])
def test_derivatives_are_those_of_finite_differences(sensor: Sensor, part: int) -> None:
    equations = WeakForm(forward_model(sensor))
    torch.manual_seed(0)
    image = relative(sensor, pressed(sensor)).clamp(0.3, 0.95).requires_grad_()
    start = 0.1 * equations.scale * torch.randn(len(equations.points), sensor.n_electrodes)
    potentials = start.requires_grad_()
    weights = torch.randn(sensor.n_measurements, dtype=torch.float64)

    def value(image: torch.Tensor, potentials: torch.Tensor) -> torch.Tensor:
        differences, residual = equations.of(image, potentials)
        return weights @ differences if part == 0 else residual

    torch.autograd.backward(value(image, potentials))
    for unknown in (image, potentials):
        assert unknown.grad is not None
        direction = torch.randn_like(unknown)
        step = 1e-2 * unknown.detach().abs().mean()
        moved = [
            float(
                value(
                    *(
                        (u + sign * step * direction if u is unknown else u).detach()
                        for u in (image, potentials)
                    )
                )
            )
            for sign in (1, -1)
        ]
        slope = (moved[0] - moved[1]) / (2 * float(step))
        assert slope == pytest.approx(float((unknown.grad * direction).sum()), rel=2e-2)


@pytest.mark.slow
def test_an_inclusion_is_recovered() -> None:
    s = foam((16, 16))
    truth = touch(s)
    problem = clean_problem(s)
    frame = forward_model(s).voltages(truth)
    method = Pinn(steps=200)
    method.fit(problem)
    found = np.sqrt(np.mean((method.reconstruct(frame[None])[0] - truth) ** 2))
    assert found < 0.55 * np.sqrt(np.mean((s.background - truth) ** 2))


@pytest.mark.slow
def test_its_potentials_come_to_satisfy_their_equation() -> None:
    """The more they must, the nearer the image's own voltages are to the frame."""
    s = foam((16, 16))
    model, problem = forward_model(s), clean_problem(s)
    frame = model.voltages(touch(s))

    def unexplained(physics: float) -> float:
        method = Pinn(steps=200, physics=physics)
        method.fit(problem)
        modelled = model.voltages(method.reconstruct(frame[None])[0])
        return float(np.linalg.norm(modelled - frame))

    assert unexplained(1e3) < 0.5 * unexplained(1e-2)


@pytest.mark.parametrize(
    ("method", "sentence"),
    [
        (Pinn(bandwidth=0.0), "'pinn' needs a positive weight of its physics and a positive band"),
        (Pinn(physics=-1.0), "got physics=-1.0"),
        (Pinn(steps=0), "'pinn' needs at least 1 step"),
    ],
)
def test_what_cannot_be_is_refused(method: Pinn, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        method.fit(clean_problem(foam()))
