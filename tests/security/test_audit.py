"""Sentences and exit codes of the audit of dependencies."""

import importlib
from pathlib import Path
from typing import Any

import pytest

FINE = {"name": "a", "version": "1", "vulns": []}
UNLISTED = {"name": "eitbench", "skip_reason": "not found"}
BROKEN = {
    "name": "b",
    "version": "2",
    "vulns": [
        {"id": "PYSEC-1", "fix_versions": ["2.1", "3.0"]},
        {"id": "PYSEC-2", "fix_versions": []},
    ],
}


@pytest.fixture
def audit(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(Path(__file__).resolve().parents[2]))
    return importlib.import_module("tests.security.audit").audit


def test_a_known_vulnerability_fails(audit: Any) -> None:
    pip = BROKEN | {"name": "pip"}  # comes with Python
    assert audit(lambda service: {"dependencies": [FINE, BROKEN, UNLISTED, pip]}) == (
        [
            "b 2 has the known vulnerability PYSEC-1: install 2.1 or 3.0.",
            "b 2 has the known vulnerability PYSEC-2: no version without it is known.",
            "2 packages looked up in pypi: 2 known vulnerabilities; 1 packages are not listed "
            "there.",
        ],
        1,
    )


@pytest.mark.parametrize(
    ("packages", "says"),
    [
        ([FINE], "1 packages looked up in pypi: 0 known vulnerabilities."),
        ([], "nothing was audited."),
        ([UNLISTED] * 3, "nothing was audited."),
    ],
)
def test_nothing_that_is_known_passes(audit: Any, packages: list[Any], says: str) -> None:
    (sentence,), code = audit(lambda service: {"dependencies": packages} if packages else {})
    assert (sentence.endswith(says), code) == (True, 0)


def test_the_second_database_is_asked_where_the_first_says_nothing(audit: Any) -> None:
    said, code = audit(lambda service: {"dependencies": [BROKEN] if service == "osv" else []})
    assert code == 1
    assert "looked up in osv" in said[-1]
