"""Requests of a page: small JSON messages; everything else is refused."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from eitbench.scenarios.errors import InputError

MAX_BYTES = 4096


class _PageRequest(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class Painted(_PageRequest):
    """A live image is on the canvas."""

    do: Literal["painted"]
    number: int


class ChooseMethod(_PageRequest):
    """Use another method."""

    do: Literal["method"]
    name: Annotated[str, Field(max_length=80)]


class TakeReference(_PageRequest):
    """Take the next frames as reference frames."""

    do: Literal["reference"]


class Record(_PageRequest):
    """Begin or end a recording."""

    do: Literal["record"]
    on: bool


class Press(_PageRequest):
    """Press an emulated sensor at a place [m]; say where a real one is touched."""

    do: Literal["touch"]
    x_m: Annotated[float, Field(ge=-10, le=10)]
    y_m: Annotated[float, Field(ge=-10, le=10)]
    radius_m: Annotated[float, Field(gt=0, le=1)]
    pressure_pa: Annotated[float, Field(gt=0, le=1e6)] | None = None


class Release(_PageRequest):
    """End the touch."""

    do: Literal["release"]


PageRequest = Painted | ChooseMethod | TakeReference | Record | Press | Release
_ANY: TypeAdapter[PageRequest] = TypeAdapter(Annotated[PageRequest, Field(discriminator="do")])


def read_request(text: str) -> PageRequest:
    """Return the request in a message.

    Raises:
        InputError: it holds no request.
    """
    try:
        return _ANY.validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False, include_context=False)[0]
        raise InputError(f"This is no request of the live view: {first['msg']}.") from error
