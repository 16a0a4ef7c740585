"""Errors for the user: one sentence each, with the mistake and the remedy."""

import difflib
from collections.abc import Iterable


class EitbenchError(Exception):
    """Base of every error the command line prints as one sentence, without a traceback."""

    exit_code = 1


class InputError(EitbenchError, ValueError):
    """An input that cannot be used: a name, a file, an array, an option."""

    exit_code = 2


class DataUnavailableError(EitbenchError):
    """Recorded data that is not on this machine and could not be downloaded."""


class UnreadableError(InputError, DataUnavailableError):
    """A file that the user named is not there, may not be read, or is of another kind."""


class DataCorruptError(EitbenchError):
    """A file whose content does not match its checksum or format."""


def counted(n: int, what: str, several: str = "") -> str:
    """A number of things for a sentence: "1 frame", "2 frames", "2 touches" (`several`)."""
    return f"{n} {what}" if n == 1 else f"{n} {several or what + 's'}"


def unknown_name(kind: str, name: str, known: Iterable[str]) -> InputError:
    """The error for an unknown `name`, suggesting the nearest of the `known` ones."""
    names = sorted(known)
    near = difflib.get_close_matches(name, names, n=1)
    hint = f"did you mean {near[0]!r}?" if near else f"known: {', '.join(names) or 'none'}."
    return InputError(f"Unknown {kind} {name!r}: {hint}")
