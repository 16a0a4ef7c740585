"""Thirteen two-layer e-skins pressed by a robot: a hydrogel and a layer of carbon black.

From upstream: 16 electrodes, the board and the opposition pattern of the hydrogel discs (module
`hydrogel`); for each press the difference of the frames, pressed minus released, without either of
them, so that the reference is modelled and the gain unknown; the place of the press in the robot's
coordinates, on a disc of radius 40 mm. By the title of the publication, a skin combines a layer
that conducts by electrons with one that conducts by ions; by the repository's scripts, the study
compares patterns of carbon black ("CB"): the whole disc, parallel lines, radii, concentric circles,
and none. By the names of files, the layer of 04 covers the whole disc, and 18 has concentric
circles and was damaged and healed; nothing there says which pattern the others have. To a model of
one homogeneous layer each is another sensor. (The publication itself was not at hand: its authors,
title, journal, volume and number are those of a bibliography that cites it.)

Ours: a disc of radius 60 mm, electrodes a quarter of their spacing wide, contact impedance
1e-3 Ohm*m2; the robot's coordinates less the middle of the pressed disc, one for each of the two
set-ups, 04 to 12 and 14 to 18 (upstream's (33.5, -297) mm for the latter is 0.6 mm from it). Where
the electrodes are was found from the presses: the changes agree best with drops of conductivity at
their places for radii of 55 to 70 mm, electrode 0 at 226 degrees and clockwise numbers in the first
set-up (mean correlation over presses 0.25 to 0.37 for 05, 06 and 08 to 11, 0.10 for 12), and at 319
degrees and counter-clockwise in the second (0.26 to 0.33 for 14, 16 and 18). The changes of 04, 07
and 15 agree with no orientation (0.12 at most), and get that of their set-up.

What the suite `skins` registers confirms size and orientation: the images of `greit` are scaled by
0.82 to 1.31 (median 0.99) and turned by at most 18 degrees on all skins but 04, where nothing is
found, and 15, where they are turned over: there, too, the numbers seem to be clockwise, from about
250 degrees on.

The robot's height is not used: 04, 05 and 06 were pressed to two heights 4.5 mm apart, the others
to one.
"""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.scenarios.recordings.descriptors import (
    RecordedFrames,
    RecordedSet,
    Source,
    source,
    validation_every_fifth,
)
from eitbench.scenarios.recordings.differences import on_modelled_reference
from eitbench.scenarios.recordings.superposed import superposed
from eitbench.scenarios.sensors.outlines import Disc
from eitbench.scenarios.sensors.patterns import opposition_pattern
from eitbench.scenarios.sensors.sensor import Sensor, even_electrodes

REPOSITORY = "DSHardman/Anisotropy"
CITATION = (
    "A. Costa Cornellà, D. Hardman, L. Costi, J. Brancart, G. Van Assche, F. Iida. Variable "
    "sensitivity multimaterial robotic e-skin combining electronic and ionic conductivity using "
    "electrical impedance tomography. Scientific Reports 13, 20004, 2023; "
    "data: https://github.com/DSHardman/Anisotropy"
)
_FOLDERS = {
    **{number: f"CAM09-{number:02d}" for number in (5, 6, 7, 8, 9, 10, 11, 12, 14, 15, 16, 18)},
    4: "CAM09-04_rep",
}
_ELECTRODES = 16
_RADIUS = 0.06
_FIRST_SETUP = range(4, 13)


def _skin(number: int) -> Sensor:
    outline = Disc(_RADIUS)
    first = number in _FIRST_SETUP
    electrodes = even_electrodes(
        outline, _ELECTRODES, outline.perimeter / _ELECTRODES / 4, 1e-3,
        start=_RADIUS * np.deg2rad(226 if first else 319), clockwise=first,
    )  # fmt: skip
    return Sensor(
        f"cam09-{number:02d}", outline, electrodes, opposition_pattern(_ELECTRODES),
        image_shape=(48, 48), conductivity_range=(0.05, 1.0),
    )  # fmt: skip


def _table(path: Path) -> NDArray[np.float64]:
    # The files begin with a byte-order mark.
    return np.loadtxt(path, delimiter=",", encoding="utf-8-sig", ndmin=2)


def _read(files: Source, number: int, folder: Path, sensor: Sensor) -> RecordedFrames:
    differences, places = (_table(folder / file.path) for file in files.files)
    x, y = (places[:, :2] - ((0.0458, -0.4093) if number in _FIRST_SETUP else (0.0331, -0.2974))).T
    split = validation_every_fifth(len(places))
    samples = pd.DataFrame({"split": split, "x_m": x, "y_m": y, "touched": True})
    return on_modelled_reference(differences, sensor, samples)


def _read_superposed(files: Source, number: int, folder: Path, sensor: Sensor) -> RecordedFrames:
    return superposed(_read(files, number, folder, sensor))


def _recorded_set(number: int) -> RecordedSet:
    folder = f"Shared Code/tests Aleix/{_FOLDERS[number]}"
    files = source(REPOSITORY, f"{folder}/inp*.csv", f"{folder}/out*.csv")
    return RecordedSet(
        name=f"cam09-{number:02d}",
        title=f"two-layer disc skin CAM09-{number:02d}, 16 electrodes, robot presses, differences",
        sensor_name=f"cam09-{number:02d}",
        sensor=partial(_skin, number),
        truth="position",
        source=files,
        citation=CITATION,
        reader=partial(_read, files, number),
    )


def _superposed_set(number: int) -> RecordedSet:
    single = _recorded_set(number)
    return replace(
        single,
        name=f"superposed-pairs-{single.name}",
        title=f"CAM09-{number:02d}: pairs of presses, superposed, not measured, 10 to 75 mm apart",
        reader=partial(_read_superposed, single.source, number),
    )


ANISOTROPY = (*(_recorded_set(number) for number in sorted(_FOLDERS)), _superposed_set(5))
