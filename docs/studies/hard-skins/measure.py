"""Measures what makes each of the 13 `cam09` skins easy or hard.

Run: python docs/studies/hard-skins/measure.py properties|errors OUT.csv

Properties, over the presses of the pool of the suite `new-skin`, none of which it locates:

- explained: share of the unit frames' variance that a smooth function of the place explains
  (kernel ridge regression from place to frame, learned from half of the presses, scored on others).
- memory: correlation of what remains of a frame after that with what remains of the next one.
- alike: share of the variance of what remains that lies in its five strongest directions; white
  noise in 192 values would have about 0.07 of it there.
- like_model: median over measurements of the absolute correlation of unit frames with those of the
  model's drop of conductivity at the same place, whatever the gain and sign of each measurement.
- rank: effective number of independent values in the unit frames, (sum s^2)^2 / sum s^4 of their
  singular values s.
- weak: strength of presses at the weakest tenth of places over that at the median place, where
  strength is the mean of the 20 nearest presses.
- at_1500: median error [mm] on the test presses of kernel ridge regression of 1,500 labelled ones.

Errors: median error [mm] on the test presses of the suite, by method and labelled presses, and the
version and hash of the splits.
"""

import sys
from collections.abc import Iterator

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from eitbench import __version__
from eitbench.methods.place_method import PlaceProblem
from eitbench.methods.places.by_image import create_place_method
from eitbench.methods.places.kernel_ridge import gaussian, kernel_ridge
from eitbench.methods.places.topographic_map import compressed
from eitbench.methods.training.samples import no_split
from eitbench.scenarios.arrays import Array, Index, unit_frames
from eitbench.scenarios.data.transfer import load_transfer, split
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.recordings import recorded_set
from eitbench.scenarios.recordings.fetch import read_recording
from eitbench.scenarios.similarity import fit_similarity
from eitbench.scenarios.suites.scenario import TransferScenario

SKINS = [f"cam09-{k:02d}" for k in (4, 5, 6, 7, 8, 9, 10, 11, 12, 14, 15, 16, 18)]
METHODS = [
    ("one-place", 25), ("kernel-ridge", 25), ("topographic-map", 25), ("topographic-map-skins", 25),
    ("topographic-map-skins", 0),
]  # fmt: skip


def scenario(skin: str, labelled: int) -> TransferScenario:
    """The scenario of the suite `new-skin`."""
    others = tuple(other for other in SKINS if other != skin)
    return TransferScenario(name="skin", recording=skin, labelled=labelled, others=others)


def errors() -> Iterator[dict[str, object]]:
    """Rows of errors.csv."""
    for name, labelled in METHODS:
        for skin in SKINS:
            data = load_transfer(scenario(skin, labelled))
            method = create_place_method(name)
            method.fit(PlaceProblem(data.given, no_split))
            found = method.locate(data.test.voltages - data.test.references)
            if not labelled:
                seen = method.locate(data.registration.differences)
                found = fit_similarity(seen, data.registration.places)(found)
            away = 1e3 * np.hypot(*(found - data.test.samples[["x_m", "y_m"]].to_numpy()).T)
            yield {
                "skin": skin, "method": name, "labelled": labelled, "median_mm": np.median(away),
                "p90_mm": np.quantile(away, 0.9), "within_5_mm": np.mean(away < 5),
                "version": __version__,
                "splits": split(skin, len(data.test) + len(data.given.unlabelled)).sha256[:12],
            }  # fmt: skip


def properties() -> Iterator[dict[str, object]]:
    """Rows of properties.csv."""
    for skin in SKINS:
        recording = read_recording(skin)
        differences = recording.voltages - recording.reference
        places = recording.samples[["x_m", "y_m"]].to_numpy()
        rows = split(skin, len(places))
        pool, frames = rows.pool, unit_frames(differences)
        learned, scored = pool[:750], pool[750:1500]
        kernel = [lambda a, b: gaussian(0.015, a, b)]
        guess = kernel_ridge(places[learned], frames[learned], kernel)(places[scored])
        rest = frames[scored] - guess
        explained = 1 - np.sum(rest**2) / np.sum((frames[scored] - frames[scored].mean(0)) ** 2)
        after = np.full(frames.shape, np.nan)
        after[scored] = rest
        pairs = np.isfinite(after[:-1, 0] + after[1:, 0])
        memory = np.corrcoef(after[:-1][pairs].ravel(), after[1:][pairs].ravel())[0, 1]
        left2 = np.linalg.svd(rest, compute_uv=False) ** 2
        s2 = np.linalg.svd(frames[pool], compute_uv=False) ** 2
        strength = np.linalg.norm(differences, axis=1)[pool]
        near = cKDTree(places[pool]).query(places[pool], 20)[1]
        smooth = strength[near].mean(axis=1)
        x = compressed(differences)
        many = pool[:1500]
        width = np.median(np.linalg.norm(x[many[:200]][:, None] - x[many[200:400]][None], axis=2))
        narrow = [lambda a, b, w=width: gaussian(w, a, b)]
        found = kernel_ridge(x[many], places[many], narrow)(x[rows.test])
        yield {
            "skin": skin, "explained": explained, "memory": memory,
            "alike": left2[:5].sum() / left2.sum(),
            "like_model": like_model(skin, frames, places, pool),
            "rank": s2.sum() ** 2 / np.sum(s2**2),
            "weak": np.quantile(smooth, 0.1) / np.median(smooth),
            "at_1500": 1e3 * np.median(np.hypot(*(found - places[rows.test]).T)),
            "version": __version__,
        }  # fmt: skip


def like_model(skin: str, frames: Array, places: Array, pool: Index) -> float:
    """Return the agreement of unit `frames` (n, M) with the model, see above."""
    sensor = recorded_set(skin).sensor()
    model = forward_model(sensor)
    x, y = sensor.pixel_centres
    jacobian = model.jacobian(model.background).reshape(sensor.n_measurements, -1)
    away2 = (places[pool, :1] - x.ravel()) ** 2 + (places[pool, 1:] - y.ravel()) ** 2
    blobs = np.exp(away2 / (-2 * 0.007**2)) * sensor.mask.ravel()
    predicted = unit_frames(blobs @ jacobian.T)
    pairs = zip(predicted.T, frames[pool].T, strict=True)
    return float(np.median([abs(np.corrcoef(p, f)[0, 1]) for p, f in pairs]))


if __name__ == "__main__":
    what, out = sys.argv[1:]
    rows = []
    for row in {"errors": errors, "properties": properties}[what]():
        rows.append(row)
        pd.DataFrame(rows).to_csv(out, index=False, float_format="%.4g")
