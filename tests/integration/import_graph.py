"""Imports between the subpackages, lowest first; exits with 1 where they form a cycle.

`python -m tests.integration.import_graph` prints a line for each subpackage: its name, then those
that it imports. Modules that lie beside the subpackages of a folder count as subpackages.
"""

import ast
import sys
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

from tests.support.source_files import source_files

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("scenarios", "methods", "benchmark", "hardware", "reports")


def imported_names(file: Path) -> Iterator[str]:
    """Dotted names of the modules and objects of eitbench that a file imports."""
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "eitbench":
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (a.name for a in node.names if a.name.split(".")[0] == "eitbench")


def subpackage(parts: tuple[str, ...]) -> str:
    """The subpackage that a dotted name, without `eitbench`, belongs to; else its folder."""
    there = ROOT.joinpath(*parts[:2])
    inside = len(parts) > 1 and (there.is_dir() or there.with_suffix(".py").is_file())
    return "/".join(parts[:2] if inside else parts[:1])


def import_graph() -> dict[str, set[str]]:
    """For each subpackage those that it imports."""
    graph: dict[str, set[str]] = {}
    for folder in FOLDERS:
        for file in source_files(folder):
            parts = file.relative_to(ROOT).with_suffix("").parts
            node = subpackage(parts[:-1] if parts[-1] == "__init__" else parts)
            imports = graph.setdefault(node, set())
            for name in imported_names(file):
                _, *rest = name.split(".")
                if rest and rest[0] in FOLDERS:
                    imports.add(subpackage(tuple(rest)))
            imports.discard(node)
    return graph


def main() -> int:
    """Print the graph."""
    graph = import_graph()
    try:
        order = list(TopologicalSorter(graph).static_order())
    except CycleError as error:
        print("cycle:", " <- ".join(error.args[1]))
        return 1
    for node in order:
        print(f"{node}: {', '.join(sorted(graph[node], key=order.index)) or '-'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
