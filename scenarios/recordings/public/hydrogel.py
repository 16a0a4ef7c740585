"""Hydrogel e-skins of the HydrogelEIT project, pressed by a robot: discs and rectangles.

The discs. From upstream: opposition drive, the pattern table (checked against `lookup192.mat` and
`lookup32.mat`), magnitudes only, a skin 171 mm across (the scale of upstream's `calcEIT.m`),
presses within 70 mm of its centre. Ours: electrodes a quarter of their spacing wide, contact
impedance 1e-3 Ohm*m2, electrode 0 at 281.25 degrees, numbers counter-clockwise in the robot's
coordinates.
The mirrored order contradicts the measured changes. The angle is uncertain: upstream draws
electrode 0 lowermost (270 degrees), the changes fit best at 272 or 287 degrees with or without the
leak described below. To score positions, a similarity transform between image and robot is fitted.

The boards' channels are uneven: between source and sink the values of a frame are several times
larger in the first half of the rim than in the second, so that a homogeneous disc hardly correlates
with the reference (0.19 for 16 electrodes, -0.03 for 8). Common-mode voltage that leaks into the
difference, V = U[a] - U[b] - 0.46 ((U[a] + U[b]) / 2 - U[sink]), explains most of it on both boards
(0.74 and 0.73), including the last values of each drive, which answer with the opposite sign.

The rectangles, 130 x 60 mm. From upstream: the pressed area, the pattern (as for the discs), the
robot's coordinates, which start at the lower-left corner. Ours: the pressed area taken for the
whole skin; electrodes every 23.75 mm (16) or 47.5 mm (8) along the rim, counter-clockwise, the
first 17.5 mm from the lower-left corner, each a third of its spacing wide, contact impedance
1e-3 Ohm*m2. This layout (for 8
electrodes three on each long side, one on each short side) is where the 10,000 presses show each
drive pair to be most sensitive; nothing confirms it for 16. In the 8-electrode recording several
electrodes conduct badly: a third of the values are saturated, drives (0, 4) and (1, 5) show little.

`hydrogel-rectangle` is on no board, since its electrodes are not known. Its frames tell the place
of a press: a ridge regression of all 10,000, cross-validated in five blocks of time, is 16.0 mm off
in the median, where a guess of one place is 36.6 mm off; with labels one press earlier or later it
is 36.5 mm off, so that they are right. But linear images from the model are 30 mm off and more,
with any gains and without the eight saturated values. Of all 40,320 numberings of eight electrodes
in this layout the best agrees no better (mean |correlation| 0.217 over the 12 values that follow
the place) than the best after these values were shuffled (0.197 to 0.215 in three trials).

Drift. Between the first and the last of 500 presses the released frame moves by 20 % of its norm
(`ohmc16`) and 14 % (`superpose500`), ten times as far as a press moves it. `ohmc16` and the others
are re-based on each press's own released frame; `ohmc16-start` and `superpose500-start` are the
same presses as measured, with the first released frames as the only reference.

`superpose500` is the skin of the multi-touch sets, two weeks earlier: by then its released frame
had moved by 40 %. The files `Extracted/MultiTouch/multitouch*.mat` state no places. Upstream's
`MembraneProbing.py` and `ExtractResponses.m` tell how they were made: a probe with two tips, turned
by 0, 45, 90 and 180 degrees, pressed by 10 and 15 mm. Rows 4 to 7 of A and B repeat rows 0 to 3
to the last bit, and are left out.
Where the tips were stands in upstream's figure (`Figures/FinalFigc.pdf`, crosses on six of the
touches): A and B on both sides of the centre, C 46 and 66 mm from it (but for the two touches at
the centre), turned clockwise. The crosses differ from this rule by up to 6 mm, so that these places
of `hydrogel-two-probes` are known to about 5 mm; the single presses agree with them.

`hydrogel-damage` is a skin like these, a frame every 8 s, cut three times and not touched else. Its
file holds nothing but frames. When and where it was cut stands in upstream's figure
(`Figures/FinalFigb.pdf`): a time line, and a photograph of the cuts, from which the places are
taken to about 5 mm. The frames of each cut follow from the only steps of 1 % and more.

Rows of `response` alternate; the second of each pair is the pressed one, as in upstream's
`ExtractResponses.m`, and it varies more from press to press.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.scenarios.recordings.descriptors import (
    RecordedFrames,
    RecordedSet,
    Truth,
    is_validation,
    source,
    validation_every_fifth,
)
from eitbench.scenarios.recordings.differences import rebased
from eitbench.scenarios.recordings.matlab import read_arrays
from eitbench.scenarios.recordings.superposed import superposed
from eitbench.scenarios.sensors.outlines import Disc, rectangle
from eitbench.scenarios.sensors.patterns import opposition_pattern
from eitbench.scenarios.sensors.sensor import Sensor, even_electrodes

REPOSITORY = "DSHardman/HydrogelEIT"
CITATION = (
    "D. Hardman, T. George Thuruthel, F. Iida. Tactile perception in hydrogel-based robotic skins "
    "using data-driven electrical impedance tomography. Materials Today Electronics 4, 2023; data: "
    "https://github.com/DSHardman/HydrogelEIT"
)
DISTANCES_MM = {"A": 108.0, "B": 75.0, "C": 20.0}
"""Distance between the two probes of each multi-touch file."""

Reference = Literal["own", "start"]
"""Of each press its own released frame, or of all presses the first ones."""
FRAME_INTERVAL_S = 8.0
"""Time from one frame of `hydrogel-damage` to the next, of upstream's `plotDamageDetect.m` [s]."""
TIPS_MM = {"A": (54.0, -54.0), "B": (37.5, -37.5), "C": (46.0, 66.0)}
"""Places of both tips along the turned probe, from the skin's centre."""
_TURNS = {"A": (0, 45, 90, 180), "B": (0, 45, 90, 180), "C": (0, 45, 90, 180, None) * 2}
"""Of the rows that do not repeat others [degrees, clockwise]; None: at the centre."""
START_FRAMES = 5
"""Released frames whose median is the reference that is taken once, at the start."""


