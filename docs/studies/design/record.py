"""The bounds of `eitbench design` beside the errors of presses on recorded skins.

`python docs/studies/design/record.py` writes `skins.csv`, one row for each skin, and `record.json`,
of which `make tables` makes the tables of docs/design.md. No skin's gain is known, and contrast and
gain cannot be told apart; so the measured ratio of signal to noise is taken, which is all that a
bound depends on. The presses are those of the suite `new-skin`: `LABELLED` labelled ones, and
presses to be located.

Noise: of a change (pressed minus released), from presses and their nearest neighbours of equal
depth, closer than `NEAR`: half the mean square of what their changes differ by, without pairs that
differ more than `OUTLIER` times as much as the median one, as medians of errors are compared. With
these pairs, too, the first bound is `noise_with_outliers`.
The two-layer skins have neighbours 0.4 mm away in the median, the discs of one layer 3 mm, which
adds little. Where the robot's height is not known (`cam09-04` to `-06`) it is part of the noise.

Touch: a drop of conductivity of radius `RADIUS`. The size of the model's changes is put to that of
the measured ones: medians over the labelled presses of the sum of squares, noise taken off.

Three predictions of the place error, for each press that is located; the bound of a normal error
has the median sqrt(ln 2) sqrt(var x + var y) where x and y are alike, and this is compared:

- noise: the model's changes in white noise of the measured size, as `eitbench design --snr` has it.
- misfit: the model's changes; the noise is all that the model leaves of the measured changes of the
  labelled presses, each with the strength that fits best, with its covariance over values.
- response: the changes are those of the skin itself, kernel ridge regression from place to frame;
  the noise is as measured, with its covariance over values. No model takes part.

Of each skin also Spearman's rank correlations over the presses: of predicted with measured error,
of either with the distance from the rim, and of the prediction with errors drawn at random from it
(normal, the mean of 200 draws), which is what a right prediction would have.

Four measured errors: the most likely place in the model's own terms under either noise (the place
of the best fit, registered on the labelled presses), `noser`, and kernel ridge regression, both as
in the suite `new-skin`.
"""

import json
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import stats
from scipy.spatial import cKDTree

from eitbench import __version__
from eitbench.benchmark.design.bounds import Touch, WhitenedJacobian, maps, room, whitened
from eitbench.benchmark.rundir.manifest import git_commit
from eitbench.methods.place_method import PlaceProblem
from eitbench.methods.places.by_image import create_place_method
from eitbench.methods.places.kernel_ridge import gaussian, kernel_ridge
from eitbench.methods.problem import no_split
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.data.transfer import load_transfer
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.recordings.fetch import read_recording
from eitbench.scenarios.sensors.sensor import Sensor
from eitbench.scenarios.similarity import fit_similarity
from eitbench.scenarios.suites.scenario import TransferScenario

OUT = Path(__file__).resolve().parent
SKINS = (
    *(f"cam09-{k:02d}" for k in (4, 5, 6, 7, 8, 9, 10, 11, 12, 14, 15, 16, 18)),
    "ohmc16", "superpose500", "ohmc8",
)  # fmt: skip
LABELLED = 400
NEAR = 5e-3
OUTLIER = 2.0
"""Size of a difference of neighbours over the median one, above which a press went wrong."""
RADIUS, CONTRAST = 8e-3, -0.3
WIDTH = 0.015
"""Of the kernel of the response [m], as in docs/studies/hard-skins."""
SHRINK = 0.1
"""Share of a covariance that is left to its diagonal, as there are few presses for its rest."""
MEDIAN = float(np.sqrt(np.log(2)))
"""Median distance of a normal error with equal x and y over sqrt(var x + var y)."""
PREDICTED = ("noise", "misfit", "response")
MEASURED = ("likely_noise", "likely_misfit", "noser", "kernel_ridge")


def covariance_of_noise(
    changes: Array, places: Array, depths: Array, outlier: float = OUTLIER
) -> Array:
    """Covariance (M, M) of the noise of `changes` (n, M), from neighbours of equal depth."""
    apart = np.column_stack([places, depths])  # in mm, so that another depth is far away
    distance, other = cKDTree(apart).query(apart, 2)
    near = distance[:, 1] < NEAR
    pairs = np.unique(np.sort(np.column_stack([np.flatnonzero(near), other[near, 1]])), axis=0)
    steps = changes[pairs[:, 0]] - changes[pairs[:, 1]]
    size = np.linalg.norm(steps, axis=1)
    steps = steps[size <= outlier * np.median(size)]
    return np.asarray(steps.T @ steps / (2 * len(steps)))


