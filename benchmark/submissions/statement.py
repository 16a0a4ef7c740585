"""The statement of who submits a run: `submission.json`, filled in by its author, read as data."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

from packaging.licenses import InvalidLicenseExpression, canonicalize_license_expression
from pydantic import AfterValidator, Field, StringConstraints, ValidationError

from eitbench.benchmark.rundir.folder import read_json_file
from eitbench.benchmark.rundir.manifest import first_problem
from eitbench.scenarios.declaration import Declaration
from eitbench.scenarios.errors import DataCorruptError

STATEMENT = "submission.json"


def _visible(text: str) -> str:
    # Printed in terminals and on pages, where such characters move the cursor or turn text around.
    for character in text:
        if unicodedata.category(character) in ("Cc", "Cf", "Zl", "Zp"):
            raise ValueError(
                f"it holds the invisible character U+{ord(character):04X}, leave it out"
            )
    return text


def _address(text: str) -> str:
    if marks := [mark for mark in "\"'<>" if mark in text]:
        raise ValueError(f"an address has no {marks[0]}, leave it out")
    return text


def _of_form(pattern: str, form: str) -> Callable[[str], str]:
    """A validator of texts that are empty or match the whole `pattern`, `form` in words."""

    def check(text: str) -> str:
        if text and not re.fullmatch(pattern, text):
            raise ValueError(f"it has to be {form}")
        return text

    return check


def _licence(text: str) -> str:
    try:
        return canonicalize_license_expression(text) if text else text
    except InvalidLicenseExpression as error:
        raise ValueError(
            "it has to be an SPDX expression, such as MIT or LicenseRef-Mine"
        ) from error


_Line = Annotated[str, StringConstraints(max_length=200), AfterValidator(_visible)]
_Text = Annotated[str, StringConstraints(max_length=2000), AfterValidator(_visible)]
_Address = Annotated[_Line, AfterValidator(_address)]
_Code = Annotated[
    _Address,
    AfterValidator(
        _of_form(r"https://\S+", "an address that begins with https://, without spaces")
    ),
]
_Commit = Annotated[
    str,
    AfterValidator(
        _of_form(
            r"[0-9a-f]{40}([0-9a-f]{24})?",
            "a git commit of 40 or 64 hex digits, or empty beside a 'container'",
        )
    ),
]
_Container = Annotated[
    str,
    StringConstraints(max_length=300),
    AfterValidator(
        _of_form(
            r"[a-z0-9./:_-]+@sha256:[0-9a-f]{64}",
            "an image by its digest (NAME@sha256:DIGEST), or empty beside a 'commit'",
        )
    ),
]


class Statement(Declaration):
    """What the author of a submission says; nothing of it can be checked but its form.

    Attributes:
        name: of the submission, as a reader cites it.
        authors: their names.
        contact: an address that is answered.
        code: https address of the code.
        commit: its git commit, 40 or 64 hex digits; "" where a `container` is given.
        container: image by digest, such as "ghcr.io/me/mine@sha256:..."; "" with a `commit`.
        licence: of the code, such as "MIT" (SPDX).
        training_data: all that was trained, fitted or tuned on, in a few sentences, with hashes
            where there are.
        test_split_seen: true if any of it touches the test split of the suite; None until answered.
    """

    name: _Line = ""
    authors: Annotated[tuple[_Line, ...], Field(max_length=50)] = ()
    contact: _Address = ""
    code: _Code = ""
    commit: _Commit = ""
    container: _Container = ""
    licence: Annotated[_Line, AfterValidator(_licence)] = ""
    training_data: _Text = ""
    test_split_seen: bool | None = None


def read_statement(folder: Path) -> Statement:
    """Read the statement of the submission in `folder`.

    Raises:
        DataCorruptError: it is not there, or not of this form.
    """
    path = folder / STATEMENT
    try:
        return Statement.model_validate_json(read_json_file(path), strict=True)
    except ValidationError as error:
        where, reason = first_problem(error)
        raise DataCorruptError(f"{path}: {where or 'all of it'}: {reason}.") from error
    except (OSError, ValueError, RecursionError) as error:
        raise DataCorruptError(f"{path} cannot be read ({type(error).__name__}).") from error


def unfilled(statement: Statement) -> str:
    """What the statement does not say yet, as a sentence; "" if it is complete."""
    for field in ("name", "authors", "contact", "code", "licence", "training_data"):
        value = getattr(statement, field)
        if not (value.strip() if isinstance(value, str) else any(map(str.strip, value))):
            return f"{STATEMENT} does not say {field!r}: fill it in."
    if not (statement.commit or statement.container):
        return (
            f"{STATEMENT} names neither a 'commit' nor a 'container' by its digest: without one "
            "nobody can make the images again."
        )
    if statement.test_split_seen is None:
        return f"{STATEMENT} does not say 'test_split_seen': answer true or false."
    if statement.test_split_seen:
        return "Its author says that test data were learned from: it is not ranked."
    return ""