@dataclass(frozen=True)
class Cut:
    """A cut of the skin of `hydrogel-damage`.

    Attributes:
        letter: in upstream's figure.
        first, after: the first frame that it disturbs, and the first one after it.
        place: x, y [m] of its middle, in the robot's coordinates, to about 5 mm.
    """

    letter: str
    first: int
    after: int
    place: tuple[float, float]


CUTS = (
    Cut("B", 491, 495, (0.037, 0.031)),
    Cut("C", 503, 505, (-0.057, -0.008)),
    Cut("D", 663, 665, (-0.004, -0.002)),
)
"""The cuts in the order of time; upstream's A is a time without any."""

_RECTANGLE = "Extracted/Rectangle"
_RANDOM = f"{_RECTANGLE}/random_f_d_8_10k.mat"
_FIXED = f"{_RECTANGLE}/fixed_f_d_16_200.mat"
_REPEATS = f"{_RECTANGLE}/repeats_r_s_16_50_5.mat"
_DAMAGE = "DamageTests/Damage.mat"
_RADIUS = 0.0855
_FIRST_ELECTRODE = np.deg2rad(281.25)


def _disc_skin(name: str, n_electrodes: int) -> Sensor:
    outline = Disc(_RADIUS)
    electrodes = even_electrodes(
        outline, n_electrodes, outline.perimeter / n_electrodes / 4, 1e-3,
        start=_RADIUS * _FIRST_ELECTRODE,
    )  # fmt: skip
    # Sixteen electrodes resolve far less than 80 x 80; 3.6 mm pixels keep real time in reach.
    return Sensor(
        name, outline, electrodes, opposition_pattern(n_electrodes), image_shape=(48, 48),
        conductivity_range=(0.05, 1.0),
    )  # fmt: skip


def _read_presses(file: str, reference: Reference, folder: Path, sensor: Sensor) -> RecordedFrames:
    """Read presses, each with its own released frame, or all with the first ones."""
    mat = read_arrays(folder / file, "positions", "responsedowns", "responseups")
    x, y, depth = mat["positions"].T
    samples = pd.DataFrame(
        {
            "split": validation_every_fifth(len(x)),
            "x_m": x,
            "y_m": y,
            "depth_mm": np.round(depth * 1e3, 3),
            "touched": True,
        }
    )
    if reference == "start":
        start = np.median(mat["responseups"][:START_FRAMES], axis=0)
        return RecordedFrames(mat["responsedowns"], start, samples)
    return rebased(mat["responsedowns"], mat["responseups"], samples)


def _read_superposed(folder: Path, sensor: Sensor) -> RecordedFrames:
    return superposed(_read_presses(_SINGLE, "own", folder, sensor))


