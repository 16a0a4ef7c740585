"""The columns of printed leaderboards, and how their numbers are written."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

from eitbench.benchmark.analysis.leaderboard import Row
from eitbench.benchmark.metrics.metric_spec import SMALL, TIME, MetricSpec
from eitbench.benchmark.metrics.operator_metrics import OPERATOR_COSTS, OPERATOR_METRICS
from eitbench.benchmark.metrics.specs import METRICS


@dataclass(frozen=True)
class Column:
    """One column of a printed leaderboard.

    Attributes:
        name: key in a row.
        title: heading; units belong to it.
        form: format specification of its numbers, `TIME` for durations, `SMALL` for numbers that
            may be of any smallness; "" for text.
        best: whether the largest or the smallest value is highlighted, if any.
        always: shown even if no row of the scenario has a value.
    """

    name: str
    title: str
    form: str = ""
    best: Literal["max", "min"] | None = None
    always: bool = False

    @property
    def arrow(self) -> str:
        """An arrow up where more is better, down where less is; "" where neither is."""
        return {"max": "↑", "min": "↓", None: ""}[self.best]

    def text(self, row: Row) -> str:
        """The value in `row` as printed."""
        value = row[self.name]
        if value is None or value == "":
            return "–"
        return self.number(value) if self.form else printable(str(value))

    def whole_text(self, row: Row) -> str:
        """As `text`, with the 95 % interval that `ends` returns."""
        ends = self.ends(row)
        return f"{self.text(row)} ({ends})" if ends else self.text(row)

    def ends(self, row: Row) -> str:
        """The 95 % interval of a rank, of what ranks or of the distance from the ceiling, or ""."""
        low, high = (row.get(f"{self.name}_{end}") for end in ("low", "high"))
        shown = ("rank", "below_ceiling_db", row.get("ranked_by"))
        if low is None or high is None or self.name not in shown:
            return ""
        # A rank that all draws agree on needs none.
        if self.name == "rank" and low == high:
            return ""
        return f"{self.number(low)}–{self.number(high)}"

    def number(self, value: float) -> str:
        """A number as printed."""
        written = {TIME: _time, SMALL: _small}
        return written[self.form](value) if self.form in written else format(value, self.form)


def _time(value: float) -> str:
    """At most 3 significant digits and 3 decimals, and no exponent."""
    if 0 < value < 0.0005:
        return "<0.001"
    rounded = float(f"{value:.3g}")
    return f"{rounded:.3f}".rstrip("0").rstrip(".")


def _small(value: float) -> str:
    """3 significant digits, with an exponent below 0.1: 1.62e-2."""
    if value == 0 or abs(value) >= 0.1:
        return f"{value:.3g}"
    mantissa, exponent = f"{value:.2e}".split("e")
    return f"{mantissa}e{int(exponent)}"


def p_text(p: float | None) -> str:
    """A p-value to three decimals; a dash where nothing was tested."""
    return "–" if p is None else f"{p:.3f}" if p >= 0.001 else "<0.001"


def printable(text: str) -> str:
    """`text` on one line, with what is not printable written as an escape."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def listed(names: Sequence[str]) -> str:
    """Names in a sentence: "a", "a and b", "a, b and c"."""
    *most, last = names
    return f"{', '.join(most)} and {last}" if most else last


def _metrics(specs: Mapping[str, MetricSpec], *names: str) -> list[Column]:
    """Columns of the metrics called `names`."""
    return [Column(s.name, s.heading, s.form, s.best) for s in (specs[name] for name in names)]


@dataclass(frozen=True)
class Layout:
    """The columns for one kind of run.

    Attributes:
        columns: in the order of printed tables.
        paper: names of those in tables for papers.
        terminal: what a terminal shows, the most important first, under headings of a word a line;
            what does not fit its width is left out from the end, and is in the files.
    """

    columns: tuple[Column, ...]
    paper: frozenset[str]
    terminal: Mapping[str, str]

    def column(self, name: str) -> Column | None:
        """The column called `name`; None without one."""
        return next((column for column in self.columns if column.name == name), None)


