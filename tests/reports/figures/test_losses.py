"""The figure of the losses in training, and the learning curves that it is drawn from."""

import json
from pathlib import Path

import pandas as pd
import pytest
import torch

from eitbench.benchmark.studies.training_study import learning_curve
from eitbench.methods.learned.image_networks import Dnn
from eitbench.reports.figures.losses import difference_percent, write_losses
from eitbench.scenarios.catalogue import sensor
from eitbench.scenarios.errors import DataCorruptError, InputError

LOSSES = ("train", "validation", "train_physical", "validation_physical")


def curve(epochs: int, factor: float) -> pd.DataFrame:
    epoch = range(1, epochs + 1)
    return pd.DataFrame({"epoch": epoch} | {name: [factor / k for k in epoch] for name in LOSSES})


@pytest.mark.slow
def test_losses_are_compared_epoch_by_epoch(tmp_path: Path) -> None:
    curves = {"dnn": curve(6, 2.0), "phydnn": curve(4, 1.9)}  # one stopped early
    found = difference_percent(curves, "validation")
    assert found.index.tolist() == [1, 2, 3, 4]
    assert found.to_numpy() == pytest.approx([-5.0] * 4)
    written = write_losses(curves, tmp_path)
    assert [path.name for path in written] == ["losses.png", "losses.pdf"]
    assert all(path.stat().st_size > 10_000 for path in written)


def test_the_curve_beside_the_weights_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EITBENCH_CACHE", str(tmp_path))
    foam = sensor("foam16", offset=5)  # no weights come with the package for it
    with pytest.raises(InputError, match="'dnn' has no weights for the sensor"):
        learning_curve("dnn", foam)
    weights = tmp_path / "weights" / Dnn.files.file_name(foam)
    Dnn.files.save(weights, foam, {"x": torch.zeros(1)}, {})
    with pytest.raises(InputError, match="There is no learning curve"):
        learning_curve("dnn", foam)
    beside = weights.with_suffix(".json")
    beside.write_text(json.dumps({"curve": curve(3, 1.0).to_dict("records")}))
    pd.testing.assert_frame_equal(learning_curve("dnn", foam), curve(3, 1.0))
    beside.write_text("{}")
    with pytest.raises(DataCorruptError, match="holds no learning curve"):
        learning_curve("dnn", foam)
    with pytest.raises(InputError, match="'noser' is no method that is trained"):
        learning_curve("noser", foam)
