"""Asks how much of a skin's frames a conductivity model explains, and where the skin is sensitive.

Run: python docs/studies/hard-skins/physics.py fit|maps OUT.csv

This is an explanation and no method: all labelled presses of a skin are used, one half (every
second press) to fit, the other to score, and the reverse.

The models are sheets on the disc of the descriptor with the complete electrode model; a press
lowers the conductivity around its place (Gaussian of 7 mm) by the same share in all directions.
Electrodes may be turned, and numbered the other way; that is fitted first, with the homogeneous
model.

- disc: homogeneous and isotropic.
- tensor: one conductivity tensor, of a ratio along and across an angle (parallel lines).
- polar: a ratio of radial to tangential conductivity (radii, circles).
- radial: isotropic, exp(b (r / R)^2) times that of the middle.

fit: a row each for skin, half that fits, and model: what was fitted; the share of the sum of
squares of frames (each divided by its rms, as those of the model) that the model's explain with a
gain for each press (`explained`), and with a gain for each measurement instead (`with_gains`; the
gains come from the half that fits); `error_mm`: median error of the place of NOSER with that model,
its weight chosen and its places registered (similarity) by the half that fits, and
`error_gains_mm`: the same with those gains.
Model `place` is a smooth function of the place (kernel ridge regression, 15 mm), no physics: the
most that any model of one press at that place can explain.

maps: a row each for skin and square of the skin: the root mean square of the frames' norms
(`size`), and of their part that the place explains (`of_place`), over the median of the squares;
for `disc` the same of the modelled frames.
"""

import sys
from collections.abc import Iterator
from functools import cache

import numpy as np
import pandas as pd
from scipy import sparse

from eitbench import __version__
from eitbench.methods.places.kernel_ridge import gaussian, kernel_ridge
from eitbench.scenarios.arrays import Array, unit_frames
from eitbench.scenarios.physics.elements import electrode_terms
from eitbench.scenarios.physics.forward import signed_voltages
from eitbench.scenarios.physics.mesh import triangle_mesh
from eitbench.scenarios.recordings import recorded_set
from eitbench.scenarios.recordings.fetch import read_recording
from eitbench.scenarios.similarity import fit_similarity

SKINS = [f"cam09-{k:02d}" for k in (4, 5, 6, 7, 8, 9, 10, 11, 12, 14, 15, 16, 18)]
RATIOS = (1.25, 1.6, 2.0, 3.0, 5.0, 10.0)
ANGLES = range(0, 180, 15)
BENDS = (-4.0, -2.0, -1.0, -0.5, 0.5, 1.0, 2.0, 4.0)
WEIGHTS = (0.01, 0.1, 1.0, 10.0)
PRESS = 0.007
SQUARE = 0.008
FITTED = 400
"""Presses of a half that choose among models; all of the other half score the choice."""


def jacobian(skin: str, kind: str, first: float, angle: float) -> Array:
    """d|V|/d(ln conductivity) of each measurement by pixel (M, pixels) of a model, see above."""
    sensor, mesh, slopes, areas, terms = discretised(skin)
    centres = mesh.nodes[mesh.elements].mean(axis=1)
    along = np.full(len(centres), np.deg2rad(angle))
    if kind == "polar":
        along = np.arctan2(*centres.T[::-1])
    ratio = first if kind in ("tensor", "polar") else 1.0
    e = np.stack([np.cos(along), np.sin(along)], axis=1)
    across = np.stack([-e[:, 1], e[:, 0]], axis=1)
    tensor = np.sqrt(ratio) * e[:, :, None] * e[:, None]
    tensor = tensor + across[:, :, None] * across[:, None] / np.sqrt(ratio)
    if kind == "radial":
        radius2 = (centres**2).sum(axis=1) / (mesh.nodes**2).sum(axis=1).max()
        tensor = tensor * np.exp(first * radius2)[:, None, None]
    flux = np.einsum("k,kxy,kyc->kxc", areas, tensor, slopes)  # area * tensor @ gradients
    local = np.einsum("kxi,kxc->kic", slopes, flux)
    rows, columns = np.repeat(mesh.elements, 3, axis=1), np.tile(mesh.elements, (1, 3))
    size = (len(mesh.nodes),) * 2
    stiff = sparse.coo_array((local.ravel(), (rows.ravel(), columns.ravel())), shape=size)
    solved = sparse.linalg.splu(sparse.csc_array(stiff + terms.mass)).solve(terms.coupling)
    schur = np.diag(terms.conductance) - terms.coupling.T @ solved
    resistance = np.linalg.inv(schur + schur.max() / len(schur))
    fields = (solved @ resistance)[mesh.elements]  # (k, 3, E)
    gradients = np.einsum("kxc,kce->kxe", slopes, fields)
    fluxes = np.einsum("kxc,kce->kxe", flux, fields)
    src, sink, a, b = sensor.pattern.table.T
    change = -np.einsum(
        "kxm,kxm->mk", gradients[..., a] - gradients[..., b], fluxes[..., src] - fluxes[..., sink]
    )
    signs = np.sign(signed_voltages(sensor.pattern.table, resistance))
    assert mesh.pixel_shares is not None
    inside = sensor.mask.ravel()
    return np.asarray(signs[:, None] * (mesh.pixel_shares.T @ change.T).T[:, inside])


