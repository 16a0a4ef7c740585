"""`python -m docs.tables.drawings [FILE...]`: draw figures of pages from records, all or some."""

import sys
from collections.abc import Callable
from pathlib import Path

import matplotlib as mpl
from docs.tables.record import DOCS, record
from docs.tables.recorded import apart, skin_boards, transfer
from docs.tables.sim2real import ladder
from docs.tables.simulated import acuity
from docs.tables.uncertainty import NOISE, stated
from matplotlib.figure import Figure

from eitbench.benchmark.analysis.leaderboard import leaderboard_rows
from eitbench.benchmark.findings.drift import over_time
from eitbench.benchmark.findings.novelty import read_novelty
from eitbench.benchmark.findings.transfer import over_skins
from eitbench.benchmark.studies.superposition import FIT
from eitbench.reports.figures.cases import published_cases
from eitbench.reports.figures.error_maps import error_maps_figure
from eitbench.reports.figures.image_grid import comparison
from eitbench.reports.figures.image_grid import draw as draw_images
from eitbench.reports.figures.style import COLOURS, COLUMN, NOTE, PAGE, STYLE, new_figure, save
from eitbench.reports.findings.acuity import draw as draw_acuity
from eitbench.reports.findings.acuity import draw_depths
from eitbench.reports.findings.ladder import draw as draw_ladder
from eitbench.reports.findings.novelty import draw as draw_novelty
from eitbench.reports.findings.touches import panels
from eitbench.reports.findings.transfer import draw as draw_transfer
from eitbench.reports.findings.uncertainty import draw as draw_uncertainty
from eitbench.reports.page.error_maps import error_maps


def _new_skin() -> Figure:
    return draw_transfer(over_skins(transfer("new-skin")))


def _skin_maps() -> Figure:
    """A map for each skin, of the method that is best there."""
    maps = []
    for best, *_ in skin_boards():
        name, skin = best.row["method"], best.row["scenario"]
        about = error_maps({name: (best.run, name)}, {name: best.cell}, skin)
        assert about is not None  # a skin has enough presses, whose places are known
        maps.append((skin, about, about["maps"][0]))
    return error_maps_figure(maps, PAGE, 5)


def _skin_drift() -> Figure:
    x_label = "fifth of the presses, in order of time"
    return panels(over_time(record("drift")), "part", "error_mm", x_label, "error [mm]")


def _two_touch() -> Figure:
    """A panel for each skin: the fit of two presses, the best image, and where all images lie."""
    shares = apart()
    figure = new_figure(COLUMN, 4.4)
    # Scenario, title, and where the labels of fit, best image and all images stand.
    skins = (
        ("superposed-pairs", "hydrogel disc", (43, 0.8), (40, 0.28), (88, 0.1)),
        ("superposed-pairs-cam09-05", "two-layer skin 05", (34, 0.76), (79, 0.9), (63, 0.4)),
    )
    frames = shares[shares["method"] == FIT]
    images = shares[(shares["method"] != FIT) & shares["apart"].notna()]
    for axes, (scenario, title, *places) in zip(figure.subplots(2, 1), skins, strict=True):
        of_images = images[images["scenario"] == scenario].pivot(
            index="distance_mm", columns="method", values="apart"
        )
        best = of_images.mean().idxmax()
        least, most = of_images.min(axis=1), of_images.max(axis=1)
        axes.fill_between(of_images.index, least, most, color="0.85", lw=0)
        drawn = (
            (FIT, COLOURS[0], "fit of\ntwo presses"),
            (best, COLOURS[1], f"best image:\n{best}"),
        )
        for (method, colour, label), place in zip(drawn, places[:2], strict=True):
            of = shares[(shares["scenario"] == scenario) & (shares["method"] == method)]
            of = of[of["distance_mm"] > 0]
            error = [of["apart"] - of["low"], of["high"] - of["apart"]]
            axes.errorbar(
                of["distance_mm"], of["apart"], error, color=colour, marker="o", ms=3, lw=1.2,
                elinewidth=0.6,
            )  # fmt: skip
            axes.text(*place, label, color=colour, fontsize=NOTE, va="top")
        axes.text(*places[2], "all images", color="0.25", fontsize=NOTE)
        axes.set_title(title, loc="left")
        axes.set_ylim(-0.02, 1.05)
        axes.set_xlim(5, 113)
        axes.set_ylabel("share told apart")
        axes.grid(alpha=0.3, lw=0.4)
        if scenario == "superposed-pairs":
            real = frames[frames["scenario"] == "real-pairs"]
            axes.plot(
                real["distance_mm"], real["apart"], ls="", marker="D", ms=5, mfc="white",
                color=COLOURS[0], zorder=3,
            )  # fmt: skip
            axes.text(
                72, 0.5, "real pairs", color=COLOURS[0], fontsize=NOTE, ha="right", va="center"
            )
    axes.set_xlabel("distance of the two touches [mm]")
    return figure


def _novelty() -> Figure:
    return draw_novelty(read_novelty(record("novelty")))


def _acuity() -> Figure:
    """Maps of one method at every level of noise."""
    return draw_acuity([of for of in acuity() if of.method == "noser"])


def _uncertainty() -> Figure:
    return draw_uncertainty([one for one in stated("noise") if one.scenario in NOISE])


def _cases(suite: str) -> Figure:
    ((_, cases),) = published_cases(record(suite))
    return draw_images(cases)


def _images(suite: str, scenario: str, methods: set[str], families: tuple[str, ...] = ()) -> Figure:
    """Images of `methods`, by rank: the first kept sample of each family, or all kept ones."""
    run = record(suite)
    ranked = [row["method"] for row in leaderboard_rows([run]) if row["scenario"] == scenario]
    rows = run.samples[run.samples["scenario"] == scenario].drop_duplicates("sample")
    rows = rows[rows["sample"].isin(run.scene(scenario, sorted(rows["sample"])).sample)]
    if families:
        rows = rows[rows["family"].isin(families)].sort_values("sample").drop_duplicates("family")
    shown = [name for name in dict.fromkeys(ranked) if name in methods]
    return draw_images(comparison(run, scenario, shown, sorted(rows["sample"])))


DRAWINGS: dict[str, Callable[[], Figure]] = {
    "quick.png": lambda: _images(
        "quick",
        "quick",
        {"learned-gn", "dnn", "gauss-newton-tv", "tv", "noser"},
        ("circle", "two-circles", "triangle", "ring"),
    ),
    "ohmc16.png": lambda: _images(
        "presses",
        "ohmc16",
        {"noser", "greit", "tv", "linear-touch", "coarse-to-fine", "dnn", "back-projection"},
    ),
    "new-skin.png": _new_skin,
    "skin-maps.svg": _skin_maps,
    "skin-drift.png": _skin_drift,
    "two-touch.png": _two_touch,
    "novelty.png": _novelty,
    "sim2real.png": lambda: draw_ladder(ladder()),
    "uncertainty.png": _uncertainty,
    "cases.png": lambda: _cases("paper"),
    "objects.png": lambda: _cases("objects"),
    "acuity.png": _acuity,
    "acuity-merit.png": lambda: draw_depths(acuity()),
}
"""By their files in `docs`."""


if __name__ == "__main__":
    for name in sys.argv[1:] or DRAWINGS:
        file = Path(name)
        with mpl.rc_context(STYLE):
            save(DRAWINGS[name](), DOCS / file.stem, (file.suffix[1:],))
