"""The kinds of runs: they rank methods by images or by places, or forward operators."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from eitbench.benchmark.metrics.metric_spec import MetricSpec
from eitbench.benchmark.metrics.operator_metrics import OPERATOR_COSTS, OPERATOR_METRICS
from eitbench.benchmark.metrics.specs import METRICS

PINNED, SHARED = "pinned", "shared"
"""How a cell was timed: on a core of its own, or beside other cells; column `timed`."""
CONDITIONS = ("calibration_ms", "calibration_spread", "load", "cpu_mhz")
"""Columns that say under which conditions it was, see `run.timing.Conditions`."""


@dataclass(frozen=True)
class RunKind:
    """A kind of run: what it ranks, and the names of its files and columns.

    Attributes:
        name: "method" or "operator": the column of every table that says who is ranked.
        table: file with one row per scenario and method or operator.
        arrays: file with their answers.
        array: name of the answers in that file.
        labels: columns beside the name that tell rows of one scenario apart.
        metrics: the figures of accuracy by name, in the order of rows of leaderboards.
        costs: columns of times and memory.
        facts: columns of text.
        ranked_by: what decides a rank, by the first of these that any row of the scenario has.
    """

    name: str
    table: str
    arrays: str
    array: str
    labels: tuple[str, ...]
    metrics: Mapping[str, MetricSpec]
    costs: tuple[str, ...]
    facts: tuple[str, ...]
    ranked_by: tuple[str, ...]

    def __reduce__(self) -> tuple[Callable[[str], "RunKind"], tuple[str]]:
        """Name it: in another process it is one of `RUN_KINDS`, too, and no copy of it."""
        return _kind_of, (self.table,)


def _kind_of(table: str) -> RunKind:
    return next(kind for kind in RUN_KINDS.values() if kind.table == table)


METHOD_RUNS = RunKind(
    name="method",
    table="methods.parquet",
    arrays="reconstructions.h5",
    array="conductivity",
    labels=("track",),
    metrics=METRICS,
    costs=(
        "first_frame_ms",
        "frame_ms_p50",
        "frame_ms_p95",
        "frame_ms_p99",
        "batch_fps",
        "setup_s",
        "train_s",
        "memory_mb",
    ),
    facts=("differs", "timed"),
    # A true conductivity gives a score, true classes the challenge's score or a CC, presses a
    # place, and recordings else a response.
    ranked_by=("score", "ktc_score", "cc", "localisation_mm", "repeatability_db"),
)
PLACE_RUNS = replace(METHOD_RUNS, table="places.parquet", arrays="places.h5", array="place")
OPERATOR_RUNS = RunKind(
    name="operator",
    table="operators.parquet",
    arrays="voltages.h5",
    array="voltages",
    labels=(),
    metrics=OPERATOR_METRICS,
    costs=tuple(OPERATOR_COSTS),
    facts=("trained_on", "timed"),
    ranked_by=("mse",),
)
RUN_KINDS = {"methods": METHOD_RUNS, "places": PLACE_RUNS, "operators": OPERATOR_RUNS}
