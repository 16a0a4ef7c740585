"""Descriptions of classes and functions, for listings."""

import inspect


def first_line(described: object) -> str:
    """Return the first line of the docstring of a class or function; "" without one."""
    return (inspect.getdoc(described) or "").partition("\n")[0]
