"""Boards as printed: rows of one suite, scenario and data, with title, best values and notes."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from eitbench.benchmark.analysis.leaderboard import Row, boards, is_whole
from eitbench.benchmark.rundir.kinds import SHARED
from eitbench.reports.tables.ceiling import ceiling_notes, ceiling_rows
from eitbench.reports.tables.columns import Column, layout, printable, shown_columns
from eitbench.reports.tables.published import comparison, published_rows

_HASH_DIGITS = 6


@dataclass(frozen=True)
class PrintedBoard:
    """Rows of the same suite, scenario and data.

    Attributes:
        name: of its suite and scenario, with the hash of the data where several have it.
        title: its name and what its data are.
        rows: in their order; below them the ceiling, where it is known, and the published figures
            of the paper's scenarios.
        chosen: names of columns; empty for all that say something.
    """

    name: str
    title: str
    rows: list[Row]
    chosen: Sequence[str] = ()

    def columns(self) -> list[Column]:
        """The columns that were chosen, or that say something here."""
        if not self.chosen:
            return shown_columns(self.rows)
        found = map(layout(self.rows[0]).column, self.chosen)
        return [column for column in found if column is not None]

    def is_best(self, column: Column, row: Row) -> bool:
        """True if the value of `row` is the best of its column, or printed like it."""
        # A mean over the easier part of the samples is no rival of one over all of them; methods
        # are charged for what they lose.
        charged = [r for r in self.rows if r["coverage"] == 1 or (r["coverage"] and "method" in r)]
        whole = [r for r in charged if is_whole(r)]
        values: list[Any] = [r[column.name] for r in whole if r.get(column.name) is not None]
        if column.best is None or row not in whole or row[column.name] is None:
            return False
        # Values that print alike are highlighted alike, unless there is nothing to choose from.
        best = column.number(max(values) if column.best == "max" else min(values))
        return column.text(row) == best and any(column.number(v) != best for v in values)

    def texts(
        self, escape: Callable[[str], str], highlight: Callable[[str], str]
    ) -> list[list[str]]:
        """Return the escaped texts of all rows and columns, the best values highlighted."""
        columns = self.columns()
        return [
            [
                highlight(text) if self.is_best(column, row) else text
                for column in columns
                for text in [escape(column.whole_text(row))]
            ]
            for row in self.rows
        ]

    def paper_columns(self) -> list[Column]:
        """The columns that were chosen, or that papers print."""
        if self.chosen:
            return self.columns()
        names = layout(self.rows[0]).paper
        lost = any(row["coverage"] is not None and row["coverage"] < 1 for row in self.rows)
        return [c for c in self.columns() if c.name in names and (lost or c.name != "coverage")]


def printed_boards(rows: Sequence[Row], columns: Sequence[str] = ()) -> list[PrintedBoard]:
    """Return the boards of `rows`, in the order given, with these `columns` alone, if any."""
    apart = boards(rows)
    names = [" / ".join(dict.fromkeys((b[0]["suite"], b[0]["scenario"]))) for b in apart]
    named = [
        f"{name} ({data})" if data else name
        for name, data in zip(names, told_apart([board[0] for board in apart]), strict=True)
    ]
    return [
        PrintedBoard(
            printable(name),
            printable(f"{name}: {_about(board[0])}"),
            [*board, *ceiling_rows(board), *published_rows(board)],
            columns,
        )
        for name, board in zip(named, apart, strict=True)
    ]


def told_apart(firsts: Sequence[Row]) -> list[str]:
    """Return size and hash of the data of boards where others share suite and scenario, else "".

    Args:
        firsts: a row of each board.
    """
    names = [(row["suite"], row["scenario"]) for row in firsts]
    return [
        _data(row) if names.count(name) > 1 else "" for row, name in zip(firsts, names, strict=True)
    ]


def _data(row: Row) -> str:
    """Return the size and hash of data, which tell those of one scenario apart."""
    return f"n = {row['data_n']}, data {row['data_hash'][:_HASH_DIGITS]}"


def _about(row: Row) -> str:
    """Return what is known of the data of a board: sensor, noise, number of samples, mesh."""
    parts = [f"sensor {row['sensor']}"]
    if row.get("snr_db") is not None:
        ends = dict.fromkeys(f"{row[name]:.0f}" for name in ("snr_db_min", "snr_db_max"))
        parts.append(f"SNR {' to '.join(ends)} dB")
    n = row["data_n"]
    parts.append(f"{n:,} test sample{'' if n == 1 else 's'}")
    if row["inverse_crime"] is not None:
        parts.append(f"data from {_MESHES[row['inverse_crime']]}")
    return ", ".join(parts)


_MESHES = {
    True: "the mesh that methods invert with",
    False: "another mesh than methods invert with",
}


_RECORDED = {
    "guess_mm": "always guessing one place gives {:.1f} mm",
    "guess_localisation_p90_mm": "90 % of the guesses are within {:.1f} mm",
    "guess_within_5_mm": "{:.1%} within 5 mm",
    "guess_within_10_mm": "{:.1%} within 10 mm",
    "guess_unevenness": "its unevenness is {:.2f}",
    "guess_worst_tenth_mm": "its worst tenth {:.1f} mm",
    "guess_force_n": "always guessing the mean force gives {:.2f} N",
    "guess_load_percent": "always guessing the mean load gives {:.1f} %",
    "reciprocity_error": "reciprocity error of the reference frame: {:.2%}",
    "repeat_noise": "noise between repeats: {:.3%}",
}
_TRACKS = ("default", "tuned", "oracle")
_GAPS = ("tuning_gain", "oracle_gap")


def note(board: Sequence[Row]) -> str:
    """Return `notes` and the quality of recorded data as one line; "" where there is nothing."""
    parts = notes(board)
    for name, form in _RECORDED.items():
        known = [row[name] for row in board if row.get(name) is not None]
        if known:
            parts.append(form.format(known[0]))
    return f"{'; '.join(parts)}." if parts else ""


def notes(board: Sequence[Row]) -> list[str]:
    """Return parts of a sentence on the reading of a board.

    They tell the noise, why there are no ties and which methods were not tuned, compare with the
    ceiling and the published figures, and name the cost of failures, methods that lack samples, the
    overlap of training and test samples, differences in software that is not ours, methods that
    used the network, programs or test data, the tiers of records and submissions with the gaps to
    their hidden sets, times that were measured while other cells ran, and those left out, as the
    machine was busy.
    """
    return (
        _noise(board)
        + _no_ties(board)
        + _untuned(board)
        + ceiling_notes(board)
        + comparison(board)
        + _repeats(board)
        + _costs_of_failures(board)
        + lacking(board)
        + overlaps(board)
        + _by_text(board, "differs")
        + _by_text(board, "actions")
        + [f"tier of {said}" for said in _by_text(board, "tier")]
        + _gaps(board)
        + _shared_times(board)
        + _busy(board)
    )


def _gaps(board: Sequence[Row]) -> list[str]:
    """Hidden minus open of all methods that were run on a hidden set."""
    told = [f"{row['method']} {row['gap']}" for row in board if row.get("gap")]
    return [f"on the hidden set, minus here: {', '.join(told)}"] if told else []


def _repeats(board: Sequence[Row]) -> list[str]:
    """For the methods whose results several runs hold, the others beside the run that is shown."""
    methods: dict[str, list[str]] = {}
    for row in board:
        if row.get("repeats"):
            methods.setdefault(row["repeats"], []).append(row.get("method") or row["operator"])
    return [
        f"{', '.join(names)}: the same results in {runs}, too" for runs, names in methods.items()
    ]


def lacking(board: Sequence[Row]) -> list[str]:
    """For each method that lacks samples, how many it has."""
    return [
        f"{row.get('method') or row['operator']} has {row['n']:,} of {row['data_n']:,} samples and "
        "ranks below those that have all"
        for row in board
        if not is_whole(row)
    ]


def _no_ties(board: Sequence[Row]) -> list[str]:
    """A part of a sentence on why methods have no ties; empty where they have, or where unknown."""
    why = board[0].get("why_not")
    if not why or "method" not in board[0] or len(board) < 2:
        return []
    return [f"no ties: {why[0].lower()}{why[1:].rstrip('.')}"]


def _untuned(board: Sequence[Row]) -> list[str]:
    """A part of a sentence on methods that were not tuned; empty unless others were."""
    methods: dict[str | None, list[str]] = {}
    for row in board:
        methods.setdefault(row.get("track"), []).append(row.get("method", ""))
    if not {"default", "tuned"} <= methods.keys():
        return []
    return [f"not tuned, beside methods that are: {', '.join(dict.fromkeys(methods['default']))}"]


def _costs_of_failures(board: Sequence[Row]) -> list[str]:
    """For each method that lost samples, the rank it would have without them, if another."""
    return [
        f"{row['method']} failed on some samples: if such of each method were left out, its rank "
        f"would be {row['rank_valid']}"
        for row in board
        if row.get("rank_valid") not in (None, row["rank"]) and row["coverage"] < 1
    ]


def _noise(board: Sequence[Row]) -> list[str]:
    """Parts of a sentence on how noisy frames are, and how far from the model; as far as known."""
    names = ("snr_db", "touch_snr_db", "model_distance_db")
    frame, touch, distance = (board[0].get(name) for name in names)
    parts = []
    if frame is not None and touch is not None:
        parts.append(
            f"SNR {frame:.0f} dB of the frame, {touch:.0f} dB of its change by the touch (medians)"
        )
    # What it says of frames is no longer so where these are calibrated.
    if distance is not None and board[0]["track"] != "calibrated":
        parts.append(
            f"the nominal model's error is {distance:.0f} dB smaller than the change by the touch "
            "(median)"
        )
    return parts


def _busy(board: Sequence[Row]) -> list[str]:
    """A part of a sentence on times that are left out; empty where none is."""
    names = [row.get("method") or row["operator"] for row in board if row.get("busy")]
    if not names:
        return []
    return [f"no time of {', '.join(names)}: the machine was busy with something else"]


def _shared_times(board: Sequence[Row]) -> list[str]:
    """A part of a sentence on times that were measured while other cells ran; empty without any."""
    timed = [row["timed"] for row in board if row.get("timed")]
    shared = timed.count(SHARED)
    if not shared:
        return []
    which = "times" if shared == len(timed) else f"times of {shared} of {len(timed)} rows"
    return [f"{which} were measured while other cells ran: run with --jobs 1 for comparable times"]


def overlaps(board: Sequence[Row]) -> list[str]:
    """For each method, the number of test samples in its training set, unless that is 0."""
    sentences = []
    for row in board:
        if row.get("overlap"):
            total = row["data_n"]
            sentences.append(
                f"{row['overlap']:.0f} of {total} test samples were in the training set of "
                f"{row['method']}"
            )
        elif row.get("prior_knowledge") and row["overlap"] is None:
            sentences.append(
                f"{row['method']} was trained on data that this run cannot look up: test samples "
                "may be among them"
            )
    return sentences


def prior_knowledge(board: Sequence[Row]) -> list[str]:
    """Return the prior knowledge of the methods of a board, methods with the same together."""
    return _by_text(board, "prior_knowledge")


def _by_text(board: Sequence[Row], column: str) -> list[str]:
    """Return each text of a column after the names of the methods that have it."""
    methods: dict[str, list[str]] = {}
    for row in board:
        if text := row.get(column):
            methods.setdefault(text, []).append(row.get("method") or row["operator"])
    return [f"{', '.join(dict.fromkeys(names))}: {text}" for text, names in methods.items()]


def tracks_table(board: Sequence[Row]) -> list[list[str]]:
    """The heads, then a row for each method that was run on other tracks; empty if none was."""
    rows = [row for row in board if any(row.get(gap) is not None for gap in _GAPS)]
    if not rows:
        return []
    by = layout(board[0]).column(rows[0]["ranked_by"])
    assert by is not None
    body = []
    for row in rows:
        figures = [row[f"{track}_figure"] for track in _TRACKS]
        texts = ["–" if value is None else by.number(value) for value in figures]
        body.append([row["method"], *texts, *(_gap(row, name, by) for name in _GAPS)])
    return [[by.title, *_TRACKS, "gained by tuning", "left to the oracle"], *body]


def _gap(row: Row, name: str, by: Column) -> str:
    """Return the difference between two tracks with its 95 % interval, if it has one."""
    value, low, high = (row[f"{name}{end}"] for end in ("", "_low", "_high"))
    if value is None:
        return "–"
    # What rounds to 0 has no sign.
    texts = [re.sub(r"^-(?=[0.]*$)", "", by.number(v)) for v in (value, low, high) if v is not None]
    return texts[0] if len(texts) < 3 else f"{texts[0]} ({texts[1]} to {texts[2]})"
