"""Tables of recorded sensors: skins, drift, two touches and a tank."""

import json
from collections.abc import Callable, Sequence
from functools import cache

import numpy as np
import pandas as pd
from docs.tables.record import STUDIES, printed, record, recorded

from eitbench.benchmark.analysis.leaderboard import Entry, ranked_boards
from eitbench.benchmark.analysis.overall import OverallRow, overall
from eitbench.benchmark.analysis.results import GUESS
from eitbench.benchmark.findings.drift import alarms, over_time
from eitbench.benchmark.findings.transfer import SkinError, over_skins, skin_errors
from eitbench.benchmark.findings.two_touch import told_apart
from eitbench.reports.findings.touches import alarm_grid, apart_grid, time_grid
from eitbench.reports.findings.transfer import grid
from eitbench.reports.studies.superposition import explained_table
from eitbench.reports.tables.challenge import challenge_rows, challenge_table
from eitbench.scenarios.recordings.public.hydrogel import CUTS

_PLACE_COLUMNS = {
    "localisation_mm": ("median [mm]", ".1f"),
    "localisation_p90_mm": ("90 % [mm]", ".1f"),
    "within_5_mm": ("within 5 mm", ".0%"),
    "within_10_mm": ("within 10 mm", ".0%"),
    "unevenness": ("unevenness", ".2f"),
    "worst_tenth_mm": ("worst tenth [mm]", ".1f"),
}


@cache
def skin_boards() -> list[list[Entry]]:
    """The leaderboards of the record of `skins`, one a skin."""
    return ranked_boards([record("skins")])


def _over_skins() -> list[OverallRow]:
    """Methods over all skins, by mean rank."""
    skins = {board[0].row["scenario"]: [of.row for of in board] for board in skin_boards()}
    found = overall(
        {
            skin: {row["method"]: -row["localisation_mm"] for row in rows}
            for skin, rows in skins.items()
        },
        {skin: rows[0]["guess_mm"] for skin, rows in skins.items()},
    )
    assert found is not None  # the suite has several skins and methods
    return found.rows


def _skins() -> str:
    """Return the board over skins: ranks, and medians over the skins of what each has."""
    read = pd.DataFrame([of.row for board in skin_boards() for of in board])
    medians = read.groupby("method")[list(_PLACE_COLUMNS)].median()
    rows = []
    for found in _over_skins():
        figures = medians.loc[found.method]
        rows.append([
            f"`{found.method}`",
            f"{found.rank:.2f} ({found.rank_low:.2f} to {found.rank_high:.2f})",
            f"{found.ratio:.2f} ({found.ratio_low:.2f} to {found.ratio_high:.2f})",
            *(format(figures[name], form) for name, (_, form) in _PLACE_COLUMNS.items()),
        ])  # fmt: skip
    guess = read.drop_duplicates("scenario")[list(GUESS)].median()
    guesses = zip(guess, _PLACE_COLUMNS.values(), strict=True)
    rows.append(["one place", "", "1", *(format(value, form) for value, (_, form) in guesses)])
    heads = ["", "mean rank (95 %)", "error over a guess's (95 %)"]
    return printed([*heads, *(heading for heading, _ in _PLACE_COLUMNS.values())], rows)


def _each_skin() -> str:
    """Return the median error of every method on every skin."""
    methods = [found.method for found in _over_skins()]
    rows = []
    for board in skin_boards():
        of = board[0].row
        error = {entry.row["method"]: entry.row["localisation_mm"] for entry in board}
        best = f"{min(error.values()):.1f}"
        texts = (f"{error[method]:.1f}" for method in methods)
        marked = (f"**{text}**" if text == best else text for text in texts)
        rows.append([f"`{of['scenario']}`", f"{of['n']:,}", f"{of['guess_mm']:.1f}", *marked])
    heads = ["median error [mm]", "presses", "one place", *(f"`{method}`" for method in methods)]
    return printed(heads, rows)


def _part_of_skins() -> str:
    """Return the median error of every method on the first presses of every skin.

    Those of `tv` are all that its record has; the others are scored on the same presses.
    """
    tv = pd.read_csv(STUDIES / "skins" / "tv.csv").set_index("scenario")
    samples = record("skins").samples
    same = samples[samples["sample"] < samples["scenario"].map(tv["count"])]
    error = same.pivot_table("localisation_mm", "scenario", "method", aggfunc="median", sort=False)
    error["tv"] = tv["median"]
    error = error[error.median().sort_values().index]
    rows = [
        [name, *(f"{value:.1f}" for value in row)]
        for name, row in [
            *((f"`{skin}`", row) for skin, row in error.iterrows()),
            ("median", error.median()),
        ]
    ]
    return printed(["median error [mm]", *(f"`{method}`" for method in error.columns)], rows)


def _course() -> str:
    """Return the error in the first, middle and last fifth of the presses."""
    heads, *rows = time_grid(over_time(record("drift")))
    return printed(heads, [_named(row, 2) for row in rows])


