"""What the pages of the site say: rows and sentences, which the templates lay out."""

from __future__ import annotations

import itertools
import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple
from urllib.parse import quote

import numpy as np
from markupsafe import Markup

from eitbench.benchmark.analysis.overall import MIN_SCENARIOS, mid_ranks
from eitbench.benchmark.analysis.results import failures
from eitbench.benchmark.analysis.standings import SIGNIFICANT
from eitbench.benchmark.findings.noise import CEILING
from eitbench.benchmark.submissions.hidden import (
    PublishedKey,
    is_retired,
    published_keys,
    read_hidden,
)
from eitbench.benchmark.submissions.tiers import board_of, is_ranked, tier
from eitbench.reports.page.answer import MOST_ANSWERS, answer, summary, tied_with_first
from eitbench.reports.page.report_data import counted_data
from eitbench.reports.site.edition import Edition, SuitePart, method_file, name_of
from eitbench.reports.tables.boards import PrintedBoard, lacking
from eitbench.reports.tables.ceiling import ceiling_notes, ceiling_rows
from eitbench.reports.tables.columns import Column, layout, legend, printable
from eitbench.reports.tables.gaps import HEADS, gap_texts, gaps_note, run_tier, tier_texts

if TYPE_CHECKING:
    from eitbench.benchmark.analysis.leaderboard import Row
    from eitbench.benchmark.analysis.overall import WinsRow
    from eitbench.benchmark.analysis.results import Run
    from eitbench.reports.page.report_data import BoardData

MOST_TABLES = 8
"""Of suites of more scenarios: a page of all their tables would be slow to open."""
NAMES = ("method", "operator")
WORST = 5  # scenarios that a method's page lists of those on which it does worst


Text = str | Markup


class Cell(NamedTuple):
    """A cell of a table, with its class."""

    text: Text
    kind: str = ""


@dataclass(frozen=True)
class Table:
    """A table with its caption; a number in a cell is text already."""

    title: str
    heads: Sequence[str]
    rows: Sequence[Sequence[Text | Cell]]
    note: str = ""


def link(text: str, file: str, home: str = "") -> Markup:
    """A link to a file of the site, from a page whose way to the front page is `home`."""
    # What is quoted in a file's name is quoted once more.
    return Markup('<a href="{}">{}</a>').format(home + quote(file), printable(text))


def overall_table(edition: Edition) -> Table | None:
    """All methods over all suites: what they win, and their mean rank in each suite."""
    if not edition.wins:
        return None
    suites = [suite for suite in edition.suites if suite.report["boards"][0]["kind"] == "method"]
    ranks = {suite.name: mean_ranks(suite) for suite in suites}
    heads = ["Method", "Comparisons won", "Suites", "Simulated training", *(s.name for s in suites)]
    trained: dict[str, set[bool]] = {}
    for board in (board for suite in suites for board in suite.boards):
        for of in board["views"][0]["rows"]:
            known = trained.setdefault(name_of(of), set())
            known |= set() if of["training"] is None else {bool(of["training"])}
    rows = []
    for row in edition.wins:
        known = trained.get(row.method, set())  # empty where nothing is known
        cells: list[Text | Cell] = [
            link(row.method, method_file(row.method)),
            Cell(_share(row), "bar"),
            Cell(str(row.suites), "number"),
            "yes" if True in known else "no" if known else "–",
        ]
        for suite in suites:
            rank = ranks[suite.name].get(row.method)
            cells.append(Cell("–", "number") if rank is None else _rank_cell(*rank))
        rows.append(cells)
    note = (
        "A method is compared with every other one on each data set, by the figure that ranks "
        "there. Frames that several suites use count once, in the data set that has the most "
        "frames and, of equals, the most methods. A suite counts as much as any other, and figures "
        "of different data sets are never averaged. Intervals (95 %) are of a bootstrap over "
        f"suites. Methods on fewer than {MIN_SCENARIOS} suites stand below the others, without an "
        "interval: they met few opponents. Columns of suites hold the mean rank over all of their "
        "own scenarios and the number of methods there. Green: in the first third of them; red: in "
        "the last third."
    )
    return Table("Over all suites", heads, rows, note)


