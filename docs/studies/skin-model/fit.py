"""Does a skin whose conductivity and contacts vary explain the gains of its measurements?

    python docs/studies/skin-model/fit.py docs/studies/skin-model/errors.csv

The reference frame of each skin is fitted with a conductivity exp(sum c_k b_k), b_k cosines over
the skin up to an order, and a contact impedance for each electrode, by Gauss-Newton steps with a
prior. Then NOSER finds the validation presses with the Jacobian of the homogeneous or of the fitted
skin, each without and with the gains that the reference frame leaves over that model. Places are
registered by a similarity, in five parts: each is judged with the similarity of the other four. The
weight of NOSER is the best of three for each row. A simulated skin shows that the fit works.

Of recordings without labelled single presses the reference frame alone is fitted.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from eitbench import __version__
from eitbench.methods.classical.noser import noser_covariance
from eitbench.methods.classical.one_step import regularised_inverse
from eitbench.methods.normalisation import gains_of_reference
from eitbench.scenarios import forward_model, sensor
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.phantoms.contacts import locate
from eitbench.scenarios.physics.forward import ForwardModel
from eitbench.scenarios.recordings.fetch import read_recording
from eitbench.scenarios.sensors.sensor import Sensor
from eitbench.scenarios.similarity import registered_in_parts

PRESSED = ("ohmc16", "superpose500", "ohmc8")
"""All recordings of single presses with a measured reference frame and known electrodes."""
UNPRESSED = (
    "hydrogel-damage", "hydrogel-fixed",
    "sciospec-tank", "jku-tank-adjacent", "pyeidors-tank", "ktc2023",
)  # fmt: skip
"""One recording of each other sensor with a measured reference frame."""
ORDERS = (0, 1, 2, 3)
DEVIATIONS = {"conductivity": 0.5, "contact": 2.0}
"""Prior standard deviations of the logarithms: of each cosine's factor, of contact impedances."""
NOISE = 0.03  # of a value of the reference frame, relative to the frame's rms
STEPS = 12
WEIGHTS = (0.3, 1.0, 3.0)
PIXELS = (32, 32)


def cosines(skin: Sensor, order: int) -> Array:
    """Basis (K, H, W) of cosines i + j <= order in the skin's square, without the constant."""
    x0, y0, x1, y1 = skin.outline.bounds
    x, y = skin.pixel_centres
    u, v = np.pi * (x - x0) / (x1 - x0), np.pi * (y - y0) / (y1 - y0)
    pairs = [(i, k - i) for k in range(1, order + 1) for i in range(k + 1)]
    return np.array([np.cos(i * u) * np.cos(j * v) for i, j in pairs]).reshape(-1, *x.shape)


class Fit:
    """The skin with map and contacts p, in standard deviations of their priors."""

    def __init__(self, skin: Sensor, reference: Array, order: int) -> None:
        self.skin, self.reference = skin, reference
        self.basis = cosines(skin, order)
        self.size = len(self.basis) + skin.n_electrodes * (order > 0)

    def model(self, p: Array) -> tuple[ForwardModel, Array]:
        """The forward model with the contacts of `p`, and its conductivity (H, W)."""
        cosine, contact = np.split(p, [len(self.basis)])
        electrodes = self.skin.electrodes
        if len(contact):
            factors = np.exp(DEVIATIONS["contact"] * contact).tolist()
            electrodes = tuple(
                replace(e, contact_impedance=e.contact_impedance * factor)
                for e, factor in zip(electrodes, factors, strict=True)
            )
        fitted = ForwardModel(
            replace(self.skin, electrodes=electrodes), forward_model(self.skin).mesh
        )
        map_ = np.exp(DEVIATIONS["conductivity"] * np.tensordot(cosine, self.basis, 1))
        return fitted, fitted.background * map_

    def frame(self, p: Array) -> Array:
        """The model's frame (M,) [V/A]."""
        model, conductivity = self.model(p)
        return np.asarray(model.voltages(conductivity))

    def factor(self, frame: Array) -> float:
        """The least-squares factor from a model's frame (M,) to the reference frame."""
        return float(frame @ self.reference / (frame @ frame))

    def residual(self, p: Array) -> Array:
        """What the best factor leaves of the reference frame (M,), over the noise."""
        frame = self.frame(p)
        rms = np.sqrt(np.mean(self.reference**2))
        return np.asarray((self.reference - self.factor(frame) * frame) / (NOISE * rms))

    def slopes(self, p: Array) -> Array:
        """Derivative (M, P) of `residual`: the model's adjoint one of the map, else differences."""
        model, conductivity = self.model(p)
        frame, rows = model.linearise(conductivity)
        along = np.tensordot(
            rows, DEVIATIONS["conductivity"] * self.basis * conductivity, ([1, 2], [1, 2])
        )
        steps = 1e-3 * np.eye(self.size)[len(self.basis) :]
        contacts = [(self.frame(p + step) - frame) / 1e-3 for step in steps]
        change = np.column_stack([along, *contacts])
        rms = np.sqrt(np.mean(self.reference**2))
        # The best factor changes, too.
        c = self.factor(frame)
        of_factor = (self.reference @ change - 2 * c * (frame @ change)) / (frame @ frame)
        return np.asarray(-(c * change + np.outer(frame, of_factor)) / (NOISE * rms))

    def misfit(self, p: Array) -> float:
        """Norm of what the best factor leaves, relative to the reference frame."""
        return float(np.linalg.norm(self.residual(p)) * NOISE / np.sqrt(len(self.reference)))

    def solve(self) -> Array:
        """The most probable p (P,)."""
        p = np.zeros(self.size)
        for _ in range(STEPS if self.size else 0):
            residual, slopes = self.residual(p), self.slopes(p)
            update = np.linalg.solve(
                slopes.T @ slopes + np.eye(self.size), -(slopes.T @ residual) - p
            )
            now = residual @ residual + p @ p
            for length in (1.0, 0.5, 0.25, 0.1, 0.03):
                tried = np.clip(p + length * update, -4, 4)
                if (r := self.residual(tried)) @ r + tried @ tried < now:
                    break
            else:
                break
            p = tried
        return p


