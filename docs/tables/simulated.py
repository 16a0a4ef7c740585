"""Tables of simulated data, of methods and of operators."""

import json
from collections.abc import Callable, Mapping
from functools import partial

import pandas as pd
from docs.tables.record import STUDIES, printed

from eitbench.methods.weights.weight_files import packaged_weights
from eitbench.reports.claims.rules import LABELS
from eitbench.reports.studies.priors import priors_table
from eitbench.reports.tables.published import TABLE_I, TABLE_II

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
    return printed(["PSNR [dB]", *_SCENARIOS.values()], rows)


def _boards() -> str:
    """Return the PSNR of every method at every level of noise, and on unseen shapes."""
    stored = pd.read_csv(STUDIES / "noise" / "boards.csv")
    psnr = stored.pivot_table(index="method", columns="scenario", values="psnr")
    psnr = psnr.sort_values("noise-50db", ascending=False)[list(_SCENARIOS)]
    rows = [[f"`{method}`", *(f"{value:.1f}" for value in row)] for method, row in psnr.iterrows()]
    return printed(["PSNR [dB]", *_SCENARIOS.values()], rows)


def _families() -> str:
    stored = pd.read_csv(STUDIES / "noise" / "families.csv")
    psnr = stored.pivot_table(index="method", columns="family", values="psnr")
    psnr = psnr.loc[psnr.mean(axis=1).sort_values(ascending=False).index]
    rows = [[f"`{method}`", *(f"{value:.1f}" for value in row)] for method, row in psnr.iterrows()]
    return printed(["PSNR [dB]", *psnr.columns], rows)


def _mutation() -> str:
    score = pd.read_csv(STUDIES / "mutation" / "score.csv")
    counts = ["mutants", "survived", "explained"]
    total = pd.DataFrame([{"module": "all", **score[counts].sum()}])
    rows = pd.concat([score.assign(module="`" + score["module"] + "`"), total]).astype(str)
    return printed(["module", *counts], rows.to_numpy().tolist())


def _trap(run: str, scenario: str, columns: Mapping[str, tuple[str, str]]) -> Callable[[], str]:
    """Return the table of a scenario of `traps.csv`; columns by name with heading and format."""

    def made() -> str:
        of = _traps().loc[run, scenario].reset_index().sort_values("ssim", ascending=False)
        rows = [
            [
                f"`{row['method']}`",
                *(format(row[name], form) for name, (_, form) in columns.items()),
            ]
            for row in of.to_dict("records")
        ]
        return printed(["", *(heading for heading, _ in columns.values())], rows)

    return made


def _traps() -> pd.DataFrame:
    stored = pd.read_csv(STUDIES / "traps" / "traps.csv")
    return stored.set_index(["run", "scenario", "method"]).sort_index()


def _untuned_and_tuned() -> str:
    stored = _traps()
    rows = []
    for method in ("noser", "tv"):
        both = (stored.loc[run, "finer-mesh", method] for run in ("untuned", "tuned"))
        rows.append([f"`{method}`", *(f"{r['score']:.2f} ({r['psnr']:.1f} dB)" for r in both)])
    return printed(["S on `finer-mesh`", "as it comes", "tuned"], rows)


def _meshes_and_noise() -> str:
    psnr = _traps().loc["tuned"]["psnr"]
    names = {"same-mesh": "same mesh", "finer-mesh": "finer mesh", "finer-mesh-40db": "and 40 dB"}
    rows = [
        [f"`{method}`", *(f"{psnr[name, method]:.2f}" for name in names)]
        for method in ("tv", "noser", "back-projection", "nothing")
    ]
    return printed(["PSNR [dB]", *names.values()], rows)


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
    return printed(["", *(heading for heading, _ in columns.values())], rows)


