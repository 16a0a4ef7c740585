"""Runs for the claim ledger, which continue where they were stopped."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from eitbench.benchmark.run.runner import RunInterruptedError, resume_run, start_run
from eitbench.benchmark.rundir import manifest
from eitbench.benchmark.rundir.plan import Plan, make_plan
from eitbench.benchmark.studies import reproduce
from eitbench.benchmark.studies.reproduce import run_claims
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.suites.suite import Suite


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch, tiny: Suite) -> None:
    """Tiny suites in the place of the paper's."""

    def plans(limit: int | None) -> Sequence[Plan]:
        second = tiny.model_copy(update={"name": "second"})
        return [make_plan(suite, methods=["noser"], limit=limit) for suite in (tiny, second)]

    monkeypatch.setattr(reproduce, "_plans", plans)


@pytest.mark.slow
@pytest.mark.usefixtures("small")
def test_finished_runs_are_taken_as_they_are(tmp_path: Path) -> None:
    folders = run_claims(tmp_path / "new", limit=2)
    assert folders == [tmp_path / "new" / "tiny", tmp_path / "new" / "second"]
    before = [manifest.read(folder) for folder in folders]
    assert [content["status"] for content in before] == ["finished", "finished"]
    assert before[0]["data"]["tiny"]["n"] == 2
    assert run_claims(tmp_path / "new", limit=2) == folders
    assert [manifest.read(folder) for folder in folders] == before
    with pytest.raises(InputError, match=r"tiny holds a run with another --limit or"):
        run_claims(tmp_path / "new", limit=3)


@pytest.mark.slow
@pytest.mark.usefixtures("small")
def test_a_stopped_run_is_continued(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Stopped in the second suite; called again, no suite is started anew."""
    out = tmp_path / "out"

    def stopped(plan: Plan, folder: Path, **options: Any) -> None:
        start_run(plan, folder, **options)
        if folder.name == "second":
            raise RunInterruptedError("Interrupted.", f"eitbench run --resume {folder}")

    again = f"`eitbench reproduce --out {out} --limit 2`"
    monkeypatch.setattr(reproduce, "start_run", stopped)
    with pytest.raises(RunInterruptedError, match=re.escape(again)):
        run_claims(out, limit=2)
    resumed = []

    def noted(folder: Path, **options: Any) -> None:
        resumed.append(folder)
        resume_run(folder, **options)

    monkeypatch.setattr(reproduce, "start_run", None)
    monkeypatch.setattr(reproduce, "resume_run", noted)
    assert run_claims(out, limit=2) == resumed == [out / "tiny", out / "second"]
