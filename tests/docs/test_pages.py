"""Every code block and command of README and docs is run: each page, top to bottom, in one folder.

Fences by language:

- none, `sh` or `bash`: commands, one a line, which have to end well. Boards are emulated, guided
  sessions get their answers, `record` lasts a second, commands that serve until Ctrl-C get that.
  `commands.toml` lists the commands that a test runs with other options, or not.
- `python`: run, or, if its first line is a comment that names a file, written to that file.
- `toml`: read by the reader of such files, and written if its first line names a file.
- `text` and other listings: nothing.
"""

import io
import json
import os
import re
import shlex
import signal
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from markdown_it import MarkdownIt
from typer.main import get_command

from eitbench import cli
from eitbench.benchmark.run.runner import make_plan
from eitbench.hardware.emulation.emulated_sensor import read_script
from eitbench.hardware.recording import guided
from eitbench.hardware.recording.guided import StepDurations
from eitbench.methods.registry import METHOD_REGISTRY, OPERATOR_REGISTRY, Registry
from eitbench.scenarios import load_suite, sensor
from eitbench.scenarios.recordings import RECORDED_SETS
from eitbench.scenarios.suites.suite import suites

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted(
    str(page.relative_to(ROOT))
    for page in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md"))
)
EXCEPTIONS: dict[str, dict[str, dict[str, Any]]] = tomllib.loads(
    Path(__file__).with_name("commands.toml").read_text()
)
SHELL = ("", "sh", "bash")
REGISTRIES: tuple[Registry[Any], ...] = (METHOD_REGISTRY, OPERATOR_REGISTRY)
# Of a guided session: sensor untouched, touches of a place, their depth; places; end.
# Column by column: every fifth touch of the rows would lie on a line, and registers nothing.
ANSWERS = "\n\n\n" + "".join(f"{x} {y}\n" for x in (20, 40, 60, 80) for y in (20, 40, 60)) + "\n"
Command = Callable[..., tuple[int, str, str]]


@dataclass(frozen=True)
class Fence:
    """A code block of a page: its language (`indented` if it has no fence), its code, its line."""

    language: str
    code: str
    line: int

    @property
    def file(self) -> str | None:
        """The file that its first line names."""
        named = re.match(r"# ([\w./-]+\.\w+)$", self.code.split("\n", 1)[0])
        return named[1] if named else None

    @property
    def commands(self) -> list[str]:
        """Its commands, without comments."""
        lines = self.code.replace("\\\n", " ").splitlines()
        words = (shlex.split(line, comments=True) for line in lines)
        return [" ".join(found) for found in words if found] if self.language in SHELL else []


def fences(page: str) -> list[Fence]:
    return [
        Fence(
            "indented" if token.type == "code_block" else token.info.split(" ")[0],
            token.content,
            (token.map or [0])[0] + 1,
        )
        for token in MarkdownIt("commonmark").parse((ROOT / page).read_text())
        if token.type in ("fence", "code_block")
    ]


def is_long(page: str) -> bool:
    return any(exception.get("nightly") for exception in EXCEPTIONS.get(page, {}).values())


@pytest.mark.parametrize("page", PAGES)
def test_every_fence_is_run_or_a_listing(page: str) -> None:
    exceptions, known = EXCEPTIONS.get(page, {}), set[str]()
    for fence in fences(page):
        assert fence.language in (*SHELL, "python", "toml", "json", "text", "yaml"), fence
        known |= {*fence.commands, fence.file or ""}
        for command in fence.commands:
            parsed_only = "parse" in exceptions.get(command, {})
            assert parsed_only or command.split()[0] in ("eitbench", "make"), (
                f"cannot be run: {command}"
            )
    assert not exceptions.keys() - known, f"{page} has no such command"


def test_no_exception_is_for_a_page_that_is_gone() -> None:
    assert not EXCEPTIONS.keys() - set(PAGES)


