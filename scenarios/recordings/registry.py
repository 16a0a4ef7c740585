"""Recorded sets by name: the public ones, and own recordings by their path."""

from pathlib import Path

from eitbench.scenarios.errors import unknown_name
from eitbench.scenarios.recordings.descriptors import RecordedSet
from eitbench.scenarios.recordings.files.own import is_recording, own_set
from eitbench.scenarios.recordings.public.anisotropy import ANISOTROPY
from eitbench.scenarios.recordings.public.hydrogel import HYDROGEL
from eitbench.scenarios.recordings.public.jku_tank import JKU_TANKS
from eitbench.scenarios.recordings.public.kuopio import KTC2023, KTC2023_LEVELS
from eitbench.scenarios.recordings.public.pyeidors_tank import PYEIDORS_TANK
from eitbench.scenarios.recordings.public.sciospec_tank import SCIOSPEC_TANK

RECORDED_SETS: dict[str, RecordedSet] = {
    recorded.name: recorded
    for recorded in (
        *HYDROGEL,
        *ANISOTROPY,
        KTC2023,
        *KTC2023_LEVELS,
        SCIOSPEC_TANK,
        *JKU_TANKS,
        PYEIDORS_TANK,
    )
}
"""Every public recorded set by name."""


def recorded_set(name: str) -> RecordedSet:
    """Return the descriptor of the public set called `name`, or of a recording by its path (.h5).

    Raises:
        InputError: unknown name (the nearest one is suggested), or a recording without labels.
        DataUnavailableError, DataCorruptError: no such recording, or a damaged one.
    """
    if is_recording(name):
        return own_set(Path(name))
    if name not in RECORDED_SETS:
        raise unknown_name("recorded set", name, RECORDED_SETS)
    return RECORDED_SETS[name]