def mean_ranks(suite: SuitePart) -> dict[str, tuple[float, int]]:
    """Mean rank of each method over the scenarios of a suite, and the number of those ranked.

    As on the suite's own page, methods without a figure on one of the scenarios are left out, and
    the others are ranked among themselves.
    """
    scenarios = list(suite.figures.values())
    names = [name for name in scenarios[0] if all(name in of for of in scenarios)]
    if not names:
        return {}
    ranks = mid_ranks(np.array([[of[name] for name in names] for of in scenarios])).mean(axis=0)
    return {name: (rank, len(names)) for name, rank in zip(names, ranks.tolist(), strict=True)}


def _rank_cell(rank: float, most: int) -> Cell:
    text = Markup("{}<small> of {}</small>").format(f"{rank:.3g}", most)
    third = (rank - 1) / max(most - 1, 1)
    return Cell(text, "number " + ("good" if third <= 1 / 3 else "poor" if third > 2 / 3 else ""))


def _share(row: WinsRow) -> Markup:
    ends = "" if row.low is None else f" ({row.low:.0%} to {row.high:.0%})"
    return Markup('<span style="--share:{}">{}<small>{}</small></span>').format(
        f"{row.share:.3f}", f"{row.share:.0%}", ends
    )


def brief_answers(suite: SuitePart) -> list[str]:
    """Who is first, in a line for each scenario, or in one for the suite where there are many."""
    if len(suite.boards) > MOST_ANSWERS:
        return answers(suite)
    lines = []
    for board in suite.boards:
        rows = board["views"][0]["rows"]
        column = layout(rows[0]).column(board["ranked_by"])
        if column is None or rows[0].get(board["ranked_by"]) is None:
            continue
        tied = tied_with_first(board)
        others = "method" if len(tied) == 1 else "methods"
        apart = f", not told apart from {len(tied)} other {others}" if tied else ""
        lines.append(
            printable(
                f"{board['scenario']}: {rows[0]['label']}, {column.title} "
                f"{column.whole_text(rows[0])}{apart}."
            )
        )
    return lines


def answers(suite: SuitePart) -> list[str]:
    """The answer of each scenario, or that of the suite where there are many."""
    boards = suite.report["boards"]
    if len(boards) <= MOST_ANSWERS:
        return [answer(board, boards) for board in boards]
    return summary(suite.boards)


def summary_table(suite: SuitePart) -> Table | None:
    """Mean rank and wins over the scenarios of a suite; None for a single one."""
    found = suite.report["overall"].get("||")
    if not found:
        return None
    names = {
        row["label"]: name_of(row) for board in suite.boards for row in board["views"][0]["rows"]
    }
    rows: list[list[Text | Cell]] = [
        [
            link(row["method"], method_file(names[row["method"]]), "../"),
            Cell(_with_ends(row, "rank", ".2f"), "number"),
            Cell(_with_ends(row, "wins", ".0%"), "number"),
        ]
        for row in found["rows"]
    ]
    left_out = ", ".join(found["left_out"])
    notes = [
        f"Not on all scenarios, and left out: {printable(left_out)}." if left_out else "",
        counted_data(suite.report["boards"]),
    ]
    note = " ".join(filter(None, notes))
    title = f"Over the {len(found['scenarios'])} scenarios"
    return Table(title, ["Method", "Mean rank", "Best on"], rows, note)


