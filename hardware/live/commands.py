"""What a page may ask for: small JSON messages; everything else is refused."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from eitbench.scenarios.errors import InputError

MAX_BYTES = 4096


class _Command(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class Painted(_Command):
    """A picture is on the canvas."""

    do: Literal["painted"]
    picture: int


class ChooseMethod(_Command):
    """Use another method."""

    do: Literal["method"]
    name: Annotated[str, Field(max_length=80)]


class TakeReference(_Command):
    """Take the next frames as the untouched sensor."""

    do: Literal["reference"]


class Record(_Command):
    """Begin or end a recording."""

    do: Literal["record"]
    on: bool


class Press(_Command):
    """Press an emulated sensor at a place [m]; say where a real one is touched."""

    do: Literal["touch"]
    x_m: Annotated[float, Field(ge=-10, le=10)]
    y_m: Annotated[float, Field(ge=-10, le=10)]
    radius_m: Annotated[float, Field(gt=0, le=1)]
    pressure_pa: Annotated[float, Field(gt=0, le=1e6)] | None = None


class Release(_Command):
    """Let go of it; the touch is over."""

    do: Literal["release"]


Command = Painted | ChooseMethod | TakeReference | Record | Press | Release
_ANY: TypeAdapter[Command] = TypeAdapter(Annotated[Command, Field(discriminator="do")])


def read_command(text: str) -> Command:
    """The command in a message.

    Raises:
        InputError: it is none.
    """
    try:
        return _ANY.validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False, include_context=False)[0]
        raise InputError(f"This is no command of the live view: {first['msg']}.") from error
