"""Runs of the transfer question: registered outside the method, scored by the distance."""

from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
from tests.support.pressed_skin import SKIN, recording, renumbered, rows

from eitbench.benchmark import InputError
from eitbench.benchmark.analysis.leaderboard import leaderboard_rows
from eitbench.benchmark.analysis.results import read_run
from eitbench.benchmark.findings.transfer import skin_errors
from eitbench.benchmark.run.cell_task import CellPlan
from eitbench.benchmark.run.place_cell import PlaceData, register
from eitbench.benchmark.run.runner import make_plan, resume_run, start_run
from eitbench.benchmark.rundir.cells import Cell
from eitbench.benchmark.rundir.kinds import PLACE_RUNS
from eitbench.benchmark.rundir.store import RunStore
from eitbench.benchmark.workers.place_service import PlaceService
from eitbench.reports.findings.collect import write_findings
from eitbench.scenarios.suites.suite import Suite, load_suite

PLUGIN = '''
import numpy as np
from eitbench.methods import PlaceMethod, register_place_method

class Memory(PlaceMethod):
    """Places that it was told, turned, mirrored, shifted and scaled; one is lost."""

    def fit(self, problem):
        self.problem = problem
        assert not len(problem.labelled)

@register_place_method("similar")
class Similar(Memory):
    """A similarity of what a frame knows."""

    def locate(self, differences):
        x = self.problem.unit(differences)[:, :2]
        return 3 * x[:, ::-1] @ np.array([[0.6, 0.8], [-0.8, 0.6]]) + 5

@register_place_method("plain")
class Plain(Memory):
    """What a frame knows itself."""

    def locate(self, differences):
        return self.problem.unit(differences)[:, :2]

@register_place_method("lost")
class Lost(Memory):
    """No place at all."""

    def locate(self, differences):
        return np.full((len(differences), 2), np.nan)
'''


PEEKING = """
import os
from pathlib import Path
from eitbench.methods import PlaceMethod, register_place_method
from eitbench.scenarios.recordings.fetch import read_recording

class OnePlace(PlaceMethod):
    "The same place for all."

    def locate(self, differences):
        return 0 * differences[:, :2]

@register_place_method("peeks")
class Peeks(OnePlace):
    "Reads the recording that it is scored on."

    def fit(self, problem):
        Path(OWN).read_bytes()

@register_place_method("asks")
class Asks(OnePlace):
    "Lets eitbench read the recording, without its test split."

    def fit(self, problem):
        read_recording(OWN)

@register_place_method("looks-around")
class LooksAround(OnePlace):
    "Reads a public recording."

    def fit(self, problem):
        Path(os.environ["EITBENCH_DATA"], "owner", "set", "out.csv").read_bytes()

@register_place_method("simulates")
class Simulates(OnePlace):
    "Is given simulated presses, of the sensor that the recording holds."

    def fit(self, problem):
        assert len(problem.simulated(3)) == 3
"""


def suite_of(folder: Path, labelled: str) -> Suite:
    recording(folder / "skin.h5")
    path = folder / "new.toml"
    path.write_text(
        'name = "new"\ntitle = "New"\nmethods = ["one-place", "kernel-ridge"]\n'
        f'[[scenarios]]\nkind = "transfer"\nname = "skin"\nrecording = "skin.h5"\n'
        f"labelled = {labelled}\n"
    )
    return load_suite(path)


@pytest.mark.slow
def test_a_run_locates_presses_and_is_resumed(tmp_path: Path) -> None:
    run = start_run(make_plan(suite_of(tmp_path, "25")), tmp_path / "run").path
    errors = {error.method: error for error in skin_errors([read_run(run)])}
    assert skin_errors([read_run(run)] * 2) == list(errors.values())  # each skin counts once
    assert errors["kernel-ridge"].labelled == 25
    assert errors["kernel-ridge"].median_mm < 0.6 * errors["one-place"].median_mm
    samples = pd.read_parquet(run / "samples.parquet")
    guessed = samples[samples["method"] == "one-place"]
    assert guessed["found_x_m"].nunique() == guessed["found_y_m"].nunique() == 1
    places = guessed[["expected_x_m", "expected_y_m"]].to_numpy()
    away = np.linalg.norm(places - np.median(places, axis=0), axis=1)
    np.testing.assert_allclose(errors["one-place"].guess_mm, 1e3 * np.median(away))
    distance = np.hypot(
        samples["found_x_m"] - samples["expected_x_m"],
        samples["found_y_m"] - samples["expected_y_m"],
    )
    np.testing.assert_allclose(samples["localisation_mm"], 1e3 * distance)
    known = pd.read_parquet(run / "places.parquet")["prior_knowledge"]
    assert known.str.contains('"split": "labelled", "samples": 25').all()
    with h5py.File(run / "places.h5") as file:
        assert file["skin/kernel-ridge/place"].shape == (10, 2)
    assert resume_run(run).path == run
    written = {path.name: path for path in write_findings(run)}
    assert written["transfer.png"].stat().st_size > 500
    assert written["transfer.csv"].read_text().count(".h5,25,") == len(errors)


