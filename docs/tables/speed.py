"""Tables of the speed of the exact operator, from the record of `make bench`."""

import json
from typing import Any

from docs.tables.record import STUDIES, printed


def _record() -> Any:
    return json.loads((STUDIES / "speed" / "speed.json").read_text())


def _table(number: int, title: str) -> str:
    rows = _record()["tables"][number]
    return printed([title, "ms", "times ours"], rows, [False, True, True])


TABLES = {
    "speed of voltages": lambda: _table(0, "voltages of one image, `foam16`, 80 x 80, one thread"),
    "speed of the Jacobian": lambda: _table(1, "voltages and Jacobian of one image"),
    "speed, where": lambda: f"On {_record()['machine']}:",
    "speed in short": lambda: str(_record()["summary"]),
}
