"""Leaderboards in every format they are printed in."""

import csv
import html
import io
import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from eitbench.benchmark.cards import METRICS
from eitbench.benchmark.results import Row, leaderboard_rows, read_run

if TYPE_CHECKING:
    from rich.console import Group

Board = tuple[str, list[Row]]


@dataclass(frozen=True)
class Column:
    """One column of a printed leaderboard.

    Attributes:
        name: key in a row.
        title: heading; units belong to it.
        form: format specification of its numbers; "" for text.
        best: whether the largest or the smallest value is highlighted, if any.
        always: shown even if no row of the scenario has a value.
    """

    name: str
    title: str
    form: str = ""
    best: Literal["max", "min"] | None = None
    always: bool = False

    def text(self, row: Row) -> str:
        """The value in `row` as printed."""
        value = row[self.name]
        if value is None:
            return "–"
        return format(value, self.form) if self.form else printable(str(value))


def _metric(name: str, form: str) -> Column:
    card = METRICS[name]
    title = card.title if card.unit == "1" else f"{card.title} [{card.unit}]"
    return Column(name, title, form, card.best)


COLUMNS = (
    Column("rank", "#", "d", always=True),
    Column("method", "Method", always=True),
    Column("track", "Track", always=True),
    Column("run", "Run"),
    _metric("score", ".3f"),
    _metric("ssim", ".3f"),
    _metric("cc", ".3f"),
    _metric("rie", ".3f"),
    _metric("psnr", ".2f"),
    _metric("localisation_mm", ".1f"),
    _metric("contact_count_error", ".2f"),
    _metric("area_error", ".2f"),
    _metric("iou", ".3f"),
    _metric("iou_resistive", ".3f"),
    _metric("iou_conductive", ".3f"),
    _metric("strength_spearman", ".2f"),
    _metric("repeatability_db", ".1f"),
    Column("frame_ms_p50", "Frame p50 [ms]", ".3g", "min"),
    Column("frame_ms_p99", "p99 [ms]", ".3g", "min"),
    Column("setup_s", "Set-up [s]", ".3g", "min"),
    Column("train_s", "Training [s]", ".3g", "min"),
    Column("coverage", "Coverage", ".1%", always=True),
    Column("n", "n", "d", always=True),
)

# What a terminal shows, the most important first, under headings of a word a line; what does not
# fit its width is left out from the end, and is in the files.
TERMINAL = {
    "rank": "#", "method": "Method", "score": "S", "localisation_mm": "Loc.\nmm",
    "coverage": "Cover-\nage", "ssim": "SSIM", "psnr": "PSNR\ndB", "cc": "CC",
    "repeatability_db": "Repeat.\ndB", "frame_ms_p50": "Frame\nms", "rie": "RIE",
    "strength_spearman": "Strength", "iou": "IoU", "n": "n", "track": "Track",
    "setup_s": "Set-up\ns", "run": "Run",
}  # fmt: skip
_LONGEST_NAME = 24
_PADDING = 3


def leaderboard(runs: Sequence[Path]) -> list[Row]:
    """The ranked rows of run directories, those of one scenario together; JSON-able.

    Raises:
        InputError: a path is no run directory.
        DataCorruptError: a file of a run is damaged.
    """
    return leaderboard_rows([read_run(path) for path in runs])


def write_leaderboard(rows: Sequence[Row], folder: Path) -> list[Path]:
    """Write `leaderboard.json`, `.csv` and `.md` into `folder`."""
    written = []
    for form in ("json", "csv", "md"):
        path = folder / f"leaderboard.{form}"
        path.write_text(FORMATS[form](rows), encoding="utf-8")
        written.append(path)
    return written


def to_json(rows: Sequence[Row]) -> str:
    """A list of rows, in full precision."""
    return json.dumps(list(rows), indent=2, allow_nan=False) + "\n"


def to_csv(rows: Sequence[Row]) -> str:
    """One line per row, in full precision; empty where a figure is not defined."""
    text = io.StringIO()
    if rows:
        writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    return text.getvalue()


def to_markdown(rows: Sequence[Row]) -> str:
    """One table per scenario, the best values in bold."""
    parts = []
    for title, board in _boards(rows):
        columns = _shown(board)
        lines = [f"### {_markdown(title)}", ""]
        lines.append("| " + " | ".join(_markdown(c.title) for c in columns) + " |")
        lines.append("|" + "|".join(" ---: " if c.form else " --- " for c in columns) + "|")
        for row in board:
            cells = (_markdown(c.text(row)) for c in columns)
            bold = (_is_best(c, row, board) for c in columns)
            lines.append(
                "| "
                + " | ".join(f"**{t}**" if b else t for t, b in zip(cells, bold, strict=True))
                + " |"
            )
        parts.append("\n".join(lines) + "\n")
    return "\n".join(parts)


