"""The choice of a method: its file, and the rule that picks the best of those that were tried."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import pandas as pd
from pydantic import Field, ValidationError

from eitbench.benchmark.analysis.standings import SIGNIFICANT
from eitbench.benchmark.metrics.statistics import signed_rank_of
from eitbench.benchmark.rundir.folder import read_json_file
from eitbench.methods.registry import create
from eitbench.scenarios.declaration import Declaration
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.sensors.sensor import Sensor, content_hash
from eitbench.scenarios.storage.limits import check_regular

ChosenBy = Literal["record", "tuning", "default", "few presses", "no figure", "none"]

AS_FAST = 1.5
"""Times whose ratio is smaller count as equal: they differ so much from run to run."""


class Figure(Declaration):
    """A median error of the place [mm], with the ends of its 95 % interval."""

    value: float
    low: float
    high: float


class Tried(Declaration):
    """A method that was tried.

    Attributes:
        method: its name.
        parameters: constructor parameters that it was tried with.
        chosen_by: what chose these: a "record" of an earlier tuning, "tuning" within the time
            limit, "default" where that had too little time, "few presses" where those for it would
            choose by chance, "no figure" where all trials failed, "none" where there are none to
            choose.
        place: error of the place on what decides.
        with_drift: the same where drift is expected: on recorded drift, or on simulated touches
            after drift; where labelled frames decide and only simulation has drift, on these frames
            with what it adds in simulation.
        touches, drift: error of the place on simulated touches, and on those or presses with drift.
        score, bounded: S and B of simulated touches.
        frame_ms: 95th percentile of the time of one frame [ms]; None where it made no image.
        in_time: true if that is within the deadline.
        coverage: share of frames that gave an image, of the scenario where it is least.
    """

    method: str
    parameters: dict[str, Any]
    chosen_by: ChosenBy
    place: Figure
    with_drift: Figure
    touches: Figure
    drift: Figure
    score: float
    bounded: float
    frame_ms: float | None
    in_time: bool
    coverage: float


class Pick(Declaration):
    """The best method of one table.

    Attributes:
        method: its name.
        not_told_from: methods that it, or the one of the smallest error, cannot be told from.
    """

    method: str
    not_told_from: tuple[str, ...] = ()


class Choice(Declaration):
    """The content of `choice.json`.

    Attributes:
        asked: name of the set or sensor, or path of its file.
        sensor_sha256: hash of all that is declared of the sensor.
        decided_on: the scenario whose place error decides: simulated "touches", or labelled frames.
        presses: number of frames that decide.
        drift: whether it is simulated or recorded.
        frame_rate: the deadline [frames/s].
        time_limit_s: for all that is run [s].
        processor: name of the processor that times are of.
        best: within the deadline; None where nothing is. No method uses a GPU for its images, so
            that it is the best without one, too.
        best_with_drift: the best after drift, of those within the deadline.
        tried: by the error of the place, the smallest first.
        not_tried: methods that the time limit left no time for.
        stopped: it was stopped by hand before these.
        unusable: methods that cannot be used on the sensor, or failed as a whole, and why.
        note: why labelled frames were left out, as a sentence; else "".
        answer: all of this in one sentence.
    """

    format: Literal["eitbench choice 1"] = "eitbench choice 1"
    asked: str
    sensor_sha256: str
    decided_on: str
    presses: int
    drift: Literal["simulated", "recorded"]
    frame_rate: float = Field(gt=0)
    time_limit_s: float
    processor: str
    best: Pick | None
    best_with_drift: Pick | None
    tried: tuple[Tried, ...] = Field(min_length=1)
    not_tried: tuple[str, ...]
    stopped: bool = False
    unusable: dict[str, str]
    note: str = ""
    answer: str = ""

    def row(self, method: str) -> Tried:
        """The row of a method that was tried."""
        return next(row for row in self.tried if row.method == method)


def pick(errors: pd.DataFrame, frame_ms: Mapping[str, float]) -> Pick | None:
    """Return the method of the smallest median error, or a faster one that is not told from it.

    Others are compared with that of the smallest error by Wilcoxon's signed ranks of the paired
    differences, by cluster, at 5 %. The p-values are not adjusted for their number: a difference
    that is missed costs accuracy, one that is found by mistake but speed.

    Args:
        errors: (n, methods) error of the place of every frame; the index says what frames share.
        frame_ms: time of a frame by method.
    """
    if errors.empty:
        return None
    medians = errors.median().sort_values(kind="stable")
    first = medians.index[0]

    def p(name: str) -> float:
        differences = (errors[name] - errors[first]).to_numpy()
        return signed_rank_of(medians[name] - medians[first], differences, errors.index)

    equal = [name for name in medians.index if name == first or p(name) >= SIGNIFICANT]
    fastest = min(frame_ms[name] for name in equal)
    method = next(name for name in equal if frame_ms[name] <= AS_FAST * fastest)
    return Pick(method=method, not_told_from=tuple(name for name in equal if name != method))


def sensor_hash(sensor: Sensor) -> str:
    """Return the SHA-256 (hex) of all that is declared of a sensor."""
    return content_hash(sensor.describe())


def read_choice(path: Path, sensor: Sensor) -> tuple[str, dict[str, dict[str, Any]]]:
    """Read the file of a choice that was made for `sensor`.

    Returns:
        The best method, and the parameters of every method that was tried.

    Raises:
        InputError: it cannot be read, is damaged or of another sensor, chose no method, or a method
            that is not known here.
    """
    again = "make it again with `eitbench choose`"
    try:
        check_regular(path)
        choice = Choice.model_validate_json(read_json_file(path))
    except OSError as error:
        raise InputError(f"Cannot read the choice {path}: {error.strerror}.") from error
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(map(str, first["loc"])) or "the file"
        raise InputError(f"The choice {path} is damaged at {where!r}: {again}.") from error
    except ValueError as error:
        raise InputError(f"The choice {path} is not read: {error}.") from error
    if choice.sensor_sha256 != sensor_hash(sensor):
        raise InputError(
            f"The choice {path} was made for the sensor of {choice.asked!r}, which is not the "
            f"board's, {sensor.name!r}: choose for this one, or name the sensor with --sensor."
        )
    if choice.best is None:
        raise InputError(
            f"The choice {path} names no method, as none was fast enough: choose with a lower "
            "--frame-rate."
        )
    parameters = {row.method: row.parameters for row in choice.tried}
    if (name := choice.best.method) not in parameters:
        raise InputError(f"The choice {path} is damaged, as it did not try {name!r}: {again}.")
    create(name, **parameters[name])
    return name, parameters
