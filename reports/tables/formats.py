"""Leaderboards as Markdown, LaTeX and HTML, tables as CSV; names and texts are but data in them."""

import html
import re
from collections.abc import Iterable, Sequence

import pandas as pd
from pandas.api.types import is_numeric_dtype

from eitbench.benchmark.analysis.leaderboard import Row
from eitbench.reports.tables.boards import (
    PrintedBoard,
    note,
    printed_boards,
    prior_knowledge,
    tracks_table,
)
from eitbench.reports.tables.challenge import LEGEND, challenge_rows, challenge_table
from eitbench.reports.tables.columns import Column, layout, legend
from eitbench.reports.tables.references import KEYS, SELF


def csv_text(table: pd.DataFrame, float_format: str | None = None) -> str:
    """`table` as CSV; a text that a spreadsheet would take for a formula gets an apostrophe.

    Source: OWASP, CSV injection.
    """
    safe = table.copy()
    for name in table.columns:
        if not is_numeric_dtype(table[name]):
            safe[name] = pd.Series(map(_no_formula, table[name]), table.index, dtype=object)
    return safe.to_csv(index=False, lineterminator="\n", float_format=float_format)


def _no_formula(value: object) -> object:
    if not isinstance(value, str):
        return value
    text = f"'{value}" if value.startswith(("=", "+", "-", "@", "\t", "\r")) else value
    return text.replace("\r", "\n")  # which is quoted, where a lone \r would begin a line


def to_markdown(rows: Sequence[Row], columns: Sequence[str] = ()) -> str:
    """One table per scenario, the best values in bold, and notes below it."""
    parts = []
    for board in printed_boards(rows, columns):
        shown = board.columns()
        lines = [f"### {escape_markdown(board.title)}", ""]
        lines += markdown_table(
            [escape_markdown(c.title) for c in shown],
            board.texts(escape_markdown, "**{}**".format),
            [c.form != "" for c in shown],
        )
        lines += ["", escape_markdown(legend(shown))]
        if text := note(board.rows):
            lines += ["", escape_markdown(text)]
        if tracks := tracks_table(board.rows):
            heads, *body = ([escape_markdown(text) for text in row] for row in tracks)
            lines += ["", *markdown_table(heads, body)]
        if known := prior_knowledge(board.rows):
            lines += ["", "Prior knowledge:", ""]
            lines += [f"- {escape_markdown(sentence)}" for sentence in known]
        parts.append("\n".join(lines) + "\n")
    if challenge := challenge_rows(rows):
        texts = challenge_table(challenge)
        heads, *body = ([escape_markdown(text) for text in row] for row in texts)
        table = markdown_table(heads, body, [False, False, *[True] * (len(heads) - 2)])
        parts.append("\n".join([escape_markdown(LEGEND), "", *table]) + "\n")
    return "\n".join(parts)


def markdown_table(
    heads: Sequence[str], rows: Iterable[Sequence[str]], right: Sequence[bool] | None = None
) -> list[str]:
    """Return the lines of a Markdown table of escaped texts.

    Args:
        right: True for columns that are aligned to the right; all but the first if not given.
    """
    right = right or [False, *[True] * (len(heads) - 1)]
    rule = [" ---: " if of_numbers else " --- " for of_numbers in right]
    return [
        f"| {' | '.join(heads)} |",
        f"|{'|'.join(rule)}|",
        *(f"| {' | '.join(row)} |" for row in rows),
    ]


def escape_markdown(text: str) -> str:
    """Return `text` as Markdown that shows it as it is."""
    escaped = html.escape(text, quote=False)
    for character in "\\`*_{}[]|~#":
        escaped = escaped.replace(character, "\\" + character)
    return escaped