def matrix_table(suite: SuitePart) -> Table | None:
    """What ranks, of each method on each scenario; None for a single scenario."""
    boards = suite.boards
    if len(boards) < 2:
        return None
    names = list(dict.fromkeys(
        row["label"] for board in boards for row in board["views"][0]["rows"]
    ))  # fmt: skip
    rows = []
    for board in boards:
        of = {row["label"]: row for row in board["views"][0]["rows"]}
        column = layout(next(iter(of.values()))).column(board["ranked_by"])
        cells: list[Text | Cell] = [
            Markup("{}<small> {}</small>").format(board["scenario"], column.title if column else "")
        ]
        first = board["views"][0]["rows"][0]
        best = {row["label"] for row in (first, *tied_with_first(board))}
        for name in names:
            text = column.text(of[name]) if column and name in of else "–"
            kind = "number best" if board["pairs"] and name in best else "number"
            cells.append(Cell(text, kind))
        rows.append(cells)
    tested = any(board["clusters"] for board in boards)
    note = "Green: the best, and methods that cannot be told apart from it." if tested else ""
    return Table("What ranks, by scenario", ["Scenario", *names], rows, note)


def hidden_table(suite: SuitePart) -> Table | None:
    """Methods on the open and on a hidden test set; None where none was drawn."""
    version = board_of(suite.runs[0].path)
    if version is None:
        return None
    keys = published_keys(version)
    found = [
        (gap, _key(keys, record.key))
        for record in read_hidden(version)
        if record.suite == suite.name
        for gap in record.gaps
    ]
    if not found:
        return None
    rows: list[list[Text | Cell]] = [
        [*(Cell(text, "number" if k > 2 else "") for k, text in enumerate(gap_texts(gap))), key]
        for gap, key in found
    ]
    note = gaps_note()
    if any(key == "key published" for _, key in found):
        note += (
            " Key published: the key was secret when these methods ran. It is published now, so "
            "that anybody can draw the set; methods that come later need a new key."
        )
    return Table("On a hidden test set", [*HEADS, "Key"], rows, note)


def _key(keys: Sequence[PublishedKey], sha256: str) -> str:
    if all(of.sha256 != sha256 for of in keys):  # of a folder without `hidden.toml`
        return "key not known here"
    return "key published" if is_retired(keys, sha256) else "key secret"


def hidden_keys(edition: Edition) -> str:
    """Say which hidden sets of a version have a secret key, and which one that is published."""
    keys = edition.keys
    secret = sorted({of.suite for of in keys if not is_retired(keys, of.sha256)})
    published = sorted({of.suite for of in keys} - set(secret))
    sentences = []
    if secret:
        sentences.append(f"The key of {', '.join(secret)} is secret.")
    if published:
        sentences.append(
            f"The key of {', '.join(published)} is published since its runs were made: anybody can "
            "draw these sets, so they are no test of a method that comes later. It needs a new key."
        )
    return printable(" ".join(sentences))


def self_reported_table(suite: SuitePart) -> Table | None:
    """Submissions that are not ranked; None without any."""
    if suite.self_reported is None:
        return None
    rows: list[list[Text | Cell]] = []
    for board in suite.self_reported.report["boards"]:
        for row in board["views"][0]["rows"]:
            column = layout(row).column(board["ranked_by"])
            rows.append([
                row["scenario"] + (f" ({board['apart']})" if board["apart"] else ""),
                Cell(link(name_of(row), method_file(name_of(row)), "../")),
                printable(row["run"]),
                Cell(f"{column.title} {column.whole_text(row)}" if column else "–", "number"),
                "self-reported",
            ])  # fmt: skip
    note = (
        "Nobody but their authors has made these images. They count in no rank, no answer and no "
        "comparison until they are made again from code (tier reproduced)."
    )
    heads = ["Scenario", "Method", "Submission", "Figure", "Tier"]
    return Table("Self-reported, not ranked", heads, rows, note)