@pytest.mark.slow
def test_skins_of_ones_own_are_left_out_one_after_the_other(tmp_path: Path) -> None:
    """Electrodes of the second are numbered from another corner: places are put onto each other."""
    turned = renumbered(SKIN, (np.arange(16) + 8) % 16)
    recording(tmp_path / "First_skin.h5")
    recording(tmp_path / "second.h5", 40, turned)
    path = tmp_path / "own.toml"
    path.write_text(
        'name = "own"\ntitle = "Own skins"\nmethods = ["kernel-ridge-skins"]\n'
        '[[scenarios]]\nkind = "transfer"\nrecordings = ["First_skin.h5", "second.h5"]\n'
        "labelled = [0]\n"
    )
    plan = make_plan(load_suite(path))
    assert plan.scenarios == ("first-skin-0", "second-0")
    for found in skin_errors([read_run(start_run(plan, tmp_path / "run").path)]):
        assert found.median_mm < 0.6 * found.guess_mm


def test_places_are_registered_outside_the_method(tmp_path: Path) -> None:
    """A method that says a similarity of a place is as good as one that says the place."""
    plugin = tmp_path / "similar.py"
    plugin.write_text(PLUGIN)
    plan = make_plan(
        suite_of(tmp_path, "0"), methods=["one-place", "lost", "plain", "similar"], plugins=[plugin]
    )
    run = start_run(plan, tmp_path / "run").path
    samples = pd.read_parquet(run / "samples.parquet").set_index("method")
    places = PlaceData.load(
        plan.suite.scenarios[0], plan.suite, None, jobs=1, progress=False
    ).transfer.registration.places
    found = samples.loc["one-place", ["found_x_m", "found_y_m"]].to_numpy()
    np.testing.assert_allclose(found, np.tile(np.median(places, axis=0), (10, 1)))
    away = {name: of["localisation_mm"].to_numpy() for name, of in samples.groupby("method")}
    np.testing.assert_allclose(away["similar"], away["plain"], rtol=1e-6)
    assert np.ptp(away["plain"]) > 1  # they are found, not placed in the middle
    lost = samples.loc["lost"]
    assert (lost["status"] == "invalid-output").all()
    np.testing.assert_allclose(lost["localisation_mm"], 1e3 * np.hypot(0.1, 0.08), rtol=0.01)


@pytest.mark.slow
def test_a_method_that_reads_recordings_itself_is_marked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    public = tmp_path / "public" / "owner" / "set" / "out.csv"
    public.parent.mkdir(parents=True)
    public.write_text("1,2,3")
    monkeypatch.setenv("EITBENCH_DATA", str(tmp_path / "public"))
    suite = suite_of(tmp_path, "0")
    plugin = tmp_path / "peeking.py"
    plugin.write_text(f"OWN = {str(tmp_path / 'skin.h5')!r}\n{PEEKING}")
    names = ["peeks", "asks", "looks-around", "simulates"]
    run = start_run(make_plan(suite, methods=names, plugins=[plugin]), tmp_path / "run").path
    marked = {row["method"]: row["actions"] for row in leaderboard_rows([read_run(run)])}
    own = f"asked for test data (open of {tmp_path / 'skin.h5'})"
    assert marked == {
        "peeks": own,
        "asks": own,
        "looks-around": f"asked for test data (open of {public})",
        "simulates": "",
    }


def test_an_isolated_method_of_places_reads_no_public_recordings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EITBENCH_DATA", str(tmp_path / "public"))
    suite = suite_of(tmp_path, "0")
    data = PlaceData.load(suite.scenarios[0], suite, None, jobs=1, progress=False)
    cell = CellPlan(Cell("skin", "one-place"), "default", {}, {}, suite, None, 128)
    task = data.task(cell, RunStore.create(tmp_path / "run", PLACE_RUNS))
    assert task.readable == (tmp_path / "skin.h5",)


def test_the_similarity_of_a_method_costs_nothing() -> None:
    rng = np.random.default_rng(0)
    places = rng.uniform(-0.04, 0.04, (25, 2))
    found = 3 * places[:, ::-1] @ np.array([[0.6, 0.8], [-0.8, 0.6]]) + 5
    np.testing.assert_allclose(register(found, places)(found), places, atol=1e-9)


def test_no_worker_is_sent_what_it_is_scored_on(tmp_path: Path) -> None:
    suite = suite_of(tmp_path, "0")
    data = PlaceData.load(suite.scenarios[0], suite, None, jobs=1, progress=False)
    cell = CellPlan(Cell("skin", "one-place"), "default", {}, {}, suite, None, 128)
    task = data.task(cell, RunStore.create(tmp_path / "run", PLACE_RUNS))
    service = task.service()
    assert isinstance(service, PlaceService)
    given = service.given
    assert (len(given.labelled), given.others) == (0, {})
    assert not rows(given.unlabelled) & rows(data.differences("test"))
    # It holds nothing else of the data.
    assert {type(value).__name__ for value in vars(service).values()} <= {
        "Learnable", "str", "dict", "partial", "NoneType"
    }  # fmt: skip


def test_methods_that_no_suite_of_places_has_are_refused(tmp_path: Path) -> None:
    suite = suite_of(tmp_path, "0")
    with pytest.raises(InputError, match="ranks places: choose among them with --methods"):
        make_plan(suite, operators=["fem"])
    with pytest.raises(InputError, match="ranks places, which have no tracks"):
        make_plan(suite, tracks=["default"])
    with pytest.raises(InputError, match=r"Unknown method .*kernel-ridge"):
        make_plan(suite, methods=["kernel-rigde"])
    assert make_plan(suite, methods=["noser"]).names == ("noser",)


def test_a_method_of_places_is_sent_to_a_suite_that_ranks_it() -> None:
    with pytest.raises(InputError, match=r"'kernel-ridge' says places .* new-skin"):
        make_plan(load_suite("quick"), methods=["kernel-ridge"])
