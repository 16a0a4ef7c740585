"""The figures of the claim ledger, in the order of the paper's."""

import base64
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from eitbench.benchmark.analysis.results import Run, read_run
from eitbench.reports.claims.evidence import SCENARIO
from eitbench.reports.claims.ledger import Ledger
from eitbench.reports.studies.summaries import training_budget


@dataclass(frozen=True)
class LedgerFigure:
    """A figure beside the ledger.

    Attributes:
        path: the PNG; a PDF lies beside it.
        caption: one sentence.
    """

    path: Path
    caption: str

    @property
    def data(self) -> str:
        """The PNG as a URL."""
        return f"data:image/png;base64,{base64.b64encode(self.path.read_bytes()).decode()}"


def draw_figures(
    ledger: Ledger,
    runs: Sequence[Path],
    folder: Path,
    curves: Mapping[str, pd.DataFrame] | None,
) -> list[LedgerFigure]:
    """Draw into `folder` what a reader of the paper looks for, as far as the runs hold it.

    These are the architectures, the voltages of a typical sample, the losses in training, the
    studies of `ledger`, and the published cases.
    """
    read = [read_run(run) for run in runs]
    return [
        *_architectures(folder),
        *_voltages(read, folder),
        *_training(ledger, curves, folder),
        *_cases(read, folder),
    ]


# What draws, traces and trains takes seconds to load, and is imported where it is needed.


def _architectures(folder: Path) -> Iterator[LedgerFigure]:
    from eitbench.benchmark.studies.architecture import published_networks
    from eitbench.reports.figures.architecture import TITLES, write_architectures

    networks = published_networks()
    pictures = write_architectures(networks, folder)
    for name, path in zip(networks, pictures[::2], strict=True):
        yield LedgerFigure(path, f"{TITLES[name][0]}, drawn from the code. {_READING}")


_READING = (
    "Below each layer: the number of channels and the grid, or the number of values. Arrows that "
    "meet are added or joined."
)


def _voltages(runs: Sequence[Run], folder: Path) -> Iterator[LedgerFigure]:
    from eitbench.reports.figures.style import save
    from eitbench.reports.figures.voltages import voltage_figures

    for run in runs:
        for scenario, figure in voltage_figures(run):
            if scenario == SCENARIO:
                caption = "Voltages of the touch with the median error of the last operator."
                yield LedgerFigure(save(figure, folder / "voltages")[0], caption)


def _training(
    ledger: Ledger, curves: Mapping[str, pd.DataFrame] | None, folder: Path
) -> Iterator[LedgerFigure]:
    from eitbench.reports.figures.losses import write_losses
    from eitbench.reports.figures.style import save
    from eitbench.reports.studies.training_study import draw

    for summary in ledger["studies"]:
        path = save(draw(summary), folder / f"study-{summary['study']}")[0]
        yield LedgerFigure(path, f"Study {summary['study']!r}: {training_budget(summary)}.")
    if curves is not None:
        caption = "Losses of DNN and PhyDNN while the weights in use were trained, from their logs."
        yield LedgerFigure(write_losses(curves, folder)[0], caption)


def _cases(runs: Sequence[Run], folder: Path) -> Iterator[LedgerFigure]:
    from eitbench.reports.figures.cases import published_cases
    from eitbench.reports.figures.image_grid import draw
    from eitbench.reports.figures.style import save

    for run in runs:
        for scenario, grid in published_cases(run):
            first, last = (grid.rows[k][0][0] for k in (0, -1))
            path = save(draw(grid), folder / f"cases-{scenario}")[0]
            caption = f"The published {first} to {last}: the first samples of their families."
            yield LedgerFigure(path, caption)
