"""Problems of a recording, in sentences."""

from pathlib import Path

import numpy as np

from eitbench.scenarios.errors import DataCorruptError
from eitbench.scenarios.recordings.files.own import damage, outside
from eitbench.scenarios.recordings.files.recording_file import Condition, Content, read_file
from eitbench.scenarios.recordings.quality import reciprocity_error, suspect_electrodes

MAX_RECIPROCITY = 0.1
"""Relative reciprocity error of the untouched sensor above which a recording is a problem."""
_LOOKED_AT = 1000  # frames that suspect electrodes are looked for in


def check(path: Path) -> tuple[list[str], list[str]]:
    """Check the recording at `path` and summarise it.

    Returns:
        Problems (none where it is sound) and facts, one sentence each.

    Raises:
        UnreadableError: there is no such file, or it may not be read.
    """
    try:
        content, condition = read_file(path)
    except DataCorruptError as error:
        return [str(error)], []
    problems = [*_condition(content, condition), *_frames(content), *_marks(content)]
    facts = [_summary(content), *_missing_for_a_set(content)]
    # Frames that hold no numbers say nothing about electrodes.
    if len(content) and np.isfinite(content.values).all() and not outside(content):
        more_problems, more_facts = _electrodes(content)
        problems += more_problems
        facts += more_facts
    return problems, facts


def _condition(content: Content, condition: Condition) -> list[str]:
    problems = []
    if not condition.complete:
        lost = f"; {condition.trimmed} at its end are not" if condition.trimmed else ""
        problems.append(f"It was not closed: {len(content)} whole frames are intact{lost}.")
    if problem := damage(condition):
        problems.append(f"{problem[0].upper()}{problem[1:]}.")
    return problems


def _frames(content: Content) -> list[str]:
    if len(content) == 0:
        return ["It holds no frames."]
    problems = []
    bad = ~np.isfinite(content.values).all(axis=1)
    if bad.any():
        first = int(np.flatnonzero(bad)[0])
        problems.append(
            f"{_count(int(bad.sum()), 'frame')} with values that are not numbers, the first is "
            f"frame {first}."
        )
    for name, times in (("time_s", content.time_s), ("received_s", content.received_s)):
        if not np.isfinite(times).all():
            problems.append(f"{name} holds values that are not numbers.")
        elif (back := np.flatnonzero(np.diff(times) < 0)).size:
            problems.append(f"{name} goes back at frame {int(back[0]) + 1}.")
    steps = np.diff(content.number)
    dropped = int(np.sum(steps[steps > 1] - 1))
    if dropped:
        share = dropped / (dropped + len(content))
        problems.append(f"{_count(dropped, 'frame')} of the board's were dropped ({share:.1%}).")
    if (back := np.flatnonzero(steps <= 0)).size:
        problems.append(f"The running number does not grow at frame {int(back[0]) + 1}.")
    return problems


def _marks(content: Content) -> list[str]:
    n = len(content)
    problems = []
    first, last = content.labels["first"].to_numpy(), content.labels["last"].to_numpy()
    wrong = np.flatnonzero((first < 0) | (last >= n) | (last < first))
    if wrong.size:
        k = int(wrong[0])
        problems.append(
            f"Label {k} names frames {first[k]} to {last[k]}, and there are frames 0 to {n - 1}."
        )
    if ((content.reference < 0) | (content.reference >= n)).any():
        problems.append("The reference names frames that are not there.")
    places = content.labels[["x_m", "y_m"]].to_numpy(dtype=np.float64)
    away = ~content.sensor.outline.contains(*places.T) & np.isfinite(places).all(axis=1)
    if away.any():
        x, y = 1e3 * places[away][0]
        problems.append(
            f"{_count(int(away.sum()), 'label')} outside the sensor, the first at "
            f"({x:.4g}, {y:.4g}) mm."
        )
    return problems


def _missing_for_a_set(content: Content) -> list[str]:
    needs = {
        "reference frames": len(content.reference),
        "labelled touches": len(content.labels),
    }
    if missing := " and ".join(what for what, count in needs.items() if not count):
        return [f"To be a set for suites it needs {missing}: record with --guided."]
    return []


def _electrodes(content: Content) -> tuple[list[str], list[str]]:
    """Problems and facts of the electrodes, by the reference frames; by all if there are none."""
    marked = content.reference if len(content.reference) else slice(None)
    frames = content.values[marked][:_LOOKED_AT]
    pattern = content.sensor.pattern
    problems, facts = [], []
    if len(pattern.reciprocal_pairs()):
        error = float(reciprocity_error(frames.mean(axis=0), pattern))
        of = "the untouched sensor" if len(content.reference) else "all frames"
        facts.append(f"Reciprocity error of {of}: {error:.2%}.")
        if not error <= MAX_RECIPROCITY:
            problems.append(
                f"The reciprocity error is {error:.1%}, and a sound sensor has less than "
                f"{MAX_RECIPROCITY:.0%}: check contacts, and that the pattern is the board's."
            )
    if suspects := suspect_electrodes(frames, pattern):
        named = ", ".join(map(str, suspects))
        problems.append(f"Suspect electrodes: {named} (noisy, or without contact).")
    return problems, facts


def _summary(content: Content) -> str:
    kind = "emulated board" if content.emulated else "board"
    seconds = float(np.ptp(content.time_s)) if len(content) else 0.0
    return (
        f"{_count(len(content), 'frame')} of {content.sensor.n_measurements} values from the "
        f"{kind} {content.board}, sensor {content.sensor.name}, {seconds:.1f} s, "
        f"{_count(len(content.labels), 'touch', 'touches')}, started {content.started}."
    )


def _count(n: int, what: str, several: str = "") -> str:
    return f"{n} {what}" if n == 1 else f"{n} {several or what + 's'}"
