"""Every code block and command of README and docs is run: each page, top to bottom, in one folder.

What a fence is, its language says:

- none, or `sh`: commands, one a line, which have to end well. Boards on a port are emulated ones,
  guided sessions get their answers, `record` lasts a second, what serves until Ctrl-C gets that.
- `python`: run, or, if its first line is a comment that names a file, written to that file.
- `toml`: read by whatever reads such a file, and written if its first line names a file.
- `text` and other listings: nothing.

Comments on the lines above a fence say what a test has to do otherwise:

    <!-- test: + --limit 2 -->      options added to every command of the fence that takes them
    <!-- test: first COMMAND -->    a command (of eitbench, or `cp`) that has to be run before
    <!-- test: slow -->             run in the nightly tests only, else parsed
    <!-- test: parse, REASON -->    parsed only, since it cannot be run here
"""

import io
import json
import os
import re
import shlex
import shutil
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
import typer
from markdown_it import MarkdownIt
from typer.main import get_command

from eitbench import cli
from eitbench.benchmark.run.runner import make_plan
from eitbench.hardware.emulation.touch_script import read_script
from eitbench.hardware.recording import guided
from eitbench.hardware.recording.guided import Timing
from eitbench.methods.registry import METHOD_REGISTRY, OPERATOR_REGISTRY, Registry
from eitbench.scenarios import load_suite, sensor
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.recordings import RECORDED_SETS
from eitbench.scenarios.suites.suite import suites

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))
]  # fmt: skip
SHELL = ("", "sh", "bash")
LISTINGS = ("text", "yaml", "matlab")
DIRECTIVE = re.compile(r"<!-- test: (.+?) -->")
SERVES = ("live", "emulate")
REGISTRIES: tuple[Registry[Any], ...] = (METHOD_REGISTRY, OPERATOR_REGISTRY)
STORED = {"--resume", "--runs"}
"""Options that name what was run before, with which nothing is made smaller."""
# Typer raises these of click's, or of its own copy of click, which has no public name.
BAD_USAGE: type[Exception] = typer.BadParameter.__mro__[1]
Command = Callable[..., tuple[int, str, str]]


@dataclass(frozen=True)
class Block:
    """A fence: its language, its code, its line, and what a test is told of it."""

    language: str
    code: str
    line: int
    told: tuple[str, ...]

    @property
    def file(self) -> str | None:
        """The file that its first line names."""
        named = re.match(r"# ([\w./-]+\.\w+)$", self.code.split("\n", 1)[0])
        return named[1] if named else None

    @property
    def commands(self) -> list[list[str]]:
        """The words of every command."""
        whole = self.code.replace("\\\n", " ").splitlines()
        split = [shlex.split(line, comments=True) for line in whole]
        return [_without_folder(words) for words in split if words]

    def options(self) -> list[list[str]]:
        """What is added to commands."""
        return [shlex.split(told[2:]) for told in self.told if told.startswith("+ ")]

    def first(self) -> list[list[str]]:
        """Commands that have to be run before."""
        return [shlex.split(told[6:]) for told in self.told if told.startswith("first ")]

    @property
    def slow(self) -> bool:
        """Whether it takes too long to be run by default."""
        return "slow" in self.told

    @property
    def parsed_only(self) -> bool:
        """Whether there is a reason not to run it."""
        return any(told.startswith("parse, ") for told in self.told)


def _without_folder(words: list[str]) -> list[str]:
    return ["eitbench", *words[1:]] if words[0] == ".venv/bin/eitbench" else words


def blocks_of(text: str) -> list[Block]:
    """The fences of a page; indented code has language `indented`."""
    found, told = list[Block](), list[str]()
    for token in MarkdownIt("commonmark").parse(text):
        if token.type == "html_block":
            told += DIRECTIVE.findall(token.content)
        elif token.type in ("fence", "code_block"):
            language = "indented" if token.type == "code_block" else token.info.split(" ")[0]
            line = (token.map or [0])[0] + 1
            found.append(Block(language, token.content, line, tuple(told)))
            told = []
        elif told:
            raise AssertionError(f"No fence follows the directive {told[0]!r}.")
    return found


