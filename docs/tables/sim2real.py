"""Tables of the page on imperfections of real sensors."""

from collections.abc import Mapping, Sequence
from functools import cache

import pandas as pd
from docs.tables.record import SCENARIOS, STUDIES, printed, record

from eitbench.benchmark.findings.ladder import Ladder, Step, read_ladder

_RUNGS = {
    "sim2real-ideal": "ideal",
    "sim2real-mesh": "unstructured triangles",
    "sim2real-slab": "slab in three dimensions",
    "sim2real-contact-impedance": "uneven contact impedances",
    "sim2real-gain": "gains off by 1 %",
    "sim2real-quantisation": "16 bits, clipped",
    "sim2real-electrode-shift": "electrodes off by 0.5 mm",
    "sim2real-drift": "conductivity drifts by 1 %",
    "sim2real-relaxation": "5 % of the last touch is left",
    "sim2real-emulated": "all, at 60 dB (`emulated`)",
    "sim2real-severity-2": "all, twice as severe",
    "sim2real-dead-electrode": "emulated, with a dead electrode",
    "sim2real-lost-frames": "emulated, one in three frames lost",
}

_RANDOMISED = {
    "sim2real-severity-0": "severity 0",
    "sim2real-severity-half": "severity a half",
    "sim2real-noise": "ideal, at 60 dB",
    "sim2real-stale-reference": "emulated, with a stale reference",
    "sim2real-two-dead-electrodes": "emulated, with two dead electrodes",
    "sim2real-saturated-channel": "emulated, with a saturated channel",
}

_CALIBRATED = (
    *("sim2real-electrode-shift", "sim2real-gain", "sim2real-drift", "sim2real-emulated"),
    *("sim2real-severity-2", "sim2real-two-dead-electrodes"),
)


@cache
def ladder() -> Ladder:
    """What the record of `sim2real` says."""
    found = read_ladder(record("sim2real"))
    assert found is not None  # a suite with rungs
    return found


def _steps(methods: Sequence[str], rungs: Mapping[str, str]) -> str:
    """Return B on rungs, by their titles, and the area under it over severity."""
    read = ladder()
    rows = [
        [title, *(f"{read.steps[rung, method].value.value:.3f}" for method in methods)]
        for rung, title in rungs.items()
    ]
    areas = (f"{read.areas[method, False].value:.3f}" for method in methods)
    rows.append(["**area under B over severity**", *areas])
    return printed(["B", *(f"`{method}`" for method in methods)], rows)


def _rungs() -> str:
    """Return B on the main rungs, of the better methods of each kind."""
    methods = (
        *("dnn-randomised", "learned-gn-2", "coarse-to-fine", "dnn", "gauss-newton-tv", "tv"),
        *("linear-learned", "noser"),
    )
    return _steps(methods, _RUNGS)


def _fitted_to_each_frame() -> str:
    """Return B on the few touches of the methods that fit a network to each frame."""
    samples = record("sim2real").samples
    methods = ("cnn-pinn", "inr", "pinn", "dnn", "tv", "noser")
    touches = samples.loc[samples["method"] == methods[0], "sample"].unique()
    mean = (
        samples[samples["sample"].isin(touches)].groupby(["scenario", "method"])["bounded"].mean()
    )
    rows = [
        [title, *(f"{mean[rung, method]:.3f}" for method in methods)]
        for rung, title in _RUNGS.items()
    ]
    return printed(["B", *(f"`{method}`" for method in methods)], rows)


def _randomised() -> str:
    """Return B of networks that learned from the nominal sensor and from many, by rung."""
    return _steps(("dnn", "dnn-randomised"), _RUNGS | _RANDOMISED)


def _calibration() -> str:
    """Return what calibration adds to B, with ! where the interval excludes 0."""
    methods = ("dnn-randomised", "learned-gn-2", "coarse-to-fine", "dnn", "tv", "noser")
    titles = _RUNGS | _RANDOMISED
    rows = [
        [titles[rung], *(_gain(ladder().steps[rung, method]) for method in methods)]
        for rung in _CALIBRATED
    ]
    return printed(["B won", *(f"`{method}`" for method in methods)], rows)


def _gain(step: Step) -> str:
    assert step.gain is not None  # every rung of the suite has its twin
    sure = step.gain.low > 0 or step.gain.high < 0
    return f"{step.gain.value:+.3f}{'!' * sure}"


def _randomised_noise() -> str:
    """Return the PSNR of both networks on sensors that are nearly as their model."""
    stored = pd.read_csv(STUDIES / "randomised" / "noise.csv")
    psnr = stored.set_index(["scenario", "method"])["psnr"]
    names = [name for name in SCENARIOS if name in psnr.index.get_level_values("scenario")]
    rows = [
        [f"`{method}`", *(f"{psnr[name, method]:.1f}" for name in names)]
        for method in stored["method"].unique()
    ]
    return printed(["PSNR [dB]", *(SCENARIOS[name] for name in names)], rows)


def _faults() -> str:
    """Return B with dead electrodes, as zeros and filled in."""
    stored = pd.read_csv(STUDIES / "faults" / "dead.csv")
    shown = stored.set_index(["method", "rung"])
    rows = [
        [
            f"`{name}`",
            *(
                f"{shown.loc[(name, rung), column]:.3f}"
                for rung, column in (
                    ("sim2real-emulated", "filled_in"),
                    ("sim2real-dead-electrode", "as_zeros"),
                    ("sim2real-dead-electrode", "filled_in"),
                    ("sim2real-two-dead-electrodes", "as_zeros"),
                    ("sim2real-two-dead-electrodes", "filled_in"),
                )
            ),
        ]
        for name in stored["method"].unique()
    ]
    heads = ["B", "none dead", "one, as zeros", "filled in", "two, as zeros", "filled in"]
    return printed(heads, rows)


TABLES = {
    "rungs": _rungs,
    "rungs of networks per frame": _fitted_to_each_frame,
    "calibration": _calibration,
    "randomised": _randomised,
    "randomised noise": _randomised_noise,
    "faults": _faults,
}
