"""The version, which stands in three files."""

import tomllib

from tests.support.source_files import ROOT

import eitbench


def test_the_version_is_the_same_wherever_it_stands() -> None:
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    cited = (ROOT / "CITATION.cff").read_text()
    assert eitbench.__version__ == declared
    assert f"\nversion: {declared}\n" in cited