def to_latex(rows: Sequence[Row], columns: Sequence[str] = ()) -> str:
    """One booktabs table per scenario in the width of IEEE's page, the best values in bold.

    It holds the columns that papers print; the others are in the other formats. It cites the keys
    of `bibliography`.
    """
    parts = []
    for board in printed_boards(rows, columns):
        shown = board.paper_columns()
        headings = layout(board.rows[0]).terminal
        about = escape_latex(f"{board.title}. {legend(shown, headings)}")
        heads = [" ".join([*headings.get(c.name, c.title).split(), c.arrow]) for c in shown]
        keys = [key for row in board.rows for key in (row.get("cites") or "").split(",") if key]
        data = f"; data~\\cite{{{','.join(dict.fromkeys(keys))}}}" if keys else ""
        lines = [
            "% needs \\usepackage{booktabs}; \\cite is of the references.bib of `eitbench report`",
            "\\begin{table*}",
            "\\centering",
            "\\footnotesize",
            "\\setlength{\\tabcolsep}{3.5pt}",
            f"\\caption{{{about} Made with eitbench~\\cite{{{SELF}}}{data}.}}",
            f"\\label{{tab:{_label(board)}}}",
            *_latex_tabular(
                "".join("r" if c.form else "l" for c in shown),
                [escape_latex(head.strip()) for head in heads],
                [[_latex_cell(c, row, board) for c in shown] for row in board.rows],
            ),
        ]
        if tracks := tracks_table(board.rows):
            heads, *body = ([escape_latex(text) for text in row] for row in tracks)
            form = "l" + "r" * (len(heads) - 1)
            lines += ["", "\\smallskip", *_latex_tabular(form, heads, body)]
        for text in filter(None, (note(board.rows), *prior_knowledge(board.rows))):
            lines += ["", f"\\smallskip{{\\footnotesize {escape_latex(text)}}}"]
        lines.append("\\end{table*}")
        parts.append("\n".join(lines) + "\n")
    if challenge := challenge_rows(rows):
        texts = challenge_table(challenge)
        heads, *body = ([escape_latex(text) for text in row] for row in texts)
        lines = ["\\begin{table*}", "\\centering", "\\footnotesize"]
        lines += [f"\\caption{{{escape_latex(LEGEND)}}}", "\\label{tab:ktc2023}"]
        lines += _latex_tabular("ll" + "r" * (len(heads) - 2), heads, body)
        parts.append("\n".join([*lines, "\\end{table*}"]) + "\n")
    return "\n".join(parts)


def _latex_tabular(form: str, heads: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    return [
        f"\\begin{{tabular}}{{{form}}}",
        "\\toprule",
        " & ".join(heads) + " \\\\",
        "\\midrule",
        *(" & ".join(row) + " \\\\" for row in rows),
        "\\bottomrule",
        "\\end{tabular}",
    ]


def _label(board: PrintedBoard) -> str:
    """Return what other text refers to a table by: letters, digits and hyphens of its title."""
    return re.sub(r"[^a-z0-9]+", "-", board.name.lower()).strip("-")


def _latex_cell(column: Column, row: Row, board: PrintedBoard) -> str:
    text = escape_latex(column.text(row))
    if board.is_best(column, row):
        text = f"\\textbf{{{text}}}"
    if column.name == "method" and row["method"] in KEYS:
        text += f"~\\cite{{{KEYS[row['method']]}}}"
    ends = escape_latex(column.ends(row))
    return f"{text} {{\\scriptsize({ends})}}" if ends else text


_LATEX = {
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "$": r"\$", "&": r"\&", "#": r"\#",
    "_": r"\_", "%": r"\%", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}", "–": "--",
    "↑": r"$\uparrow$", "↓": r"$\downarrow$",
}  # fmt: skip


def escape_latex(text: str) -> str:
    """Return `text` as LaTeX that shows it as it is."""
    return "".join(_LATEX.get(character, character) for character in text)


def to_html(rows: Sequence[Row], columns: Sequence[str] = ()) -> str:
    """One table per scenario, the best values in bold: a fragment to put into a page."""
    lines = []
    for board in printed_boards(rows, columns):
        titles = [html.escape(c.title) for c in board.columns()]
        body = board.texts(html.escape, "<strong>{}</strong>".format)
        lines += _html_table(html.escape(board.title), titles, body)
        lines.append(f"<p>{html.escape(legend(board.columns()))}</p>")
        if text := note(board.rows):
            lines.append(f"<p>{html.escape(text)}</p>")
        if tracks := tracks_table(board.rows):
            heads, *body = ([html.escape(text) for text in row] for row in tracks)
            lines += _html_table("Tracks", heads, body)
        if known := prior_knowledge(board.rows):
            items = "".join(f"<li>{html.escape(sentence)}</li>" for sentence in known)
            lines += ["<p>Prior knowledge:</p>", f"<ul>{items}</ul>"]
    if challenge := challenge_rows(rows):
        heads, *body = ([html.escape(text) for text in row] for row in challenge_table(challenge))
        lines += [*_html_table("KTC2023", heads, body), f"<p>{html.escape(LEGEND)}</p>"]
    return "\n".join(lines) + "\n" if lines else ""


def _html_table(caption: str, heads: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    cells = "".join(f'<th scope="col">{head}</th>' for head in heads)
    return [
        "<table>",
        f"<caption>{caption}</caption>",
        f"<thead><tr>{cells}</tr></thead>",
        "<tbody>",
        *(f"<tr>{''.join(f'<td>{text}</td>' for text in row)}</tr>" for row in rows),
        "</tbody>",
        "</table>",
    ]
