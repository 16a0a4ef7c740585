"""Guided recording: a reference and touches at known places, ready for a suite."""

import json
import math
import re
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Event, Thread

import numpy as np

from eitbench.hardware.board import Board, BoardError
from eitbench.hardware.recording.loop import Status, record
from eitbench.hardware.recording.recorder import Recorder
from eitbench.scenarios.errors import InputError, counted
from eitbench.scenarios.phantoms.press import FOAM
from eitbench.scenarios.recordings.descriptors import PLACES
from eitbench.scenarios.sensors.sensor import Sensor
from eitbench.scenarios.sensors.sensor_file import toml_string

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
        released_s: the untouched sensor before each touch [s], which drifts.
    """

    reference_s: float = 5.0
    settle_s: float = 0.5
    hold_s: float = 1.0
    released_s: float = 1.0


@dataclass(frozen=True)
class _Contact:
    """A place [m] that is touched, and the force there [N], NaN where unknown."""

    x_m: float
    y_m: float
    force_n: float

    def __str__(self) -> str:
        force = f" with {self.force_n:g} N" if math.isfinite(self.force_n) else ""
        return f"({1e3 * self.x_m:g}, {1e3 * self.y_m:g}) mm{force}"

    @property
    def state(self) -> str:
        """What is equal for repeats of the same contact."""
        force = f" {self.force_n:g} N" if math.isfinite(self.force_n) else ""
        return f"{1e3 * self.x_m:g} {1e3 * self.y_m:g}{force}"


class GuidedSession:
    """Questions and touches that lead the user of the open `board`, recorded by `recorder`.

    Args:
        ask: shows a question and returns what was typed, "" for a mere Enter.
        say: shows a sentence.
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
        self._places = list[tuple[float, float]]()  # [m], of the first contact of each touch
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
                raise BoardError(
                    "The board stopped sending before the session was over: look at its cable and "
                    "power, and record again."
                )
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
        self._say(
            "Type a place as 30 55, or with a force in N as 30 55 2.5. Places that are touched at "
            f"the same time: 30 55; 70 20. {self._registering()}"
        )
        while contacts := self._contacts():
            for _ in range(int(repeats)):
                self._touch(contacts, depth_mm)
            self._report(f"{counted(self.touches, 'touch', 'touches')} so far.")
        if self.lacks:
            self._say(self.lacks)

    @property
    def touches(self) -> int:
        """Number of touches so far that are labelled."""
        return len(self._places)

    @property
    def lacks(self) -> str:
        """Why methods cannot be scored on them yet, as a sentence; "" if they can be."""
        lacks = registration_lacks(self._places)
        return f"No suite is written: {lacks} Record again." if lacks else ""

    def _registering(self) -> str:
        """Which touches find how images map to places, and where they do it well: a sentence."""
        sensor = self._board.sensor
        x0, y0, x1, y1 = (1e3 * bound for bound in sensor.outline.bounds)
        corners = [
            (x0 + x * (x1 - x0), y0 + y * (y1 - y0))
            for x, y in ((0.3, 0.3), (0.7, 0.35), (0.45, 0.7))
        ]
        inside = all(sensor.outline.contains(x / 1e3, y / 1e3) for x, y in corners)
        such = ", then ".join(f"{x:.0f} {y:.0f}" for x, y in corners)
        such = f", such as {such}" if inside else ""
        return (
            "Touches 1, 6, 11 and so on (every fifth) are used to find how images map to places: "
            "at least 3 such places are needed, far apart and not on a line, as a line does not "
            f"tell an image from its mirror image{such}."
        )

    def _report(self, sentence: str) -> None:
        if self._status is not None:
            self._say(self._status.line())
        self._say(sentence)

    def _touch(self, contacts: list[_Contact], depth_mm: float) -> None:
        before, until = self._during(self._timing.released_s)
        if self._board.can_be_pressed:
            (contact,) = contacts
            self._board.press(contact.x_m, contact.y_m, _RADIUS_M, _pressure_pa(contact))
        else:
            self._ask(f"Touch {' and '.join(map(str, contacts))}, hold still, and press Enter")
        self._during(self._timing.settle_s)
        first, last = self._during(self._timing.hold_s)
        state = "; ".join(contact.state for contact in contacts)
        for contact in contacts:
            self._recorder.label(
                first,
                last,
                x_m=contact.x_m,
                y_m=contact.y_m,
                force_N=contact.force_n,
                depth_mm=depth_mm,
                state=state,
                reference_first=before,
                reference_last=until,
            )
        self._places.append((contacts[0].x_m, contacts[0].y_m))
        if self._board.can_be_pressed:
            self._board.release()
        else:
            self._ask("Let go, and press Enter")
        self._during(self._timing.settle_s)

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
            self._say(f"Type a {kind} from {least} to {_GREATEST}; got {typed!r}.")
        return default

    def _contacts(self) -> list[_Contact]:
        """Ask for the places of the next touch; none ends the session."""
        while typed := self._ask("Place x y [mm]? (Enter ends the session)").strip():
            try:
                contacts = [_contact(part) for part in typed.split(";")]
                if len(contacts) > len(PLACES):
                    raise InputError(f"A touch has at most {len(PLACES)} places.")
                for contact in contacts:
                    self._board.sensor.check_place(contact.x_m, contact.y_m)
                if self._board.can_be_pressed:
                    if len(contacts) > 1:
                        raise InputError("The emulated board is pressed at one place at a time.")
                    _pressure_pa(contacts[0])  # it may be more than the foam's law allows
            except InputError as wrong:
                self._say(str(wrong))
                continue
            return contacts
        return []