def test_the_readme_is_read_in_one_sitting() -> None:
    assert len((ROOT / "README.md").read_bytes()) <= 9000


@pytest.mark.parametrize("page", sorted(Path(ROOT / "docs" / "reference").glob("*.md")))
def test_every_name_of_the_reference_has_an_example(page: Path) -> None:
    text = page.read_text()
    code = "".join(re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL))
    named = re.findall(r"^::: eitbench\.([\w.]+)$", text, re.MULTILINE)
    lacking = [name for name in named if not re.search(rf"\b{name.split('.')[-1]}\b", code)]
    # Of errors any example will do.
    assert [name for name in lacking if name != "scenarios.errors"] == []


def test_every_command_has_an_example() -> None:
    lacking = [" ".join(names) for names, found in _commands() if "Example: " not in found.epilog]
    assert lacking == []


def _commands(names: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    found, _ = command_of(["eitbench", *names])
    if not hasattr(found, "commands"):
        yield names, found
    for name in getattr(found, "commands", ()):
        yield from _commands((*names, name))


@pytest.mark.parametrize("page", PAGES)
def test_commands_in_its_sentences_exist(page: str) -> None:
    for token in MarkdownIt("commonmark").enable("table").parse((ROOT / page).read_text()):
        for part in token.children or ():
            if part.type != "code_inline" or not re.match(r"eitbench [a-z]", part.content):
                continue
            words = shlex.split(part.content)
            if "..." not in words and command_of(words)[1]:  # a mere name has to be one
                parse(words)


@pytest.fixture(scope="module")
def _cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture
def reader(
    tmp_path: Path, _cache: Path, monkeypatch: pytest.MonkeyPatch, eitbench: Command
) -> "Reader":
    """A reader who follows a page in a folder beside `docs`, with one cache for all pages."""
    monkeypatch.setenv("EITBENCH_CACHE", str(_cache))
    shared = Path(os.environ.get("EITBENCH_DATA") or ROOT.parent / "shared" / "recordings")
    if shared.is_dir():
        monkeypatch.setenv("EITBENCH_DATA", str(shared))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(guided, "StepDurations", lambda: StepDurations(0.3, 0.05, 0.1, 0.1))
    (tmp_path / "docs").symlink_to(ROOT / "docs")
    return Reader(eitbench, monkeypatch, absent=() if shared.is_dir() else tuple(RECORDED_SETS))


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, marks=pytest.mark.slow) if any(f.commands for f in found) else page
        for page in PAGES
        if (found := fences(page))
    ],
)
def test_page(page: str, reader: "Reader") -> None:
    reader.follow(page, nightly=False)


@pytest.mark.nightly
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("page", [page for page in PAGES if is_long(page)])
def test_page_with_all_that_is_long(page: str, reader: "Reader") -> None:
    reader.follow(page, nightly=True)


