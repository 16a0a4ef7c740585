"""Cards of data sets, read by the checker of their format."""

import json
from pathlib import Path
from typing import Any

import pytest

from eitbench.benchmark.analysis.catalogue import about_recording
from eitbench.benchmark.analysis.results import read_run
from eitbench.reports.site.croissant import recording_card, suite_card

mlcroissant = pytest.importorskip("mlcroissant", reason="needs the extra `test`")

RECORD = Path(__file__).parents[3] / "reports" / "board" / "2026.1" / "quick"


def checked(card: Path) -> Any:
    """The data set of a card without errors and warnings."""
    found = mlcroissant.Dataset(jsonld=card)
    assert not found.metadata.ctx.issues.errors
    assert not found.metadata.ctx.issues.warnings
    return found


@pytest.mark.parametrize("name", ["ohmc16", "cam09-04", "ktc2023", "sciospec-tank"])
def test_a_card_of_a_recording_is_valid(name: str, tmp_path: Path) -> None:
    recording = about_recording(name)
    assert recording is not None
    card = tmp_path / "card.json"
    card.write_text(json.dumps(recording_card(recording)))
    files = checked(card).metadata.distribution
    assert [file.sha256 for file in files] == [file.sha256 for file in recording.source.files]


def test_the_table_of_a_suite_is_read_through_its_card(tmp_path: Path) -> None:
    run = read_run(RECORD)
    table = tmp_path / "samples.parquet"
    table.write_bytes((RECORD / "samples.parquet").read_bytes())
    card = tmp_path / "croissant.json"
    made = suite_card("quick", "Title", "For a test.", "2026.1", "2026-11-25", table, run.samples)
    card.write_text(json.dumps(made))
    records = list(checked(card).records("samples"))
    assert [row["samples/method"].decode() for row in records] == run.samples["method"].tolist()
    psnr = [row["samples/psnr"] for row in records]
    assert psnr == pytest.approx(run.samples["psnr"].tolist(), nan_ok=True)
