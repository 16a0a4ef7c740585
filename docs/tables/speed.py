"""Tables of the speed of the exact operator, from the record of `make bench`."""

import json
from typing import Any

from docs.tables.record import STUDIES, printed


def _record() -> Any:
    return json.loads((STUDIES / "speed" / "speed.json").read_text())


def _table(number: int, title: str) -> str:
    rows = _record()["tables"][number]
    return printed([title, "ms", "times ours"], rows, [False, True, True])


def _overhead() -> Any:
    return json.loads((STUDIES / "overhead" / "noise.json").read_text())


def _beside_methods() -> str:
    heads = ["Method", "method [ms a sample]", "harness [ms a sample]", "share of its run"]
    rows = [
        [f"`{row['method']}`", f"{row['own_ms_a_sample']:.1f}", f"{row['harness_ms_a_sample']:.1f}",
         f"{row['share']:.0%}"]
        for row in sorted(_overhead()["rows"], key=lambda row: row["own_ms_a_sample"])
        if row["method"] != "the run"
    ]  # fmt: skip
    return printed(heads, rows, [False, True, True, True])


def _measured() -> str:
    found = _overhead()
    return (
        f"`{found['command']}`, on {found['machine']}, whose calibration solve took "
        f"{found['calibration_ms']:.0f} ms:"
    )


TABLES = {
    "overhead of the harness": _beside_methods,
    "overhead, where": _measured,
    "speed of voltages": lambda: _table(0, "voltages of one image, `foam16`, 80 x 80, one thread"),
    "speed of the Jacobian": lambda: _table(1, "voltages and Jacobian of one image"),
    "speed, where": lambda: f"On {_record()['machine']}:",
    "speed in short": lambda: str(_record()["summary"]),
}
