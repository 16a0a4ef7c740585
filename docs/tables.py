"""Tables of the documentation, made from stored runs and studies.

A table stands between `<!-- table: NAME -->` and `<!-- end of table -->`. `make tables` writes them
all anew; a test fails where a page and its record differ.
"""

import json
import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import pandas as pd

from eitbench.benchmark.analysis.results import GUESS
from eitbench.benchmark.analysis.transfer import SkinError, over_skins
from eitbench.reports.claims.rules import LABELS
from eitbench.reports.figures.touches import alarm_grid, apart_grid, time_grid
from eitbench.reports.figures.transfer import grid
from eitbench.reports.studies.priors import priors_table
from eitbench.reports.studies.superposition import explained_table
from eitbench.reports.tables.challenge import challenge_rows, challenge_table
from eitbench.reports.tables.formats import markdown_table
from eitbench.reports.tables.published import TABLE_I, TABLE_II

DOCS = Path(__file__).resolve().parent
STUDIES = DOCS / "studies"
_PLACE = re.compile(r"(<!-- table: (.+?) -->\n).*?(\n<!-- end of table -->)", flags=re.DOTALL)


def pages() -> list[Path]:
    """Return all pages that may hold a table."""
    return [DOCS.parent / "README.md", DOCS.parent / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md"))]


def filled(text: str) -> str:
    """Return a page with its tables made anew."""
    return _PLACE.sub(lambda place: place[1] + TABLES[place[2]]().strip("\n") + place[3], text)


def _table(
    heads: Sequence[str], rows: Sequence[Sequence[str]], right: Sequence[bool] | None = None
) -> str:
    return "\n".join(markdown_table(heads, rows, right))


_SCENARIOS = {
    "noise-clean": "clean",
    "noise-60db": "60 dB",
    "noise-50db": "50 dB",
    "noise-40db": "40 dB",
    "noise-30db": "30 dB",
    "shapes": "unseen shapes, 50 dB",
}


def _generators(*generators: int, form: str) -> str:
    """Return the PSNR on each scenario, of one generator of the data or of several in turn."""
    stored = pd.read_csv(STUDIES / "generator" / "generators.csv")
    psnr = stored.set_index(["generator", "scenario", "method"])["psnr"]
    rows = [
        [
            f"`{method}`",
            *(" → ".join(format(psnr[g, s, method], form) for g in generators) for s in _SCENARIOS),
        ]
        for method in stored["method"].unique()
    ]
    return _table(["PSNR [dB]", *_SCENARIOS.values()], rows)


def _families() -> str:
    stored = pd.read_csv(STUDIES / "generator" / "families.csv")
    psnr = stored.pivot_table(index="method", columns="family", values="psnr")
    psnr = psnr.loc[psnr.mean(axis=1).sort_values(ascending=False).index]
    rows = [[f"`{method}`", *(f"{value:.1f}" for value in row)] for method, row in psnr.iterrows()]
    return _table(["PSNR [dB]", *psnr.columns], rows)


def _mutation() -> str:
    score = pd.read_csv(STUDIES / "mutation" / "score.csv")
    counts = ["mutants", "survived", "explained"]
    total = pd.DataFrame([{"module": "all", **score[counts].sum()}])
    rows = pd.concat([score.assign(module="`" + score["module"] + "`"), total]).astype(str)
    return _table(["module", *counts], rows.to_numpy().tolist())


def _trap(run: str, scenario: str, columns: Mapping[str, tuple[str, str]]) -> Callable[[], str]:
    """Return the table of a scenario of `traps.csv`; columns by name with heading and format."""

    def table() -> str:
        of = _traps().loc[run, scenario].reset_index().sort_values("ssim", ascending=False)
        rows = [
            [
                f"`{row['method']}`",
                *(format(row[name], form) for name, (_, form) in columns.items()),
            ]
            for row in of.to_dict("records")
        ]
        return _table(["", *(heading for heading, _ in columns.values())], rows)

    return table


def _traps() -> pd.DataFrame:
    stored = pd.read_csv(STUDIES / "traps" / "traps.csv")
    return stored.set_index(["run", "scenario", "method"]).sort_index()


def _untuned_and_tuned() -> str:
    stored = _traps()
    rows = []
    for method in ("noser", "tv"):
        both = (stored.loc[run, "finer-mesh", method] for run in ("untuned", "tuned"))
        rows.append([f"`{method}`", *(f"{r['score']:.2f} ({r['psnr']:.1f} dB)" for r in both)])
    return _table(["S on `finer-mesh`", "as it comes", "tuned"], rows)


def _meshes_and_noise() -> str:
    psnr = _traps().loc["tuned"]["psnr"]
    names = {"same-mesh": "same mesh", "finer-mesh": "finer mesh", "finer-mesh-40db": "and 40 dB"}
    rows = [
        [f"`{method}`", *(f"{psnr[name, method]:.2f}" for name in names)]
        for method in ("tv", "noser", "back-projection", "nothing")
    ]
    return _table(["PSNR [dB]", *names.values()], rows)


def _objects() -> str:
    columns = {
        "group": ("Ties", ""), "score": ("S", ".2f"), "ssim": ("SSIM", ".3f"), "cc": ("CC", ".3f"),
        "rie": ("RIE", ".3f"), "psnr": ("PSNR [dB]", ".1f"),
        "localisation_mm": ("Localisation [mm]", ".1f"), "iou": ("IoU", ".2f"),
        "edge": ("Edge", ".2f"), "artefacts": ("Artefacts", ".2f"),
    }  # fmt: skip
    stored = pd.read_csv(STUDIES / "objects" / "objects.csv")
    rows = [
        [f"`{row['method']}`", *(format(row[name], form) for name, (_, form) in columns.items())]
        for row in stored.to_dict("records")
    ]
    return _table(["", *(heading for heading, _ in columns.values())], rows)


def _claims() -> str:
    stored = json.loads((STUDIES / "claims" / "claims.json").read_text())
    rows = []
    for claim in stored["claims"]:
        says = claim["claim"].removesuffix(".")
        rows.append([f"**{claim['verdict']}**", says, claim["source"], str(claim["n"] or "–")])
    return _table(["verdict", "claim", "in", "samples"], rows, [False] * 3 + [True])


def _clean() -> str:
    stored = pd.read_csv(STUDIES / "paper" / "paper.csv").to_dict("records")
    rows = [[f"`{row['method']}`", *_clean_figures(row)] for row in stored]
    for name in ("phydnn", "dnn"):
        rows.append([f"published {LABELS[name]}", *_clean_figures(TABLE_II[name])])
    return _table(["", "SSIM", "CC", "RIE", "PSNR [dB]"], rows)


def _clean_figures(row: Mapping[str, float]) -> list[str]:
    return [f"{row['ssim']:.4f}", f"{row['cc']:.4f}", f"{row['rie']:.4f}", f"{row['psnr']:.2f}"]


def _symmetries() -> str:
    """Return the worth and cost of averaging over the symmetries of the sensor."""
    stored = pd.read_csv(STUDIES / "symmetries" / "symmetries.csv").to_dict("records")
    rows = [
        [
            f"`{row['method']}`", f"{row['psnr_one']:.2f}", f"{row['psnr']:.2f}",
            f"{row['gain']:+.2f} ({row['gain_low']:+.2f} to {row['gain_high']:+.2f})",
            f"{row['ms_one']:.1f}", f"{row['ms']:.1f}",
        ]
        for row in stored
    ]  # fmt: skip
    heads = ["PSNR [dB]", "one image", "mean of eight", "gain (95 %)", "ms a frame", "with eight"]
    return _table(heads, rows)


def _physical_loss() -> str:
    """Return PhyDNN minus DNN in PSNR, with intervals, wherever the ledger has it."""
    claims = json.loads((STUDIES / "claims" / "claims.json").read_text())["claims"]
    rows = []
    for claim in claims:
        names = {"phydnn-over-dnn": "clean, same mesh", "generalisation": "unseen shapes, 50 dB"}
        for figure in claim["figures"]:
            name = figure["name"]
            if not name.startswith("PSNR") or "PhyDNN minus DNN" not in name or not claim["n"]:
                continue
            *_, level = name.rpartition("noise-")
            data = names.get(claim["id"]) or (level if claim["id"] == "noise-robustness" else "")
            if data:
                low, high = figure["interval"]
                rows.append([
                    data.replace("db", " dB"), str(claim["n"]), f"{figure['ours']:+.3f}",
                    f"{low:+.3f} to {high:+.3f}", figure["verdict"],
                ])  # fmt: skip
    heads = ["data", "samples", "PSNR, PhyDNN minus DNN [dB]", "95 %", "better"]
    return _table(heads, rows, [False, True, True, True, False])


def _supervision() -> str:
    stored = json.loads((STUDIES / "supervision" / "summary.json").read_text())
    psnr = pd.DataFrame(stored["rows"]).pivot_table(index="alpha", columns="seed", values="psnr")
    words = {1.0: "1: true images and voltages", 0.0: "0: voltages alone"}
    rows = [[words[alpha], *(f"{psnr.loc[alpha, seed]:.2f}" for seed in psnr)] for alpha in words]
    return _table(["alpha", *(f"seed {seed} [dB]" for seed in psnr)], rows)


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


def _rungs() -> str:
    stored = pd.read_csv(STUDIES / "sim2real" / "ladder.csv")
    value = stored.set_index(["rung", "method"])["value"]
    methods = ("coarse-to-fine", "dnn", "learned-gn", "tv", "linear-learned", "noser")
    rows = [
        [title, *(f"{value[rung, method]:.3f}" for method in methods)]
        for rung, title in _RUNGS.items()
    ]
    return _table(["B", *(f"`{method}`" for method in methods)], rows)


def _ladder() -> str:
    lines = (STUDIES / "sim2real" / "ladder.md").read_text().splitlines()
    return "\n".join(line for line in lines if line.startswith("|"))


def _operators() -> str:
    stored = pd.read_csv(STUDIES / "operators" / "operators.csv")
    names = {"paper": "same mesh", "paper-finer": "finer mesh"}
    rows = [
        [
            names[row["scenario"]],
            f"`{row['operator']}`",
            f"{row['mse']:.3g}",
            f"{row['r']:.4f}" + (f" ({row['r_low']:.4f} to {row['r_high']:.4f})"),
            f"{100 * row['rel_error']:.2g} %",
            f"{row['grad_cosine']:.3f}",
        ]
        for row in stored.to_dict("records")
    ]
    for name, title in (("surrogate", "learned operator"), ("jacobian", "Jacobian")):
        table = TABLE_I[name]
        rows.append(["published", title, f"{table['mse']:.3g}", f"{table['r']:.5f}", "", ""])
    heads = ["data from", "operator", "MSE", "R (95 %)", "rel. error", "gradient cosine"]
    return _table(heads, rows, [False] * 2 + [True] * 4)


_READ = (
    # frames, axes, background
    ("absolute maps", "as they are", "as they are", True),
    ("without their background", "as they are", "as they are", False),
    ("the same, axes exchanged", "as they are", "exchanged", False),
    ("frames of offset 4 taken for offset 3, without background",
     "offset 4, taken for offset 3", "as they are", False),
    ("electrodes numbered the other way, without background",
     "electrodes numbered the other way", "as they are", False),
)  # fmt: skip


def _readings() -> str:
    stored = pd.DataFrame(json.loads((STUDIES / "readings" / "readings.json").read_text())["rows"])
    plain = stored[(stored["sign"] == 1) & (stored["strength"] == 1)]
    by = plain.set_index(["method", "frames", "axes", "background"])
    rows = []
    for method in ("noser", "tv"):
        rows.append([LABELS[method], "published", *_four(TABLE_II[method])])
        rows += [["", title, *_four(by.loc[(method, *reading)])] for title, *reading in _READ]
    return _table(["", "read as", "SSIM", "CC", "RIE", "PSNR"], rows, [False] * 2 + [True] * 4)


def _four(row: Mapping[str, float]) -> list[str]:
    return [
        f"{row['ssim']:.3f}", f"{row['cc']:.2f}", f"{row['rie']:.2f}", f"{row['psnr']:.1f} dB",
    ]  # fmt: skip


def _peers() -> str:
    """Return figures on simulated touches, and the localisation error of real presses."""
    stored = pd.read_csv(STUDIES / "peers" / "quick.csv")
    touches = stored[stored["scenario"] == "quick"].sort_values("score", ascending=False)
    presses = stored[stored["scenario"] == "ohmc16"].set_index("method")
    columns = {
        "group": ("Ties", ""), "score": ("S", ".3f"), "ssim": ("SSIM", ".3f"), "cc": ("CC", ".3f"),
        "rie": ("RIE", ".4f"), "psnr": ("PSNR [dB]", ".2f"),
    }  # fmt: skip
    rows = []
    for row in touches.to_dict("records"):
        name = row["method"]
        figures = [format(row[column], form) for column, (_, form) in columns.items()]
        pressed = ["", ""]  # not run
        if name in presses.index:
            pressed = [f"{presses['localisation_mm'][name]:.1f}", presses["group"][name]]
        rows.append([f"`{name}`", *figures, *pressed])
    heads = ["method", *(heading for heading, _ in columns.values()), "`ohmc16` [mm]", "Ties"]
    return _table(heads, rows)


_PLACE_COLUMNS = {
    "localisation_mm": ("median [mm]", ".1f"),
    "localisation_p90_mm": ("90 % [mm]", ".1f"),
    "within_5_mm": ("within 5 mm", ".0%"),
    "within_10_mm": ("within 10 mm", ".0%"),
    "unevenness": ("unevenness", ".2f"),
    "worst_tenth_mm": ("worst tenth [mm]", ".1f"),
}


def _skins() -> str:
    """Return the board over skins: ranks, and medians over the skins of what each has."""
    stored = pd.read_csv(STUDIES / "skins" / "skins.csv")
    found = json.loads((STUDIES / "skins" / "skins.json").read_text())["overall"]
    medians = stored.groupby("method")[list(_PLACE_COLUMNS)].median()
    rows = []
    for row in found["rows"]:
        figures = medians.loc[row["method"]]
        rank, ratio = (
            f"{row[of]:.2f} ({row[f'{of}_low']:.2f} to {row[f'{of}_high']:.2f})"
            for of in ("rank", "ratio")
        )
        rows.append([
            f"`{row['method']}`", rank, ratio,
            *(format(figures[name], form) for name, (_, form) in _PLACE_COLUMNS.items()),
        ])  # fmt: skip
    guess = stored.drop_duplicates("scenario")[list(GUESS)].median()
    guesses = zip(guess, _PLACE_COLUMNS.values(), strict=True)
    rows.append(["one place", "", "1", *(format(value, form) for value, (_, form) in guesses)])
    heads = ["", "mean rank (95 %)", "error over a guess's (95 %)"]
    return _table([*heads, *(heading for heading, _ in _PLACE_COLUMNS.values())], rows)


def _each_skin() -> str:
    """Return the median error of every method on every skin."""
    stored = pd.read_csv(STUDIES / "skins" / "skins.csv")
    found = json.loads((STUDIES / "skins" / "skins.json").read_text())["overall"]
    methods = [row["method"] for row in found["rows"]]
    rows = []
    for skin, of in stored.groupby("scenario", sort=False):
        error = of.set_index("method")["localisation_mm"]
        best = f"{error.min():.1f}"
        texts = (f"{error[method]:.1f}" for method in methods)
        marked = (f"**{text}**" if text == best else text for text in texts)
        rows.append([f"`{skin}`", f"{of['n'].iloc[0]:,}", f"{of['guess_mm'].iloc[0]:.1f}", *marked])
    heads = ["median error [mm]", "presses", "one place", *(f"`{method}`" for method in methods)]
    return _table(heads, rows)


def _course() -> str:
    """Return the error in the first, middle and last fifth of the presses."""
    heads, *rows = time_grid(pd.read_csv(STUDIES / "drift" / "over-time.csv"))
    return _table(heads, [_named(row, 2) for row in rows])


def _alarms() -> str:
    heads, *rows = alarm_grid(pd.read_csv(STUDIES / "drift" / "alarms.csv"))
    return _table(heads, rows)


def _told_apart() -> str:
    """Return the shares told apart by images, and by the fit of two presses."""
    folder = STUDIES / "two-touch"
    fitted = json.loads((folder / "superposition.json").read_text())["told_apart"]
    stored = pd.concat([pd.read_csv(folder / "two-touch.csv"), pd.DataFrame(fitted)])
    heads, *rows = apart_grid(stored)
    return _table(heads, [_named(row, 1) for row in sorted(rows, key=lambda row: row[0])])


def _named(row: Sequence[str], names: int) -> list[str]:
    return [*(f"`{name}`" for name in row[:names]), *row[names:]]


def _explained() -> str:
    stored = (STUDIES / "two-touch" / "superposition.json").read_text()
    return explained_table(json.loads(stored))


def _challenge() -> str:
    stored = json.loads((STUDIES / "ktc2023" / "ktc2023.json").read_text())
    heads, *body = challenge_table(challenge_rows(stored["rows"]))
    rows = [
        [name if track == "published" else f"`{name}`", track, *scores]
        for name, track, *scores in body
    ]
    return _table(heads, rows, [False, False, *[True] * (len(heads) - 2)])


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
    return _table(heads, rows)


def _transfer(name: str) -> list[SkinError]:
    """The errors of every method on every skin that a run of methods of places stored."""
    stored = pd.read_csv(STUDIES / "new-skin" / f"{name}.csv")
    return [SkinError(**row) for row in stored.to_dict("records")]


def _new_skin() -> str:
    heads, *rows = grid(over_skins(_transfer("new-skin")))
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
    return _table(
        ["method", "learned from", *heads[1:]], body, [False, False] + [True] * len(heads[1:])
    )


def _by_skin() -> str:
    """The median error on each skin of some methods after some numbers of presses."""
    stored = pd.DataFrame(_transfer("new-skin")).set_index(["method", "labelled", "recording"])
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
    return _table(["median error [mm]", *(title for *_, title in shown)], rows)


def _agreement() -> str:
    """Spearman's rank correlation over skins of the median errors of two methods."""
    stored = pd.DataFrame(_transfer("new-skin"))
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
    return _table(heads, rows, [False] * 2 + [True])


def _presses() -> str:
    """The place error of imaging methods on the set `ohmc16`."""
    stored = pd.read_csv(STUDIES / "skins" / "skins.csv")
    found = stored[stored["scenario"] == "ohmc16"].sort_values("localisation_mm")
    rows = [
        [f"`{row['method']}`", f"{row['localisation_mm']:.1f}", f"{row['localisation_p90_mm']:.1f}"]
        for row in found.to_dict("records")
    ]
    guess = found.iloc[0]
    rows.append(
        ["one place", f"{guess['guess_mm']:.1f}", f"{guess['guess_localisation_p90_mm']:.1f}"]
    )
    return _table(["", "median error [mm]", "90 % [mm]"], rows)


def _few_presses() -> str:
    names = {
        "one-place": "one place, whatever the frame",
        "ridge": "ridge regression of the place on unit frames",
        "kernel-ridge": "kernel ridge regression",
        "network": "network, real presses only",
        "network-simulated": "network, simulated presses first",
    }
    errors = _transfer("few-presses")
    value = {(e.method, e.labelled): f"{e.median_mm:.1f}" for e in errors}
    counts = sorted({e.labelled for e in errors})
    rows = [
        [title, *(value.get((name, count), "–") for count in counts)]
        for name, title in names.items()
    ]
    return _table(["median error [mm] after so many real presses", *map(str, counts)], rows)


UNSEEN = [f"cam09-{number}" for number in ("07", "08", "10", "15", "18")]
"""Skins whose errors chose no setting of the topographic map."""


def _hard_skins() -> str:
    skins = pd.read_csv(STUDIES / "hard-skins" / "properties.csv").set_index("skin")
    errors = pd.read_csv(STUDIES / "hard-skins" / "errors.csv")
    errors = errors.pivot_table(index="skin", columns=["method", "labelled"], values="median_mm")
    errors.columns = errors.columns.to_flat_index()
    skins = skins.join(errors).sort_values("explained")
    forms = {
        "explained": ".2f", "memory": ".2f", "alike": ".2f", "like_model": ".2f",
        "rank": ".1f", "at_1500": ".1f",
        ("kernel-ridge", 25): ".1f", ("topographic-map", 25): ".1f",
        ("topographic-map-skins", 25): ".1f", ("topographic-map-skins", 0): ".1f",
    }  # fmt: skip
    heads = [
        "skin", "explained", "memory", "alike", "like the model", "rank", "1,500 labelled",
        "25, kernel ridge", "25, map", "25, map and skins", "0, map and skins",
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
    return _table(heads, rows)


TABLES: dict[str, Callable[[], str]] = {
    "hard skins": _hard_skins,
    "generators": partial(_generators, 1, 2, form=".2f"),
    "noise and unseen shapes": partial(_generators, 2, form=".1f"),
    "families of shapes": _families,
    "mutation testing": _mutation,
    "priors": lambda: priors_table(pd.read_csv(STUDIES / "priors" / "priors.csv")),
    "nothing": _trap(
        "untuned",
        "finer-mesh-40db",
        {
            "ssim": ("SSIM", ".3f"), "rie": ("RIE", ".3f"), "psnr": ("PSNR [dB]", ".1f"),
            "cc": ("CC", ".3f"), "iou": ("IoU", ".3f"), "score": ("S", ".2f"),
            "bounded": ("B", ".3f"),
        },
    ),
    "untuned and tuned": _untuned_and_tuned,
    "meshes and noise": _meshes_and_noise,
    "readings": _readings,
    "objects": _objects,
    "claims": _claims,
    "clean data": _clean,
    "symmetries": _symmetries,
    "physical loss": _physical_loss,
    "supervision": _supervision,
    "rungs": _rungs,
    "ladder": _ladder,
    "operators": _operators,
    "peers": _peers,
    "skins": _skins,
    "each skin": _each_skin,
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
    "presses": _presses,
}  # fmt: skip


if __name__ == "__main__":
    for page in pages():
        page.write_text(filled(page.read_text()))