def _alarms() -> str:
    heads, *rows = alarm_grid(alarms(record("drift")))
    away = (f"{1e3 * np.hypot(*cut.place):.0f}" for cut in CUTS)
    middle = [cell for text in away for cell in ("–", "–", f"{text}, {text}")]
    return printed(heads, [*rows, ["the middle", "–", "–", *middle]])


def apart() -> pd.DataFrame:
    """Shares of pairs told apart by images, and by the fit of two presses."""
    study = json.loads((STUDIES / "two-touch" / "superposition.json").read_text())
    return pd.concat([told_apart(record("two-touch").samples), pd.DataFrame(study["told_apart"])])


def _told_apart() -> str:
    heads, *rows = apart_grid(apart())
    return printed(heads, [_named(row, 1) for row in sorted(rows, key=lambda row: row[0])])


def _named(row: Sequence[str], names: int) -> list[str]:
    return [*(f"`{name}`" for name in row[:names]), *row[names:]]


def _explained() -> str:
    stored = (STUDIES / "two-touch" / "superposition.json").read_text()
    return explained_table(json.loads(stored))


def _challenge() -> str:
    heads, *body = challenge_table(challenge_rows(recorded("ktc2023")))
    rows = [
        [name if track == "published" else f"`{name}`", track, *scores]
        for name, track, *scores in body
    ]
    return printed(heads, rows, [False, False, *[True] * (len(heads) - 2)])


def _tank() -> str:
    rows = [
        [
            str(row["target"]), f"{row['strength']:.2f}", f"{row['common']:+.1%}",
            f"{row['unexplained_alone']:.0%}", f"{row['unexplained']:.0%}",
        ]
        for row in pd.read_csv(STUDIES / "ktc2023" / "tank.csv").to_dict("records")
    ]  # fmt: skip
    heads = [
        "training target", "change over the modelled one", "common factor",
        "unexplained without that factor", "with it",
    ]  # fmt: skip
    return printed(heads, rows)


@cache
def transfer(suite: str) -> list[SkinError]:
    """The errors of every method on every skin in the record of a suite of methods of places."""
    return skin_errors([record(suite)])


def _new_skin() -> str:
    heads, *rows = grid(over_skins(transfer("new-skin")))
    learned = {
        "one-place": "nothing: guessing", "kernel-ridge": "presses of the skin",
        "ridge": "presses of the skin", "network": "presses of the skin",
        "kernel-ridge-skins": "other skins", "network-skins": "other skins",
        "network-simulated": "simulated presses", "linear-touch": "simulated presses",
        "network-simulated-skins": "simulated presses, other skins", "noser": "nothing: a model",
        "greit": "nothing: a model", "back-projection": "nothing: a model",
        "topographic-map": "presses of the skin, unlabelled ones",
        "topographic-map-skins": "other skins, presses of the skin, unlabelled ones",
    }  # fmt: skip
    body = [[f"`{name}`", learned[name], *cells] for name, *cells in rows]
    return printed(
        ["method", "learned from", *heads[1:]], body, [False, False] + [True] * len(heads[1:])
    )


def _by_skin() -> str:
    """The median error on each skin of some methods after some numbers of presses."""
    stored = pd.DataFrame(transfer("new-skin")).set_index(["method", "labelled", "recording"])
    shown = [
        ("kernel-ridge", 0, "guessing"), ("noser", 0, "`noser`, 0"),
        ("linear-touch", 0, "`linear-touch`, 0"),
        ("kernel-ridge-skins", 0, "`kernel-ridge-skins`, 0"),
        ("kernel-ridge", 25, "`kernel-ridge`, 25"), ("network", 25, "`network`, 25"),
        ("kernel-ridge-skins", 25, "`kernel-ridge-skins`, 25"),
        ("topographic-map-skins", 0, "`topographic-map-skins`, 0"),
        ("topographic-map-skins", 25, "`topographic-map-skins`, 25"),
        ("kernel-ridge", 400, "`kernel-ridge`, 400"),
    ]  # fmt: skip
    value = stored["median_mm"]
    skins = sorted({skin for _, _, skin in value.index})
    rows = [
        [f"`{skin}`", *(f"{value[method, count, skin]:.1f}" for method, count, _ in shown)]
        for skin in skins
    ]
    return printed(["median error [mm]", *(title for *_, title in shown)], rows)


def _agreement() -> str:
    """Spearman's rank correlation over skins of the median errors of two methods."""
    stored = pd.DataFrame(transfer("new-skin"))
    value = stored.pivot(index="recording", columns=["method", "labelled"], values="median_mm")
    pairs = [
        (("noser", 0), ("linear-touch", 0)), (("noser", 0), ("kernel-ridge-skins", 0)),
        (("noser", 0), ("kernel-ridge", 25)), (("kernel-ridge-skins", 0), ("kernel-ridge", 25)),
    ]  # fmt: skip
    rows = [
        [
            *(f"`{method}`, {count}" for method, count in pair),
            f"{value[pair[0]].corr(value[pair[1]], method='spearman'):.2f}",
        ]
        for pair in pairs
    ]
    heads = ["method, labelled", "method, labelled", "rank correlation"]
    return printed(heads, rows, [False] * 2 + [True])