@cache
def discretised(skin: str):
    """Sensor, mesh, gradients (k, 2, 3) of the shape functions, areas (k,), electrode terms."""
    sensor = recorded_set(skin).sensor()
    mesh = triangle_mesh(sensor)
    corners = mesh.nodes[mesh.elements]
    edges = corners[:, 1:] - corners[:, :1]
    reference = np.array([[-1.0, 1, 0], [-1, 0, 1]])
    slopes = np.linalg.solve(edges, np.broadcast_to(reference, (len(edges), 2, 3)))
    terms = electrode_terms(mesh, sensor.electrodes, sensor.outline.perimeter)
    return sensor, mesh, slopes, np.linalg.det(edges) / 2, terms


@cache
def model(skin: str, kind: str, first: float, angle: float) -> Array:
    """The Jacobian of a skin; skins of one set-up share it."""
    of = "cam09-05" if int(skin[-2:]) < 13 else "cam09-14"
    return jacobian(skin, kind, first, angle) if of == skin else model(of, kind, first, angle)


def blobs(skin: str, places: Array) -> Array:
    """Presses at `places` (n, 2) by pixel (n, pixels)."""
    sensor = recorded_set(skin).sensor()
    x, y = (of[sensor.mask] for of in sensor.pixel_centres)
    away2 = (places[:, :1] - x) ** 2 + (places[:, 1:] - y) ** 2
    return np.exp(away2 / (-2 * PRESS**2))


def turned(places: Array, angle: float, mirrored: bool) -> Array:
    """Places (n, 2) turned by `angle` [degrees], mirrored before."""
    c, s = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
    return np.asarray((places * ([1, -1] if mirrored else [1, 1])) @ np.array([[c, -s], [s, c]]).T)


def by_press(frames: Array, modelled: Array) -> float:
    """Share of the sum of squares of frames that modelled ones explain; both have an rms of 1."""
    return float(np.mean(np.mean(frames * modelled, axis=1) ** 2))


def gains(frames: Array, modelled: Array) -> Array:
    """The gain (M,) of each measurement, by least squares over presses."""
    return np.asarray(np.sum(frames * modelled, axis=0) / np.sum(modelled**2, axis=0))


def explained(frames: Array, predicted: Array) -> float:
    """Share of the sum of squares that a prediction explains."""
    return float(1 - np.sum((frames - predicted) ** 2) / np.sum(frames**2))


def located(skin: str, j: Array, frames: Array, weight: float) -> Array:
    """Places (n, 2) that NOSER's images show: centre of the pixels above half of the extreme."""
    sensor = recorded_set(skin).sensor()
    places = np.stack([of[sensor.mask] for of in sensor.pixel_centres], axis=1)
    scaled = j / np.sqrt(np.sum(j**2, axis=0))
    system = scaled @ scaled.T
    system += weight * np.trace(system) / len(system) * np.eye(len(system))
    images = frames @ np.linalg.solve(system, scaled) / np.sqrt(np.sum(j**2, axis=0))
    images *= np.sign(images[np.arange(len(images)), np.abs(images).argmax(axis=1)])[:, None]
    share = np.where(images > 0.5 * images.max(axis=1, keepdims=True), images, 0)
    return np.asarray(share @ places / share.sum(axis=1, keepdims=True))


def place_error(skin: str, j: Array, frames: Array, places: Array, fit: Array) -> float:
    """Median error [mm] on the half that does not fit."""
    errors = []
    for weight in WEIGHTS:
        found = located(skin, j, frames, weight)
        similarity = fit_similarity(found[fit], places[fit])
        if similarity is not None:
            away = 1e3 * np.hypot(*(similarity(found) - places).T)
            errors.append((np.median(away[fit]), np.median(away[~fit])))
    return float(min(errors)[1])


