"""The claim ledger as Markdown, JSON and an HTML page, with its figures."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd
from markupsafe import Markup

from eitbench.benchmark import atomic_write, writing
from eitbench.benchmark.metrics.specs import METRICS
from eitbench.reports.claims.ledger import Ledger
from eitbench.reports.claims.rules import IMAGE_METRICS
from eitbench.reports.page.ledger_figures import LedgerFigure, draw_figures
from eitbench.reports.page.rendering import render
from eitbench.reports.tables.leaderboard import FORMATS, ranked_rows

FILES = {"md": "claims.md", "json": "claims.json", "html": "claims.html"}
_TITLES = {name: METRICS[name].heading for name in IMAGE_METRICS}


def write_ledger(
    ledger: Ledger,
    runs: Sequence[Path],
    folder: Path,
    curves: Mapping[str, pd.DataFrame] | None = None,
) -> list[Path]:
    """Write `claims.md`, `claims.json`, `claims.html` and their figures into `folder`.

    The page itself holds the figures, too, and the leaderboards of the run directories. `curves`
    are the learning curves of "dnn" and "phydnn", if they have weights.

    Raises:
        EitbenchError: they cannot be written.
    """
    boards = [FORMATS["html"](ranked_rows([run])) for run in runs]
    with writing(f"the claim ledger into {folder}"):
        figures = draw_figures(ledger, runs, folder, curves)
        texts = {
            "md": to_markdown(ledger, figures),
            "json": json.dumps(ledger, indent=2, allow_nan=False) + "\n",
            "html": to_page(ledger, boards, figures),
        }
        for form, text in texts.items():
            atomic_write(folder / FILES[form], text.encode())
    return [folder / FILES[form] for form in texts]


def to_markdown(ledger: Ledger, figures: Sequence[LedgerFigure] = ()) -> str:
    """The ledger as Markdown, with `figures` beside it."""
    return render("ledger.md.jinja", ledger=ledger, figures=figures, titles=_TITLES)


def to_page(ledger: Ledger, boards: Sequence[str], figures: Sequence[LedgerFigure] = ()) -> str:
    """The ledger as one HTML page that needs nothing else, with `boards`, fragments of HTML."""
    shown = [Markup(board) for board in boards]  # escaped by to_html
    return render("ledger.html.jinja", ledger=ledger, boards=shown, figures=figures, titles=_TITLES)
