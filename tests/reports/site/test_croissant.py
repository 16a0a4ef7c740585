"""Cards of data sets, read by the checker of their format."""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from eitbench.benchmark.analysis.catalogue import about_recording
from eitbench.benchmark.analysis.results import read_run
from eitbench.reports.site.croissant import recording_card, suite_card

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        importlib.util.find_spec("mlcroissant") is None, reason="needs the extra `test`"
    ),
]

RECORD = Path(__file__).parents[3] / "reports" / "board" / "2026.1" / "quick"
READER = """
import json, sys
import mlcroissant
found = mlcroissant.Dataset(jsonld=sys.argv[1])
issues = found.metadata.ctx.issues
records = found.records("samples") if found.metadata.record_sets else ()
print(json.dumps({
    "issues": [*issues.errors, *issues.warnings],
    "files": [file.sha256 for file in found.metadata.distribution],
    "records": [
        [row["samples/method"].decode(), row["samples/psnr"]] for row in records
    ],
}))
"""


def read(card: Path) -> Any:
    """What the checker says of a card, and reads through it.

    In a process of its own: its logging keeps the streams of this one, and closes them later.
    """
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", READER, str(card)],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize("name", ["ohmc16", "cam09-04", "ktc2023", "sciospec-tank"])
def test_a_card_of_a_recording_is_valid(name: str, tmp_path: Path) -> None:
    recording = about_recording(name)
    assert recording is not None
    card = tmp_path / "card.json"
    card.write_text(json.dumps(recording_card(recording)))
    found = read(card)
    assert found["issues"] == []
    assert found["files"] == [file.sha256 for file in recording.source.files]


def test_the_table_of_a_suite_is_read_through_its_card(tmp_path: Path) -> None:
    run = read_run(RECORD)
    table = tmp_path / "samples.parquet"
    table.write_bytes((RECORD / "samples.parquet").read_bytes())
    card = tmp_path / "croissant.json"
    made = suite_card("quick", "Title", "For a test.", "2026.1", "2026-11-25", table, run.samples)
    card.write_text(json.dumps(made))
    found = read(card)
    assert found["issues"] == []
    methods, psnr = zip(*found["records"], strict=True)
    assert list(methods) == run.samples["method"].tolist()
    read_back = [float("nan") if value is None else value for value in psnr]
    assert read_back == pytest.approx(run.samples["psnr"].tolist(), nan_ok=True)


def test_a_card_that_says_too_little_is_refused(tmp_path: Path) -> None:
    recording = about_recording("ohmc16")
    assert recording is not None
    card = tmp_path / "card.json"
    made = recording_card(recording)
    del made["distribution"][0]["sha256"], made["license"]
    card.write_text(json.dumps(made))
    with pytest.raises(AssertionError):
        assert read(card)["issues"] == []