def fits() -> Iterator[dict[str, object]]:
    """Rows of physics.csv."""
    candidates = {
        "disc": [(1.0, 0.0)],
        "tensor": [(1.0, 0.0), *((r, float(a)) for r in RATIOS for a in ANGLES)],
        "polar": [(s, 0.0) for r in RATIOS for s in (1 / r, r)] + [(1.0, 0.0)],
        "radial": [(b, 0.0) for b in (0.0, *BENDS)],
    }
    for skin in SKINS:
        recording = read_recording(skin)
        frames = unit_frames(recording.voltages - recording.reference)
        places = recording.samples[["x_m", "y_m"]].to_numpy()
        for half in (0, 1):
            fit = np.arange(len(frames)) % 2 == half
            few = np.flatnonzero(fit)[:FITTED]
            disc = model(skin, "disc", 1.0, 0.0)

            def agreement(seen: Array, j: Array, known: Array = frames[few]) -> float:
                return by_press(known, unit_frames(seen @ j.T))

            turns = [(float(t), m) for t in range(0, 360, 10) for m in (False, True)]
            turn, mirrored = max(
                turns,
                key=lambda of: agreement(blobs(skin, turned(places[few], *of)), disc),
            )
            seen = blobs(skin, turned(places, turn, mirrored))
            base = {
                "skin": skin, "half": half, "turn": turn, "mirrored": mirrored,
                "version": __version__,
            }  # fmt: skip
            for kind, of_kind in candidates.items():
                first, angle = max(
                    of_kind, key=lambda of: agreement(seen[few], model(skin, kind, *of))
                )
                j = model(skin, kind, first, angle)
                modelled = unit_frames(seen @ j.T)
                gain = gains(frames[fit], modelled[fit])
                signed = np.sign(gain.sum() or 1.0) * gain
                of_robot = turn - angle if mirrored else angle - turn
                yield base | {
                    "model": kind, "first": first,
                    "angle": of_robot % 180 if kind == "tensor" else 0,
                    "explained": by_press(frames[~fit], modelled[~fit]),
                    "with_gains": explained(frames[~fit], modelled[~fit] * gain),
                    "error_mm": place_error(skin, j, frames, places, fit),
                    "error_gains_mm": place_error(skin, signed[:, None] * j, frames, places, fit),
                }  # fmt: skip
            smooth = kernel_ridge(places[fit], frames[fit], [kernel])(places[~fit])
            yield base | {"model": "place", "with_gains": explained(frames[~fit], smooth)}


def kernel(a: Array, b: Array) -> Array:
    """Of places [m]."""
    return gaussian(0.015, a, b)


def maps() -> Iterator[dict[str, object]]:
    """Rows of maps.csv."""
    for skin in ["disc", *SKINS]:
        recording = read_recording("cam09-05" if skin == "disc" else skin)
        frames = recording.voltages - recording.reference
        places = recording.samples[["x_m", "y_m"]].to_numpy()
        fit = np.arange(len(frames)) % 2 == 0
        if skin == "disc":
            frames = blobs("cam09-05", places) @ model("cam09-05", "disc", 1.0, 0.0).T
            of_place = frames
        else:
            of_place = np.empty_like(frames)
            for half in (fit, ~fit):
                of_place[~half] = kernel_ridge(places[half], frames[half], [kernel])(places[~half])
        squares = pd.DataFrame(np.round(places / SQUARE).astype(int), columns=["column", "row"])
        squares["n"] = 1
        squares["size"] = np.sum(frames**2, axis=1)
        squares["of_place"] = np.sum(of_place**2, axis=1)
        table = squares.groupby(["column", "row"], as_index=False).agg(
            n=("n", "sum"), size=("size", "mean"), of_place=("of_place", "mean")
        )
        table = table[table["n"] >= 5]
        rms = np.sqrt(table[["size", "of_place"]])
        table[["size", "of_place"]] = rms / rms["size"].median()
        yield from table.assign(skin=skin, version=__version__).to_dict("records")


if __name__ == "__main__":
    what, out = sys.argv[1:]
    rows = []
    for row in {"fit": fits, "maps": maps}[what]():
        rows.append(row)
        pd.DataFrame(rows).to_csv(out, index=False, float_format="%.4g")
