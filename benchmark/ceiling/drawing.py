"""Draws of the posteriors of test frames, kept in a folder and resumed.

The folder holds `<scenario>/<sample>.safetensors`: the draws of both samplers, as `Draws` has them.
A file that is there and belongs to the same frame and version is kept, so that a run that was
stopped goes on, and one with more samples adds to one with fewer.
"""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import joblib
import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from eitbench.benchmark.ceiling.agreement import greatest_rhat, traces
from eitbench.benchmark.ceiling.importance import draws_about
from eitbench.benchmark.ceiling.models import PhantomModels, images
from eitbench.benchmark.ceiling.moves import PROPOSALS, Proposals
from eitbench.benchmark.ceiling.prior import FamilyPrior
from eitbench.benchmark.ceiling.record import recorded_frames
from eitbench.benchmark.ceiling.sampler import (
    CORRECTED,
    LIBRARY,
    PARTICLES,
    Draws,
    Sampler,
    library,
    merged,
)
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.errors import DataCorruptError, InputError
from eitbench.scenarios.imperfections.imperfections import Imperfections
from eitbench.scenarios.interrupts import worker_pool
from eitbench.scenarios.phantoms.phantom import Phantom
from eitbench.scenarios.physics.forward import ForwardModel
from eitbench.scenarios.progress import with_bar
from eitbench.scenarios.seeds import generator
from eitbench.scenarios.storage.array_file import read_arrays, write_arrays
from eitbench.scenarios.suites.scenario import TOUCHES, Scenario, SimulatedScenario

VERSION, STAYS, KEPT_RHAT, RUNS = 10, 9, 1.02, 4
"""The first is raised by one whenever a frame gives other draws than before; recorded frames by the
second and later ones stay. Draws are kept where their weights are exact and R-hat is below the
third: as far as a frame's own checks can tell, they are right, and recorded ones by earlier
versions stay, too, if no trace of the truth lies outside of all of them. (That samplers agree
selects frames whose errors by chance are alike, so that the product of the errors is a little too
large.) Where R-hat is not, both samplers run again, so often in all at most, and the draws of their
runs are merged."""
SURPASSED = 3.0
"""By how much the true phantom may explain a frame better than the draw of a sampler that does so
best. Where it is more, the sampler has lost what is likely: it draws about the true phantom next,
and these draws count by their evidence."""
CLEAN_DB, MOST_DB = 70.0, 80.0
"""SNR of the frames that stand for those without noise, whose posterior has no width, and the
greatest one."""
SEEDS = (
    'first particles: generator("ceiling", "library", session, proposals, run); steps: '
    'generator("ceiling", scenario, sample, proposals, run); ranks and images of figures: '
    'generator("ceiling", "ties" or "draws", scenario, sample)'
)
"""Where random numbers come from, see `scenarios.seeds`."""

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
        what = [f"the imperfection {name!r}" for name in sorted(unknown)]
        what += [*["a slab"] * (unit.mesh == "slab"), "calibration"]
        raise InputError(
            f"Scenario {scenario.name!r} has {what[0]}, which the ceiling is not told: it knows "
            "the mesh and the electrodes of every unit."
        )
    priors_of(scenario)
    noise = scenario.noise.test
    if noise == "mixture" or (noise != "clean" and not 0 < noise <= MOST_DB):
        raise InputError(
            f"The noise of scenario {scenario.name!r} is {noise!r}: the ceiling needs frames that "
            f'all have one SNR, above 0 and up to {MOST_DB:g} dB, or "clean".'
        )
    if noise != "clean":
        return scenario
    return scenario.model_copy(
        update={
            "name": f"{scenario.name}-at-{CLEAN_DB:.0f}db",
            "phantoms": scenario.phantom_stream,
            "noise": scenario.noise.model_copy(update={"test": CLEAN_DB}),
        }
    )


