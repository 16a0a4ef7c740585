"""Answers of workers as bytes: JSON and arrays of numbers, so that scored code can send data only.

A message is a JSON header, then the content of its arrays one after the other, in pieces: each is
read into its array at once, so that many megabytes are never copied as a whole. Whoever reads it
checks it again: the process that sent it runs somebody else's code.
"""

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

Status = Literal["ok", "error", "timeout", "invalid-output", "out-of-memory"]

MAX_TEXT = 500  # characters
MAX_TRACE = 2000  # characters
MAX_HEADER = 2**16  # bytes
MAX_ARRAYS = 2**28  # bytes: 32 images of the largest sensor, twice
LARGEST = 1e9  # seconds, MiB
# Kinds of failures that asking again sample by sample would not mend.
BROKEN_CONTRACT = frozenset({"shape", "dtype", "mutated"})
PIECE = 2**17  # bytes of an array that are sent at once, which stay in the cache
_ARRAY = "array of the message"
_NO_ANSWER = "its process sent something that is no answer"


@dataclass(frozen=True)
class Failure:
    """Reason why a method or operator gave no result.

    Attributes:
        message: a sentence for people.
        kinds: for programs: class names of the exception, or one of `BROKEN_CONTRACT`.
        trace: where scored code raised it, as lines of a traceback; "" where it raised nothing.
    """

    status: Status
    message: str
    kinds: tuple[str, ...] = ()
    trace: str = ""


@dataclass(frozen=True, eq=False)
class Reply:
    """Answer of a worker.

    Attributes:
        value: the result: an array of float32, float64 or uint64, text, a number, None, or lists
            and dictionaries of these. `parsed` makes a value of a declared type of it.
        seconds: time in the method or operator alone.
        failure: set where it gave no result.
        memory_mb: peak resident memory of the worker so far [MiB].
    """

    value: Any
    seconds: float
    failure: Failure | None = None
    memory_mb: float = float("nan")


class WorkerLostError(Exception):
    """The worker is gone: past its limit, dead, stopped, or sending nonsense."""

    def __init__(self, failure: Failure) -> None:
        super().__init__(failure.message)
        self.failure = failure


def no_answer(what: str) -> WorkerLostError:
    """Return the error of a worker that sent nonsense while it was doing `what`."""
    return WorkerLostError(Failure("error", f"{_NO_ANSWER} during {what}"))


def plain_text(text: str) -> str:
    """Return `text` without lone surrogates, which no file takes, and not longer than others."""
    plain = text[: MAX_TEXT + 1].encode(errors="backslashreplace").decode()
    return plain if len(plain) <= MAX_TEXT else plain[: MAX_TEXT - 1] + "…"


def plain_trace(text: str) -> str:
    """Return the lines of a traceback as `plain_text` does a line, its middle left out if long."""
    printable = "\n".join(
        "".join(c if c.isprintable() else "?" for c in line) for line in text.splitlines()
    )
    plain = printable.encode(errors="backslashreplace").decode()
    half = MAX_TRACE // 2 - 1
    return plain if len(plain) <= MAX_TRACE else f"{plain[:half]}\n…{plain[-half:]}"


def _cost(given: float) -> float:
    return given if 0 <= given <= LARGEST else math.nan


Cost = Annotated[float, AfterValidator(_cost)]
"""Seconds or MiB; NaN where it is not known, or cannot be."""
Seconds = Annotated[float, Field(ge=0, le=LARGEST, allow_inf_nan=False)]


def parsed(kind: TypeAdapter[Any], value: object, what: str) -> Any:
    """Return the answer `value` as the type that `kind` declares.

    Raises:
        WorkerLostError: it is none; `what` was asked for is said.
    """
    try:
        return kind.validate_python(value)
    except (ValidationError, RecursionError) as error:
        raise no_answer(what) from error


def array_in(value: object, dtype: type, shape: tuple[int, ...], what: str) -> NDArray[Any]:
    """Return the answer `value`, an array of that type and shape.

    Raises:
        WorkerLostError: it is none; `what` was asked for is said.
    """
    if not (isinstance(value, np.ndarray) and value.dtype == dtype and value.shape == shape):
        raise no_answer(what)
    return value


