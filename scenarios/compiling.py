"""Compiling loops to machine code."""

from collections.abc import Callable
from contextlib import suppress
from typing import TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., object])


def compiled(function: Function) -> Function:
    """Return `function` compiled at its first call; the machine code is stored on disk."""
    # Sums may be taken in another order, or they would not be vectorised.
    fast = {"contract", "reassoc"}
    machine_code = numba.njit(nogil=True, error_model="numpy", fastmath=fast)(function)
    # Where neither the package's folder nor the user's is writable, every process compiles anew.
    with suppress(RuntimeError):
        machine_code.enable_caching()
    return cast("Function", machine_code)
