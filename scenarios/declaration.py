"""Declarations: frozen parameters read from TOML files; errors name the file and the field."""

import difflib
import json
import re
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError, ValidationInfo

from eitbench.scenarios.errors import InputError
from eitbench.scenarios.storage.limits import check_regular

Key = tuple[str | int, ...]
TAGS = ("simulated", "recorded", "transfer")
"""Kinds of scenarios: they stand in the locations of errors, and are no fields."""

MAX_BYTES = 200_000
"""Greatest size of a file: the largest packaged suite has 20 kB."""
MAX_PARTS = 32
"""Most parts of a dotted key: the time that Python takes to read one grows with their square."""
_PART = r"""(?:[\w-]++|"(?:[^"\\\n]|\\.)*+"|'[^'\n]*+')"""
_DEEP_KEY = re.compile(rf"(?<![\w-])(?:{_PART}[ \t]*+\.[ \t]*+){{{MAX_PARTS}}}")


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


def field_error(kind: str, path: Path, key: Key, problem: object, section: str = "") -> InputError:
    """Return the error for a wrong field of a TOML file.

    Args:
        kind: of file, such as "Suite".
        path: of the file.
        key: names of tables, numbers (from 0) of list elements, and the name of the field.
        problem: the rest of the sentence, with its full stop.
        section: name of the table around the field, if it has one.
    """
    parts = (f"[{part}]" if isinstance(part, int) else f".{part}" for part in key)
    of = f" of {section!r}" if section else ""
    return InputError(f"{kind} file {path}, field {''.join(parts).lstrip('.')!r}{of}: {problem}")


def read_declaration(
    kind: str,
    path: Path,
    model: type[Declared],
    in_full: Callable[[dict[str, Any]], dict[str, Any]] = lambda declared: declared,
) -> Declared:
    """Read the declaration `model` from the TOML file at `path`.

    Args:
        kind: of file, such as "Suite", for sentences.
        path: of the file; `beside` finds the files that it names.
        model: of the whole file.
        in_full: writes out what the file abbreviates.

    Raises:
        InputError: the file cannot be read or declares something wrong.
    """
    try:
        declared = in_full(tomllib.loads(_text(kind, path)))
        # Read as JSON, so that numbers written as text are refused but lists can be tuples. No
        # field holds a date of TOML, but many hold text.
        content = json.dumps(declared, default=lambda value: {"date": str(value)})
    except InputError:  # a ValueError, too
        raise
    except OSError as error:
        raise InputError(
            f"Cannot read the {kind.lower()} file {path}: {error.strerror}."
        ) from error
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{kind} file {path} is not valid TOML: {error}.") from error
    except (ValueError, RecursionError) as error:
        raise InputError(
            f"Cannot read the {kind.lower()} file {path}: it is not UTF-8 text, a number is too "
            "long, or tables lie too deep in one another."
        ) from error
    try:
        return model.model_validate_json(content, strict=True, context={"folder": path.parent})
    except ValidationError as error:
        errors = error.errors(include_url=False)
        # A misspelt field explains why another is missing.
        first = next((e for e in errors if e["type"] == "extra_forbidden"), errors[0])
        loc = (*first["loc"], "kind") if first["type"].startswith("union_tag") else first["loc"]
        key, section = _declared_key(loc, declared)
        raise field_error(kind, path, key, _problem(dict(first), model), section) from error


def _text(kind: str, path: Path) -> str:
    """The text of the TOML file at `path`, unless it would take forever to parse."""
    check_regular(path)
    with path.open("rb") as file:
        content = file.read(MAX_BYTES + 1)
    if len(content) > MAX_BYTES:
        raise InputError(f"{kind} file {path} is larger than 200 kB: declare less in it.")
    text = content.decode("utf-8-sig")
    if _DEEP_KEY.search(text):
        raise InputError(f"{kind} file {path} has a key of more than {MAX_PARTS} parts.")
    return text


def beside(path: str, info: ValidationInfo) -> str:
    """The absolute path of a file that a declaration names, relative to its own folder."""
    folder = (info.context or {}).get("folder", Path())
    return str(Path(folder, Path(path).expanduser()).resolve())


def _problem(error: Mapping[str, Any], model: type[Declaration]) -> str:
    """Sentence of one validation `error`."""
    if error["type"] == "missing":
        return "it is missing."
    if error["type"] == "extra_forbidden":
        schema = model.model_json_schema()
        tables = (schema, *schema.get("$defs", {}).values())
        fields = sorted({field for table in tables for field in table.get("properties", {})})
        given = str(error["loc"][-1])
        if given in fields:
            return "it does not belong here, but in another table."
        near = difflib.get_close_matches(given, fields, n=1)
        return f"unknown field, the nearest is {near[0]!r}." if near else "unknown field."
    if error["type"] in ("list_type", "tuple_type"):
        return "it is a list, in square brackets."
    if error["type"] == "too_short" and not error["ctx"]["actual_length"]:
        return "it is empty."
    if error["type"].startswith("union_tag"):
        return f"it is {', '.join(map(repr, TAGS[:-1]))} or {TAGS[-1]!r}."
    problem = str(error["msg"]).removeprefix("Value error, ").rstrip(".")
    return problem if problem.endswith("?") else f"{problem}."


def _declared_key(loc: Key, declared: Any) -> tuple[Key, str]:
    """Key of the location `loc` of an error, and the name of the table around it, if any.

    Locations also hold what a file does not: the tag of a union, and the number of a single value
    that stands for a list.
    """
    key: list[str | int] = []
    section = ""
    for k, part in enumerate(loc):
        if part in TAGS:
            continue
        try:
            declared = declared[part]
        except (KeyError, IndexError, TypeError):
            holds = list if isinstance(part, int) else dict
            if k < len(loc) - 1 or not isinstance(declared, holds):
                continue
        key.append(part)
        if k < len(loc) - 1 and isinstance(declared, dict):
            section = str(declared.get("name", section))
    return tuple(key), section