class _Array(BaseModel):
    dtype: Literal["<f4", "<f8", "<u8"]
    shape: list[Annotated[int, Field(ge=0, le=2**40)]] = Field(max_length=8)


class _Failure(BaseModel):
    status: Status
    message: str
    kinds: list[str]
    trace: str


class _Header(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid")

    value: Any
    seconds: Seconds
    failure: _Failure | None
    memory_mb: Cost
    arrays: list[_Array]


def encode(reply: Reply) -> list[bytes | memoryview]:
    """Return the pieces of the message of `reply`, its texts shortened; objects become their texts.

    Raises:
        ValueError: it is larger than a message may be.
    """
    arrays: list[NDArray[Any]] = []
    failure = reply.failure
    header = {
        "value": _plain(reply.value, arrays),
        "seconds": reply.seconds,
        "failure": failure and _plain(vars(failure), []) | {"trace": plain_trace(failure.trace)},
        "memory_mb": reply.memory_mb,
        "arrays": [{"dtype": array.dtype.str, "shape": array.shape} for array in arrays],
    }
    text = json.dumps(header).encode()
    if len(text) > MAX_HEADER:
        raise ValueError(f"its answer holds more than {MAX_HEADER:,} bytes of text")
    if sum(array.nbytes for array in arrays) > MAX_ARRAYS:
        raise ValueError(f"its answer holds more than {MAX_ARRAYS:,} bytes of numbers")
    return [text, *(piece for array in arrays for piece in _pieces(array))]


def decode(receive: Callable[[int], bytes]) -> Reply:
    """Return the reply of the next message; its arrays may be written to.

    Args:
        receive: gives the next piece, of at most so many bytes.

    Raises:
        ValueError: it is none.
    """
    try:
        header = _Header.model_validate(json.loads(receive(MAX_HEADER)))
        shapes = [(np.dtype(of.dtype), tuple(of.shape)) for of in header.arrays]
        if sum(dtype.itemsize * math.prod(shape) for dtype, shape in shapes) > MAX_ARRAYS:
            raise ValueError("no message: its arrays are larger than they may be")
        arrays = [np.empty(shape, dtype) for dtype, shape in shapes]
        value = _with_arrays(_plain(header.value, []), arrays)
    except RecursionError as error:
        raise ValueError("no message: it is nested too deeply") from error
    for array in arrays:
        left = _bytes_of(array)
        while len(left):
            piece = receive(PIECE)
            if not 0 < len(piece) <= len(left):
                raise ValueError("no message: what it holds is not as long as it says")
            left[: len(piece)] = piece
            left = left[len(piece) :]
    if (lost := header.failure) is None:
        return Reply(value, header.seconds, None, header.memory_mb)
    kinds = tuple(map(plain_text, lost.kinds))
    failure = Failure(lost.status, plain_text(lost.message), kinds, plain_trace(lost.trace))
    return Reply(None, header.seconds, failure, header.memory_mb)


def _pieces(array: NDArray[Any]) -> list[memoryview]:
    whole = _bytes_of(np.ascontiguousarray(array))
    return [whole[start : start + PIECE] for start in range(0, len(whole), PIECE)]


def _bytes_of(array: NDArray[Any]) -> memoryview:
    return array.reshape(-1).view(np.uint8).data


def _plain(value: object, arrays: list[NDArray[Any]]) -> Any:
    """Return `value` as JSON; its arrays are added to `arrays`."""
    if isinstance(value, np.ndarray):
        arrays.append(value)
        return {_ARRAY: len(arrays) - 1}
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, Mapping):
        return {plain_text(str(name)): _plain(part, arrays) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part, arrays) for part in value]
    if value is None or isinstance(value, bool | int | float):
        return value
    return plain_text(str(value))


def _with_arrays(value: Any, arrays: list[NDArray[Any]]) -> Any:
    """Return `value` with the arrays that it names."""
    if isinstance(value, dict):
        number = value.get(_ARRAY)
        if type(number) is int and 0 <= number < len(arrays):
            return arrays[number]
        return {name: _with_arrays(part, arrays) for name, part in value.items()}
    if isinstance(value, list):
        return [_with_arrays(part, arrays) for part in value]
    return value
