"""Speed of the exact operator, by `make bench`, and what the harness takes beside each method."""

import json
from typing import Any

from docs.tables.record import STUDIES, newest_version, printed

from eitbench.benchmark.analysis.results import read_run
from eitbench.benchmark.rundir.kinds import METHOD_RUNS

AIM_MS, AIM_SHARE = 5.0, 0.03
"""What the harness may take for a sample, or of a run: the larger of the two is the aim."""
AIMS_MS = {"dip": 1000.0, "gauss-newton-tv": 100.0}
"""What slow methods may take for a frame, on one thread [ms]."""


def _record() -> Any:
    return json.loads((STUDIES / "speed" / "speed.json").read_text())


def _table(number: int, title: str) -> str:
    rows = _record()["tables"][number]
    return printed([title, "ms", "times ours"], rows, [False, True, True])


def _costs() -> list[Any]:
    return [json.loads(path.read_text()) for path in sorted((STUDIES / "harness").glob("*.json"))]


def _cost_rows(record: Any) -> list[dict[str, Any]]:
    """Each method's own time for a sample, and that of the harness beside it, fastest first.

    What a run does as a whole is shared out evenly.
    """
    found = []
    *methods, run = record["rows"]
    for row in methods:
        harness = row["harness_s"] + run["harness_s"] / len(methods)
        share = harness / (row["own_s"] + harness)
        found.append(row | {"ms": 1e3 * harness / row["samples"], "share": share})
    return sorted(found, key=lambda row: float(row["own_ms_a_sample"]))


def _held(row: dict[str, Any]) -> bool:
    return bool(row["ms"] <= AIM_MS or row["share"] <= AIM_SHARE)


def _cost_table() -> str:
    """Of the machine on which fewest methods hold the aim."""
    worst = min(map(_cost_rows, _costs()), key=lambda rows: sum(map(_held, rows)))
    rows = [
        [f"`{row['method']}`", f"{row['samples']:,}", f"{row['own_ms_a_sample']:.3g}",
         f"{row['ms']:.1f}", f"{100 * row['share']:.2f} %", "yes" if _held(row) else "no"]
        for row in worst
    ]  # fmt: skip
    heads = ["method", "samples", "method, ms a sample", "harness, ms a sample", "share of the run"]
    return printed([*heads, "aim met"], rows, [False, *[True] * 4, False])


def _cost_where() -> str:
    commands = dict.fromkeys(f"`{record['command']}`" for record in _costs())
    machines = []
    for record in _costs():
        rows = _cost_rows(record)
        machines.append(
            f"{sum(map(_held, rows))} of {len(rows)} on {record['machine']} (calibration solve "
            f"{record['calibration_ms']:.0f} ms)"
        )
    return (
        f"The aim is {AIM_MS:g} ms a sample or {100 * AIM_SHARE:g} % of a run, whichever is "
        f"larger. Methods within it: {', '.join(machines)}. Measured by {' and '.join(commands)}. "
        "The table is of the machine on which fewest are."
    )


def _aims_table() -> str:
    """Time of a frame of the slow methods that have an aim, in records of the newest version."""
    rows = []
    for path in sorted(newest_version().glob("*/manifest.json")):
        run = read_run(path.parent)
        for method, aim_ms in AIMS_MS.items() if run.kind is METHOD_RUNS else ():
            cells = run.cells[run.cells["method"] == method].dropna(subset="frame_ms_p50")
            of = run.samples[run.samples["method"] == method]
            in_batches = of.groupby("scenario")["frame_ms"].mean()
            in_batches = in_batches[in_batches.index.isin(cells["scenario"])]
            if cells.empty:
                continue
            times = (cells["frame_ms_p50"], in_batches)
            met = [f"{(values <= aim_ms).sum()} of {len(values)}" for values in times]
            spans = [f"{values.min():,.0f} to {values.max():,.0f}" for values in times]
            pairs = (text for pair in zip(spans, met, strict=True) for text in pair)
            rows.append([f"`{method}`", f"`{path.parent.name}`", f"{aim_ms:,.0f}", *pairs])
    rows.sort(key=lambda row: row[0])
    heads = ["method", "suite", "aim", "one frame", "met", "in batches", "met"]
    return printed(heads, rows, [False, False, *[True] * 5])


TABLES = {
    "time of slow methods": _aims_table,
    "speed of voltages": lambda: _table(0, "voltages of one image, `foam16`, 80 x 80, one thread"),
    "speed of the Jacobian": lambda: _table(1, "voltages and Jacobian of one image"),
    "speed, where": lambda: f"On {_record()['machine']}:",
    "operations of a gradient": lambda: str(_record()["gradient"]),
    "cost of the harness": _cost_table,
    "cost of the harness, where": _cost_where,
    "speed in short": lambda: str(_record()["summary"]),
}
