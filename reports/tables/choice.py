"""The choice of a method as a table, and as one sentence."""

from __future__ import annotations

from typing import TYPE_CHECKING

from eitbench.reports.tables.columns import listed, printable

if TYPE_CHECKING:
    from collections.abc import Sequence

    from eitbench.benchmark.choice.decision import Choice, Figure, Tried

_USELESS = 3.0
"""Times of the error without drift; above it drift has taken most of what a method tells."""
_CHOSEN_BY = {
    "record": "tuned before",
    "tuning": "tuned here",
    "default": "default",
    "few presses": "default",
    "none": "nothing to tune",
}


def choice_rows(choice: Choice) -> list[dict[str, str]]:
    """The table as texts by heading, one row a method."""
    apart = choice.decided_on != "touches"
    return [
        {
            "method": row.method,
            "place error, mm (95 %)": _figure(row.place),
            "with drift": _figure(row.with_drift),
            **({"simulated": _figure(row.touches)} if apart else {}),
            "S": f"{row.score:.2f}",
            "B": f"{row.bounded:.3f}",
            "frame p95": _ms(row),
            "in time": "yes" if row.in_time else "no",
            "images": f"{100 * row.coverage:.0f} %",
            "parameters": _CHOSEN_BY[row.chosen_by],
        }
        for row in choice.tried
    ]


def sentence(choice: Choice) -> str:
    """The answer in one sentence."""
    parts = [
        *_best(choice),
        f"every method tried runs without a GPU (times are of one core of {choice.processor})",
    ]
    for chosen_by, why in (
        ("default", "too little time was left to tune"),
        ("no figure", "no trial of tuning gave a figure of"),
        ("few presses", "too few presses are there to tune"),
    ):
        if names := [row.method for row in choice.tried if row.chosen_by == chosen_by]:
            parts.append(f"{why} {_code(names)}, compared as they come")
    if choice.not_tried:
        end = (
            "it was stopped before" if choice.stopped else f"{choice.time_limit_s:g} s ended before"
        )
        were = "were" if len(choice.not_tried) > 1 else "was"
        parts.append(f"{end} {_code(choice.not_tried)} {were} tried")
    return printable("; ".join(parts) + ".")


def _best(choice: Choice) -> list[str]:
    if choice.best is None or choice.best_with_drift is None:
        fastest = min(choice.tried, key=lambda row: row.frame_ms or float("inf"))
        return [
            f"No method tried makes {choice.frame_rate:g} frames/s here: the fastest, "
            f"`{fastest.method}`, takes {_ms(fastest)} a frame"
        ]
    row, drift = choice.row(choice.best.method), choice.row(choice.best_with_drift.method)
    simulated = choice.decided_on == "touches"
    answer = (
        f"Put `{row.method}` behind {choice.asked}: it finds "
        f"{'simulated touches' if simulated else 'presses'} to {row.place.value:.1f} mm (median of "
        f"{choice.presses}) in {_ms(row)} a frame"
    )
    if others := [choice.row(name) for name in choice.best.not_told_from]:
        answer += f", and cannot be told from {_code([other.method for other in others])}"
        if min(other.place.value for other in others) < row.place.value:
            answer += ", but is faster than the best of them"
    same = drift.method == row.method
    return [
        answer,
        f"when drift as {choice.drift} is expected "
        f"{'keep it' if same else f'take `{drift.method}`'} ({drift.with_drift.value:.1f} mm"
        + (
            ": of little use, so take new reference frames)"
            if drift.with_drift.value > _USELESS * drift.place.value
            else ")"
        ),
    ]


def _figure(figure: Figure) -> str:
    return f"{figure.value:.1f} ({figure.low:.1f}–{figure.high:.1f})"


def _ms(row: Tried) -> str:
    return "–" if row.frame_ms is None else f"{row.frame_ms:.2g} ms"


def _code(names: Sequence[str]) -> str:
    return listed([f"`{name}`" for name in names])
