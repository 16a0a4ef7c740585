"""The README's code is run as it stands."""

import re
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

from eitbench import cli
from eitbench.benchmark.checks import check_target
from eitbench.benchmark.runner import make_plan
from eitbench.scenarios.suites import load_suite

README = (Path(__file__).resolve().parents[1] / "README.md").read_text()
BLOCKS = re.findall(r"```(\w*)\n(.*?)```", README, flags=re.DOTALL)
PYTHON = [code for language, code in BLOCKS if language == "python"]
SHELL = [line for language, code in BLOCKS if not language for line in code.splitlines()]
INLINE = re.findall(r"`(eitbench [^`]*)`", README)
COMMANDS = sorted({line.split("  ")[0] for line in SHELL + INLINE if line.startswith("eitbench ")})


def test_the_method_of_the_readme_passes_the_checks(tmp_path: Path) -> None:
    code = next(code for code in PYTHON if "@register" in code)
    assert len(code.splitlines()) <= 22
    file = tmp_path / "my_method.py"
    file.write_text(code)
    (report,) = check_target(str(file))
    assert report.passed, report.results


def test_the_python_example_runs() -> None:
    code = next(code for code in PYTHON if "forward_model" in code)
    names: dict[str, object] = {}
    exec(compile(code, "README.md", "exec"), names)
    assert names["v"].shape == (208,)  # type: ignore[attr-defined]


def test_the_operator_example_runs() -> None:
    code = next(code for code in PYTHON if "operator(" in code)
    names: dict[str, Any] = {}
    exec(compile(code, "README.md", "exec"), names)
    assert names["sigma"].grad.shape == names["back"].shape == (4, 80, 80)
    # d/dc V(c sigma) = -V / c at c = 1, up to the contact impedance's share.
    total = float((names["gradient"] * 0.5).sum())
    assert abs(total / float(names["v"][0].sum()) + 1) < 0.05


@pytest.mark.parametrize("command", COMMANDS)
def test_commands_of_the_readme_exist_with_their_options(command: str) -> None:
    """Parsed as the command line would, down to suites, methods and scenarios; not run."""
    words = command.split()[1:]
    group = get_command(cli.app)
    context = group.make_context("eitbench", ["list"], resilient_parsing=True)
    found, rest = group, words
    while hasattr(found, "get_command") and rest:
        inner = found.get_command(context, rest[0])
        assert inner is not None, f"{command}: no command {rest[0]!r}"
        found, rest = inner, rest[1:]
    parsed = found.make_context(found.name or "", list(rest), resilient_parsing=False)
    if found.name == "run" and parsed.params["suite"]:
        names = [
            [n for n in (parsed.params[key] or "").split(",") if n]
            for key in ("methods", "scenarios")
        ]
        make_plan(load_suite(parsed.params["suite"]), methods=names[0], scenarios=names[1])