def _claims() -> str:
    stored = json.loads((STUDIES / "claims" / "claims.json").read_text())
    rows = []
    for claim in stored["claims"]:
        says = claim["claim"].removesuffix(".")
        rows.append([f"**{claim['verdict']}**", says, claim["source"], str(claim["n"] or "–")])
    return printed(["verdict", "claim", "in", "samples"], rows, [False] * 3 + [True])


def _clean() -> str:
    stored = pd.read_csv(STUDIES / "paper" / "paper.csv").to_dict("records")
    rows = [
        [
            f"`{row['method']}`", f"{row['n']:,}", *_clean_figures(row),
            _known(row["psnr_median"], ".2f"), _known(row["psnr_of_mean"], ".2f"),
            f"{row['gain']:+.2f} ({row['gain_low']:+.2f} to {row['gain_high']:+.2f})"
            if row["gain"] == row["gain"] and row["method"] != "dnn" else "",
        ]
        for row in stored
    ]  # fmt: skip
    for name in ("phydnn", "dnn"):
        rows.append([f"published {LABELS[name]}", "", *_clean_figures(TABLE_II[name]), "", "", ""])
    heads = [
        "",
        "samples",
        "SSIM",
        "CC",
        "RIE",
        "PSNR [dB]",
        "median",
        "of the mean error",
        "over `dnn` (95 %)",
    ]
    return printed(heads, rows)


def _known(value: float, form: str) -> str:
    return format(value, form) if value == value else ""


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
    return printed(heads, rows)


_TRAININGS = {
    "dnn": "the published 100 epochs over all samples, with the eight symmetries of the sensor and "
    "noise drawn anew for every batch",
    "phydnn": "the same, with the physical loss",
    "learned-gn": "refines the image of `dnn` once, with the residual of the exact model",
    "learned-gn-2": "refines that of `learned-gn` in the same way, with the loss `log-mse`",
    "coarse-to-fine": "refines NOSER's images",
    "dnn-randomised": "continues `dnn` on units with imperfections",
    "learned-proximal": "three unrolled steps",
    "fno": "a Fourier neural operator",
    "latent-flow": "a conditional normalising flow over principal components of images",
    "dnn-heteroscedastic": "gives the deviation of each pixel from the image of `dnn`",
}


def _weights() -> str:
    """Return how the packaged weights for `foam16` were trained, from what lies beside them."""
    rows = []
    for name, what in _TRAININGS.items():
        (path,) = packaged_weights().glob(f"{name}-foam16-*.json")
        about = json.loads(path.read_text())
        minutes = sum(epoch["seconds"] for epoch in about["curve"]) / 60
        rows.append([f"`{name}`", what, about["epochs"], f"{minutes:.0f}"])
    rows.append(["`shape-posterior`, `ensemble`", "none of their own: they use `dnn` and "
                 "`learned-gn`", "", ""])  # fmt: skip
    return printed(["weights", "training", "epochs", "minutes"], rows)


def _training_data() -> str:
    """Return PSNR over the number of training samples, at equal work."""
    rows = [
        [
            f"{row['samples']:,}", f"{row['each_seen']}",
            f"{row['psnr']:.2f}",
            f"{row['gain']:+.2f} ({row['gain_low']:+.2f} to {row['gain_high']:+.2f})"
            if row["samples"] != 24_000 else "",
        ]
        for row in pd.read_csv(STUDIES / "data" / "data.csv").to_dict("records")
    ]  # fmt: skip
    return printed(["training samples", "each seen", "PSNR [dB]", "over 24,000 (95 %)"], rows)


def _losses() -> str:
    """Return the PSNR of trainings with either loss, by seed."""
    stored = pd.read_csv(STUDIES / "loss" / "loss.csv")
    psnr = stored.pivot_table(index="loss", columns="seed", values="psnr")
    rows = [
        [f"`{loss}`", *(f"{value:.2f}" for value in psnr.loc[loss]), f"{psnr.loc[loss].mean():.2f}"]
        for loss in ("mse", "log-mse")
    ]
    return printed(["PSNR [dB]", *(f"seed {seed}" for seed in psnr), "mean"], rows)


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
    return printed(heads, rows, [False, True, True, True, False])