def _read_two_probes(folder: Path, sensor: Sensor) -> RecordedFrames:
    """Read the real pairs as test split, with the validation presses of `superpose500`.

    The frames are on the pairs' reference, two weeks younger than that of the single presses.
    """
    single = _read_presses(_SINGLE, "own", folder, sensor)
    presses = is_validation(single.samples)
    change, released = [(single.voltages - single.reference)[presses]], []
    described = single.samples[presses].drop(columns="depth_mm")
    samples = [described.assign(contacts=1, probe_distance_mm=0.0)]
    for part, turns in _TURNS.items():
        path = folder / f"Extracted/MultiTouch/multitouch{part}.mat"
        mat = read_arrays(path, "responsedowns", "responseups")
        n = len(turns)
        change.append((mat["responsedowns"] - mat["responseups"])[:n])
        released.append(mat["responseups"][:n])
        places = np.array([_tips(part, turn) for turn in turns]).reshape(n, 4)
        table = pd.DataFrame(places, columns=["x_m", "y_m", "x2_m", "y2_m"])
        table = table.assign(split="test", contacts=2, touched=True)
        samples.append(table.assign(probe_distance_mm=DISTANCES_MM[part]))
    reference = np.median(np.concatenate(released), axis=0)
    table = pd.concat(samples, ignore_index=True)
    return RecordedFrames(reference + np.concatenate(change), reference, table)


def _tips(part: str, turn: float | None) -> NDArray[np.float64]:
    """Places (2, 2) [m] of both tips of a probe."""
    along = np.array([10.0, -10.0] if turn is None else TIPS_MM[part])
    angle = -np.deg2rad(turn or 0)
    return np.asarray(1e-3 * along[:, None] * [np.cos(angle), np.sin(angle)])


def _read_damage(folder: Path, sensor: Sensor) -> RecordedFrames:
    """Read frames as measured; those that make the reference are the validation split."""
    frames = read_arrays(folder / _DAMAGE, "damage")["damage"]
    number = np.arange(len(frames))
    samples = pd.DataFrame(
        {
            "split": np.where(number < START_FRAMES, "validation", "test"),
            "time_s": FRAME_INTERVAL_S * number,
            "cuts": sum((number >= cut.first).astype(int) for cut in CUTS),
            # By what cuts the skin.
            "touched": sum((cut.first <= number) & (number < cut.after) for cut in CUTS) > 0,
        }
    )
    return RecordedFrames(frames, np.median(frames[:START_FRAMES], axis=0), samples)


def _read_multitouch(folder: Path, sensor: Sensor) -> RecordedFrames:
    pressed, released, distances, states = [], [], list[float](), list[str]()
    for part, distance in DISTANCES_MM.items():
        path = folder / f"Extracted/MultiTouch/multitouch{part}.mat"
        mat = read_arrays(path, "responsedowns", "responseups")
        n = len(_TURNS[part])  # further rows repeat these
        states += [f"{part} {turn}" for turn in _TURNS[part]]
        pressed.append(mat["responsedowns"][:n])
        released.append(mat["responseups"][:n])
        distances += [distance] * n
    samples = pd.DataFrame(
        {
            "split": validation_every_fifth(len(distances)),
            "probe_distance_mm": distances,
            "touched": True,
            "state": np.unique(states, return_inverse=True)[1],
        }
    )
    return rebased(np.concatenate(pressed), np.concatenate(released), samples)


def _rectangular_skin(name: str, n_electrodes: int) -> Sensor:
    outline = rectangle(0.13, 0.06)
    width = outline.perimeter / n_electrodes / 3
    electrodes = even_electrodes(outline, n_electrodes, width, 1e-3, start=0.0175)
    pattern = opposition_pattern(n_electrodes)
    return Sensor(
        name, outline, electrodes, pattern, image_shape=(48, 104), conductivity_range=(0.05, 1.0)
    )


def _read_rectangle_presses(folder: Path, sensor: Sensor) -> RecordedFrames:
    mat = read_arrays(folder / _RANDOM, "positions", "response")
    x, y = mat["positions"].T
    split = validation_every_fifth(len(x))
    samples = pd.DataFrame({"split": split, "x_m": x, "y_m": y, "touched": True})
    return rebased(mat["response"][1::2], mat["response"][::2], samples)


def _read_fixed(folder: Path, sensor: Sensor) -> RecordedFrames:
    """Read released and pressed frames as measured: not re-based, since their drift matters."""
    frames = read_arrays(folder / _FIXED, "response")["response"]
    touched = np.arange(400) % 2 == 1
    # Both frames of a press share its split.
    split = np.repeat(validation_every_fifth(200), 2)
    samples = pd.DataFrame({"split": split, "touched": touched, "state": touched.astype(int)})
    reference = np.median(frames[~touched & is_validation(samples)], axis=0)
    return RecordedFrames(frames, reference, samples)


