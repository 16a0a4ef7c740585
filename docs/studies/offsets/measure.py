"""What drive patterns are worth by the ceiling: the same touches, seen with other offsets.

`python -m docs.studies.offsets.measure DIR SAMPLES [JOBS]` draws from posteriors of the first test
frames of `noise-40db` as sensors of other patterns (i, i + k) see them, on the same units, at
the same SNR of frames and at the same noise in volts, into DIR, where a stopped run goes on. It
writes the figures of each frame to `offsets.csv`, with those of the ceiling's record for the offset
3 of `foam16`, and what made them to `offsets.json`.
"""

import json
import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from docs.tables.record import STUDIES

from eitbench.benchmark.ceiling.drawing import draw_posteriors
from eitbench.benchmark.ceiling.figures import frames_table
from eitbench.benchmark.ceiling.record import recorded_frames
from eitbench.benchmark.rundir.manifest import environment
from eitbench.scenarios.catalogue import sensor
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.sensors.patterns import offset_pattern
from eitbench.scenarios.sensors.sensor import Sensor
from eitbench.scenarios.sensors.sensor_file import sensor_to_toml
from eitbench.scenarios.suites.scenario import SimulatedScenario
from eitbench.scenarios.suites.suite import scenario_by_name

OUT = STUDIES / "offsets"
KNOWN, OFFSETS = "noise-40db", (1, 5, 7)
SAME = ("snr", "noise")
"""What the frames of another pattern share with those of the offset 3: 40 dB, or volts of noise."""
COLUMNS = [
    "offset", "same", "sample", "input_hash", "cluster", "family", "touch_snr_db", "mse", "rhat",
    "effective", "sd_x", "sd_y", "psnr", "localisation_mm", "version",
]  # fmt: skip


def seen_with(offset: int, same: str, folder: Path) -> SimulatedScenario:
    """The scenario `KNOWN` on `foam16` with another pattern; its sensor file goes to `folder`."""
    known = scenario_by_name(KNOWN)
    assert isinstance(known, SimulatedScenario)
    foam = sensor(known.sensor)
    other = replace(
        foam, name=f"foam16-offset-{offset}", pattern=offset_pattern(foam.n_electrodes, offset)
    )
    path = folder / f"{other.name}.toml"
    path.write_text(sensor_to_toml(other))
    name, snr_db = f"offset-{offset}", known.noise.test
    if same == "noise":
        assert isinstance(snr_db, float)
        ratio = _size(other) / _size(foam)
        name, snr_db = f"{name}-noise", round(snr_db + 20 * math.log10(ratio), 2)
    noise = known.noise.model_copy(update={"test": snr_db})
    return known.model_copy(update={"name": name, "sensor": str(path), "noise": noise})


def _size(of: Sensor) -> float:
    """Root mean square of the frame of the untouched sensor [V/A]."""
    model = forward_model(of)
    return float(np.sqrt(np.mean(model.voltages(model.background) ** 2)))


def write(folder: Path, samples: int, jobs: int) -> None:
    """Draw what is missing, and write the record."""
    folder.mkdir(parents=True, exist_ok=True)
    cases = {(k, same): seen_with(k, same, folder) for same in SAME for k in OFFSETS}
    draw_posteriors(list(cases.values()), folder / "draws", samples, jobs=jobs, progress=True)
    known = recorded_frames(KNOWN, scenario_by_name(KNOWN).data_hash("test"))
    known = known[known["sample"] < samples]
    tables = [known.assign(offset=3, same=same) for same in SAME] + [
        frames_table(folder / "draws", [scenario], samples).assign(offset=offset, same=same)
        for (offset, same), scenario in cases.items()
    ]
    table = pd.concat(tables)[COLUMNS].sort_values(["same", "offset", "sample"])
    table.to_csv(OUT / "offsets.csv", index=False, float_format="%.6g", lineterminator="\n")
    about = {"command": f"python -m docs.studies.offsets.measure DIR {samples}", **environment()}
    (OUT / "offsets.json").write_text(json.dumps(about, indent=1) + "\n")


if __name__ == "__main__":
    write(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]) if sys.argv[3:] else 1)