def name_of(page: Path) -> str:
    return str(page.relative_to(ROOT))


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_fence_is_run_or_a_listing(page: Path) -> None:
    for block in blocks_of(page.read_text()):
        where = f"{page.name}:{block.line}"
        assert block.language in (*SHELL, "python", "toml", "json", *LISTINGS), where
        for told in block.told:
            assert re.fullmatch(r"slow|\+ --.+|first (eitbench|cp) .+|parse, .+", told), where
        if block.language in SHELL:
            for words in block.commands:
                known = block.parsed_only or words[0] in ("eitbench", "make")
                assert known, f"{where}: say why {words[0]!r} cannot be run here"


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_commands_in_its_sentences_exist(page: Path) -> None:
    for token in MarkdownIt("commonmark").enable("table").parse(page.read_text()):
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
    """Somebody who follows a page, in a folder beside `docs`, with a cache for all pages."""
    monkeypatch.setenv("EITBENCH_CACHE", str(_cache))
    shared = Path(os.environ.get("EITBENCH_DATA") or ROOT.parent / "shared" / "recordings")
    if shared.is_dir():
        monkeypatch.setenv("EITBENCH_DATA", str(shared))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(guided, "Timing", lambda: Timing(0.3, 0.05, 0.1))
    (tmp_path / "docs").symlink_to(ROOT / "docs")
    return Reader(eitbench, monkeypatch, recorded=shared.is_dir())


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_page(page: Path, reader: "Reader") -> None:
    reader.follow(page, slow=False)


@pytest.mark.slow
@pytest.mark.timeout(7200)
@pytest.mark.parametrize(
    "page", [p for p in PAGES if any(b.slow for b in blocks_of(p.read_text()))], ids=name_of
)
def test_page_with_all_that_is_slow(page: Path, reader: "Reader") -> None:
    reader.follow(page, slow=True)


