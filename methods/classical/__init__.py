"""Classical reconstruction: linear one-step methods, total variation, Gauss-Newton."""

from eitbench.methods.classical.gauss_newton import GaussNewton
from eitbench.methods.classical.noser import Noser
from eitbench.methods.classical.one_step import OneStep

__all__ = ["GaussNewton", "Noser", "OneStep"]
