"""What people declare in suite files: frozen, and strict about what it does not know."""

from pydantic import BaseModel, ConfigDict


class Declaration(BaseModel):
    """A frozen set of declared parameters; unknown ones are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=False)