def _few_presses() -> str:
    names = {
        "one-place": "one place, whatever the frame",
        "ridge": "ridge regression of the place on normalised frames",
        "kernel-ridge": "kernel ridge regression",
        "network": "network, real presses only",
        "network-simulated": "network, simulated presses first",
    }
    errors = transfer("few-presses")
    value = {(e.method, e.labelled): f"{e.median_mm:.1f}" for e in errors}
    counts = sorted({e.labelled for e in errors})
    rows = [
        [title, *(value.get((name, count), "–") for count in counts)]
        for name, title in names.items()
    ]
    return printed(["median error [mm] after so many real presses", *map(str, counts)], rows)


UNSEEN = [f"cam09-{number}" for number in ("07", "08", "10", "15", "18")]
"""Skins whose errors chose no setting of the topographic map."""


def _hard_skins() -> str:
    skins = pd.read_csv(STUDIES / "hard-skins" / "properties.csv").set_index("skin")
    errors = pd.DataFrame(transfer("new-skin"))
    errors = errors.pivot(index="recording", columns=["method", "labelled"], values="median_mm")
    errors.columns = errors.columns.to_flat_index()
    skins = skins.join(errors).sort_values("explained")
    forms = {
        "explained": ".2f", "memory": ".2f", "alike": ".2f", "like_model": ".2f",
        "rank": ".1f", "at_1500": ".1f",
        ("kernel-ridge", 25): ".1f", ("topographic-map", 25): ".1f",
        ("topographic-map-skins", 25): ".1f", ("topographic-map-skins", 0): ".1f",
    }  # fmt: skip
    heads = [
        "skin", "explained", "serial correlation", "in five components", "like the model", "rank",
        "1,500 labelled", "25, kernel ridge", "25, map", "25, map and skins", "0, map and skins",
    ]  # fmt: skip
    rows = [
        [name, *(format(row[key], form) for key, form in forms.items())]
        for name, row in [
            *skins.iterrows(),
            ("median", skins.drop(columns="version").median()),
            (
                "median of those that chose nothing",
                skins.loc[UNSEEN].drop(columns="version").median(),
            ),
        ]
    ]
    return printed(heads, rows)


def _models_of_skins() -> str:
    """What conductivity models explain of each skin, means of both halves of its presses."""
    stored = pd.read_csv(STUDIES / "hard-skins" / "physics.csv")
    figures = ["explained", "with_gains", "error_mm", "error_gains_mm"]
    mean = stored.groupby(["skin", "model"])[figures].mean().unstack("model")
    maps = pd.read_csv(STUDIES / "hard-skins" / "maps.csv")
    maps = maps.set_index(["row", "column", "skin"])["of_place"].map(np.log).unstack("skin")
    alike = maps.corrwith(maps["disc"]).rename("alike")
    fitted = stored[stored["model"] == "tensor"].groupby("skin", sort=False)
    ratios, angles = fitted["first"].agg(list), fitted["angle"].agg(list)
    models = ("disc", "tensor", "polar", "radial")
    shown = [
        *(("explained", model, ".0%") for model in models),
        *(("with_gains", model, ".0%") for model in ("disc", "tensor", "polar", "place")),
        *((of, model, ".1f") for of in figures[2:] for model in models),
    ]
    rows = [
        [
            name,
            *(format(row[figure, model], form) for figure, model, form in shown),
            "" if name == "median" else ", ".join(
                "none" if ratio == 1 else f"{ratio:g} at {angle:.0f}°"
                for ratio, angle in zip(ratios[name], angles[name], strict=True)
            ),
            f"{alike.drop('disc').median() if name == 'median' else alike[name]:.2f}",
        ]
        for name, row in [*mean.iterrows(), ("median", mean.median())]
    ]  # fmt: skip
    heads = [
        "skin", "disc", "tensor", "polar", "radial", "disc, gains", "tensor, gains",
        "polar, gains", "place", "error, disc [mm]", "tensor [mm]", "polar [mm]", "radial [mm]",
        "disc, gains [mm]", "tensor, gains [mm]", "polar, gains [mm]", "radial, gains [mm]",
        "ratio of the tensor", "map like the disc",
    ]  # fmt: skip
    return printed(heads, rows)


TABLES: dict[str, Callable[[], str]] = {
    "hard skins": _hard_skins,
    "models of skins": _models_of_skins,
    "skins": _skins,
    "each skin": _each_skin,
    "part of each skin": _part_of_skins,
    "error over time": _course,
    "alarms": _alarms,
    "told apart": _told_apart,
    "superposition": _explained,
    "challenge": _challenge,
    "tank": _tank,
    "new skin": _new_skin,
    "by skin": _by_skin,
    "agreement over skins": _agreement,
    "few presses": _few_presses,
}  # fmt: skip