def _supervision() -> str:
    stored = json.loads((STUDIES / "supervision" / "summary.json").read_text())
    psnr = pd.DataFrame(stored["rows"]).pivot_table(index="alpha", columns="seed", values="psnr")
    words = {1.0: "1: true images and voltages", 0.0: "0: voltages alone"}
    rows = [[words[alpha], *(f"{psnr.loc[alpha, seed]:.2f}" for seed in psnr)] for alpha in words]
    return printed(["alpha", *(f"seed {seed} [dB]" for seed in psnr)], rows)


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
    return printed(["B", *(f"`{method}`" for method in methods)], rows)


_RANDOMISED = {
    "sim2real-severity-0": "severity 0",
    "sim2real-severity-half": "severity a half",
    "sim2real-noise": "ideal, at 60 dB",
    "sim2real-stale-reference": "emulated, with a stale reference",
    "sim2real-two-dead-electrodes": "emulated, with two dead electrodes",
    "sim2real-saturated-channel": "emulated, with a saturated channel",
}


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
    names = [name for name in _SCENARIOS if name in psnr.index.get_level_values("scenario")]
    rows = [
        [f"`{method}`", *(f"{psnr[name, method]:.1f}" for name in names)]
        for method in stored["method"].unique()
    ]
    return printed(["PSNR [dB]", *(_SCENARIOS[name] for name in names)], rows)


def _ladder() -> str:
    lines = (STUDIES / "sim2real" / "ladder.md").read_text().splitlines()
    return "\n".join(line for line in lines if line.startswith("|"))


def _acuity(name: str = "acuity") -> str:
    lines = (STUDIES / "acuity" / f"{name}.md").read_text().splitlines()
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
    return printed(heads, rows, [False] * 2 + [True] * 4)


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
    return printed(["", "read as", "SSIM", "CC", "RIE", "PSNR"], rows, [False] * 2 + [True] * 4)


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
    return printed(heads, rows)


def _gains() -> str:
    """Return the error of presses without and with gains of measurements, by method."""
    stored = pd.read_csv(STUDIES / "gains" / "presses.csv")
    errors = stored.pivot_table(index="method", columns="gains", values="localisation_mm")
    errors = errors.loc[errors["learned"].fillna(errors["with"]).sort_values().index]
    rows = [
        [
            f"`{name}`",
            *(
                "" if pd.isna(row[gains]) else f"{row[gains]:.1f}"
                for gains in ("without", "with", "learned")
            ),
        ]
        for name, row in errors.iterrows()
    ]
    heads = ["median error [mm]", "without", "with gains", "and learned with them"]
    return printed(heads, rows)


def _skin_model() -> str:
    """Return misfit and error of presses of models of a skin, by order of the map."""
    stored = pd.read_csv(STUDIES / "skin-model" / "errors.csv")
    rows = []
    for (name, order), part in stored.groupby(["skin", "order"], sort=False):
        error = part.set_index("gain_power")["error_mm"]
        shown = [f"{error[p]:.1f}" if p in error else "" for p in (0.0, 1.0)]
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


TABLES: dict[str, Callable[[], str]] = {
    "generators": partial(_generators, 1, 2, form=".2f"),
    "noise and unseen shapes": _boards,
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
    "weights": _weights,
    "training data": _training_data,
    "losses": _losses,
    "physical loss": _physical_loss,
    "supervision": _supervision,
    "rungs": _rungs,
    "ladder": _ladder,
    "randomised": _randomised,
    "randomised noise": _randomised_noise,
    "acuity": _acuity,
    "acuity merit": lambda: _acuity("acuity-merit"),
    "operators": _operators,
    "gains": _gains,
    "skin model": _skin_model,
    "faults": _faults,
    "peers": _peers,
}  # fmt: skip
