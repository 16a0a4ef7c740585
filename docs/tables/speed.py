"""Tables of the speed of the exact operator, from the record of `make bench`."""

import json
from typing import Any

from docs.tables.record import STUDIES, printed

from eitbench.scenarios.catalogue import sensor
from eitbench.scenarios.physics.forward import forward_model

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


TABLES = {
    "speed of voltages": lambda: _table(0, "voltages of one image, `foam16`, 80 x 80, one thread"),
    "speed of the Jacobian": lambda: _table(1, "voltages and Jacobian of one image"),
    "speed, where": lambda: f"On {_record()['machine']}:",
    "operations of a gradient": _operations_of_a_gradient,
    "speed in short": lambda: str(_record()["summary"]),
}
