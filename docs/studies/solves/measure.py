"""Image quality against forward solutions a frame, on clean frames of `paper`.

    python docs/studies/solves/measure.py docs/studies/solves/solves.csv docs/solves.png [METHOD...]

Counted are the eliminations of the exact model while frames are reconstructed, whether they give
voltages alone or the derivative, too. What is solved once for a reference frame counts for no
frame. Methods have the parameters that were selected for `paper`, but where a row says otherwise.
"""

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from eitbench.benchmark.metrics.image_metrics import psnr
from eitbench.benchmark.tuning.selection import selected_parameters
from eitbench.methods import Problem, create
from eitbench.methods.method import reconstructed
from eitbench.methods.problem import no_split
from eitbench.scenarios import load
from eitbench.scenarios.physics.forward import ForwardModel
from eitbench.scenarios.suites.suite import scenario_by_name

FRAMES = 24
TOP = 50.0
"""Of the figure [dB]: images that are right to the pixel have no PSNR to speak of."""
METHODS: tuple[tuple[str, Mapping[str, int]], ...] = (
    ("noser", {}),
    ("tv", {}),
    ("dnn", {}),
    ("learned-gn", {}),
    ("learned-gn-2", {}),
    *(("gauss-newton-noser", {"steps": steps}) for steps in (1, 2, 5)),
    *(("gauss-newton-tv", {"steps": steps}) for steps in (1, 2, 6)),
    *(("shape-posterior", {"particles": count}) for count in (100, 200)),
    ("dip", {}),
)


def measure(chosen: Sequence[str]) -> pd.DataFrame:
    """Return a row for every method, or for those that are chosen."""
    paper = scenario_by_name("paper")
    test = load(paper, limit=FRAMES)
    assert test.conductivity is not None
    solved = 0
    solve = ForwardModel._solve

    def counting(model: ForwardModel, images: np.ndarray, *, fields: bool) -> object:
        nonlocal solved
        solved += len(images)
        return solve(model, images, fields=fields)

    rows = []
    for name, parameters in METHODS:
        if chosen and name not in chosen:
            continue
        problem = Problem(test.sensor, test.references[0], no_split)
        method = create(name, **{**(selected_parameters(paper, name) or {}), **parameters})
        method.fit(problem)
        method.reconstruct(test.voltages[:1])
        solved = 0
        ForwardModel._solve = counting
        images = reconstructed(method, problem, test)
        ForwardModel._solve = solve
        figures = psnr(test.conductivity, images, 1.0)
        said = ", ".join(f"{key} {value}" for key, value in parameters.items())
        rows.append((name, said, solved / FRAMES, figures.mean(), float(np.median(figures))))
        print(rows[-1], flush=True)
    return pd.DataFrame(rows, columns=["method", "parameters", "solves", "psnr", "psnr_median"])


def draw(table: pd.DataFrame, path: Path) -> None:
    """Draw the median PSNR over solutions a frame; methods without any stand at the left."""
    figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
    for name, of in table.groupby("method", sort=False):
        at = of["solves"].clip(lower=0.5)
        shown = of["psnr_median"].clip(upper=TOP - 1)
        (line,) = axes.plot(at, shown, "o-")
        reached = of["psnr_median"].iloc[-1]
        exact = f" ↑ to the pixel: {reached:.0f} dB" if reached > TOP else ""
        axes.annotate(
            name + exact, (at.iloc[-1], shown.iloc[-1]), (8, -2), textcoords="offset points",
            color=line.get_color(), fontsize=8,
        )  # fmt: skip
    axes.set_xscale("log")
    axes.set_xlim(0.4, 9000)
    axes.set_ylim(15, TOP)
    axes.set_xticks([0.5, 1, 10, 100, 1000], ["0", "1", "10", "100", "1,000"])
    axes.set_xlabel("forward solutions a frame")
    axes.set_ylabel("median PSNR [dB]")
    axes.grid(visible=True, alpha=0.3)
    figure.savefig(path, dpi=150)


if __name__ == "__main__":
    table, picture, *names = sys.argv[1:]
    found = measure(names)
    if names:
        stored = pd.read_csv(table)
        found = pd.concat([stored[~stored["method"].isin(names)], found])
        order = {name: k for k, (name, _) in enumerate(METHODS)}
        found = found.sort_values("method", key=lambda of: of.map(order), kind="stable")
    found.to_csv(table, index=False, float_format="%.6g", lineterminator="\n")
    draw(found, Path(picture))
