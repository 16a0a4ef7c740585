"""Measures what makes each of the 13 `cam09` skins easy or hard.

Run: python docs/studies/hard-skins/measure.py OUT.csv

Over the presses of the pool of the suite `new-skin`, none of which it locates:

- explained: share of the variance of normalised frames (divided by their rms) that a smooth
  function of the place explains (kernel ridge regression from place to frame, learned from half of
  the presses, scored on others).
- memory: correlation of what remains of a frame after that with what remains of the next one.
- alike: share of the variance of what remains that lies in its five strongest directions; white
  noise in 192 values would have about 0.07 of it there.
- like_model: median over measurements of the absolute correlation of normalised frames with those
  of the model's drop of conductivity at the same place, whatever gain and sign measurements have.
- rank: effective number of independent values in the normalised frames, (sum s^2)^2 / sum s^4 of
  their singular values s.
- weak: strength of presses at the weakest tenth of places over that at the median place, where
  strength is the mean of the 20 nearest presses.
- at_1500: median error [mm] on the test presses of kernel ridge regression of 1,500 labelled ones.
"""

import sys
from collections.abc import Iterator

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from eitbench import __version__
from eitbench.methods.places.kernel_ridge import gaussian, kernel_ridge
from eitbench.methods.places.topographic_map import compressed
from eitbench.scenarios.arrays import Array, Index, unit_frames
from eitbench.scenarios.data.transfer import split
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.recordings import recorded_set
from eitbench.scenarios.recordings.fetch import read_recording

SKINS = [f"cam09-{k:02d}" for k in (4, 5, 6, 7, 8, 9, 10, 11, 12, 14, 15, 16, 18)]


def properties() -> Iterator[dict[str, object]]:
    """A row for each skin."""
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
    pd.DataFrame(properties()).to_csv(sys.argv[1], index=False, float_format="%.4g")