def shrunk(covariance: Array) -> Array:
    """A covariance with less of what lies off its diagonal."""
    return (1 - SHRINK) * covariance + SHRINK * np.diag(np.diag(covariance))


def model_changes(sensor: Sensor, places: Array) -> Array:
    """The model's changes (n, M) by the touch at `places` (n, 2)."""
    model = forward_model(sensor)
    x, y = (of.ravel() for of in sensor.pixel_centres)
    away = (places[:, :1] - x) ** 2 + (places[:, 1:] - y) ** 2
    touched = sensor.background * CONTRAST * np.exp(-away / RADIUS**2) * sensor.mask.ravel()
    jacobian = model.jacobian(model.background).reshape(sensor.n_measurements, -1)
    return np.asarray(touched @ jacobian.T)


def left_by_model(changes: Array, modelled: Array) -> Array:
    """What the model leaves of each change (n, M) with the strength that fits it best."""
    strength = np.sum(changes * modelled, axis=1) / np.sum(modelled**2, axis=1)
    return np.asarray(changes - strength[:, None] * modelled)


def bound_at(of: WhitenedJacobian, places: Array) -> Array:
    """Bound of the place error (n,) [m] at the place of the lattice next to each of `places`."""
    found = maps(of, Touch(RADIUS, CONTRAST))
    x, y = np.meshgrid(found.x, found.y)
    free = np.isfinite(found.place)
    next_to = cKDTree(np.column_stack([x[free], y[free]])).query(places)[1]
    return np.asarray(MEDIAN * found.place[free][next_to])


def bound_of_response(
    response: Callable[[Array], Array], covariance: Array, places: Array
) -> Array:
    """Bound of the place error (n,) [m] of a skin with a `response` (n, M) to places (n, 2).

    The strength is unknown.
    """
    white = np.linalg.inv(np.linalg.cholesky(covariance))
    step = 1e-3
    by = [
        (response(places + move) - response(places - move)) / (2 * step)
        for move in step * np.eye(2)
    ]
    derivatives = np.stack([*by, response(places)], axis=-1)
    triangles = np.linalg.qr(white @ derivatives, mode="r")
    inverse = np.linalg.inv(triangles)
    variance = np.sum(inverse[:, :2] ** 2, axis=(1, 2))
    return np.asarray(MEDIAN * np.sqrt(variance))


def most_likely(sensor: Sensor, covariance: Array, changes: Array) -> Array:
    """Places (n, 2) whose modelled change explains `changes` (n, M) best."""
    free = room(sensor, RADIUS)
    places = np.column_stack([of[free] for of in sensor.pixel_centres])
    white = np.linalg.inv(np.linalg.cholesky(covariance))
    modelled = model_changes(sensor, places) @ white.T
    modelled /= np.linalg.norm(modelled, axis=1, keepdims=True)
    return np.asarray(places[np.argmax(changes @ white.T @ modelled.T, axis=1)])


