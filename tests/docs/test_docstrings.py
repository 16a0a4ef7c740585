"""Docstrings of the reference pages name arguments that there are.

The builder of the documentation refuses others, and is no part of the default tests.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SHOWN = re.compile(r"^::: eitbench\.([\w.]+)", re.MULTILINE)
ENTRY = re.compile(r"^    (\S.*?):(?: |$)", re.MULTILINE)


def documented() -> set[Path]:
    """The modules that objects of the reference pages are in."""
    pages = (ROOT / "docs" / "reference").glob("*.md")
    names = [name for page in pages for name in SHOWN.findall(page.read_text())]
    files = [ROOT / f"{name.replace('.', '/')}.py" for name in names]
    return {path if path.is_file() else path.parent.with_suffix(".py") for path in files}


def unknown(tree: ast.AST) -> Iterator[str]:
    """What a docstring calls an argument and its function does not have."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        _, _, said = (ast.get_docstring(node) or "").partition("\nArgs:\n")
        section = re.split(r"^\S", said, maxsplit=1, flags=re.MULTILINE)[0]
        known = {arg.arg for arg in ast.walk(node.args) if isinstance(arg, ast.arg)}
        yield from (f"{node.name}: {name}" for name in ENTRY.findall(section) if name not in known)


def test_docstrings_name_arguments_that_there_are() -> None:
    modules = documented()
    assert len(modules) > 25
    assert [name for path in modules for name in unknown(ast.parse(path.read_text()))] == []


@pytest.mark.parametrize("name", ["first, second", "third"])
def test_an_argument_that_is_not_there_is_found(name: str) -> None:
    text = f"def f(first, second):\n    '''Do it.\n\n    Args:\n        {name}: a number.\n    '''"
    assert list(unknown(ast.parse(text))) == [f"f: {name}"]
