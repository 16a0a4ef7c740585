"""Reconstruction methods and forward operators: their interfaces and registries."""

from eitbench.methods.method import Method
from eitbench.methods.operator import Operator
from eitbench.methods.place_method import PlaceMethod, PlaceProblem
from eitbench.methods.problem import Problem
from eitbench.methods.registry import (
    create,
    load_plugin,
    methods,
    operator,
    register,
    register_operator,
    register_place_method,
)

__all__ = [
    "Method",
    "Operator",
    "PlaceMethod",
    "PlaceProblem",
    "Problem",
    "create",
    "load_plugin",
    "methods",
    "operator",
    "register",
    "register_operator",
    "register_place_method",
]