def studied(name: str) -> dict[str, object]:
    """The row of one skin."""
    scenario = TransferScenario(name="skin", recording=name, labelled=LABELLED, others=())
    data = load_transfer(scenario)
    sensor, labelled = data.given.sensor, data.given.labelled
    known, known_at = labelled.differences, labelled.places
    tested = data.test.voltages - data.test.references
    at = data.test.samples[["x_m", "y_m"]].to_numpy()

    recording = read_recording(name)
    samples = recording.samples
    depths = samples["depth_mm"] if "depth_mm" in samples else pd.Series(0.0, samples.index)
    every, everywhere = recording.voltages - recording.reference, samples[["x_m", "y_m"]].to_numpy()
    placed = every, everywhere, depths.to_numpy(dtype=float)
    noise = covariance_of_noise(*placed)
    variance = float(np.mean(np.diag(noise)))
    with_outliers = float(np.mean(np.diag(covariance_of_noise(*placed, np.inf))))
    m = sensor.n_measurements

    # All in the model's units from here on.
    modelled = model_changes(sensor, known_at)
    signal = float(np.median(np.sum(known**2, axis=1)) - m * variance)
    # A bound in white noise is as large as the noise is over the signal.
    left = max(signal + m * (variance - with_outliers), 0)
    larger = np.sqrt(with_outliers / variance * signal / left) if left else np.inf
    gain = float(np.sqrt(signal / np.median(np.sum(modelled**2, axis=1))))
    known, tested = known / gain, tested / gain
    noise, variance = noise / gain**2, variance / gain**2
    # White noise that is far below the rest keeps saturated values, which never change, regular.
    least = 1e-6 * variance * np.eye(m)
    rest = left_by_model(known, modelled)
    misfit = shrunk(rest.T @ rest / len(rest)) + least
    white = variance * np.eye(m)
    response = kernel_ridge(known_at, known, [lambda a, b: gaussian(WIDTH, a, b)])

    predicted = {
        "noise": bound_at(whitened(sensor, white), at),
        "misfit": bound_at(whitened(sensor, misfit), at),
        "response": bound_of_response(response, shrunk(noise) + least, at),
    }
    found = {}
    for what, covariance in (("likely_noise", white), ("likely_misfit", misfit)):
        seen, there = (most_likely(sensor, covariance, frames) for frames in (known, tested))
        register = fit_similarity(seen, known_at)
        assert register is not None
        found[what] = register(there)
    for method, what in (("noser", "noser"), ("kernel-ridge", "kernel_ridge")):
        fitted = create_place_method(method)
        fitted.fit(PlaceProblem(data.given, no_split))
        found[what] = fitted.locate(data.test.voltages - data.test.references)
    error = {what: np.hypot(*(places - at).T) for what, places in found.items()}

    x0, _, x1, _ = sensor.outline.bounds
    rim = (x1 - x0) / 2 - np.hypot(*at.T)  # all are discs round (0, 0)
    model = forward_model(sensor)
    rms = float(np.sqrt(np.mean(model.voltages(model.background) ** 2)))
    cosine = 1 - np.sum(rest**2, axis=1) / np.sum(known**2, axis=1)
    row: dict[str, object] = {
        "skin": name, "presses": len(at), "electrodes": sensor.n_electrodes,
        # C = 2 s^2 of the command, whose SNR is that of one frame.
        "snr_db": 20 * np.log10(rms / np.sqrt(variance / 2)),
        "signal_to_noise": float(np.sqrt(signal / (gain**2 * m * variance))),
        "explained": float(np.median(cosine)),
    }  # fmt: skip
    bounds = {f"{of}_mm": 1e3 * float(np.median(predicted[of])) for of in PREDICTED}
    row |= bounds | {f"{of}_mm": 1e3 * float(np.median(error[of])) for of in MEASURED}
    row["noise_with_outliers_mm"] = larger * bounds["noise_mm"]
    for first, second in PAIRS:
        row[f"rho_{first}_{second}"] = stats.spearmanr(predicted[first], error[second]).statistic
    for what, values in (*predicted.items(), *error.items()):
        row[f"rho_rim_{what}"] = stats.spearmanr(rim, values).statistic
    draws = np.random.default_rng(0).rayleigh(size=(200, len(at)))
    for what, values in predicted.items():
        drawn = [stats.spearmanr(values, values * draw).statistic for draw in draws]
        row[f"rho_possible_{what}"] = np.mean(drawn)
    return row


PAIRS = (
    ("noise", "likely_noise"), ("misfit", "likely_misfit"), ("noise", "noser"),
    ("misfit", "noser"), ("noise", "kernel_ridge"), ("response", "kernel_ridge"),
)  # fmt: skip


def over_skins(table: pd.DataFrame) -> list[dict[str, object]]:
    """How well predictions order the skins, and how large they are."""
    rows = []
    for first, second in PAIRS:
        predicted, measured = table[f"{first}_mm"], table[f"{second}_mm"]
        order = stats.spearmanr(predicted, measured)
        ratio = measured / predicted
        rows.append({
            "predicted": first, "measured": second, "skins": len(table),
            "spearman": order.statistic, "p": order.pvalue,
            "ratio_median": ratio.median(), "ratio_least": ratio.min(), "ratio_most": ratio.max(),
            "over_places": table[f"rho_{first}_{second}"].median(),
            "over_places_possible": table[f"rho_possible_{first}"].median(),
            "rim_predicted": table[f"rho_rim_{first}"].median(),
            "rim_measured": table[f"rho_rim_{second}"].median(),
        })  # fmt: skip
    return rows


if __name__ == "__main__":
    rows = []
    for skin in sys.argv[1:] or SKINS:
        rows.append(studied(skin))
        print(pd.DataFrame(rows[-1:]).T.to_string(header=False), flush=True)
    table = pd.DataFrame(rows)
    table.to_csv(OUT / "skins.csv", index=False, float_format="%.4g")
    about = {
        "command": "python docs/studies/design/record.py",
        "git_commit": git_commit(), "eitbench": __version__,
        "labelled": LABELLED, "radius_mm": 1e3 * RADIUS, "over_skins": over_skins(table),
    }  # fmt: skip
    (OUT / "record.json").write_text(json.dumps(about, indent=1) + "\n")
