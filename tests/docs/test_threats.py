"""Every row of the threat model names tests that exist."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_every_threat_has_a_test() -> None:
    text = (ROOT / "docs" / "security.md").read_text()
    table = text[text.index("| who |") : text.index("## A plugin")]
    rows = [line.split("|") for line in table.splitlines()[2:] if line.startswith("|")]
    assert len(rows) > 15
    for row in rows:
        named = re.findall(r"`(test_\w+\.py)::(\w+|\*)`", row[-2])
        assert named, row
        for file, function in named:
            found = [path.read_text() for path in (ROOT / "tests").rglob(file)]
            assert found, file
            assert function == "*" or any(f"def {function}(" in source for source in found), (
                function
            )
