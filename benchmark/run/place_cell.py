"""Methods of places in the cells of a run: asked where presses are, and scored by the distance.

Without labelled presses of the skin, the similarity from a method's places to the robot's
coordinates is fitted here, to presses whose places no worker is ever sent.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.benchmark.metrics.specs import METRIC_COLUMNS
from eitbench.benchmark.metrics.tactile import diameter
from eitbench.benchmark.run.cell_task import CellData, CellPlan, StoredSamples, not_finite
from eitbench.benchmark.run.method_cell import FrameTask, Rows, definition
from eitbench.benchmark.run.prior_knowledge import place_knowledge
from eitbench.benchmark.rundir.cells import Values
from eitbench.benchmark.rundir.run_arrays import Truth
from eitbench.benchmark.rundir.store import RunStore
from eitbench.benchmark.tuning.selection import recorded_selection
from eitbench.benchmark.workers.messages import Reply, array_in
from eitbench.benchmark.workers.place_service import PlaceService, simulated_presses
from eitbench.methods.registry import place_methods
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.data.transfer import TransferData, load_transfer
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.recordings.fetch import fetch_recording
from eitbench.scenarios.similarity import Similarity, fit_similarity
from eitbench.scenarios.suites.scenario import Scenario, TransferScenario
from eitbench.scenarios.suites.suite import Suite, scenario_by_name


@dataclass(frozen=True, eq=False)
class PlaceData(CellData):
    """Presses of a skin, and what methods may learn of it.

    Attributes:
        transfer: all of it; its `test` is that of the cell.
    """

    batch: ClassVar[int] = 128

    transfer: TransferData

    @classmethod
    def load(
        cls, scenario: Scenario, suite: Suite, limit: int | None, *, jobs: int, progress: bool
    ) -> Self:
        """See `CellData.load`."""
        if not isinstance(scenario, TransferScenario):
            raise InputError(f"Scenario {scenario.name!r} is not of the kind 'transfer'.")
        for recording in suite.recordings(scenario):
            fetch_recording(recording, limit_s=suite.download_limit_s, progress=progress)
        transfer = load_transfer(scenario, limit)
        return cls(scenario, transfer.test, transfer)

    @classmethod
    def known(cls) -> Mapping[str, type[Any]]:
        """See `CellData.known`."""
        return place_methods()

    def task(self, plan: CellPlan, store: RunStore) -> "PlaceCellTask":
        """Return the method of the cell."""
        return PlaceCellTask(plan, store, self)

    def truth(self) -> Truth:
        """Return the numbers of the presses, and their places."""
        arrays = {
            "sample": self.test.samples["sample"].to_numpy(np.int64),
            "place": self.places("test"),
        }
        return {}, arrays

    def selection(self, name: str, code: str) -> dict[str, Any] | None:
        """Return what was selected for a method of images by simulated presses, if anything."""
        return recorded_selection(scenario_by_name("presses"), name, code)

    def places(self, split: str) -> Array:
        """Return the true places (n, 2) [m] of "test", or of "validation", which registers."""
        if split == "validation":
            return self.transfer.registration.places
        return self.test.samples[["x_m", "y_m"]].to_numpy(np.float64)

    def differences(self, split: str) -> Array:
        """Return the differences (n, M) of such presses."""
        if split == "validation":
            return self.transfer.registration.differences
        return self.test.voltages - self.test.references


@dataclass(frozen=True, eq=False)
class PlaceCellTask(FrameTask):
    """A method of places, asked where presses are."""

    data: PlaceData

    @property
    def sizes(self) -> Mapping[str, int]:
        """The presses that a registration needs, then the test presses."""
        return {split: len(self.data.places(split)) for split in ("validation", "test")}

    @property
    def readable(self) -> tuple[Path, ...]:
        """See `CellTask`; no public recordings, since it is sent what it may learn from."""
        recordings = Path(os.environ.get("EITBENCH_DATA", ""))
        return tuple(place for place in super().readable if place != recordings)

    def service(self) -> PlaceService:
        """Return the method with its problem."""
        plan, scenario = self.plan, self.data.scenario
        assert isinstance(scenario, TransferScenario)
        return PlaceService(
            self.data.transfer.given,
            plan.cell.name,
            plan.parameters,
            partial(simulated_presses, scenario),
            plan.plugin,
            definition(plan),
        )

    def request(self, split: str, rows: Rows) -> tuple[object, ...]:
        """Return a request for the places of presses."""
        return "locate", self.data.differences(split)[rows]

    def blank(self, n: int) -> dict[str, NDArray[Any]]:
        """Return places and times of NaN."""
        return {"place": np.full((n, 2), np.nan), "frame_ms": np.full(n, np.nan)}

    def values(self, split: str, rows: slice, reply: Reply) -> tuple[Values, NDArray[np.str_]]:
        """Return the places and the time of each press."""
        n = rows.stop - rows.start
        places = array_in(reply.value, np.float64, (n, 2), "answer")
        good = np.isfinite(places).all(axis=1)
        places[~good] = np.nan
        return {"place": places, "frame_ms": np.full(n, reply.seconds * 1e3 / n)}, not_finite(good)

    def prior_knowledge(self, value: object) -> dict[str, Any]:
        """Return the columns of `place_knowledge`."""
        return place_knowledge(value, spent=self.plan.spent)

    def figures(self, stored: StoredSamples) -> tuple[pd.DataFrame, dict[str, Any]]:
        """Return the error of every place; the registration as JSON, if there is one."""
        found, places, whole = stored.values["place"], self.data.places("test"), {}
        if self.sizes["validation"]:
            seen = StoredSamples(self, "validation").values["place"]
            registration = register(seen, self.data.places("validation"))
            found, whole["registration"] = registration(found), registration.to_json()
        table = pd.DataFrame(np.nan, index=range(len(found)), columns=list(METRIC_COLUMNS))
        error = np.hypot(*(found - places).T)
        # As an image without a contact: the farthest wrong place in the sensor.
        error[np.isnan(error)] = diameter(self.data.test.sensor)
        table["localisation_mm"] = 1e3 * error
        table[["found_x_m", "found_y_m"]], table[["expected_x_m", "expected_y_m"]] = found, places
        return table.assign(frame_ms=stored.values["frame_ms"]), whole


def register(found: Array, places: Array) -> Similarity:
    """Fit the similarity from places that were `found` (n, 2) to the true `places` (n, 2).

    Where they determine none, the mean of what was found is put on the median of the places.
    """
    similarity = fit_similarity(found, places)
    if similarity is not None:
        return similarity
    known = np.isfinite(found).all(axis=1)
    centre = found[known].mean(axis=0) if known.any() else np.zeros(2)
    return Similarity(1.0, np.eye(2), np.median(places, axis=0) - centre)
