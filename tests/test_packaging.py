"""The layout: folders, links and wheel mapping agree, and rooms import only what they may."""

import ast
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
ROOMS = {
    "scenarios": set(),
    "methods": {"scenarios"},
    "benchmark": {"scenarios", "methods"},
    "hardware": {"scenarios", "methods"},
    "reports": {"benchmark"},
}


def test_links_lead_to_the_rooms() -> None:
    links = {p.name: p for p in (ROOT / "src/eitbench").iterdir() if p.is_symlink()}
    assert set(links) == set(ROOMS)
    for name, link in links.items():
        assert link.readlink() == Path(f"../../{name}")


def test_wheel_and_sdist_hold_the_rooms() -> None:
    targets = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"][
        "targets"
    ]
    front_door = [
        f"src/eitbench/{p.name}" for p in sorted((ROOT / "src/eitbench").iterdir()) if p.is_file()
    ]
    assert sorted(targets["wheel"]["only-include"]) == sorted([*front_door, *ROOMS])
    assert targets["wheel"]["sources"] == {"src/eitbench": "eitbench"} | {
        room: f"eitbench/{room}" for room in ROOMS
    }
    assert sorted(targets["sdist"]["only-include"]) == sorted(
        [*front_door, *ROOMS, "examples", "tests"]
    )


@pytest.mark.parametrize("room", ROOMS)
def test_rooms_import_only_what_they_may(room: str) -> None:
    allowed = ROOMS[room] | {room}
    for file in (ROOT / room).rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom):
                names = [node.module or ""]
                if node.module == "eitbench":
                    names = [f"eitbench.{alias.name}" for alias in node.names]
            elif isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            else:
                continue
            for name in names:
                parts = name.split(".")
                if parts[0] == "eitbench" and len(parts) > 1:
                    assert parts[1] in allowed or parts[1] == "__version__", (
                        f"{file.relative_to(ROOT)} imports {name}"
                    )


def test_no_reader_can_run_what_it_reads() -> None:
    """Files we read are data: no pickle, no eval, no shell (DESIGN, trust rule 7)."""
    for room in ROOMS:
        for file in (ROOT / room).rglob("*.py"):
            text = file.read_text()
            assert "pickle" not in text.replace("allow_pickle=False", ""), file
            assert "shell=True" not in text, file
