"""Declarations: frozen parameters read from TOML files; errors name the line and the field."""

import difflib
import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError, ValidationInfo

from eitbench.scenarios.errors import InputError

Key = tuple[str | int, ...]


def _name(value: object) -> object:
    # Names become folders, groups of result files and command-line arguments.
    if not isinstance(value, str) or not re.fullmatch(r"[a-z0-9][a-z0-9-]*", value):
        raise ValueError("a name has small letters, digits and hyphens only")
    return value


Name = Annotated[str, BeforeValidator(_name)]


class Declaration(BaseModel):
    """A frozen set of declared parameters; unknown ones are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=False)


Declared = TypeVar("Declared", bound=Declaration)


class Places:
    """Where a TOML file declares what: the beginnings of sentences about mistakes in it.

    Args:
        kind: of file, such as "Suite".
        path: of the file.
        text: its content.
    """

    def __init__(self, kind: str, path: Path, text: str) -> None:
        self.kind, self.path = kind, path
        self._lines = key_lines(text)

    def __call__(self, *key: str | int) -> str:
        """Where the field `key` is, or would be."""
        return f"{self.kind} file {self.path}, line {self.line(key)}, field {_field(key)!r}"

    def line(self, key: Key) -> int:
        """The line of `key`, or of the nearest key that contains it."""
        while key not in self._lines:
            key = key[:-1]
        return self._lines[key]


def read_declaration(
    kind: str, path: Path, model: type[Declared], models: Sequence[type[Declaration]]
) -> tuple[Declared, Places]:
    """What the TOML file at `path` declares, and where.

    Args:
        kind: of file, such as "Suite", for sentences.
        path: of the file; `beside` finds what it names by a path.
        model: of the whole file.
        models: all that the file may hold, whose fields are suggested for misspelt ones.

    Raises:
        InputError: the file cannot be read or declares something wrong.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not UTF-8 text"
        raise InputError(f"Cannot read the {kind.lower()} file {path}: {reason}.") from error
    try:
        declared = tomllib.loads(text)
        # Read as JSON, so that numbers written as text are refused but lists can be tuples.
        content = json.dumps(declared, default=_date)
    except tomllib.TOMLDecodeError as error:
        raise InputError(_syntax_message(kind, path, text, str(error))) from error
    except (ValueError, RecursionError) as error:
        raise InputError(
            f"Cannot read the {kind.lower()} file {path}: a number is too long, or lists or "
            "tables lie too deep in one another."
        ) from error
    places = Places(kind, path, text)
    try:
        found = model.model_validate_json(content, strict=True, context={"folder": path.parent})
    except ValidationError as error:
        fields = sorted({field for known in models for field in known.model_fields})
        problems = [_problem(dict(e), declared, fields) for e in error.errors(include_url=False)]
        # The first in the file, unless it is but the consequence of one further inside: a list of
        # nothing but mistakes also counts as too short.
        causes = [
            (key, problem)
            for key, problem in problems
            if not any(_in_element_of(key, other) for other, _ in problems)
        ]
        key, problem = min(causes, key=lambda cause: places.line(cause[0]))
        stop = "" if problem.endswith("?") else "."
        raise InputError(f"{places(*key)}: {problem}{stop}") from error
    return found, places


def beside(path: str, info: ValidationInfo) -> str:
    """The absolute path of a file that a declaration names, relative to its own folder."""
    folder = (info.context or {}).get("folder", Path())
    return str(Path(folder, Path(path).expanduser()).resolve())


def key_lines(text: str) -> dict[Key, int]:
    """The line (from 1) on which every key or table of a TOML `text` begins.

    A scan by line is enough to point at a mistake: keys inside inline tables and keys that look
    like text of a multi-line string are looked up at the nearest key that contains them.
    """
    lines: dict[Key, int] = {(): 1}
    counts: dict[str, int] = {}
    table: Key = ()
    for number, line in enumerate(text.splitlines(), start=1):
        if header := re.match(r"\s*\[\[\s*([\w-]+)\s*\]\]", line):
            counts[header[1]] = counts.get(header[1], -1) + 1
            table = (header[1], counts[header[1]])
            lines.setdefault((header[1],), number)
        elif header := re.match(r"\s*\[\s*([\w.-]+)\s*\]", line):
            parts: list[str | int] = []
            for part in header[1].split("."):
                parts.append(part)
                if part in counts and len(parts) == 1:
                    parts.append(counts[part])
            table = tuple(parts)
        elif entry := re.match(r"\s*\"?([\w.-]+)\"?\s*=", line):
            lines.setdefault((*table, *entry[1].split(".")), number)
            continue
        else:
            continue
        lines.setdefault(table, number)
    return lines


def _in_element_of(outer: Key, inner: Key) -> bool:
    """Whether `inner` lies in an element of the list `outer`."""
    n = len(outer)
    return len(inner) > n and inner[:n] == outer and isinstance(inner[n], int)


def _date(value: object) -> dict[str, str]:
    """What stands for a date of TOML, which no field holds: not a string, which many do."""
    return {"date": str(value)}


def _field(key: Key) -> str:
    parts = (f"[{part}]" if isinstance(part, int) else f".{part}" for part in key)
    return "".join(parts).lstrip(".")


def _syntax_message(kind: str, path: Path, text: str, reason: str) -> str:
    place = re.search(r"line (\d+)", reason)
    line = int(place[1]) if place else len(text.splitlines())
    what = reason.split(" (at ")[0]
    written = text.splitlines()[line - 1] if 0 < line <= len(text.splitlines()) else ""
    key = re.match(r"\s*([\w.-]+)\s*=", written)
    field = f", field {key[1]!r}" if key else ""
    return f"{kind} file {path}, line {line}{field}: not valid TOML, {what[:1].lower()}{what[1:]}."


def _problem(
    error: Mapping[str, Any], declared: Mapping[str, Any], fields: Sequence[str]
) -> tuple[Key, str]:
    """Field and sentence of one validation `error`."""
    key = _declared_key(error["loc"], declared)
    problem = str(error["msg"]).removeprefix("Value error, ").rstrip(".")
    if error["type"] == "missing":
        problem = "it is missing"
    elif error["type"] == "extra_forbidden":
        near = difflib.get_close_matches(str(key[-1]), fields, n=1)
        problem = f"unknown field, the nearest is {near[0]!r}" if near else "unknown field"
    elif error["type"].startswith("union_tag"):
        key = (*key, "kind")
        problem = "it is 'simulated' or 'recorded'"
    return key, problem


def _declared_key(loc: Sequence[str | int], declared: Mapping[str, Any]) -> Key:
    """`loc` of a validation error without the union tags that the file does not have."""
    key: list[str | int] = []
    here: Any = declared
    for k, part in enumerate(loc):
        if isinstance(here, list):
            inside = isinstance(part, int) and part < len(here)
        else:
            inside = isinstance(here, dict) and part in here
        # One value may stand for a list, and then has no number.
        numbered = isinstance(part, int) and not isinstance(here, list)
        if inside:
            here = here[part]
        elif k < len(loc) - 1 or numbered:
            continue
        key.append(part)
    return tuple(key)
