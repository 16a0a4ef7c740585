"""The claim ledger as Markdown, JSON and an HTML page, with its figures."""

import base64
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from markupsafe import Markup

from eitbench.benchmark import EitbenchError, InputError
from eitbench.benchmark.metrics.specs import METRICS
from eitbench.reports.claims.ledger import Ledger
from eitbench.reports.claims.rules import IMAGE_METRICS
from eitbench.reports.page.rendering import render
from eitbench.reports.studies.summaries import training_budget
from eitbench.reports.tables.leaderboard import FORMATS, ranked_rows

FILES = {"md": "claims.md", "json": "claims.json", "html": "claims.html"}
_TITLES = {name: METRICS[name].heading for name in IMAGE_METRICS}


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


def write_ledger(ledger: Ledger, runs: Sequence[Path], folder: Path) -> list[Path]:
    """Write `claims.md`, `claims.json`, `claims.html` and their figures into `folder`.

    The page itself holds the figures, too, one of each study and one of the losses in training, and
    the leaderboards of the run directories.

    Raises:
        EitbenchError: they cannot be written.
    """
    boards = [FORMATS["html"](ranked_rows([run])) for run in runs]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        figures = _draw_figures(ledger, folder)
        texts = {
            "md": to_markdown(ledger, figures),
            "json": json.dumps(ledger, indent=2, allow_nan=False) + "\n",
            "html": to_page(ledger, boards, figures),
        }
        for form, text in texts.items():
            (folder / FILES[form]).write_text(text, encoding="utf-8")
    except OSError as error:
        raise EitbenchError(
            f"Could not write the claim ledger into {folder}: {error.strerror or error}."
        ) from error
    return [folder / FILES[form] for form in texts]


def _draw_figures(ledger: Ledger, folder: Path) -> list[LedgerFigure]:
    # Imported here: what draws and trains takes seconds to load.
    from eitbench.benchmark.studies.training_study import paper_curves
    from eitbench.reports.figures.losses import write_losses
    from eitbench.reports.figures.style import save
    from eitbench.reports.studies.training_study import draw

    figures = []
    for summary in ledger["studies"]:
        path = save(draw(summary), folder / f"study-{summary['study']}")[0]
        caption = f"Study {summary['study']!r}: {training_budget(summary)}."
        figures.append(LedgerFigure(path, caption))
    try:
        curves = paper_curves()
    except InputError:
        return figures  # one of them has no weights
    caption = "Losses of DNN and PhyDNN while the weights in use were trained, from their logs."
    return [*figures, LedgerFigure(write_losses(curves, folder)[0], caption)]


def to_markdown(ledger: Ledger, figures: Sequence[LedgerFigure] = ()) -> str:
    """The ledger as Markdown, with `figures` beside it."""
    return render("ledger.md.jinja", ledger=ledger, figures=figures, titles=_TITLES)


def to_page(ledger: Ledger, boards: Sequence[str], figures: Sequence[LedgerFigure] = ()) -> str:
    """The ledger as one HTML page that needs nothing else, with `boards`, fragments of HTML."""
    shown = [Markup(board) for board in boards]  # escaped by to_html
    return render("ledger.html.jinja", ledger=ledger, boards=shown, figures=figures, titles=_TITLES)