def to_latex(rows: Sequence[Row]) -> str:
    """One booktabs table per scenario, the best values in bold."""
    parts = []
    for title, board in _boards(rows):
        columns = _shown(board)
        lines = [
            "% needs \\usepackage{booktabs}",
            "\\begin{table}",
            "\\centering",
            f"\\caption{{{_latex(title)}}}",
            "\\begin{tabular}{" + "".join("r" if c.form else "l" for c in columns) + "}",
            "\\toprule",
            " & ".join(_latex(c.title) for c in columns) + " \\\\",
            "\\midrule",
        ]
        for row in board:
            cells = (_latex(c.text(row)) for c in columns)
            bold = (_is_best(c, row, board) for c in columns)
            lines.append(
                " & ".join(f"\\textbf{{{t}}}" if b else t for t, b in zip(cells, bold, strict=True))
                + " \\\\"
            )
        lines += ["\\bottomrule", "\\end{tabular}", "\\end{table}"]
        parts.append("\n".join(lines) + "\n")
    return "\n".join(parts)


def to_html(rows: Sequence[Row]) -> str:
    """One table per scenario, the best values in bold: a fragment to put into a page."""
    lines = []
    for title, board in _boards(rows):
        columns = _shown(board)
        lines += ["<table>", f"<caption>{html.escape(title)}</caption>"]
        heads = "".join(f'<th scope="col">{html.escape(c.title)}</th>' for c in columns)
        lines.append(f"<thead><tr>{heads}</tr></thead>")
        lines.append("<tbody>")
        for row in board:
            cells = ((html.escape(c.text(row)), _is_best(c, row, board)) for c in columns)
            marked = (f"<td><strong>{t}</strong></td>" if b else f"<td>{t}</td>" for t, b in cells)
            lines.append(f"<tr>{''.join(marked)}</tr>")
        lines += ["</tbody>", "</table>"]
    return "\n".join(lines) + "\n" if lines else ""


FORMATS: dict[str, Callable[[Sequence[Row]], str]] = {
    "md": to_markdown,
    "csv": to_csv,
    "json": to_json,
    "latex": to_latex,
    "html": to_html,
}


def table(rows: Sequence[Row], width: int) -> "Group":
    """One table per scenario for a terminal of `width` characters, the best values green."""
    from rich import box
    from rich.console import Group
    from rich.table import Table
    from rich.text import Text

    tables = []
    for title, board in _boards(rows):
        columns = _fitting(board, width)
        shown = Table(title=Text(title, style="bold"), title_justify="left", box=box.SIMPLE_HEAD)
        for column in columns:
            shown.add_column(
                Text(TERMINAL[column.name]),
                justify="right" if column.form else "left",
                vertical="bottom",
                no_wrap=column.form != "",
                max_width=None if column.form else _LONGEST_NAME,
                overflow="fold",
            )
        for row in board:
            shown.add_row(
                *(
                    Text(c.text(row), style="bold green" if _is_best(c, row, board) else "")
                    for c in columns
                )
            )
        tables.append(shown)
    return Group(*tables)


def _fitting(board: Sequence[Row], width: int) -> list[Column]:
    """The most important columns that fit into `width` characters, in the usual order."""
    shown = {column.name: column for column in _shown(board)}
    kept, free = [], width
    for name, heading in TERMINAL.items():
        if name not in shown:
            continue
        texts = [*heading.split("\n"), *(shown[name].text(row) for row in board)]
        longest = max(map(len, texts))
        free -= (longest if shown[name].form else min(longest, _LONGEST_NAME)) + _PADDING
        if free < 0:
            break
        kept.append(name)
    return [column for column in COLUMNS if column.name in kept]


def printable(text: str) -> str:
    """`text` on one line, with what is not printable written as an escape."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def _boards(rows: Sequence[Row]) -> Iterable[Board]:
    """The rows of each suite and scenario under their title, in the order given."""
    boards: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        boards.setdefault((row["suite"], row["scenario"]), []).append(row)
    return [(printable(f"{suite} / {scenario}"), b) for (suite, scenario), b in boards.items()]


def _shown(board: Sequence[Row]) -> list[Column]:
    """The columns that say something about this scenario."""
    several_runs = len({row["run"] for row in board}) > 1
    return [
        column
        for column in COLUMNS
        if (
            several_runs
            if column.name == "run"
            else column.always or any(row[column.name] is not None for row in board)
        )
    ]


def _is_best(column: Column, row: Row, board: Sequence[Row]) -> bool:
    values: list[Any] = [r[column.name] for r in board if r[column.name] is not None]
    if column.best is None or row[column.name] is None:
        return False
    # Values that print alike are highlighted alike, unless there is nothing to choose from.
    best = format(max(values) if column.best == "max" else min(values), column.form)
    return column.text(row) == best and any(format(v, column.form) != best for v in values)


def _markdown(text: str) -> str:
    escaped = html.escape(text, quote=False)
    for character in "\\`*_{}[]|~#":
        escaped = escaped.replace(character, "\\" + character)
    return escaped


_LATEX = {
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "$": r"\$", "&": r"\&", "#": r"\#",
    "_": r"\_", "%": r"\%", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}", "–": "--",
}  # fmt: skip


def _latex(text: str) -> str:
    return "".join(_LATEX.get(character, character) for character in text)
