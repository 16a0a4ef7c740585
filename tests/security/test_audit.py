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
    assert audit(lambda service: {"dependencies": [FINE, BROKEN, UNLISTED]}) == (
        [
            "b 2 has the known vulnerability PYSEC-1: install 2.1 or 3.0.",
            "b 2 has the known vulnerability PYSEC-2: no version without it is known.",
            "2 packages looked up in pypi: 2 known vulnerabilities; 1 packages are not listed "
            "there.",
        ],
        1,
    )


def test_none_passes(audit: Any) -> None:
    said, code = audit(lambda service: {"dependencies": [FINE]})
    assert (said, code) == (["1 packages looked up in pypi: 0 known vulnerabilities."], 0)


@pytest.mark.parametrize("reply", [{}, {"dependencies": []}, {"dependencies": [UNLISTED] * 3}])
def test_without_a_database_nothing_is_claimed(audit: Any, reply: dict[str, Any]) -> None:
    said, code = audit(lambda service: reply)
    assert code == 0
    assert said == ["No database of vulnerabilities can be reached from here: nothing was audited."]


def test_the_second_database_is_asked_where_the_first_says_nothing(audit: Any) -> None:
    said, code = audit(lambda service: {"dependencies": [BROKEN] if service == "osv" else []})
    assert code == 1
    assert "looked up in osv" in said[-1]