@dataclass
class Reader:
    """Follows pages in the present folder; skips commands on recorded sets that are absent."""

    eitbench: Command
    patch: pytest.MonkeyPatch
    absent: tuple[str, ...]

    def follow(self, page: str, *, nightly: bool) -> None:
        """Run all code of a page, those of the night only if asked for."""
        exceptions, names = EXCEPTIONS.get(page, {}), {"__name__": "__docs__"}
        for fence in reversed(fences(page)):  # a command may use a file that is listed below it
            write(fence)
        for fence in fences(page):
            try:
                write(fence)
                if fence.language == "python" and fence.file is None:
                    exec(compile(fence.code, f"line {fence.line}", "exec"), names)
                elif fence.language == "toml" and fence.file not in exceptions:
                    read_listing(fence)
                elif fence.language == "json":
                    json.loads(fence.code)
                for command in fence.commands:
                    self._obey(command, exceptions.get(command, {}), nightly=nightly)
            except BaseException as error:
                error.add_note(f"{page}:{fence.line}")
                raise

    def _obey(self, command: str, exception: dict[str, Any], *, nightly: bool) -> None:
        words = shlex.split(f"{command} {exception.get('add', '')}")
        if words[0] == "make":
            dry = ["make", "-n", f"PYTHON={sys.executable}", *words[1:]]
            subprocess.run(dry, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
        elif words[0].endswith("eitbench"):
            parse(words)
            left = "parse" in exception or (exception.get("nightly") and not nightly)
            if not left and not set(self.absent) & set(words):
                for before in (*exception.get("first", ()), shlex.join(words)):
                    self._run(before)

    def _run(self, command: str) -> None:
        words = shlex.split(command)[1:]
        words, file = (words[:-2], Path(words[-1])) if words[-2:-1] == [">"] else (words, None)
        if "--port" in words:
            board, port = words.index("--board") + 1, words.index("--port")
            words[port : port + 2] = ["--protocol", words[board]]
            words[board] = "emulator"
        if words[0] == "record" and "--guided" not in words:
            words += ["--seconds", "1"]
        if words[0] in ("live", "emulate"):
            serve(words)
            return
        self.patch.setattr(sys, "stdin", io.StringIO(ANSWERS))
        with forgetting_plugins():
            code, out, err = self.eitbench(*words)
        assert code == 0, f"{command} ended with {code}:\n{out}\n{err}"
        if file is not None:
            file.write_text(out)


def write(fence: Fence) -> None:
    """Write the file that a fence names."""
    if fence.file is not None and fence.language in ("python", "toml"):
        Path(fence.file).parent.mkdir(parents=True, exist_ok=True)
        Path(fence.file).write_text(fence.code)


def read_listing(fence: Fence) -> None:
    """Read a TOML listing by the reader of such files."""
    path = Path(fence.file or f"line-{fence.line}.toml")
    path.write_text(fence.code)
    declared = tomllib.loads(fence.code)
    if "scenarios" in declared:
        load_suite(path)
    elif "outline" in declared:
        sensor(str(path))
    elif "touches" in declared:
        assert read_script(path, sensor("foam16"))
    else:
        assert "project" in declared, "Nothing here reads such a file."


def command_of(words: list[str]) -> tuple[Any, list[str]]:
    """The command that is named, and the words that follow its name."""
    found, rest = get_command(cli.app), words[1:]
    context = found.make_context("eitbench", ["list"], resilient_parsing=True)
    while hasattr(found, "get_command") and rest:
        inner = found.get_command(context, rest[0])
        assert inner is not None, f"There is no command {shlex.join(words)}"
        found, rest = inner, rest[1:]
    return found, rest[: rest.index(">")] if ">" in rest else rest


def parse(words: list[str]) -> None:
    """Check a command as the command line would, down to the methods and scenarios of a run."""
    found, rest = command_of(words)
    params = found.make_context(found.name or "", list(rest), resilient_parsing=False).params
    if found.name == "run" and params["suite"] in suites() and not params["plugin"]:
        methods, scenarios = (
            [name for name in (params[key] or "").split(",") if name]
            for key in ("methods", "scenarios")
        )
        make_plan(load_suite(params["suite"]), methods=methods, scenarios=scenarios)


@contextmanager
def forgetting_plugins() -> Iterator[None]:
    """Remove the methods that a command's plugin registered, as if it had its own process."""
    before = [registry.known() for registry in REGISTRIES]  # all built-in ones are imported by this
    yield
    for registry, known in zip(REGISTRIES, before, strict=True):
        for name in registry.known().keys() - known.keys():
            del registry._registered[name]


def serve(arguments: list[str]) -> None:
    """Run a command that serves until Ctrl-C, up to its first line; it has to end well."""
    free = ["--http-port", "0"] if arguments[0] == "live" else []
    process = subprocess.Popen(
        [sys.executable, "-c", "from eitbench.cli import main; main()", *arguments, *free],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    line = process.stdout.readline()
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=60)
    assert line, f"{shlex.join(arguments)} printed nothing."
    assert process.returncode in (0, 130), shlex.join(arguments)
