"""Commands on methods: check and new-method."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from eitbench.benchmark import checks
from eitbench.benchmark.checks import CheckReport, CheckResult
from eitbench.benchmark.tuning.selection import Selection, Trial, TuningBudget
from eitbench.commands.methods import _figures

Run = Callable[..., tuple[int, str, str]]


@pytest.mark.parametrize("command", ["priors", "readings", "superposition"])
def test_a_file_in_the_way_of_a_study_is_named_before_it_starts(
    eitbench: Run, tmp_path: Path, command: str
) -> None:
    (tmp_path / "mine").write_text("mine")
    code, _, error = eitbench(command, "--out", str(tmp_path / "mine" / "study"))
    assert code == 2
    assert "mine is a file: name a folder with --out." in error
    assert (tmp_path / "mine").read_text() == "mine"


def test_a_method_that_passes_all_checks(eitbench: Run) -> None:
    code, out, _ = eitbench("check", "noser", "--json")
    (report,) = json.loads(out)
    assert code == 0
    # It states no novelty.
    assert report["ran"] == report["passed"] == len(report["checks"]) - 1 > 20


def test_a_check_that_fails_is_shown_and_exits_with_1(
    eitbench: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    results = (
        CheckResult("fast", "is fast", "passed"),
        CheckResult("quiet", "prints nothing", "xfail", "it is a talker."),
        CheckResult("scaling", "obeys the scaling law", "skipped", "Only exact operators do."),
        CheckResult("images", "returns images", "failed", "it returns none."),
    )
    reports = {
        "sound": [CheckReport("operator", "sound", "foam16", results[:3])],
        "broken": [CheckReport("operator", "broken", "foam16", results)],
    }
    monkeypatch.setattr(checks, "check_target", reports.get)
    assert eitbench("check", "sound")[0] == 0
    code, out, _ = eitbench("check", "broken")
    assert code == 1
    lines = out.splitlines()
    assert [line.split()[0] for line in lines[:-1] if line[0] != " "] == [
        "passed", "xfail", "skipped", "FAILED",
    ]  # fmt: skip
    for result in results:
        assert any(result.name in line for line in lines)
        assert any(result.message in line for line in lines)
    assert lines[-1].startswith("broken on foam16: 3 checks ran, 1 passed, 1 failed")


def test_a_failure_shows_where_and_is_not_said_again_and_again(
    eitbench: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    failed = [
        CheckResult(name, name, "failed", "KeyError: 1.", '  File "a.py", line 3, in fit')
        for name in ("shape", "finite")
    ]
    report = CheckReport("method", "mine", "foam16", tuple(failed), untried=25)
    monkeypatch.setattr(checks, "check_target", lambda target: [report])
    _, out, _ = eitbench("check", "mine.py")
    assert out.splitlines() == [
        "FAILED   shape",
        "         KeyError: 1.",
        '           File "a.py", line 3, in fit',
        "FAILED   finite",
        "mine on foam16: 2 checks ran, 0 passed, 2 failed, 25 not tried for that reason.",
    ]


def test_new_method_says_what_is_next(tmp_path: Path, eitbench: Run) -> None:
    code, out, _ = eitbench("new-method", "my-method", tmp_path / "package")
    assert code == 0
    assert "eitbench check my-method" in out
    assert (tmp_path / "package" / "eitbench_my_method.py").is_file()


@pytest.mark.parametrize(
    ("ranked_by", "default", "chosen", "says"),
    [
        ("score", 5.1, 5.25, "S on validation data: 5.100 by default, 5.250 selected"),
        (
            "localisation_mm",
            -9.0,
            -8.5,
            "Localisation [mm] on validation data: 9.0 by default, 8.5 selected",
        ),
        (
            "",
            None,
            0.5,
            "Mean of scaled figures on validation data: no figure by default, 0.500 selected",
        ),
    ],
)
def test_tuning_tells_the_figures_of_the_defaults_and_of_the_choice(
    ranked_by: str, default: float | None, chosen: float, says: str
) -> None:
    trials = (Trial({"weight": 1}, default), Trial({"weight": 2}, chosen))
    choice = Selection({"weight": 2}, chosen, trials, TuningBudget(), "space", ranked_by=ranked_by)
    assert _figures(choice) == says
