"""Names that would lead out of a folder, or mean something to what shows them."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from tests.support.made_runs import edited_manifest

from eitbench.reports.page.report import write_report
from eitbench.reports.site.site import write_site
from eitbench.scenarios.data.datasets import Dataset

MATHS = r"a$\frac{$b^{_"


@pytest.fixture
def hostile(build: Any, dataset_of: Callable[..., Dataset]) -> Callable[..., Path]:
    """A run whose suite, scenario, method and version have these names."""

    def made(suite: str, scenario: str, method: str, version: str) -> Path:
        build.add_scaled(dataset_of("conductivity", 12), {method: 0.9, "plain": 0.5})
        run: Path = build.write()
        for file in ("samples.parquet", "methods.parquet"):
            table = pd.read_parquet(run / file)
            table["scenario"] = scenario
            table.assign(suite=suite).to_parquet(run / file)
        with edited_manifest(run) as manifest:
            manifest["plan"]["suite"]["name"] = suite
            manifest["versions"] = {"eitbench": version}
            manifest["data"] = {scenario: manifest["data"].popitem()[1]}
        return run

    return made


@pytest.mark.slow
@pytest.mark.parametrize(
    ("suite", "name", "version"),
    [
        ("index", "m", ".."),
        ("..", "..", "../.."),
        ("/etc/up", "../../up", "/"),
        ("s", "x" * 80, ""),
        ("s", "é" * 40, "1" * 150),
        ("con", "PLAIN", "nul"),
    ],
)
def test_a_site_stays_in_its_folder(
    hostile: Callable[..., Path], tmp_path: Path, suite: str, name: str, version: str
) -> None:
    run, out = hostile(suite, name, name, version), tmp_path / "deep" / "site"
    written = write_site(run.parent, out).pages
    assert all(path.resolve().is_relative_to(out.resolve()) for path in written)
    assert len({path.resolve() for path in written}) == len(written)
    assert {path.name for path in tmp_path.iterdir()} == {"deep", "run"}
    assert {path.name for path in out.parent.iterdir()} <= {"site"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "version", "why"),
    [("x" * 260, "1", "a name of more than 80 bytes"), ("s", "1" * 5000, "versions.eitbench"),
     ("s", "\ud800", "surrogates")],
)  # fmt: skip
def test_one_run_does_not_take_a_site_down(
    hostile: Callable[..., Path], tmp_path: Path, name: str, version: str, why: str
) -> None:
    runs = tmp_path / "runs"
    shutil.copytree(sound := hostile("s", "s", "m", "0.1.0"), runs / "sound")
    spoilt = shutil.copytree(sound, runs / "spoilt")
    for file in ("samples.parquet", "methods.parquet"):
        pd.read_parquet(spoilt / file).replace("m", name).to_parquet(spoilt / file)
    with edited_manifest(spoilt) as manifest:
        manifest["versions"] = {"eitbench": version}
    index = write_site(runs, tmp_path / "site").pages[0].read_text()
    assert "spoilt is left out" in index
    assert why in index
    assert "suites/s.html" in index


@pytest.mark.slow
@pytest.mark.parametrize("name", ["../../up", MATHS])
def test_a_report_stays_in_its_folder(
    hostile: Callable[..., Path], tmp_path: Path, name: str
) -> None:
    out = tmp_path / "deep" / "report"
    written, _ = write_report([hostile(name, name, name, "1")], out)
    assert all(path.resolve().is_relative_to(out.resolve()) for path in written)
    assert {path.name for path in tmp_path.iterdir()} == {"deep", "run"}
    assert {path.name for path in out.parent.iterdir()} == {"report"}