def board_table(board: BoardData, suite: SuitePart) -> Table:
    """The leaderboard of one scenario, with the columns of a table in a paper.

    Where the suite has submissions, every row has its tier. The ceiling is the last row, unranked.
    """
    rows = board["views"][0]["rows"]
    columns = board_columns(board)
    printed = PrintedBoard(board["name"], board["name"], rows)
    table: list[list[Text | Cell]] = [
        [_cell(column, row, printed) for column in columns] for row in [*rows, *ceiling_rows(rows)]
    ]
    about = [f"{board['n']:,} samples"]
    if board["sensor"]:
        about.append(f"sensor {board['sensor']}")
    if board["snr_db"] is not None:
        clean = isinstance(board["snr_db"], str)
        about.append("clean frames" if clean else f"{board['snr_db']:g} dB")
    about.append("a recording" if board["recorded"] else "simulated")
    if board["inverse_crime"]:
        about.append("data from the mesh that methods invert with")
    title = board["scenario"] + (f" ({board['apart']})" if board["apart"] else "")
    heads = [f"{column.title} {column.arrow}".strip() for column in columns]
    if suite.has_submissions:
        heads.append("Tier")
        for row, texts in itertools.zip_longest(rows, table):
            if row is None:
                texts.append("not ranked")
                continue
            found = tier(suite.run(row["run"]), row["scenario"], name_of(row))
            texts.append(found.tier + (" (key published)" if found.key_published else ""))
    notes = [", ".join(about), *lacking(rows), *ceiling_notes(rows)]
    return Table(title, heads, table, printable("; ".join(notes)) + ".")


def board_columns(board: BoardData) -> list[Column]:
    """The columns of a table in a paper, the method's first."""
    paper = layout(board["views"][0]["rows"][0]).paper
    columns = [Column(**of) for of in board["columns"]]
    shown = [of for of in columns if of.name in paper and of.name not in ("run", "n")]
    return sorted(shown, key=lambda of: of.name not in NAMES)


def columns_legend(suite: SuitePart) -> str:
    """What the columns of the boards of a suite hold."""
    columns = {of.name: of for board in suite.boards for of in board_columns(board)}
    return printable(legend(list(columns.values())))


def _cell(column: Column, row: Row, board: PrintedBoard) -> Cell:
    if column.name in NAMES:
        if name_of(row) == CEILING:
            return Cell(Markup("<em>{}</em>").format(CEILING))
        return Cell(link(row["label"], method_file(name_of(row)), "../"))
    text: Text = column.text(row)
    if ends := column.ends(row):
        text = Markup("{}<small> {}</small>").format(text, ends)
    best = " best" if board.is_best(column, row) else ""
    return Cell(text, ("number" if column.form else "") + best)


def _with_ends(row: Row, name: str, form: str) -> str:
    """A figure of `OverallRow` with its 95 % interval, if it has one; "–" where it is not known."""
    if row[name] is None:
        return "–"
    low, high = row[f"{name}_low"], row[f"{name}_high"]
    ends = "" if low is None else f" ({format(low, form)} to {format(high, form)})"
    return format(row[name], form) + ends


def results_table(name: str, edition: Edition) -> Table:
    """Every result of a method, with the command that makes it again."""
    heads = ["Suite", "Scenario", "Rank", "Ties", "Figure", "Frame", "Tier", "Command"]
    rows = [
        cells
        for part in edition.parts
        for board in part.report["boards"]
        for row in board["views"][0]["rows"]
        if name_of(row) == name
        for cells in _results(part, board, row)
    ]
    return Table("Every result", heads, rows)


def _results(part: SuitePart, board: BoardData, row: Row) -> list[list[Text | Cell]]:
    """A row of `results_table` for each run that holds a result of a method."""
    column = layout(row).column(board["ranked_by"])
    figure = "–" if column is None else f"{column.title} {column.whole_text(row)}"
    scenario = row["scenario"] + (f" ({board['apart']})" if board["apart"] else "")
    rank, time = f"{row['rank']} of {len(board['views'][0]['rows'])}", row.get("frame_ms_p50")
    runs = [part.run(run) for run in (row["run"], *(row["repeats"] or "").split(", ")) if run]
    return [
        [
            link(part.name, part.file, "../"), scenario,
            Cell(rank if is_ranked(run) else "not ranked", "number"),
            row.get("group") or "–", Cell(printable(figure), "number"),
            Cell("–" if time is None else f"{time:.3g} ms", "number"),
            _tier(run, row), Markup("<code>{}</code>").format(row["command"]),
        ]
        for run in runs
    ]  # fmt: skip