def least_misfit(skin: Sensor, reference: Array) -> float:
    """The least misfit that any skin can have: of a linear one a reversed drive has one magnitude.

    The nearest such frame is the mean of the values of both directions of a drive. NaN where drives
    have one direction alone.
    """
    table = skin.pattern.table.tolist()
    row = {tuple(entry): k for k, entry in enumerate(table)}
    if any((sink, src, a, b) not in row for src, sink, a, b in table):
        return float("nan")
    turned = [row[sink, src, a, b] for src, sink, a, b in table]
    return float(np.linalg.norm(reference - reference[turned]) / 2 / np.linalg.norm(reference))


def simulated(name: str) -> list[dict[str, object]]:
    """The fit of a simulated frame of a skin with a drawn map of order 2 and drawn contacts."""
    skin = replace(sensor(name), image_shape=PIXELS)
    drawn = Fit(skin, np.ones(skin.n_measurements), 2)
    rng = np.random.default_rng(0)
    frame = drawn.frame(rng.standard_normal(drawn.size) * 0.7)
    frame *= 1 + 0.01 * rng.standard_normal(len(frame))
    fits = [Fit(skin, frame, order) for order in ORDERS]
    return [
        {
            "skin": f"{name}, simulated",
            "order": order,
            "misfit": round(fit.misfit(fit.solve()), 4),
        }
        for order, fit in zip(ORDERS, fits, strict=True)
    ]


def press_error(rows: Array, changes: Array, places: Array, skin: Sensor, weight: float) -> float:
    """Median error [mm] of NOSER with the Jacobian `rows` (M, P), registered in five parts."""
    covariance = noser_covariance(rows)
    matrix = regularised_inverse(rows, covariance[:, None] * rows.T, weight)
    images = np.zeros((len(changes), *skin.image_shape))
    images[:, skin.mask] = np.minimum(changes @ matrix.T, 0)
    return float(1e3 * np.nanmedian(registered_in_parts(locate(images, skin), places)))


def errors(name: str) -> list[dict[str, object]]:
    """The rows of a skin with labelled presses."""
    recording = read_recording(name).without_test()
    skin = replace(sensor(name), image_shape=PIXELS)
    changes = recording.voltages - recording.reference
    places = recording.samples[["x_m", "y_m"]].to_numpy()
    found = []
    for order in ORDERS:
        fit = Fit(skin, recording.reference, order)
        p = fit.solve()
        model, conductivity = fit.model(p)
        frame, rows = model.linearise(conductivity)
        rows = rows[:, skin.mask] * conductivity[skin.mask]
        kept = np.ones(len(frame), dtype=bool)
        gains = gains_of_reference(recording.reference, frame, kept)
        change = changes / fit.factor(frame) if fit.factor(frame) > 0 else changes
        spread = np.exp(np.ptp(np.log(conductivity[skin.mask])))
        for power in (0.0, 0.5, 1.0):
            scaled = gains[:, None] ** power * rows
            best = min(
                (press_error(scaled, change, places, skin, weight), weight) for weight in WEIGHTS
            )
            row = {
                "skin": name, "order": order, "misfit": round(fit.misfit(p), 4),
                "least_misfit": round(least_misfit(skin, recording.reference), 4),
                "conductivity_ratio": round(float(spread), 2), "gain_power": power,
                "error_mm": round(best[0], 2), "weight": best[1],
            }  # fmt: skip
            found.append(row)
            print(row, flush=True)
    return found


def misfits(name: str) -> list[dict[str, object]]:
    """The rows of a sensor of which the reference frame alone is fitted."""
    reference = read_recording(name).reference
    skin = replace(sensor(name), image_shape=PIXELS)
    found = []
    for order in ORDERS:
        fit = Fit(skin, reference, order)
        row: dict[str, object] = {
            "skin": name, "order": order, "misfit": round(fit.misfit(fit.solve()), 4),
            "least_misfit": round(least_misfit(skin, reference), 4),
        }  # fmt: skip
        found.append(row)
        print(row, flush=True)
    return found


if __name__ == "__main__":
    table = pd.DataFrame(
        [
            *simulated("ohmc16"),
            *(row for name in PRESSED for row in errors(name)),
            *(row for name in UNPRESSED for row in misfits(name)),
        ]
    ).assign(version=__version__)
    table.to_csv(Path(sys.argv[1]), index=False, lineterminator="\n")
