"""What `eitbench choose` tries: methods, the cheapest first, on labelled and simulated frames."""

from collections.abc import Sequence

from eitbench.benchmark.metrics.statistics import MIN_CLUSTERS
from eitbench.benchmark.run.method_cell import MethodData
from eitbench.benchmark.tuning.selection import FRAMES
from eitbench.methods.registry import methods
from eitbench.scenarios.errors import (
    DataCorruptError,
    DataUnavailableError,
    InputError,
    unknown_name,
)
from eitbench.scenarios.imperfections.imperfections import TYPICAL
from eitbench.scenarios.recordings import RECORDED_SETS, is_recording
from eitbench.scenarios.sensors.sensor import Sensor
from eitbench.scenarios.suites.scenario import (
    RecordedScenario,
    Scenario,
    SimulatedScenario,
    SplitNoise,
)
from eitbench.scenarios.suites.suite import Suite, on_sensor

CANDIDATES = (
    "back-projection", "noser", "tikhonov", "laplacian", "greit",
    "coarse-to-fine", "dnn", "dnn-randomised", "phydnn", "fno", "learned-proximal", "tank-unet",
    "tv", "learned-gn", "ensemble", "learned-gn-2",
    "gauss-newton-noser", "dnn-large", "learned-gn-large", "gauss-newton-tv",
)  # fmt: skip
"""By what a fit and a frame cost, the cheapest first. None of them uses a GPU for its images."""

_LEARNS = "it learns from thousands of simulated touches before its first image"
_OTHERS = "it is other people's software, which the live view cannot count on"
LEFT_OUT = {
    "linear-learned": _LEARNS,
    "linear-touch": _LEARNS,
    **dict.fromkeys(("dip", "inr", "pinn", "cnn-pinn"), "it trains a network for every frame"),
    **dict.fromkeys(
        ("dnn-conformal", "dnn-heteroscedastic"), "its images are those of `dnn`, which is tried"
    ),
    "greit-conformal": "its images are those of `greit`, which is tried",
    "latent-flow": "it says how sure it is, and its images are blurred",
    "network-ensemble": "it runs five networks, which are tried one by one",
    "shape-posterior": "it knows the shapes that simulated touches are drawn from",
    **dict.fromkeys(("pyeit-bp", "pyeit-greit", "pyeit-jac"), _OTHERS),
    **dict.fromkeys(("eidors-greit", "eidors-noser", "eidors-tv-pdipm"), _OTHERS),
}
"""Built-in methods that are not tried, and why."""

TOUCHES, DRIFT = "touches", "drift"
"""Names of scenarios: simulated touches; drift, simulated or recorded."""
DRIFTED = {"ohmc16": "ohmc16-start", "superpose500": "superpose500-start"}
"""Recorded sets with the same presses on a reference frame that is taken once."""
SIMULATED = 60
"""Simulated touches of each scenario: 20 sessions of 3, each on a unit of its own."""
MOST_PRESSES = 400
SNR_DB = 60.0
REFERENCE_AGE_S = 8 * 3600.0
"""Age of the reference frame where drift is expected: a working day."""


def candidates(asked: Sequence[str], sensor: Sensor) -> tuple[list[str], dict[str, str]]:
    """Return the names of the methods to try on `sensor`, the cheapest first.

    Args:
        asked: names; all of `CANDIDATES` by default.
        sensor: the nominal sensor.

    Returns:
        The names, and of those that cannot be used the reason, as a sentence.

    Raises:
        InputError: an unknown name, one of `LEFT_OUT`, or none that can be used.
    """
    known = methods()
    for name in asked:
        if name not in known:
            raise unknown_name("method", name, known)
        if name in LEFT_OUT:
            raise InputError(f"The method {name!r} is never chosen: {LEFT_OUT[name]}.")
    names = sorted(dict.fromkeys(asked), key=lambda name: (*CANDIDATES, name).index(name))
    unusable = {name: known[name].unusable(sensor) for name in names or CANDIDATES}
    usable = [name for name, why in unusable.items() if not why]
    if not usable:
        raise InputError(
            f"No method can be used on sensor {sensor.name!r}: {' '.join(unusable.values())}"
        )
    return usable, {name: why for name, why in unusable.items() if why}


def scenarios_of(name: str, download_limit_s: float) -> tuple[Suite, str]:
    """Return the suite of scenarios that methods are tried on; the first one decides.

    These are the labelled frames of a recorded set, if it has any, then simulated touches with
    typical imperfections on a mesh other than that of the inversion, then drift: presses on an old
    reference frame if these were recorded, else the same touches after hours.

    Args:
        name: of a sensor or a recorded set, or the path of a sensor file (.toml) or a recording
            (.h5).
        download_limit_s: a recorded set may take this long to download [s].

    Returns:
        The suite, and a sentence if labelled frames are left out; else "".

    Raises:
        InputError: an unknown name, or a sensor that cannot be used.
        DataUnavailableError, DataCorruptError: no such recording, or one that cannot be read.
    """
    touches = SimulatedScenario(
        name=TOUCHES,
        families=("soft-press",),
        noise=SplitNoise(validation=SNR_DB, test=SNR_DB),
        train=0,
        validation=FRAMES,
        test=SIMULATED,
        phantoms="choose",
        imperfections=TYPICAL,
    )
    old = TYPICAL.model_copy(update={"reference_age_s": REFERENCE_AGE_S})
    drift = touches.model_copy(update={"name": DRIFT, "imperfections": old})
    suite = Suite(
        name="choose",
        title="Which method to put behind a sensor",
        methods=CANDIDATES,
        scenarios=(touches, drift),
        limit=MOST_PRESSES,
        download_limit_s=download_limit_s,
    )
    suite = on_sensor(suite, name)
    labelled, why_not = _labelled(name, suite)
    if labelled is None:
        return suite, why_not
    scenarios: list[Scenario] = [labelled, *suite.scenarios]
    if name in DRIFTED:
        scenarios[-1] = RecordedScenario(name=DRIFT, recording=DRIFTED[name])
    return suite.model_copy(update={"scenarios": tuple(scenarios)}), ""


def _labelled(name: str, suite: Suite) -> tuple[RecordedScenario | None, str]:
    """The scenario of labelled frames, if there are any that can be had; else why not, if known."""
    if not (is_recording(name) or name in RECORDED_SETS):
        return None, ""
    try:
        scenario = RecordedScenario(name="frames", recording=name)
        if scenario.recorded_set.truth == "none":
            return None, ""
        if scenario.recorded_set.emulated:  # no table may pass it for a real board
            scenario = scenario.model_copy(update={"name": "emulated-frames"})
        test = MethodData.load(scenario, suite, suite.limit, jobs=1, progress=True).test
    except (InputError, DataUnavailableError, DataCorruptError) as error:
        return None, f"Its labelled frames are left out: {error}"
    if (found := test.samples["cluster"].nunique()) < MIN_CLUSTERS:
        return None, (
            f"Its labelled frames are left out: {found} test presses or objects are fewer than "
            f"{MIN_CLUSTERS}, too few to tell methods apart."
        )
    return scenario, ""
