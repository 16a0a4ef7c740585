"""Descriptions of classes, for listings."""

import inspect


def first_line(cls: type) -> str:
    """Return the first line of the docstring of a class; "" without one."""
    return (inspect.getdoc(cls) or "").partition("\n")[0]
