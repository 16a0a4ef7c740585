"""Leaderboards in every format they are printed in."""

import csv
import html
import io
import json
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eitbench.benchmark.analysis.leaderboard import Row, boards
from eitbench.benchmark.analysis.results import read_run
from eitbench.benchmark.analysis.standings import standings
from eitbench.reports.tables.columns import Column, layout, printable, shown_columns
from eitbench.reports.tables.published import comparison, published_rows

if TYPE_CHECKING:
    from rich.console import Group

Board = tuple[str, list[Row]]
_HASH_DIGITS = 6
_LONGEST_NAME = 24
_PADDING = 3


def leaderboard(runs: Sequence[Path]) -> list[Row]:
    """The ranked rows of run directories with what is told of them, those of a scenario together.

    They are plain values for JSON; see `Standing.rows`.

    Raises:
        InputError: a path is no run directory.
        DataCorruptError: a file of a run is damaged.
    """
    found = standings([read_run(path) for path in runs])
    return [row for standing in found for row in standing.rows]


def write_leaderboard(
    rows: Sequence[Row],
    folder: Path,
    forms: Sequence[str] = ("json", "csv", "md"),
    stem: str = "leaderboard",
) -> list[Path]:
    """Write `leaderboard.json`, `.csv` and `.md`, or other `FORMATS`, into `folder`."""
    written = []
    for form in forms:
        path = folder / f"{stem}.{'tex' if form == 'latex' else form}"
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
    """One table per scenario, the best values in bold, and what is to be known of it."""
    parts = []
    for title, board in _boards(rows):
        columns = shown_columns(board)
        lines = [f"### {escape_markdown(title)}", ""]
        lines.append("| " + " | ".join(escape_markdown(c.title) for c in columns) + " |")
        lines.append("|" + "|".join(" ---: " if c.form else " --- " for c in columns) + "|")
        for row in board:
            cells = (escape_markdown(c.whole_text(row)) for c in columns)
            bold = (_is_best(c, row, board) for c in columns)
            lines.append(
                "| "
                + " | ".join(f"**{t}**" if b else t for t, b in zip(cells, bold, strict=True))
                + " |"
            )
        if said := note(board):
            lines += ["", escape_markdown(said)]
        if compared := tracks_table(board):
            heads, *body = ([escape_markdown(t) for t in row] for row in compared)
            lines += [
                "",
                "| " + " | ".join(heads) + " |",
                "| --- " + "| ---: " * (len(heads) - 1) + "|",
            ]
            lines += ["| " + " | ".join(texts) + " |" for texts in body]
        if known := prior_knowledge(board):
            lines += ["", "Prior knowledge:", ""]
            lines += [f"- {escape_markdown(sentence)}" for sentence in known]
        parts.append("\n".join(lines) + "\n")
    return "\n".join(parts)


def to_latex(rows: Sequence[Row]) -> str:
    """One booktabs table per scenario in the width of IEEE's page, the best values in bold.

    It holds the columns that papers print; the others are in the other formats.
    """
    parts = []
    for title, board in _boards(rows):
        known = layout(board[0])
        lost = any(row["coverage"] is not None and row["coverage"] < 1 for row in board)
        columns = [
            c
            for c in shown_columns(board)
            if c.name in known.paper and (lost or c.name != "coverage")
        ]
        headings = (known.terminal[c.name].replace("\n", " ") for c in columns)
        lines = [
            "% needs \\usepackage{booktabs}",
            "\\begin{table*}",
            "\\centering",
            "\\footnotesize",
            "\\setlength{\\tabcolsep}{3.5pt}",
            f"\\caption{{{_latex(title)}}}",
            "\\begin{tabular}{" + "".join("r" if c.form else "l" for c in columns) + "}",
            "\\toprule",
            " & ".join(map(_latex, headings)) + " \\\\",
            "\\midrule",
        ]
        for row in board:
            lines.append(" & ".join(_latex_cell(c, row, board) for c in columns) + " \\\\")
        lines += ["\\bottomrule", "\\end{tabular}"]
        if tracks := tracks_table(board):
            cells = [" & ".join(map(_latex, row)) + " \\\\" for row in tracks]
            head = ["", "\\smallskip", "\\begin{tabular}{l" + "r" * (len(tracks[0]) - 1) + "}"]
            lines += [*head, "\\toprule", cells[0], "\\midrule", *cells[1:]]
            lines += ["\\bottomrule", "\\end{tabular}"]
        for said in filter(None, (note(board), *prior_knowledge(board))):
            lines += ["", f"\\smallskip{{\\footnotesize {_latex(said)}}}"]
        lines.append("\\end{table*}")
        parts.append("\n".join(lines) + "\n")
    return "\n".join(parts)


