"""Losses of images."""

from __future__ import annotations

from typing import TYPE_CHECKING

from eitbench.scenarios.errors import unknown_name

if TYPE_CHECKING:
    from collections.abc import Callable

    from torch import Tensor

SMALLEST_MSE = 1e-5
"""Added before the logarithm, so that the untouched sensor does not decide the mean."""


def _mse(error: Tensor) -> Tensor:
    return error.square().mean()


def _log_mse(error: Tensor) -> Tensor:
    return (error.square().mean((-2, -1)) + SMALLEST_MSE).log().mean()


LOSSES: dict[str, Callable[[Tensor], Tensor]] = {"mse": _mse, "log-mse": _log_mse}


def image_loss(name: str) -> Callable[[Tensor], Tensor]:
    """The loss () of errors (n, H, W), images minus truth, relative to the background.

    "mse" is their mean square; "log-mse" is the mean over images of log(mean square + 1e-5). The
    mean PSNR of a set is, but for that constant, linear in the second one.

    Raises:
        InputError: an unknown name.
    """
    if name not in LOSSES:
        raise unknown_name("loss", name, LOSSES)
    return LOSSES[name]