def _read_repeats(folder: Path, sensor: Sensor) -> RecordedFrames:
    """Pressed frames only: the reference is their median, since no released frame was recorded."""
    mat = read_arrays(folder / _REPEATS, "positions", "responses")
    press = np.repeat(np.arange(50), 5)
    x, y, depth = mat["positions"][press].T
    samples = pd.DataFrame(
        {
            "split": np.repeat(validation_every_fifth(50), 5),
            "x_m": x,
            "y_m": y,
            "depth_mm": np.round(depth * 1e3, 3),
            "touched": True,
            "state": press,
        }
    )
    frames = mat["responses"].reshape(250, -1)
    return RecordedFrames(frames, np.median(frames[is_validation(samples)], axis=0), samples)


def _recorded_set(
    name: str,
    title: str,
    sensor: Callable[[], Sensor],
    reader: Callable[[Path, Sensor], RecordedFrames],
    *files: str,
    truth: Truth = "none",
) -> RecordedSet:
    upstream = source(REPOSITORY, *files)
    return RecordedSet(name, title, sensor().name, sensor, truth, upstream, CITATION, reader)


_DISC16, _DISC8 = partial(_disc_skin, "ohmc16", 16), partial(_disc_skin, "ohmc8", 8)
_SUPERPOSE500 = partial(_disc_skin, "superpose500", 16)
_DAMAGED = partial(_disc_skin, "hydrogel-damage", 16)
_RECTANGLE8 = partial(_rectangular_skin, "hydrogel-rectangle", 8)
_RECTANGLE16 = partial(_rectangular_skin, "hydrogel-rectangle16", 16)
_LOOKUP16, _LOOKUP8 = "lookup192.mat", "lookup32.mat"  # of the pattern, which a test compares
_OHMC16, _OHMC8 = "Extracted/ohmc16.mat", "Extracted/ohmc8.mat"
_SINGLE = "Extracted/MultiTouch/superpose500.mat"
_BY_ROBOT = "500 robot presses of 10, 15 and 20 mm"
_PRESSES: tuple[tuple[str, Callable[[], Sensor], str, Reference], ...] = (
    ("ohmc16", _DISC16, _OHMC16, "own"),
    ("ohmc8", _DISC8, _OHMC8, "own"),
    ("superpose500", _SUPERPOSE500, _SINGLE, "own"),
    ("ohmc16-start", _DISC16, _OHMC16, "start"),
    ("superpose500-start", _SUPERPOSE500, _SINGLE, "start"),
)

HYDROGEL = (
    *(
        _recorded_set(
            name,
            f"hydrogel disc skin, {skin().n_electrodes} electrodes, {_BY_ROBOT}"
            + ", reference of the start" * (reference == "start"),
            skin,
            partial(_read_presses, file, reference),
            file,
            _LOOKUP8 if skin is _DISC8 else _LOOKUP16,
            truth="position",
        )
        for name, skin, file, reference in _PRESSES
    ),
    _recorded_set(
        "superposed-pairs",
        "superpose500: pairs of presses, superposed, not measured, 10 to 108 mm apart",
        _SUPERPOSE500,
        _read_superposed,
        _SINGLE,
        _LOOKUP16,
        truth="position",
    ),
    _recorded_set(
        "hydrogel-two-probes",
        "the skin of superpose500: two probes at once, 108, 75 and 20 mm apart, at known places",
        _SUPERPOSE500,
        _read_two_probes,
        "Extracted/MultiTouch/*",
        _LOOKUP16,
        truth="position",
    ),
    _recorded_set(
        "hydrogel-damage",
        "hydrogel disc skin, 16 electrodes, cut three times in two hours, a frame every 8 s",
        _DAMAGED,
        _read_damage,
        _DAMAGE,
        _LOOKUP16,
    ),
    _recorded_set(
        "hydrogel-multitouch",
        "hydrogel disc skin, 16 electrodes, two probes 108, 75 and 20 mm apart",
        _DISC16,
        _read_multitouch,
        "Extracted/MultiTouch/multitouch?.mat",
        _LOOKUP16,
    ),
    _recorded_set(
        "hydrogel-rectangle",
        "rectangular hydrogel skin, 8 electrodes at unknown places, 10,000 robot presses",
        _RECTANGLE8,
        _read_rectangle_presses,
        _RANDOM,
        _LOOKUP8,
        truth="position",
    ),
    _recorded_set(
        "hydrogel-fixed",
        "rectangular hydrogel skin, 16 electrodes, one press repeated 200 times",
        _RECTANGLE16,
        _read_fixed,
        _FIXED,
        _LOOKUP16,
    ),
    _recorded_set(
        "hydrogel-repeats",
        "rectangular hydrogel skin, 16 electrodes, 50 presses repeated 5 times",
        _RECTANGLE16,
        _read_repeats,
        _REPEATS,
        _LOOKUP16,
    ),
)
