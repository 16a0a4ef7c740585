"""Tables of the page on learned methods."""

import json
from collections.abc import Mapping

import numpy as np
import pandas as pd
from docs.tables.claims import ledger
from docs.tables.record import SCENARIOS, STUDIES, printed, record
from scipy import special

from eitbench.benchmark.metrics.image_metrics import psnr_of_mean
from eitbench.methods.weights.weight_files import packaged_weights
from eitbench.reports.claims.rules import LABELS
from eitbench.reports.tables.published import TABLE_II

_TRAININGS = {
    "dnn": "the published 100 epochs over all samples, with the eight symmetries of the sensor and "
    "noise drawn anew for every batch",
    "phydnn": "the same, with the physical loss",
    "learned-gn": "refines the image of `dnn` once, with the residual of the exact model",
    "learned-gn-2": "refines that of `learned-gn` in the same way, with the loss `log-mse`",
    "dnn-large": "a larger U-Net, on 240,000 samples, with the loss `log-mse`",
    "learned-gn-large": "refines the image of `dnn-large` once, with the loss `log-mse`",
    "coarse-to-fine": "refines NOSER's images",
    "dnn-randomised": "continues `dnn` on units with imperfections, with the loss `log-mse`",
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
        device = "one core" if about["device"] == "cpu" else about["device"]
        rows.append([f"`{name}`", what, about["epochs"], device, f"{minutes:.0f}"])
    rows.append(["`shape-posterior`, `ensemble`", "none of their own: they use `dnn` and "
                 "`learned-gn`", "", "", ""])  # fmt: skip
    return printed(["weights", "training", "epochs", "on", "minutes"], rows)


def _clean() -> str:
    """Return the figures of clean frames, and what they gain over `dnn` on the same samples.

    Below those of methods that have all samples stand the methods that have the first ones alone,
    those of as many with the best of the others and `dnn` on the same samples.
    """
    run = record("paper")
    samples, shown = run.samples, _training_samples(run.cells)
    of = {str(name): rows.set_index("sample") for name, rows in samples.groupby("method")}
    psnr = {name: rows["psnr"] for name, rows in of.items()}
    n = max(map(len, of.values()))
    names = sorted(of, key=lambda name: -psnr[name].mean())
    whole = [name for name in names if len(of[name]) == n]
    rows = [_clean_row(name, shown, of[name], psnr["dnn"]) for name in whole]
    for count in sorted({len(samples) for samples in of.values()} - {n}, reverse=True):
        few = [name for name in names if len(of[name]) == count]
        first = of[few[0]].index
        rows += [
            _clean_row(name, shown, of[name].loc[first], psnr["dnn"].loc[first])
            for name in (*few, whole[0], "dnn")
        ]
    for name in ("phydnn", "dnn"):
        figures = _clean_figures(TABLE_II[name])
        rows.append([f"published {LABELS[name]}", "24,000", "", *figures, "", "", ""])
    heads = [
        *("", "trained on", "samples", "SSIM", "CC", "RIE", "PSNR [dB]", "median"),
        *("of the mean error", "over `dnn` (95 %)"),
    ]
    return printed(heads, rows)


def _training_samples(cells: pd.DataFrame) -> dict[str, str]:
    """The number of samples behind the weights of each method that loads some."""
    known = {row["method"]: json.loads(row["prior_knowledge"]) for _, row in cells.iterrows()}
    counts = {name: of["trained_on"].get("train_samples") for name, of in known.items()}
    return {name: f"{int(count):,}" for name, count in counts.items() if count}


def _clean_row(
    name: str, shown: Mapping[str, str], samples: pd.DataFrame, base: pd.Series
) -> list[str]:
    psnr = samples["psnr"]
    gain = psnr - base
    error = special.stdtrit(len(gain) - 1, 0.975) * gain.std() / np.sqrt(len(gain))
    ends = f"{gain.mean() - error:+.2f} to {gain.mean() + error:+.2f}"
    return [
        f"`{name}`", shown.get(name, ""), f"{len(samples):,}",
        *_clean_figures(samples.mean(numeric_only=True)),
        f"{psnr.median():.2f}", f"{psnr_of_mean(10 ** (-psnr / 10)):.2f}",
        "" if name == "dnn" else f"{gain.mean():+.2f} ({ends})",
    ]  # fmt: skip


def _known(value: float, form: str) -> str:
    return format(value, form) if value == value else ""


def _clean_figures(row: Mapping[str, float] | pd.Series) -> list[str]:
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


def _boards() -> str:
    """Return the PSNR of every method at every level of noise, and on unseen shapes."""
    samples = pd.concat([record(suite).samples for suite in ("noise", "shapes")])
    of = samples.groupby(["method", "scenario"])["psnr"]
    whole = of.size().unstack()["noise-50db"] == samples["sample"].max() + 1
    psnr = of.mean().unstack()[list(SCENARIOS)][whole].sort_values("noise-50db", ascending=False)
    rows = [
        [f"`{method}`", *(_known(value, ".1f") for value in row)] for method, row in psnr.iterrows()
    ]
    return printed(["PSNR [dB]", *SCENARIOS.values()], rows)


def _of_mean_errors() -> str:
    """Return the PSNR of the mean squared error of the best methods at every level of noise."""
    samples = record("noise").samples
    errors = (10 ** (-samples["psnr"] / 10)).groupby([samples["method"], samples["scenario"]])
    psnr = errors.agg(psnr_of_mean).unstack()
    levels = [name for name in SCENARIOS if name in psnr]
    best = (
        "shape-posterior", "learned-gn-large", "dnn-large", "learned-gn-2", "learned-gn", "dnn"
    )  # fmt: skip
    rows = [[f"`{name}`", *(f"{psnr[of][name]:.1f}" for of in levels)] for name in best]
    heads = ["PSNR of the mean error [dB]", *(SCENARIOS[of] for of in levels)]
    return printed(heads, rows)


def _families() -> str:
    samples = record("shapes").samples
    counts = samples.groupby("method")["sample"].transform("size")
    samples = samples[counts == counts.max()]
    psnr = samples.pivot_table(index="method", columns="family", values="psnr")
    psnr = psnr.loc[psnr.mean(axis=1).sort_values(ascending=False).index]
    (n,) = samples.groupby(["method", "family"]).size().unique()
    rows = [[f"`{method}`", *(f"{value:.1f}" for value in row)] for method, row in psnr.iterrows()]
    return printed([f"PSNR [dB] of {n} samples each", *psnr.columns], rows)


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
    rows = []
    for claim in ledger()["claims"]:
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


def _physical_loss_by_seeds() -> str:
    """Return PhyDNN minus DNN in PSNR over seeds, by operator, from the study `physics`."""
    stored = json.loads((STUDIES / "physics" / "summary.json").read_text())["rows"]
    of = {(row["scenario"], row["physics"]): row for row in stored if row["metric"] == "psnr"}
    titles = {"paper": "clean, same mesh", **SCENARIOS}
    rows = [
        [
            title,
            *(
                "{difference:+.2f} ({low:+.2f} to {high:+.2f})".format(**of[scenario, operator])
                for operator in ("surrogate", "fem")
            ),
        ]
        for scenario, title in titles.items()
    ]
    heads = ["PSNR, PhyDNN minus DNN [dB] (95 %)", "through the surrogate", "the exact model"]
    return printed(heads, rows)


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


def _size() -> str:
    """Return PSNR over the number of training samples, each seen equally often, by channels."""
    stored = pd.DataFrame(json.loads((STUDIES / "size" / "summary.json").read_text())["rows"])
    psnr = stored.pivot_table(index="backbone", columns="samples", values="psnr")
    rows = [[f"`{name}`", *(f"{value:.1f}" for value in row)] for name, row in psnr.iterrows()]
    return printed(["PSNR [dB]", *(f"{samples:,} samples" for samples in psnr)], rows)


def _wide() -> str:
    """Return what networks of two sizes reach with the published samples and epochs, by seed."""
    rows = [
        [
            f"`{row['backbone']}`", f"{row['seed']}", *_clean_figures(row)[:3],
            f"{row['psnr']:.2f} ({row['low']:.2f} to {row['high']:.2f})",
        ]
        for row in pd.read_csv(STUDIES / "wide" / "wide.csv").to_dict("records")
    ]  # fmt: skip
    return printed(["network", "seed", "SSIM", "CC", "RIE", "PSNR [dB] (95 %)"], rows)


def _supervision() -> str:
    stored = json.loads((STUDIES / "supervision" / "summary.json").read_text())
    psnr = pd.DataFrame(stored["rows"]).pivot_table(index="alpha", columns="seed", values="psnr")
    words = {1.0: "1: true images and voltages", 0.0: "0: voltages alone"}
    rows = [[words[alpha], *(f"{psnr.loc[alpha, seed]:.2f}" for seed in psnr)] for alpha in words]
    return printed(["alpha", *(f"seed {seed} [dB]" for seed in psnr)], rows)


TABLES = {
    "weights": _weights,
    "clean data": _clean,
    "symmetries": _symmetries,
    "noise and unseen shapes": _boards,
    "mean errors": _of_mean_errors,
    "families of shapes": _families,
    "losses": _losses,
    "physical loss": _physical_loss,
    "physical loss by seeds": _physical_loss_by_seeds,
    "training data": _training_data,
    "data and channels": _size,
    "published samples and epochs": _wide,
    "supervision": _supervision,
}