def _pressure_pa(contact: _Contact) -> float:
    """Pressure [Pa] that presses an emulated board with the force of the contact, if it is known.

    Raises:
        InputError: it is too much.
    """
    known = math.isfinite(contact.force_n)
    return FOAM.pressure_of(contact.force_n, _RADIUS_M) if known else _PRESSURE_PA


def _contact(typed: str) -> _Contact:
    if re.search(r"\d,\d", typed) and re.search(r"\s", typed.strip()):
        raise InputError(
            "Put spaces between numbers, and write decimals with a point, such as 30.5 55; got "
            f"{typed.strip()!r}."
        )
    try:
        x_mm, y_mm, *force = map(float, re.split(r"[\s,]+", typed.strip()))
        (force_n,) = force or (math.nan,)
    except ValueError:
        x_mm = y_mm = force_n = math.inf
    if not (abs(x_mm) < math.inf and abs(y_mm) < math.inf and not force_n > _GREATEST):
        raise InputError(
            "A place is two numbers in mm, such as 30 55; a force in N may follow, such as 30 55 "
            f"2.5. Got {typed.strip()!r}."
        )
    if force_n <= 0:
        raise InputError(f"A force has to be above 0 N, got {force_n:g}.")
    return _Contact(x_mm / 1e3, y_mm / 1e3, force_n)


def registration_lacks(places: Sequence[tuple[float, float]]) -> str:
    """Why the touches at `places` [m] do not say how images map to places; "" if they do."""
    found = "every fifth one is used to find how images map to places"
    if (count := len(places)) < MIN_TOUCHES:
        return (
            f"only {counted(count, 'touch', 'touches')} so far. At least {MIN_TOUCHES} are "
            f"needed, since {found}."
        )
    points = np.array(places[::5])
    if (count := len(np.unique(points, axis=0))) < 3:
        return (
            f"touches 1, 6, 11, ... are at {counted(count, 'place')}, and 3 are needed, since "
            f"{found}. Touch more places, or repeat them less often."
        )
    sizes = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if sizes[1] < 1e-6 * sizes[0]:
        return (
            f"touches 1, 6, 11, ... are on one line, which fits a mirrored image as well, and "
            f"{found}. Touch other places."
        )
    return ""


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
name = {toml_string(name)}
title = {toml_string(title)}
methods = {json.dumps(SUITE_METHODS)}

[[scenarios]]
kind = "recorded"
name = {toml_string(own)}
recording = {toml_string(recording.name)}

[[scenarios]]
kind = "recorded"
name = "ohmc16"
recording = "ohmc16"
"""
    with path.open("x", encoding="utf-8") as file:
        file.write(text)
