"""Every row of the threat model has tests that exist."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_every_threat_has_a_test() -> None:
    text = (ROOT / "docs" / "security.md").read_text()
    model = text[text.index("## Threat model") : text.index("## A plugin")]
    rows = re.findall(r"^\| (\d+) \|", model, re.MULTILINE)
    proofs = re.findall(r"^(\d+)\. (.+)$", model, re.MULTILINE)
    assert len(rows) > 15
    assert [number for number, _ in proofs] == rows
    for _, proof in proofs:
        files = re.findall(r"`(test_\w+\.py)`", proof)
        assert files
        sources = [path.read_text() for file in files for path in (ROOT / "tests").rglob(file)]
        assert len(sources) >= len(files)
        for function in re.findall(r"`(test_\w+)`", proof):
            assert any(f"def {function}(" in source for source in sources), function
