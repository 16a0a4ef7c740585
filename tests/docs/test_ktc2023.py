"""The record of what the challenge's training targets say of the tank is what the data give."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.recordings import read_recording
from eitbench.scenarios.recordings.public.kuopio import tank

RECORD = Path(__file__).parents[2] / "docs/studies/ktc2023/tank.csv"


def measured() -> pd.DataFrame:
    """Least squares of what each training target changes, by the modelled change and the frame."""
    recording, model = read_recording("ktc2023"), forward_model(tank())
    assert recording.classes is not None
    untouched = model.voltages(model.background)
    reference = recording.reference / (recording.reference @ untouched / (untouched @ untouched))
    rows = []
    for number, (frame, classes) in enumerate(
        zip(recording.voltages, recording.classes, strict=True), 1
    ):
        change = frame * (reference @ reference) / (recording.reference @ reference) - reference
        modelled = model.voltages(100.0 ** classes.astype(float)) - untouched
        row: dict[str, float] = {"target": number}
        for name, columns in (
            ("unexplained_alone", modelled[:, None]),
            ("unexplained", np.column_stack([modelled, reference])),
        ):
            factors = np.linalg.lstsq(columns, change, rcond=None)[0]
            rest = np.linalg.norm(change - columns @ factors)
            row[name] = float(rest / np.linalg.norm(change))
        rows.append({**row, "strength": float(factors[0]), "common": float(factors[1])})
    return pd.DataFrame(rows)


@pytest.mark.slow
@pytest.mark.usefixtures("recorded_data")
def test_the_record_is_what_the_data_give() -> None:
    pd.testing.assert_frame_equal(pd.read_csv(RECORD), measured(), rtol=1e-4)


if __name__ == "__main__":
    measured().to_csv(RECORD, index=False, float_format="%.6g", lineterminator="\n")
