"""Classical reconstruction: linear one-step methods, total variation, Gauss-Newton."""

from eitbench.methods.classical.back_projection import BackProjection
from eitbench.methods.classical.gauss_newton import GaussNewton, GaussNewtonNoser, GaussNewtonTV
from eitbench.methods.classical.greit import Greit
from eitbench.methods.classical.laplacian import Laplacian
from eitbench.methods.classical.noser import Noser
from eitbench.methods.classical.one_step import OneStep
from eitbench.methods.classical.tikhonov import Tikhonov
from eitbench.methods.classical.total_variation import TotalVariation

__all__ = [
    "BackProjection",
    "GaussNewton",
    "GaussNewtonNoser",
    "GaussNewtonTV",
    "Greit",
    "Laplacian",
    "Noser",
    "OneStep",
    "Tikhonov",
    "TotalVariation",
]
