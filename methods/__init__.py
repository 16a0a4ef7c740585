"""How it is inverted: the method interface and registry, and the methods themselves."""

from eitbench.methods.method import Method
from eitbench.methods.problem import Problem
from eitbench.methods.registry import create, load_plugin, methods, register

__all__ = ["Method", "Problem", "create", "load_plugin", "methods", "register"]
