"""Imports of files in a folder of the test."""

from pathlib import Path
from typing import Any

import pytest
from tests.support.frame_files import Import

from eitbench.hardware.recording.exchange import import_recording
from eitbench.hardware.recording.importing.arrays import Choice
from eitbench.hardware.recording.importing.recording import ImportOptions
from eitbench.scenarios.recordings.files.recording_file import Content, read_file
from eitbench.scenarios.sensors.sensor import Sensor


@pytest.fixture
def imported(tmp_path: Path, skin: Sensor) -> Import:
    """Import files of `tmp_path`: the content, and all that was said."""

    def run(*sources: str, sensor: Sensor = skin, **options: Any) -> tuple[Content, str]:
        out = tmp_path / f"{len(list(tmp_path.glob('*.h5')))}-out.h5"
        if "labels" in options:
            options["labels"] = str(options["labels"])
        choice = Choice(*(options.pop(name, None) for name in ("name", "order", "part")))
        said = import_recording(
            [str(tmp_path / source) for source in sources],
            out,
            sensor,
            ImportOptions(choice, **options),
        )
        return read_file(out)[0], " ".join(said)

    return run