def known_of(scenarios: Iterable[Scenario]) -> tuple[list[Scenario], list[InputError]]:
    """The scenarios that the sampler can be told, and why it cannot be told the others."""
    known: list[Scenario] = []
    refused = []
    for scenario in scenarios:
        try:
            told(scenario)
        except InputError as error:
            refused.append(error)
        else:
            known.append(scenario)
    return known, refused


def priors_of(scenario: SimulatedScenario) -> tuple[FamilyPrior, ...]:
    """The laws that the test phantoms of a scenario are drawn by, one for each shape of a family.

    Raises:
        InputError: a family whose phantoms are not vectors of parameters.
    """
    families, sensor = scenario.split_families("test"), scenario.nominal_sensor
    return tuple(prior for family in families for prior in FamilyPrior.of(family, sensor))


class _Frame(NamedTuple):
    """A frame (M,) [V/A] of a phantom, not drawn from yet, and the file of its draws."""

    scenario: str
    sample: int
    snr_db: float
    voltages: np.ndarray
    input_hash: str
    path: Path
    phantom: Phantom


def draw_posteriors(
    scenarios: Sequence[Scenario],
    folder: Path,
    samples: int,
    *,
    record: bool = False,
    jobs: int = 1,
    progress: bool = False,
) -> None:
    """Draw from the posteriors of the first `samples` test frames of scenarios.

    With `record`, frames that the product's own record has are left out, but for those by an
    earlier version that are doubtful, see `kept`.

    Raises:
        InputError: frames that the sampler does not know the law of, or draws of other frames in
            the folder.
    """
    # Scenarios with the same phantoms on the same units share their models.
    units: dict[tuple[str, int], tuple[SimulatedScenario, list[_Frame]]] = {}
    for scenario in map(told, scenarios):
        law = json.dumps(scenario.clean_parameters("test"))
        data = load(scenario, "test", samples, jobs=jobs, progress=progress)
        recorded = recorded_frames(scenario.name, scenario.data_hash("test") if record else None)
        recorded = recorded[kept(recorded)]
        for sample, input_hash in enumerate(data.frame_hashes):
            path = _path(folder, scenario.name, sample)
            if sample not in recorded.index and _read(path, input_hash) is None:
                snr_db, voltages = float(data.samples["snr_db"][sample]), data.voltages[sample]
                phantom = data.phantoms[sample]
                frame = _Frame(scenario.name, sample, snr_db, voltages, input_hash, path, phantom)
                units.setdefault((law, sample // TOUCHES), (scenario, []))[1].append(frame)
    # First sessions first, so that what a stopped run leaves has the same phantoms everywhere.
    tasks = [
        (*unit, session) for (_, session), unit in sorted(units.items(), key=lambda of: of[0][1])
    ]
    pool = worker_pool(jobs, return_as="generator_unordered", batch_size=1)
    steps = pool(joblib.delayed(_draw)(*task) for task in tasks)
    with warnings.catch_warnings():
        # joblib says so when it replaces a worker that has grown; no task is lost by it.
        warnings.filterwarnings("ignore", "A worker stopped while some jobs", UserWarning)
        for _ in with_bar(steps, "Drawing posteriors", len(tasks), show=progress):
            pass


def kept(recorded: pd.DataFrame) -> pd.Series:
    """True for recorded frames that need not be drawn anew, see `KEPT_RHAT`.

    Those by early versions are compared with the truth by its ranks, which is a rough check.
    """
    agree = (recorded["effective"] >= CORRECTED) & (recorded["rhat"] < KEPT_RHAT)
    ranks = recorded.filter(regex="^rank_")
    among = ((ranks > 0) & (ranks < 1)).all(axis=1)
    return agree & among | (recorded["version"] >= STAYS)


class Posterior(NamedTuple):
    """What was drawn of one frame.

    Attributes:
        draws: by sampler.
        surpassed: how much better the true phantom explains the frame than the best draw of the
            sampler that does so less well, as a difference of logarithms of the exact likelihood,
            see `SURPASSED`. Of frames by version 9 it is than the best draw of both samplers.
    """

    draws: dict[Proposals, Draws]
    surpassed: float


def draws_of(folder: Path, scenario: str, sample: int, input_hash: str) -> Posterior | None:
    """The draws of one frame; None where there are none.

    Raises:
        InputError: draws of another frame.
    """
    found = _read(_path(folder, scenario, sample), input_hash)
    if found is None:
        return None
    draws = {
        name: Draws._make(found[f"{name}-{field}"] for field in Draws._fields) for name in PROPOSALS
    }
    return Posterior(draws, float(found["surpassed"]))


def _path(folder: Path, scenario: str, sample: int) -> Path:
    return folder / scenario / f"{sample:05d}.safetensors"


def _metadata(input_hash: str) -> dict[str, str]:
    about = {"frame": input_hash, "version": VERSION, "runs": RUNS}
    about |= {"particles": PARTICLES, "library": LIBRARY}
    return {name: str(value) for name, value in about.items()}


def _read(path: Path, input_hash: str) -> dict[str, np.ndarray] | None:
    try:
        stored = read_arrays(path)
    except DataCorruptError:
        return None  # it is made again
    if stored is None:
        return None
    arrays, metadata = stored
    if metadata != _metadata(input_hash):
        raise InputError(
            f"{path} holds draws of another frame or by another version of the sampler: name "
            "another folder."
        )
    return arrays


def _draw(scenario: SimulatedScenario, frames: list[_Frame], session: int) -> None:
    """Draw from the posteriors of frames of one unit; runs in a worker process."""
    exact = scenario.data_model("test", session)
    assert isinstance(exact, ForwardModel)
    models = PhantomModels(priors_of(scenario), exact)

    @cache
    def sampler(name: Proposals, run: int) -> Sampler:
        begin = library(models, generator("ceiling", "library", session, name, run))
        return Sampler(models, begin, name)

    with threadpool_limits(1):
        for frame in frames:
            seen = models.frame(frame.voltages, frame.snr_db)
            phantom = models.of_phantom(frame.phantom)
            true = float(seen.log_likelihood(models.exact(*phantom))[0])
            runs: dict[Proposals, list[Draws]] = {name: [] for name in PROPOSALS}
            surpassed = dict.fromkeys(PROPOSALS, -math.inf)
            for run in range(RUNS):
                for name, draws in runs.items():
                    rng = generator("ceiling", frame.scenario, frame.sample, name, run)
                    if surpassed[name] > SURPASSED:
                        draws.append(draws_about(models, *phantom, seen, rng))
                    else:
                        draws.append(sampler(name, run).draws(seen, rng))
                found = {name: merged(draws) for name, draws in runs.items()}
                surpassed = {k: true - float(of.log_likelihoods.max()) for k, of in found.items()}
                most = max(surpassed.values())
                if most <= SURPASSED and _agree(list(found.values()), models):
                    break
            arrays = {
                f"{name}-{field}": _compact(np.asarray(values))
                for name, draws in found.items()
                for field, values in draws._asdict().items()
            }
            arrays["surpassed"] = _compact(np.asarray(most))
            write_arrays(frame.path, arrays, _metadata(frame.input_hash))


def _agree(drawn: Sequence[Draws], models: PhantomModels) -> bool:
    """Whether draws of several samplers are alike, see `KEPT_RHAT`."""
    families = [prior.parameters for prior in models.priors]
    nominal = families[0].sensor
    chains = [
        traces(nominal.background * images(families, draws.families, draws.vectors), nominal)
        for draws in drawn
    ]
    return greatest_rhat(chains, [draws.weights for draws in drawn]) < KEPT_RHAT


def _compact(values: np.ndarray) -> np.ndarray:
    return values.astype(np.int16 if values.dtype.kind == "i" else np.float32)
