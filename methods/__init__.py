"""Reconstruction methods and forward operators: their interfaces and registries."""

from eitbench.methods.method import Method
from eitbench.methods.operator import Operator
from eitbench.methods.problem import Problem
from eitbench.methods.registry import (
    create,
    load_plugin,
    methods,
    operator,
    register,
    register_operator,
)

__all__ = [
    "Method",
    "Operator",
    "Problem",
    "create",
    "load_plugin",
    "methods",
    "operator",
    "register",
    "register_operator",
]