def _tier(run: Run, row: Row) -> str:
    """The tier of a method of a run, and what its hidden figure is more or less."""
    found, gap = tier_texts(run, row)
    return (found or run_tier(run)) + (f"; hidden minus open {gap}" if gap else "")


def told(name: str, edition: Edition) -> list[tuple[str, str]]:
    """What a method was told, and on which scenarios."""
    found: dict[str, list[str]] = {}
    for part in edition.parts:
        for board, row in part.rows(name):
            if says := row.get("prior_knowledge"):
                found.setdefault(says, []).append(f"{part.name} / {board['scenario']}")
    return [(says, _listed(where)) for says, where in found.items()]


def training_cost(name: str, edition: Edition) -> list[tuple[str, str]]:
    """How long the training of a method took with all that it is built on, and for what."""
    found: dict[str, list[str]] = {}
    for part in edition.parts:
        for board, row in part.rows(name):
            if seconds := row.get("train_s"):
                where = f"{part.name} / {board['scenario']}"
                digits = ",.0f" if seconds >= 100 else ".2g"
                found.setdefault(f"{seconds:{digits}} s", []).append(where)
    return [(seconds, _listed(where)) for seconds, where in found.items()]


def chosen_parameters(name: str, edition: Edition) -> list[tuple[str, str]]:
    """Parameters that tuning chose for a method, and on which scenarios."""
    found: dict[str, list[str]] = {}
    for suite in edition.suites:
        for run in suite.report["runs"]:
            for cell in run["cells"]:
                chosen = cell.get("parameters")
                if cell.get("name") == name and not cell.get("variant") and chosen:
                    pairs = ", ".join(f"{k} = {_short(v)}" for k, v in chosen.items())
                    where = f"{suite.name} / {cell.get('scenario')}"
                    found.setdefault(pairs, []).append(where)
    return [(pairs, _listed(dict.fromkeys(where))) for pairs, where in found.items()]


def _short(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.3g}"
    return value if isinstance(value, str) else json.dumps(value)


def _listed(names: Any, most: int = 4) -> str:
    names = list(names)
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return printable(", ".join(names[:most]) + more)


def failings(name: str, edition: Edition) -> list[str]:
    """Where a method fails: samples without an image, and scenarios on which it does worst."""
    sentences = [
        f"{suite.name}: {sentence}."
        for suite in edition.suites
        for run in suite.runs
        for sentence in failures(run)
        if sentence.startswith(f"{name!r} ")
    ]
    beaten = []
    for suite in edition.suites:
        for board, row in suite.rows(name):
            rows = board["views"][0]["rows"]
            place = rows.index(row)
            lost = sum(p["second"] == place and p["p"] < SIGNIFICANT for p in board["pairs"])
            if lost and row["rank"]:
                where = f"{suite.name} / {board['scenario']}"
                share = (row["rank"] - 1) / max(len(rows) - 1, 1)
                beaten.append((share, where, row, rows, lost))
    beaten.sort(key=lambda of: (-of[0], of[1]))
    for _, where, row, rows, lost in beaten[:WORST]:
        column = layout(row).column(row["ranked_by"])
        figure = "" if column is None else f": {column.title} {column.text(row)}, the first has "
        figure += "" if column is None else column.text(rows[0])
        sentences.append(
            f"{where}{figure}; rank {row['rank']} of {len(rows)}, clearly beaten by {lost} "
            f"method{'s' * (lost != 1)}."
        )
    return [printable(sentence) for sentence in sentences]
