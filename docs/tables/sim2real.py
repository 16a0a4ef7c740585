"""Tables of the page on imperfections of real sensors."""

import pandas as pd
from docs.tables.record import SCENARIOS, STUDIES, printed

_RUNGS = {
    "sim2real-ideal": "ideal",
    "sim2real-mesh": "unstructured triangles",
    "sim2real-slab": "slab in three dimensions",
    "sim2real-contact-impedance": "uneven contact impedances",
    "sim2real-gain": "gains off by 1 %",
    "sim2real-quantisation": "16 bits",
    "sim2real-electrode-shift": "electrodes off by 0.5 mm",
    "sim2real-drift": "conductivity drifts by 1 %",
    "sim2real-relaxation": "5 % of the last touch is left",
    "sim2real-emulated": "all, at 60 dB (`emulated`)",
    "sim2real-severity-2": "all, twice as severe",
    "sim2real-dead-electrode": "emulated, with a dead electrode",
    "area": "**area under B over severity**",
}

_RANDOMISED = {
    "sim2real-severity-0": "severity 0",
    "sim2real-severity-half": "severity a half",
    "sim2real-noise": "ideal, at 60 dB",
    "sim2real-stale-reference": "emulated, with a stale reference",
    "sim2real-two-dead-electrodes": "emulated, with two dead electrodes",
    "sim2real-saturated-channel": "emulated, with a saturated channel",
}


def _rungs() -> str:
    stored = pd.read_csv(STUDIES / "sim2real" / "ladder.csv")
    value = stored.set_index(["rung", "method"])["value"]
    methods = ("coarse-to-fine", "dnn", "learned-gn", "tv", "linear-learned", "noser")
    rows = [
        [title, *(f"{value[rung, method]:.3f}" for method in methods)]
        for rung, title in _RUNGS.items()
    ]
    return printed(["B", *(f"`{method}`" for method in methods)], rows)


def _ladder() -> str:
    lines = (STUDIES / "sim2real" / "ladder.md").read_text().splitlines()
    return "\n".join(line for line in lines if line.startswith("|"))


def _randomised() -> str:
    """Return B of networks that learned from the nominal sensor and from many, by rung."""
    stored = pd.read_csv(STUDIES / "randomised" / "ladder.csv")
    value = stored.set_index(["rung", "method"])["value"]
    methods = stored["method"].unique()
    titles = {**_RUNGS, **_RANDOMISED}
    area = titles.pop("area")
    rows = [
        [title, *(f"{value[rung, method]:.3f}" for method in methods)]
        for rung, title in {**titles, "area": area}.items()
        if (rung, methods[0]) in value
    ]
    return printed(["B", *(f"`{method}`" for method in methods)], rows)


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
    "ladder": _ladder,
    "randomised": _randomised,
    "randomised noise": _randomised_noise,
    "faults": _faults,
}
