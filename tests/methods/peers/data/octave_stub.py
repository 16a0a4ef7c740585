"""Stands for `octave` in the tests of the bridge to EIDORS: it solves what a request describes.

It knows nothing of eitbench. Its finite elements are written anew from the request's format: a
wrong order of measurements, sign, electrode or axis shows in what it answers. STUB_LOG names a file
(.npz) for what it was asked and the voltages that it finds; starts.txt beside it gets a line at
each start. STUB_FAULT makes it fail, or answer zeros.
"""

import os
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Pair = tuple[Index, Index]


def main(arguments: list[str]) -> None:
    options, (script, eidors) = arguments[:-2], arguments[-2:]
    assert (Path(eidors) / "startup.m").is_file()
    assert Path(script).name == "eidors_bridge.m"
    assert Path(script).is_file()
    if "STUB_LOG" in os.environ:
        with Path(os.environ["STUB_LOG"]).with_name("starts.txt").open("a") as starts:
            starts.write("started\n")
    print("EIDORS:[Installed]", "eitbench: ready", sep="\n", flush=True)
    while sys.stdin.read(1):
        answer(Path("request.mat"), Path("answer.mat"), options)
        print("eitbench: answered", flush=True)


def answer(request: Path, answer: Path, options: list[str]) -> None:
    fault = os.environ.get("STUB_FAULT", "")
    if fault == "slow":
        time.sleep(60)
    if fault == "error":
        sys.exit("error: 'prior_noser' undefined")
    if fault == "silent":
        sys.exit()
    n = scipy.io.loadmat(request, variable_names=["frames"])["frames"].shape[1]
    if fault == "shape":
        scipy.io.savemat(answer, {"points": np.zeros((5, 2)), "values": np.zeros((4, n))})
        return
    if fault == "zero":
        scipy.io.savemat(answer, {"points": np.zeros((5, 2)), "values": np.zeros((5, n))})
        return
    if fault == "nan":
        scipy.io.savemat(answer, {"points": np.zeros((5, 2)), "values": np.full((5, n), np.nan)})
        return
    r = scipy.io.loadmat(request)
    nodes, elements, pattern = r["nodes"], r["elements"], r["pattern"]
    assert all(
        r[k].dtype == np.float64 for k in ("nodes", "elements", "electrode_nodes", "pattern")
    )
    fields = unit_fields(
        nodes, elements.astype(int) - 1, r["electrode_nodes"].astype(int) - 1,
        r["contact_impedance"][:, 0],
    )  # fmt: skip
    src, sink, a, b = pattern.astype(int).T - 1
    electrodes = fields[len(nodes) :]
    voltages = electrodes[a, src] - electrodes[a, sink] - electrodes[b, src] + electrodes[b, sink]
    jacobian = sensitivity(nodes, elements.astype(int) - 1, fields, (src, sink), (a, b))
    algorithm, parameters = str(r["algorithm"][0]), r["parameters"]
    data = r["frames"] - r["reference"]
    points = nodes[elements.astype(int) - 1].mean(axis=1)
    if algorithm == "greit":
        points, values = greit(points, jacobian, data, parameters, nodes)
    else:
        hyperparameter = float(parameters["hyperparameter"][0, 0][0, 0])
        prior = np.diag(np.sum(jacobian**2, axis=0) ** 0.5) * hyperparameter**2
        values = np.linalg.solve(jacobian.T @ jacobian + prior, jacobian.T @ data)
    if "STUB_LOG" in os.environ:
        np.savez(
            os.environ["STUB_LOG"], voltages=voltages, options=options, algorithm=algorithm,
            reference=r["reference"][:, 0], n=n,
        )  # fmt: skip
    scipy.io.savemat(answer, {"points": points, "values": values})


def unit_fields(nodes: Array, triangles: Index, electrode_nodes: Index, impedance: Array) -> Array:
    """Potentials (N + E, E) of unit currents through each electrode: first-order triangles, CEM."""
    n, e = len(nodes), len(electrode_nodes)
    system = np.zeros((n + e, n + e))
    for corners in triangles:
        gradients, area = shape_gradients(nodes[corners])
        assert area > 0, "triangles run counter-clockwise"
        system[np.ix_(corners, corners)] += area * gradients @ gradients.T
    sides = np.sort(
        np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    )
    rim, count = np.unique(sides, axis=0, return_counts=True)
    rim = rim[count == 1]
    for k, members in enumerate(electrode_nodes):
        members = members[members >= 0]
        for edge in rim[np.isin(rim, members).all(axis=1)]:
            length = np.linalg.norm(np.subtract(*nodes[edge])) / impedance[k]
            system[np.ix_(edge, edge)] += length / 6 * np.array([[2, 1], [1, 2]])
            system[edge, n + k] -= length / 2
            system[n + k, edge] -= length / 2
            system[n + k, n + k] += length
    system[n:, n:] += 1.0  # the electrodes' mean is the ground
    currents = np.zeros((n + e, e))
    currents[n:] = np.eye(e) - 1 / e
    return np.asarray(np.linalg.solve(system, currents))


def shape_gradients(corners: Array) -> tuple[Array, float]:
    x, y = corners.T
    area = ((x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0])) / 2
    gradients = np.column_stack(
        [np.roll(y, -1) - np.roll(y, -2), np.roll(x, -2) - np.roll(x, -1)]
    ) / (2 * area)
    return gradients, float(area)


def sensitivity(nodes: Array, triangles: Index, fields: Array, drive: Pair, sense: Pair) -> Array:
    """dV/dsigma (M, K) of triangles: minus the product of the fields' gradients times the area."""
    driven = fields[:, drive[0]] - fields[:, drive[1]]
    sensed = fields[:, sense[0]] - fields[:, sense[1]]
    rows = np.empty((len(drive[0]), len(triangles)))
    for k, corners in enumerate(triangles):
        gradients, area = shape_gradients(nodes[corners])
        rows[:, k] = -area * np.sum(
            (gradients.T @ driven[corners]) * (gradients.T @ sensed[corners]), axis=0
        )
    return rows


def greit(
    centres: Array, jacobian: Array, data: Array, parameters: Any, nodes: Array
) -> tuple[Array, Array]:
    """GREIT with discs as desired images, on a grid with x running fastest."""
    p = {name: parameters[name][0, 0] for name in parameters.dtype.names}
    x, y, radius = p["targets"]
    covered = np.hypot(centres[:, :1] - x, centres[:, 1:] - y) < radius
    response = jacobian @ covered
    low, high = nodes.min(axis=0), nodes.max(axis=0)
    across, up = p["imgsz"][0].astype(int)
    gx, gy = np.meshgrid(np.linspace(low[0], high[0], across), np.linspace(low[1], high[1], up))
    points = np.column_stack([gx.ravel(), gy.ravel()])
    wide = p["radius"][0, 0] * max(high - low) / 2
    desired = (np.hypot(points[:, :1] - x, points[:, 1:] - y) < wide).astype(float)
    noise = float(p["weight"][0, 0]) * np.mean(np.abs(response))
    gram = response @ response.T + noise**2 * np.eye(len(response))
    return points, desired @ response.T @ np.linalg.solve(gram, data)


main(sys.argv[1:])
