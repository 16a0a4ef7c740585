"""What tests of findings share."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from eitbench.benchmark.ceiling import record


@pytest.fixture(autouse=True)
def records(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """No records of the ceiling but those that a test writes."""
    monkeypatch.setattr(record, "RECORDS", tmp_path / "records")
    record._stored.cache_clear()
    yield tmp_path / "records"
    record._stored.cache_clear()
