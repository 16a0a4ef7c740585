"""Tables of the page on a real skin: gains of measurements, and models of the skin."""

import json

import pandas as pd
from docs.tables.record import STUDIES, printed

from eitbench.benchmark.tuning.selection import PACKAGED, validation_key
from eitbench.methods.learned.image_networks import NETWORKS
from eitbench.scenarios.suites.suite import scenario_by_name

_GAINS = {
    "without": "without",
    "with": "with gains",
    "learned": "and learned with them",
    "amplified": "and amplified",
}


def _gains() -> str:
    """Return the error of presses without and with gains of measurements, by method."""
    stored = pd.read_csv(STUDIES / "gains" / "presses.csv")
    errors = stored.pivot(index="method", columns="gains", values="localisation_mm")
    last = errors["amplified"].fillna(errors["learned"]).fillna(errors["with"])
    errors = errors.loc[last.sort_values().index]
    rows = [
        [
            f"`{name}`",
            *("" if pd.isna(row[gains]) else f"{row[gains]:.1f}" for gains in _GAINS),
        ]
        for name, row in errors.iterrows()
    ]
    changes = stored[stored["gains"] == "amplified"].set_index("method")
    for row, name in zip(rows, errors.index, strict=True):
        of = changes.loc[name] if name in changes.index else None
        row.append(
            "" if of is None else f"{of.change_mm:+.2f} ({of.low_mm:+.2f} to {of.high_mm:+.2f})"
        )
    return printed(["median error [mm]", *_GAINS.values(), "change of a press by that"], rows)


def _skin_model() -> str:
    """Return misfit and error of presses of models of a skin, by order of the map."""
    rows = []
    for (name, order), part in _with_presses()[True].groupby(["skin", "order"], sort=False):
        error = part.set_index("gain_power")["error_mm"]
        known = error.dropna()
        # As a validation split chooses: with whichever power of the gains is better.
        shown = [f"{known[0.0]:.1f}", f"{known.drop(0.0).min():.1f}"] if len(known) else ["", ""]
        least = part["least_misfit"].iloc[0]
        rows.append(
            [
                name,
                "homogeneous" if order == 0 else f"contacts and a map of order {order}",
                f"{part['misfit'].iloc[0]:.3f}",
                "" if pd.isna(least) else f"{least:.3f}",
                *shown,
            ]
        )
    heads = ["skin", "model", "misfit", "least of any skin", "NOSER [mm]", "NOSER, with gains [mm]"]
    return printed(heads, rows, [False, False, True, True, True, True])


def _with_presses() -> dict[bool, pd.DataFrame]:
    """The study of models by whether a skin has presses, beside simulated ones of the same."""
    stored = pd.read_csv(STUDIES / "skin-model" / "errors.csv")
    pressed = set(stored.loc[stored["error_mm"].notna(), "skin"])
    kept = stored["skin"].str.removesuffix(", simulated").isin(pressed)
    return {True: stored[kept], False: stored[~kept]}


def _reference_misfit() -> str:
    """Return the misfit of reference frames without presses, by order of the map."""
    rows = []
    for name, part in _with_presses()[False].groupby("skin", sort=False):
        least = part["least_misfit"].iloc[0]
        misfits = [f"{misfit:.3f}" for misfit in part.sort_values("order")["misfit"]]
        rows.append([str(name), *misfits, "" if pd.isna(least) else f"{least:.3f}"])
    heads = ["recording", "homogeneous", *(f"order {k}" for k in (1, 2, 3)), "least of any skin"]
    return printed(heads, rows, [False, *[True] * 5])


def _amplification() -> str:
    """Return the error of validation presses by amplification, of what selection tried."""
    file = PACKAGED / f"{validation_key(scenario_by_name('ohmc16'))[:16]}.json"
    rows, heads = [], NETWORKS["amplification"]
    for name, selected in json.loads(file.read_text())["choices"].items():
        best = selected["parameters"]
        if "amplification" not in best:
            continue
        # Trials that were given up have no figure; all with the other parameters that were chosen.
        errors = {
            trial["parameters"]["amplification"]: -trial["figure"]
            for trial in selected["trials"]
            if trial["figure"] is not None
            and trial["parameters"] | {"amplification": 0} == best | {"amplification": 0}
        }
        rows.append(
            (errors, [f"`{name}`", *(f"{errors[a]:.1f}" if a in errors else "–" for a in heads)])
        )
    rows.sort(key=lambda row: min(row[0].values()))
    return printed(
        ["median error [mm]", *(f"{a:g}" for a in heads)], [row for _, row in rows],
        [False, *[True] * len(heads)],
    )  # fmt: skip


def _real_skin_training() -> str:
    """Return the error of validation presses by what networks learned from."""
    stored = pd.read_csv(STUDIES / "real-skin-training" / "errors.csv", keep_default_na=False)
    learned = stored[stored["learned_from"] != ""]
    skins = list(dict.fromkeys(learned["learned_from"]))
    rows = [
        [
            f"`{method}`",
            *(f"{of.median_mm:.1f} ({float(of.not_amplified_mm):.1f})" for of in part.itertuples()),
        ]
        for method, part in learned.groupby("method", sort=False)
    ]
    others = stored[stored["learned_from"] == ""]
    rows += [
        [f"`{row.method}`, learns nothing", f"{row.median_mm:.1f}", *[""] * (len(skins) - 1)]
        for row in others.itertuples()
    ]
    return printed(["median error [mm]", *skins], rows, [False, *[True] * len(skins)])


TABLES = {
    "gains": _gains,
    "skin model": _skin_model,
    "reference misfit": _reference_misfit,
    "amplification": _amplification,
    "real-skin training": _real_skin_training,
}
