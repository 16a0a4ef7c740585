"""Draws of the posteriors of a suite's test frames, kept in a folder and resumed.

The folder holds `<scenario>/<session>.safetensors`: for every frame of the session and each of the
two samplers the draws, as `Draws` has them. A file that is there and belongs to the same frames is
kept, so that a run that was stopped goes on, and one with more samples adds to one with fewer.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import joblib
import numpy as np
from threadpoolctl import threadpool_limits

from eitbench.benchmark.ceiling.models import PhantomModels
from eitbench.benchmark.ceiling.prior import FamilyPrior
from eitbench.benchmark.ceiling.sampler import PROPOSALS, Draws, Proposals, Sampler, library
from eitbench.scenarios.data.datasets import Dataset, load
from eitbench.scenarios.data.simulation import with_bar
from eitbench.scenarios.errors import DataCorruptError, InputError
from eitbench.scenarios.imperfections.imperfections import Imperfections
from eitbench.scenarios.interrupts import end_with_parent
from eitbench.scenarios.physics.forward import ForwardModel
from eitbench.scenarios.seeds import generator
from eitbench.scenarios.storage.array_file import read_arrays, write_arrays
from eitbench.scenarios.suites.scenario import TOUCHES, Scenario, SimulatedScenario

CLEAN_DB = 70.0
"""SNR of the frames that stand for those without noise, whose posterior has no width."""
PARTICLES = 400
LIBRARY = 2000
"""Draws of the prior, of each family."""

_TOLD = {"unit", "severity", "mesh", "electrode_shift_m", "electrode_width", "contact_impedance"}


def told(scenario: Scenario) -> SimulatedScenario:
    """The scenario whose ceiling is worked out in the place of `scenario`: itself, or at 70 dB.

    Raises:
        InputError: frames that the sampler does not know the law of.
    """
    if not isinstance(scenario, SimulatedScenario):
        raise InputError(
            f"Scenario {scenario.name!r} is recorded: the ceiling is of simulated touches, whose "
            "law is known."
        )
    if scenario.acuity is not None:
        raise InputError(f"Scenario {scenario.name!r} has a design of touches, which has no law.")
    unit, ideal = scenario.split_imperfections("test"), Imperfections()
    unknown = [
        name
        for name in Imperfections.model_fields.keys() - _TOLD - {"reference_age_s"}
        if getattr(unit, name) != getattr(ideal, name)
    ]
    if unknown or unit.mesh == "slab" or scenario.calibrated:
        what = [*sorted(unknown), *["a slab"] * (unit.mesh == "slab"), "calibration"]
        raise InputError(
            f"Scenario {scenario.name!r} has {what[0]}, which the ceiling is not told: it knows "
            "the mesh and the electrodes of every unit."
        )
    for family in scenario.split_families("test"):
        FamilyPrior.of(family, scenario.nominal_sensor)
    noise = scenario.noise.test
    if noise == "mixture" or noise == 0:
        raise InputError(
            f"The noise of scenario {scenario.name!r} is {noise!r}: the ceiling needs an SNR above "
            "0 dB that all frames have."
        )
    if noise != "clean":
        return scenario
    stem = scenario.name.removesuffix("-clean")
    at = scenario.noise.model_copy(update={"test": CLEAN_DB})
    return scenario.model_copy(update={"name": f"{stem}-{CLEAN_DB:.0f}db", "noise": at})


class _Task(NamedTuple):
    """A session of touches, in all scenarios that share its phantoms and its unit."""

    scenarios: tuple[SimulatedScenario, ...]
    session: int
    folder: Path


def draw_posteriors(
    scenarios: Sequence[Scenario],
    folder: Path,
    samples: int,
    *,
    jobs: int = 1,
    progress: bool = False,
) -> None:
    """Draw from the posteriors of the first `samples` test frames, whole sessions, of scenarios.

    Raises:
        InputError: frames that the sampler does not know the law of, or draws of other frames in
            the folder.
    """
    known = [told(scenario) for scenario in scenarios]
    for scenario in known:  # made before, so that processes do not make them at the same time
        load(scenario, "test", samples, jobs=jobs, progress=progress)
    laws: dict[str, list[SimulatedScenario]] = {}
    for scenario in known:
        laws.setdefault(json.dumps(scenario.clean_parameters("test")), []).append(scenario)
    tasks = [
        _Task(tuple(having), session, folder)
        for session in range(-(-samples // TOUCHES))
        for of in laws.values()
        if (having := [scenario for scenario in of if session * TOUCHES < scenario.test])
    ]
    pool = joblib.Parallel(
        n_jobs=jobs, return_as="generator_unordered", batch_size=1, initializer=end_with_parent
    )
    steps = pool(joblib.delayed(_draw)(task) for task in tasks)
    for _ in with_bar(steps, "Drawing posteriors", len(tasks), show=progress):
        pass


def draws_of(folder: Path, data: Dataset, sample: int) -> dict[Proposals, Draws] | None:
    """The draws of one frame; None where there are none.

    Raises:
        InputError: draws of other frames.
    """
    session = sample // TOUCHES
    found = _read(_path(folder, data.scenario, session), data, session)
    if found is None:
        return None
    return {
        name: Draws._make(found[f"{sample}-{name}-{field}"] for field in Draws._fields)
        for name in PROPOSALS
    }


def _path(folder: Path, scenario: str, session: int) -> Path:
    return folder / scenario / f"{session:04d}.safetensors"


def _metadata(data: Dataset, session: int) -> dict[str, str]:
    hashes = data.frame_hashes[session * TOUCHES : (session + 1) * TOUCHES]
    return {"frames": " ".join(hashes), "particles": str(PARTICLES), "library": str(LIBRARY)}


def _read(path: Path, data: Dataset, session: int) -> dict[str, np.ndarray] | None:
    try:
        stored = read_arrays(path)
    except DataCorruptError:
        return None  # it is made again
    if stored is None:
        return None
    arrays, metadata = stored
    if metadata != _metadata(data, session):
        raise InputError(
            f"{path} holds draws of other frames or of another number of particles: name an empty "
            "folder."
        )
    return arrays


def _draw(task: _Task) -> None:
    """Draw from the posteriors of a session's frames; runs in a worker process."""
    last = (task.session + 1) * TOUCHES
    data = {of.name: load(of, "test", last) for of in task.scenarios}
    missing = [
        scenario
        for scenario in task.scenarios
        if _read(_path(task.folder, scenario.name, task.session), data[scenario.name], task.session)
        is None
    ]
    if not missing:
        return
    scenario = missing[0]
    exact = scenario.data_model("test", task.session)
    assert isinstance(exact, ForwardModel)
    priors = tuple(
        FamilyPrior.of(family, scenario.nominal_sensor)
        for family in scenario.split_families("test")
    )
    with threadpool_limits(1):
        models = PhantomModels(priors, exact)
        prior_draws = library(models, LIBRARY, generator("ceiling", "library", task.session))
        for scenario in missing:
            of = data[scenario.name]
            arrays = {}
            for sample in range(task.session * TOUCHES, min(last, len(of))):
                frame = models.frame(of.voltages[sample], float(of.samples["snr_db"][sample]))
                for proposals in PROPOSALS:
                    rng = generator("ceiling", scenario.name, sample, proposals)
                    sampler = Sampler(models, prior_draws, PARTICLES, proposals)
                    for field, values in sampler.draws(frame, rng)._asdict().items():
                        arrays[f"{sample}-{proposals}-{field}"] = _compact(np.asarray(values))
            path = _path(task.folder, scenario.name, task.session)
            write_arrays(path, arrays, _metadata(of, task.session))


def _compact(values: np.ndarray) -> np.ndarray:
    return values.astype(np.int16 if values.dtype.kind == "i" else np.float32)