class Reader:
    """Follows a page in the present folder."""

    def __init__(
        self, eitbench: Command, monkeypatch: pytest.MonkeyPatch, *, recorded: bool
    ) -> None:
        self._eitbench, self._patch = eitbench, monkeypatch
        self._names: dict[str, Any] = {"__name__": "__docs__"}
        self._absent = () if recorded else tuple(RECORDED_SETS)

    def follow(self, page: Path, *, slow: bool) -> None:
        """All of it; what is slow only if asked for, else it is parsed."""
        blocks = blocks_of(page.read_text())
        # A command may use a file that is listed below it.
        for block in reversed(blocks):
            self._write(block)
        for block in blocks:
            only_parsed = block.parsed_only or (block.slow and not slow)
            try:
                self._do(block, run=not only_parsed)
            except BaseException as error:
                error.add_note(f"{name_of(page)}:{block.line}")
                raise

    def _do(self, block: Block, *, run: bool) -> None:
        self._write(block)
        if block.language == "python":
            code = compile(block.code, f"line {block.line}", "exec")
            if run and block.file is None:
                exec(code, self._names)
        elif block.language == "toml" and block.parsed_only:
            tomllib.loads(block.code)
        elif block.language == "toml":
            read_listing(block)
        elif block.language == "json" and not block.parsed_only:
            json.loads(block.code)
        elif block.language in SHELL:
            self._obey(block, run=run)

    @staticmethod
    def _write(block: Block) -> None:
        if block.file is not None and block.language in ("python", "toml"):
            Path(block.file).parent.mkdir(parents=True, exist_ok=True)
            Path(block.file).write_text(block.code)

    def _obey(self, block: Block, *, run: bool) -> None:
        unused = block.options()
        for words in block.first() if run else ():
            self._run(words)
        for words in block.commands:
            if words[0] == "make":
                dry = ["make", "-n", f"PYTHON={sys.executable}", *words[1:]]
                subprocess.run(dry, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
            if words[0] != "eitbench":
                continue
            parse(words)
            for options in block.options() if not STORED & set(words) else ():
                if parses([*words, *options]):
                    words = [*words, *options]
                    unused = [left for left in unused if left != options]
            if run and not any(name in words for name in self._absent):
                self._run(words)
        assert not unused, f"No command takes {unused}."

    def _run(self, words: list[str]) -> None:
        if words[0] == "cp":
            source, target = words[1:]
            if Path(source).is_dir():
                shutil.copytree(source, target)
            else:
                shutil.copyfile(source, target)
            return
        words, file = (words[:-2], Path(words[-1])) if words[-2] == ">" else (words, None)
        if words[1] == "record":
            words = [*words, *([] if "--guided" in words else ["--seconds", "1"])]
        with emulated_port(words) as arguments:
            if words[1] in SERVES:
                with serving(arguments):
                    return
            self._patch.setattr(sys, "stdin", io.StringIO(answers("--port" in words)))
            with forgetting_plugins():
                code, out, err = self._eitbench(*arguments)
        assert code == 0, f"{shlex.join(words)} ended with {code}:\n{out}\n{err}"
        if file is not None:
            file.write_text(out)


def read_listing(block: Block) -> None:
    """Have a TOML listing read by what reads such a file."""
    path = Path(block.file or f"line-{block.line}.toml")
    path.write_text(block.code)
    declared = tomllib.loads(block.code)
    if "scenarios" in declared:
        load_suite(path)
    elif "outline" in declared:
        sensor(str(path))
    elif "touches" in declared:
        assert read_script(path)
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


def parses(words: list[str]) -> bool:
    """Whether a command takes all these options, and has what they name."""
    try:
        parse(words)
    except (BAD_USAGE, InputError):
        return False
    return True


@contextmanager
def forgetting_plugins() -> Iterator[None]:
    """What a command's plugin registers is gone with it, as if it had a process of its own."""
    before = [registry.known() for registry in REGISTRIES]  # all built-in ones are imported by this
    yield
    for registry, kept in zip(REGISTRIES, before, strict=True):
        for name in registry.known().keys() - kept.keys():
            del registry._registered[name]


@contextmanager
def serving(arguments: list[str]) -> Iterator[str]:
    """A command that serves until Ctrl-C, with what it says first; it has to end well."""
    free = ["--http-port", "0"] if arguments[0] == "live" else []
    process = subprocess.Popen(
        [sys.executable, "-c", "from eitbench.cli import main; main()", *arguments, *free],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    try:
        said = process.stdout.readline()
        assert said, f"{shlex.join(arguments)} said nothing."
        yield said
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=60)
    assert process.returncode in (0, 130), shlex.join(arguments)


@contextmanager
def emulated_port(words: list[str]) -> Iterator[list[str]]:
    """The arguments of a command, with an emulated board on the port that it names."""
    if "--port" not in words:
        yield words[1:]
        return
    at = words.index("--port") + 1
    chosen = ["--protocol", words[words.index("--board") + 1]]
    if "--sensor" in words:
        chosen += ["--sensor", words[words.index("--sensor") + 1]]
    with serving(["emulate", *chosen]) as said:
        port = re.search(r" on (\S+) \(", said)
        assert port, said
        yield [*words[1:at], port[1], *words[at + 1 :]]


def answers(by_hand: bool) -> str:
    """What is typed in a guided session of 12 touches; one by hand is asked of every touch."""
    places = [f"{x} {y}" for y in (20, 40, 60) for x in (20, 40, 60, 80)]
    touch = "\n\n\n" if by_hand else "\n"
    return "\n\n\n" + "".join(place + touch for place in places) + "\n"
