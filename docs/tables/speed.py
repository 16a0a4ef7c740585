"""Speed of the exact operator, by `make bench`, and what the harness takes beside each method."""

import json
from typing import Any

from docs.tables.record import STUDIES, printed

from eitbench.scenarios.catalogue import sensor
from eitbench.scenarios.physics.forward import forward_model

AIM_MS, AIM_SHARE = 5.0, 0.03
"""What the harness may take for a sample, or of a run: the larger of the two is the aim."""
AIM = 1.4
"""What a solve with gradient should take, in solves."""


def _record() -> Any:
    return json.loads((STUDIES / "speed" / "speed.json").read_text())


def _table(number: int, title: str) -> str:
    rows = _record()["tables"][number]
    return printed([title, "ms", "times ours"], rows, [False, True, True])


def _operations_of_a_gradient() -> str:
    """Multiplications and additions of a solve and of what a gradient adds, from the structure."""
    model = forward_model(sensor("foam16"))
    parts, fields = model._parts, model.sensor.n_electrodes
    # Rows that are left below each unknown as it is eliminated.
    below = [
        size - pivot
        for size, count in zip(parts.size.tolist(), parts.eliminated.tolist(), strict=True)
        for pivot in range(1, count + 1)
    ]
    solve = sum(left * (left + 1) for left in below)
    substitution = sum(fields * (2 * left + 1) for left in below)
    products = 2 * fields**2 * len(model.mesh.nodes)
    # u^T K w of a square element has ten different products of its corners.
    elements = 10 * 2 * fields * len(model.mesh.elements)
    added = substitution + products + elements
    return (
        f"Of `foam16`, 80 x 80, an elimination has {solve / 1e6:.1f} million multiplications and "
        f"additions. A gradient adds {added / 1e6:.1f} million: {substitution / 1e6:.1f} for the "
        f"back substitution of {fields} fields, {products / 1e6:.1f} for their products with the "
        f"weights of the loss, {elements / 1e6:.1f} for the sums over elements. At the rate of the "
        f"elimination a solve with gradient would take {1 + added / solve:.2f} times as long as "
        f"one without, and with the back substitution alone {1 + substitution / solve:.2f} times: "
        f"the aim of {AIM:g} times is out of its reach."
    )


def _costs() -> list[Any]:
    return [json.loads(path.read_text()) for path in sorted((STUDIES / "harness").glob("*.json"))]


def _cost_rows() -> list[dict[str, Any]]:
    """Each method's own time for a sample, and that of the harness beside it, fastest first.

    What a run does as a whole is shared out evenly.
    """
    found = []
    for record in _costs():
        *methods, run = record["rows"]
        for row in methods:
            harness = row["harness_s"] + run["harness_s"] / len(methods)
            share = harness / (row["own_s"] + harness)
            found.append(row | {"ms": 1e3 * harness / row["samples"], "share": share})
    return sorted(found, key=lambda row: float(row["own_ms_a_sample"]))


def _held(row: dict[str, Any]) -> bool:
    return bool(row["ms"] <= AIM_MS or row["share"] <= AIM_SHARE)


def _cost_table() -> str:
    rows = [
        [f"`{row['method']}`", f"{row['samples']:,}", f"{row['own_ms_a_sample']:.3g}",
         f"{row['ms']:.1f}", f"{100 * row['share']:.1f} %", "yes" if _held(row) else "no"]
        for row in _cost_rows()
    ]  # fmt: skip
    heads = ["method", "samples", "method, ms a sample", "harness, ms a sample", "share of the run"]
    return printed([*heads, "aim met"], rows, [False, *[True] * 4, False])


def _cost_where() -> str:
    commands = " and ".join(f"`{record['command']}`" for record in _costs())
    solves = " and ".join(f"{record['calibration_ms']:.0f}" for record in _costs())
    machine = _costs()[0]["machine"]
    rows = _cost_rows()
    return (
        f"The aim is {AIM_MS:g} ms a sample or {100 * AIM_SHARE:g} % of a run, whichever is "
        f"larger: {sum(map(_held, rows))} of {len(rows)} methods meet it. Measured by {commands} "
        f"on {machine}, where the calibration solve took {solves} ms."
    )


TABLES = {
    "speed of voltages": lambda: _table(0, "voltages of one image, `foam16`, 80 x 80, one thread"),
    "speed of the Jacobian": lambda: _table(1, "voltages and Jacobian of one image"),
    "speed, where": lambda: f"On {_record()['machine']}:",
    "operations of a gradient": _operations_of_a_gradient,
    "cost of the harness": _cost_table,
    "cost of the harness, where": _cost_where,
    "speed in short": lambda: str(_record()["summary"]),
}