def _latex_cell(column: Column, row: Row, board: Sequence[Row]) -> str:
    text = _latex(column.text(row))
    if _is_best(column, row, board):
        text = f"\\textbf{{{text}}}"
    ends = _latex(column.ends(row))
    return f"{text} {{\\scriptsize({ends})}}" if ends else text


def to_html(rows: Sequence[Row]) -> str:
    """One table per scenario, the best values in bold: a fragment to put into a page."""
    lines = []
    for title, board in _boards(rows):
        columns = shown_columns(board)
        lines += ["<table>", f"<caption>{html.escape(title)}</caption>"]
        heads = "".join(f'<th scope="col">{html.escape(c.title)}</th>' for c in columns)
        lines.append(f"<thead><tr>{heads}</tr></thead>")
        lines.append("<tbody>")
        for row in board:
            cells = ((html.escape(c.whole_text(row)), _is_best(c, row, board)) for c in columns)
            marked = (f"<td><strong>{t}</strong></td>" if b else f"<td>{t}</td>" for t, b in cells)
            lines.append(f"<tr>{''.join(marked)}</tr>")
        lines += ["</tbody>", "</table>"]
        if said := note(board):
            lines.append(f"<p>{html.escape(said)}</p>")
        if compared := tracks_table(board):
            titles, *body = ([html.escape(t) for t in row] for row in compared)
            lines += ["<table>", "<caption>Tracks</caption>"]
            lines.append("<thead><tr>" + "".join(f'<th scope="col">{t}</th>' for t in titles))
            lines.append("</tr></thead><tbody>")
            lines += [f"<tr>{''.join(f'<td>{t}</td>' for t in cells)}</tr>" for cells in body]
            lines += ["</tbody>", "</table>"]
        if known := prior_knowledge(board):
            items = "".join(f"<li>{html.escape(sentence)}</li>" for sentence in known)
            lines += ["<p>Prior knowledge:</p>", f"<ul>{items}</ul>"]
    return "\n".join(lines) + "\n" if lines else ""


FORMATS: dict[str, Callable[[Sequence[Row]], str]] = {
    "md": to_markdown,
    "csv": to_csv,
    "json": to_json,
    "latex": to_latex,
    "html": to_html,
}