METHOD_LAYOUT = Layout(
    (
        Column("rank", "#", "d", always=True),
        Column("method", "Method", always=True),
        Column("group", "Ties"),
        *_metrics(METRICS, "score", "bounded", "ssim", "cc", "rie", "psnr"),
        Column("below_ceiling_db", "Below ceiling [dB]", ".2f", "min"),
        Column("frame_solves", "Frame [calibration solves]", TIME, "min"),
        Column("frame_ms_p50", "Frame p50 [ms]", TIME, "min"),
        Column("frame_ms_p99", "p99 [ms]", TIME, "min"),
        *_metrics(
            METRICS, "ktc_score", "localisation_mm", "localisation_p90_mm", "within_5_mm",
            "within_10_mm", "unevenness", "worst_tenth_mm", "farthest_contact_mm",
            "contact_count_error",
            "area_error", "iou", "edge", "artefacts", "force_error", "measured_force_error_n",
            "measured_load_error_percent", "iou_resistive", "iou_conductive", "strength_spearman",
            "repeatability_db",
        ),
        Column("setup_s", "Set-up [s]", TIME, "min"),
        Column("train_s", "Training [s]", TIME, "min"),
        Column("coverage", "Done", ".1%", always=True),
        Column("n", "n", "d", always=True),
        Column("track", "Track", always=True),
        Column("run", "Run"),
    ),
    frozenset(
        {
            "rank", "method", "run", "group", "score", "ssim", "cc", "rie", "psnr",
            "ktc_score", "localisation_mm", "strength_spearman", "repeatability_db", "frame_ms_p50",
            "frame_solves", "coverage", "below_ceiling_db",
        }
    ),
    {
        "rank": "#", "method": "Method", "group": "Ties", "score": "S", "ktc_score": "KTC",
        "localisation_mm": "Loc.\nmm", "farthest_contact_mm": "Farthest\nmm",
        "measured_force_error_n": "Force\nN", "measured_load_error_percent": "Load\n%",
        "repeatability_db": "Repeatability\ndB",
        "frame_ms_p50": "Frame\nms", "frame_solves": "Frame\nsolves", "coverage": "Done",
        "ssim": "SSIM", "cc": "CC", "psnr": "PSNR\ndB", "below_ceiling_db": "Below\nceiling",
        "rie": "RIE", "bounded": "B",
        "strength_spearman": "Strength", "track": "Track", "iou": "IoU", "n": "n",
        "setup_s": "Set-up\ns", "localisation_p90_mm": "90 %\nmm",
        "within_5_mm": "Within\n5 mm", "within_10_mm": "Within\n10 mm",
        "worst_tenth_mm": "Worst\ntenth", "unevenness": "Uneven-\nness", "run": "Run",
    },
)  # fmt: skip
OPERATOR_LAYOUT = Layout(
    (
        Column("rank", "#", "d", always=True),
        Column("operator", "Operator", always=True),
        Column("run", "Run"),
        *_metrics(OPERATOR_METRICS, "mse", "r", "rel_error", "grad_cosine"),
        *_metrics(OPERATOR_COSTS, "forward_ms", "grad_ms", "setup_s", "memory_mb", "train_s"),
        Column("trained_on", "Trained on"),
        Column("coverage", "Done", ".1%", always=True),
        Column("n", "n", "d", always=True),
    ),
    frozenset(
        {"rank", "operator", "run", "mse", "r", "grad_cosine", "forward_ms", "grad_ms", "coverage"}
    ),
    {
        "rank": "#", "operator": "Operator", "mse": "MSE", "r": "R", "coverage": "Done",
        "grad_cosine": "Grad.\ncosine", "forward_ms": "Forward\nms", "grad_ms": "Gradient\nms",
        "rel_error": "Rel.\nerror", "n": "n", "memory_mb": "Memory\nMiB",
        "train_s": "Training\ns", "setup_s": "Set-up\ns", "trained_on": "Trained on",
        "run": "Run",
    },
)  # fmt: skip


_MEANINGS = {
    "group": "methods that share a letter cannot be told apart",
    "score": "0.25 (SSIM + CC + PSNR - RIE)",
    "bounded": "mean of SSIM, CC, 1 - RIE and PSNR / 40 dB, each within 0 to 1",
    "below_ceiling_db": "mean squared error over that of the ceiling, which frames allow at least, "
    "in dB, on the frames that both have; in brackets its 95 % interval",
    "localisation_mm": "median error of the place",
    "localisation_p90_mm": "error of the place that 90 % of the presses stay within",
    "unevenness": "standard deviation of the local error over the skin, over its mean",
    "worst_tenth_mm": "local error that the worst tenth of the places reaches",
    "strength_spearman": "rank correlation of strength with force, pressure or depth",
    "coverage": "share of samples with a valid image",
}


def legend(columns: Sequence[Column], headings: Mapping[str, str] = MappingProxyType({})) -> str:
    """Return one line on what columns hold, and whether more (↑) or less (↓) is better.

    Args:
        columns: those of a table.
        headings: of columns that have another than their title there; the first line counts, where
            it tells them apart.
    """
    best: dict[str, list[str]] = {"↑": [], "↓": [], "": []}
    meanings = []
    whole = {column.name: headings.get(column.name, column.title) for column in columns}
    lines = Counter(heading.split("\n")[0] for heading in whole.values())
    for column in columns:
        heading = whole[column.name].split("\n")[0]
        if lines[heading] > 1:
            heading = whole[column.name].replace("\n", " ")
        best[column.arrow].append(heading)
        if meaning := _MEANINGS.get(column.name):
            meanings.append(f"{heading}: {meaning}")
    more, less = (
        f"{arrow} {word} is better: {', '.join(best[arrow])}"
        for arrow, word in (("↑", "more"), ("↓", "less"))
    )
    parts = [more] * bool(best["↑"]) + [less] * bool(best["↓"]) + meanings
    return f"{'; '.join(parts)}." if parts else ""


_TIMES = frozenset({"frame_ms_p50", "frame_ms_p99", "setup_s", "train_s", "forward_ms", "grad_ms"})


def shown_columns(board: Sequence[Row]) -> list[Column]:
    """The columns that say something about the rows of one scenario.

    Times of several machines do not compare: there, frames are shown in calibration solves alone.
    """
    machines = {row["machine"] for row in board} - {None}
    hidden = _TIMES if len(machines) > 1 else {"frame_solves"}
    if len({row["run"] for row in board} - {None}) < 2:
        hidden = hidden | {"run"}
    return [
        column
        for column in layout(board[0]).columns
        if column.name not in hidden
        and (column.always or any(row.get(column.name) not in (None, "") for row in board))
    ]


def layout(row: Row) -> Layout:
    """The layout of the table that `row` belongs to."""
    return OPERATOR_LAYOUT if "operator" in row else METHOD_LAYOUT
