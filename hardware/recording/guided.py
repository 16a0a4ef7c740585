"""Guided recording: a reference and touches at known places, ready for a suite."""

import json
import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from threading import Event, Thread

from eitbench.hardware.board import Board, BoardError
from eitbench.hardware.recording.loop import Status, record
from eitbench.hardware.recording.recorder import Recorder
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.sensors.sensor import Sensor

MIN_TOUCHES = 11
"""Least number of touches that can be scored, as every fifth registers images."""
SUITE_METHODS = (
    "back-projection", "tikhonov", "noser", "laplacian", "greit", "tv",
    "gauss-newton-noser", "gauss-newton-tv",
)  # fmt: skip
_GREATEST = 1000  # repeats, and mm
# A firm fingertip presses an emulated board.
_RADIUS_M, _PRESSURE_PA = 0.005, 30e3


@dataclass(frozen=True)
class StepDurations:
    """Durations of the steps of a guided recording.

    Attributes:
        reference_s: the untouched sensor [s].
        settle_s: from a touch until it counts [s].
        hold_s: a touch [s].
    """

    reference_s: float = 5.0
    settle_s: float = 0.5
    hold_s: float = 1.0


class GuidedSession:
    """Questions and touches that lead the user of the open `board`, recorded by `recorder`.

    Args:
        ask: shows a question and returns what was typed, "" for a mere Enter.
        say: shows a sentence.

    Attributes:
        touches: touches so far that are labelled.
    """

    def __init__(
        self,
        board: Board,
        recorder: Recorder,
        ask: Callable[[str], str],
        say: Callable[[str], None],
        timing: StepDurations | None = None,
    ) -> None:
        self._board, self._recorder = board, recorder
        self._ask, self._say = ask, say
        self._timing = timing or StepDurations()
        self.touches = 0
        self._status: Status | None = None
        self._stop = Event()
        self._failure: Exception | None = None

    def run(self) -> None:
        """Run the whole session.

        Raises:
            BoardError, RecorderError: as for `record`.
        """
        thread = Thread(target=self._record, name="guided recording", daemon=True)
        thread.start()
        try:
            self._session()
        finally:
            self._stop.set()
            thread.join()

    def _record(self) -> None:
        try:
            record(self._board, self._recorder, stop=self._stop, show=self._follow, say=self._say)
            if not self._stop.is_set():
                raise BoardError("The board has sent its last frame, and the session is not over.")
        except Exception as error:  # raised where frames are waited for
            self._failure = error

    def _follow(self, status: Status) -> None:
        self._status = status

    def _session(self) -> None:
        self._ask("Leave the sensor untouched, and press Enter")
        first, last = self._during(self._timing.reference_s)
        self._recorder.mark_reference(first, last)
        self._report(f"Reference: {last - first + 1} frames.")
        repeats = self._number("How often is each place touched? [1]", 1, whole=True)
        depth_mm = self._number("How deep is a touch [mm]? (Enter if unknown)", float("nan"))
        while (place := self._place()) is not None:
            for _ in range(int(repeats)):
                self._touch(*place, depth_mm)
            touches = "1 touch" if self.touches == 1 else f"{self.touches} touches"
            self._report(f"{touches} so far.")
        if self.touches < MIN_TOUCHES:
            self._say(
                f"Too few touches to be scored ({self.touches}): every fifth one registers images "
                f"with places, so record at least {MIN_TOUCHES}."
            )

    def _report(self, sentence: str) -> None:
        if self._status is not None:
            self._say(self._status.line())
        self._say(sentence)

    def _touch(self, x_mm: float, y_mm: float, depth_mm: float) -> None:
        where = f"({x_mm:g}, {y_mm:g}) mm"
        if self._board.can_be_pressed:
            self._board.press(x_mm / 1e3, y_mm / 1e3, _RADIUS_M, _PRESSURE_PA)
        else:
            self._ask(f"Touch {where}, hold still, and press Enter")
        self._during(self._timing.settle_s)
        first, last = self._during(self._timing.hold_s)
        self._recorder.label(
            first,
            last,
            x_m=x_mm / 1e3,
            y_m=y_mm / 1e3,
            depth_mm=depth_mm,
            state=f"{x_mm:g} {y_mm:g}",
        )
        self.touches += 1
        if self._board.can_be_pressed:
            self._board.release()
            self._during(self._timing.settle_s)
        else:
            self._ask("Let go, and press Enter")

    def _during(self, seconds: float) -> tuple[int, int]:
        """Rows of the first and last frame that arrive in `seconds`, one frame at least."""
        first, end_s = self._recorder.count, time.monotonic() + seconds
        while time.monotonic() < end_s or self._recorder.count == first:
            if self._failure is not None:
                raise self._failure
            time.sleep(0.01)
        return first, self._recorder.count - 1

    def _number(self, question: str, default: float, *, whole: bool = False) -> float:
        least, kind = (1, "whole number") if whole else (0, "number")
        while typed := self._ask(question).strip():
            try:
                number = int(typed) if whole else float(typed)
            except ValueError:
                number = -1
            if least <= number <= _GREATEST:
                return number
            self._say(f"That is a {kind} from {least} to {_GREATEST}, got {typed!r}.")
        return default

    def _place(self) -> tuple[float, float] | None:
        """Ask for the next place (x, y) [mm]; None ends the session."""
        while typed := self._ask("Place x y [mm]? (Enter ends the session)").strip():
            numbers = re.split(r"[\s,;]+", typed)
            try:
                x, y = map(float, numbers)
            except ValueError:
                self._say(f"A place is two numbers such as 30 55, got {typed!r}.")
                continue
            try:
                self._board.sensor.check_place(x / 1e3, y / 1e3)
            except InputError as outside:
                self._say(str(outside))
                continue
            return x, y
        return None


def suite_path(recording: Path) -> Path:
    """Path of the suite of a new `recording`, beside it.

    Raises:
        InputError: such a file exists already.
    """
    path = recording.with_suffix(".toml")
    if path.exists():
        raise InputError(f"{path} exists already and is never overwritten: name another file.")
    return path


def write_suite(path: Path, recording: Path, sensor: Sensor, board: str, *, emulated: bool) -> None:
    """Write the suite that scores classical methods on `recording` and, beside it, on `ohmc16`.

    Raises:
        OSError: it cannot be written.
    """
    title = f"Touches on {sensor.name}, recorded with {'an emulated board' if emulated else board}"
    name = re.sub(r"[^a-z0-9]+", "-", recording.stem.lower()).strip("-") or "own"
    # The name tells an emulated board from a real one, and this recording from the public set.
    own = f"emulated-{name}" if emulated else f"own-{name}" if name == "ohmc16" else name
    text = f"""\
name = {json.dumps(name)}
title = {json.dumps(title)}
methods = {json.dumps(SUITE_METHODS)}
limit = 100

[[scenarios]]
kind = "recorded"
name = {json.dumps(own)}
recording = {json.dumps(recording.name)}

[[scenarios]]
kind = "recorded"
name = "ohmc16"
recording = "ohmc16"
"""
    with path.open("x", encoding="utf-8") as file:
        file.write(text)