def table(rows: Sequence[Row], width: int) -> "Group":
    """One table per scenario for a terminal of `width` characters, the best values green.

    Under it stands what is to be known of it.
    """
    from rich import box
    from rich.console import Group, RenderableType
    from rich.table import Table
    from rich.text import Text

    shown_below: list[RenderableType] = []
    for title, board in _boards(rows):
        columns = _fitting(board, width)
        shown = Table(title=Text(title, style="bold"), title_justify="left", box=box.SIMPLE_HEAD)
        for column in columns:
            shown.add_column(
                Text(layout(board[0]).terminal[column.name]),
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
        shown_below.append(shown)
        if said := note(board):
            shown_below += [Text(f" {said}"), Text()]
        if compared := tracks_table(board):
            heads, *body = compared
            beside = Table(title="Tracks", title_justify="left", box=box.SIMPLE_HEAD)
            for k, head in enumerate(heads):
                beside.add_column(Text(head), justify="right" if k else "left")
            for cells in body:
                beside.add_row(*map(Text, cells))
            shown_below.append(beside)
        shown_below += [
            Text(f" Prior knowledge: {sentence}") for sentence in prior_knowledge(board)
        ]
    return Group(*shown_below)


def _fitting(board: Sequence[Row], width: int) -> list[Column]:
    """The most important columns that fit into `width` characters, in the usual order."""
    columns, terminal = layout(board[0]).columns, layout(board[0]).terminal
    shown = {column.name: column for column in shown_columns(board)}
    kept, free = [], width - 1  # of which the right edge takes one
    for name, heading in terminal.items():
        if name not in shown:
            continue
        texts = [*heading.split("\n"), *(shown[name].text(row) for row in board)]
        longest = max(map(len, texts))
        free -= (longest if shown[name].form else min(longest, _LONGEST_NAME)) + _PADDING
        if free < 0:
            break
        kept.append(name)
    return [column for column in columns if column.name in kept]


def _boards(rows: Sequence[Row]) -> Iterable[Board]:
    """The rows of each suite, scenario and data under their title, in the order given.

    The published figures stand below those of the paper's scenarios.
    """
    found = boards(rows)
    names = [f"{board[0]['suite']} / {board[0]['scenario']}" for board in found]
    return [
        (
            printable(name if names.count(name) == 1 else f"{name} ({_data(board[0])})"),
            [*board, *published_rows(board)],
        )
        for name, board in zip(names, found, strict=True)
    ]


def _data(row: Row) -> str:
    """What tells unlike data of one scenario apart."""
    digits = "unknown" if row["data_hash"] is None else row["data_hash"][:_HASH_DIGITS]
    return f"n = {row['n'] if row['data_n'] is None else row['data_n']}, data {digits}"


def note(board: Sequence[Row]) -> str:
    """What is to be known of a board, as one line; "" where there is nothing.

    That is how the published figures are to be read, what differs in software that is not ours, the
    quality of recorded data, what failures cost, and which methods were taught on what they are
    tested on.
    """
    said = comparison(board) + costs_of_failures(board) + overlaps(board) + differences(board)
    for name, words in _NOTES.items():
        known = [row[name] for row in board if row.get(name) is not None]
        if known:
            said.append(words.format(known[0]))
    return f"{'; '.join(said)}." if said else ""


def costs_of_failures(board: Sequence[Row]) -> list[str]:
    """For each method that lost samples, the rank it would have without them, if another."""
    return [
        f"{row['method']} would rank {row['rank_valid']} if what failed were left out"
        for row in board
        if row.get("rank_valid") not in (None, row["rank"]) and row["coverage"] < 1
    ]


def overlaps(board: Sequence[Row]) -> list[str]:
    """For each method that was taught on test samples, how many, or that nothing is known of it."""
    said = []
    for row in board:
        if row.get("overlap"):
            total = row["n"] if row["data_n"] is None else row["data_n"]
            said.append(
                f"{row['overlap']:.0f} of {total} test samples were in the training set of "
                f"{row['method']}"
            )
        elif row.get("prior_knowledge") and row["overlap"] is None:
            said.append(f"whether {row['method']} was trained on test samples is not known here")
    return said


def prior_knowledge(board: Sequence[Row]) -> list[str]:
    """What the methods of a board were told, those told the same together."""
    names: dict[str, list[str]] = {}
    for row in board:
        if row.get("prior_knowledge"):
            names.setdefault(row["prior_knowledge"], []).append(row["method"])
    return [f"{', '.join(dict.fromkeys(methods))}: {words}" for words, methods in names.items()]


def tracks_table(board: Sequence[Row]) -> list[list[str]]:
    """The heads, then a row for each method that was run on other tracks; empty if none was."""
    rows = [
        row
        for row in board
        if any(row.get(gap) is not None for gap in ("tuning_gain", "oracle_gap"))
    ]
    if not rows:
        return []
    by = layout(board[0]).column(rows[0]["ranked_by"])
    heads = [by.title, "default", "tuned", "oracle", "gained by tuning", "left to the oracle"]
    body = []
    for row in rows:
        figures = [row[f"{track}_figure"] for track in ("default", "tuned", "oracle")]
        texts = ["–" if value is None else by.number(value) for value in figures]
        gaps = [_gap(row, name, by) for name in ("tuning_gain", "oracle_gap")]
        body.append([row["method"], *texts, *gaps])
    return [heads, *body]


def _gap(row: Row, name: str, by: Column) -> str:
    value, low, high = (row[f"{name}{end}"] for end in ("", "_low", "_high"))
    if value is None:
        return "–"
    # What rounds to 0 has no sign.
    texts = [re.sub(r"^-(?=[0.]*$)", "", by.number(v)) for v in (value, low, high) if v is not None]
    return texts[0] if len(texts) < 3 else f"{texts[0]} ({texts[1]} to {texts[2]})"


def differences(board: Sequence[Row]) -> list[str]:
    """For each thing that differs in software that is not ours, the methods that it is true of."""
    found: dict[str, list[str]] = {}
    for row in board:
        if words := row.get("differs"):
            found.setdefault(words, []).append(row["method"])
    return [f"{', '.join(dict.fromkeys(names))}: {words}" for words, names in found.items()]


_NOTES = {
    "guess_mm": "guessing one place: {:.1f} mm",
    "reciprocity_error": "reciprocity error of the reference frame: {:.2%}",
    "repeat_noise": "noise between repeats: {:.3%}",
}


def _is_best(column: Column, row: Row, board: Sequence[Row]) -> bool:
    # A mean over the easier part of the samples is no rival of one over all of them; methods are
    # charged for what they lose.
    whole = [r for r in board if r["coverage"] == 1 or (r["coverage"] and "method" in r)]
    values: list[Any] = [r[column.name] for r in whole if r.get(column.name) is not None]
    if column.best is None or row not in whole or row[column.name] is None:
        return False
    # Values that print alike are highlighted alike, unless there is nothing to choose from.
    best = column.number(max(values) if column.best == "max" else min(values))
    return column.text(row) == best and any(column.number(v) != best for v in values)


def escape_markdown(text: str) -> str:
    """`text` as Markdown that shows it as it is."""
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
