"""The claim ledger: every published claim with its verdict, as Markdown, JSON and a page."""

import base64
import json
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from eitbench.benchmark import EitbenchError, InputError
from eitbench.benchmark.analysis.readings import FIGURES
from eitbench.benchmark.analysis.results import Run, read_run
from eitbench.benchmark.rundir import manifest
from eitbench.reports.claims.claims import CLAIMS, title
from eitbench.reports.claims.classical_rows import Audit, audit
from eitbench.reports.claims.evidence import SCENARIO, Evidence
from eitbench.reports.claims.verdicts import Verdict
from eitbench.reports.studies.summaries import budget, read_study
from eitbench.reports.tables.columns import printable
from eitbench.reports.tables.leaderboard import escape_markdown, leaderboard, to_html
from eitbench.reports.tables.published import PAPER, SSIM_IN_WORDS, TABLE_II

if TYPE_CHECKING:
    from rich.table import Table

Ledger = dict[str, Any]
FILES = {"md": "claims.md", "json": "claims.json", "html": "claims.html"}


def ledger(runs: Sequence[Path], studies: Sequence[Path] = ()) -> Ledger:
    """What the run directories and studies say of every published claim, as plain values.

    Raises:
        InputError: a path is no run directory or no study, or several runs hold the same method.
        DataCorruptError: a file of a run is damaged.
    """
    read = [read_run(path) for path in runs]
    known = {summary["study"]: summary for summary in map(read_study, studies)}
    evidence = Evidence(read, known)
    findings = [(claim, claim.finding(evidence)) for claim in CLAIMS]
    counted = Counter(finding.verdict for _, finding in findings)
    return {
        "paper": PAPER,
        "written": manifest.now(),
        "summary": {verdict.value: counted[verdict] for verdict in Verdict},
        "claims": [
            {
                "id": claim.name,
                "source": claim.source,
                "claim": claim.says,
                "verdict": finding.verdict.value,
                "why": finding.why,
                "figures": [asdict(figure) for figure in finding.figures],
                "n": finding.n,
                "conditions": finding.conditions,
                "tolerance": claim.tolerance,
                "command": claim.command,
            }
            for claim, finding in findings
        ],
        "studies": [known[name] for name in sorted(known)],
        "readings": _readings(audit(evidence)),
        "runs": [_origin(run) for run in read],
    }


def _readings(found: Audit) -> dict[str, Any]:
    methods = [
        {
            "method": of.method,
            "conditions": of.conditions,
            "says": of.says,
            "rows": [
                {"reading": "published"}
                | dict.fromkeys(FIGURES)
                | {"ssim": SSIM_IN_WORDS}
                | dict(TABLE_II[of.method]),
                *({"reading": reading.name, **reading.figures} for reading in of.readings),
            ],
        }
        for of in found.methods
    ]
    constants = [{"reading": reading.name, **reading.figures} for reading in found.constants]
    return {"methods": methods, "constants": constants, "says": found.says}


def _origin(run: Run) -> dict[str, Any]:
    """Where the figures of a run come from."""
    known = run.manifest
    return {
        "run": run.path.name,
        "suite": known["plan"]["suite"]["name"],
        "limit": known["plan"]["limit"],
        "started": known["started"],
        "command_line": known["command_line"],
        "git_commit": known["git_commit"],
        "cpu": known["machine"]["cpu"],
        "data_hash": known["data"].get(SCENARIO, {}).get("hash"),
        "weights": {cell["name"]: cell["weights"] for cell in known["cells"] if cell["weights"]},
    }


def write_ledger(found: Ledger, runs: Sequence[Path], folder: Path) -> list[Path]:
    """Write `claims.md`, `claims.json`, `claims.html` and their pictures into `folder`.

    The pictures, one of each study and one of the losses in training, are in the page itself, too,
    and so are the boards of the run directories.

    Raises:
        EitbenchError: they cannot be written.
    """
    boards = [to_html(leaderboard([run])) for run in runs]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        pictures = _pictures(found, folder)
        texts = {
            "md": to_markdown(found, pictures),
            "json": json.dumps(found, indent=2, allow_nan=False) + "\n",
            "html": to_page(found, boards, pictures),
        }
        written = [folder / name for name in FILES.values()]
        for path, text in zip(written, texts.values(), strict=True):
            path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise EitbenchError(
            f"Could not write the claim ledger into {folder}: {error.strerror or error}."
        ) from error
    return written


@dataclass(frozen=True)
class LedgerFigure:
    """A figure beside the ledger.

    Attributes:
        path: the PNG; a PDF lies beside it.
        says: what it shows.
    """

    path: Path
    says: str

    @property
    def data(self) -> str:
        """The PNG as a URL."""
        return f"data:image/png;base64,{base64.b64encode(self.path.read_bytes()).decode()}"


def _pictures(found: Ledger, folder: Path) -> list[LedgerFigure]:
    # Imported here: what draws and trains takes seconds to load.
    from eitbench.benchmark.studies.curves import paper_curves
    from eitbench.reports.figures.losses import write_losses
    from eitbench.reports.studies.training_study import draw

    pictures = []
    for summary in found["studies"]:
        path = folder / f"study-{summary['study']}.png"
        figure = draw(summary)
        figure.savefig(path, dpi=180)
        figure.savefig(path.with_suffix(".pdf"), metadata={"CreationDate": None})
        pictures.append(LedgerFigure(path, f"Study {summary['study']!r}: {budget(summary)}."))
    try:
        curves = paper_curves()
    except InputError:
        return pictures  # one of them has no weights
    path = write_losses(curves, folder)[0]
    says = "Losses of DNN and PhyDNN while the weights in use were trained, from their logs."
    return [*pictures, LedgerFigure(path, says)]


def to_markdown(found: Ledger, pictures: Sequence[LedgerFigure] = ()) -> str:
    """The ledger as Markdown, with `pictures` beside it."""
    template = _environment(autoescape=False).get_template("ledger.md.jinja")
    return template.render(ledger=found, pictures=pictures)


def to_page(found: Ledger, boards: Sequence[str], pictures: Sequence[LedgerFigure] = ()) -> str:
    """The ledger as one HTML page that needs nothing else, with `boards`, fragments of HTML."""
    template = _environment(autoescape=True).get_template("ledger.html.jinja")
    shown = [Markup(board) for board in boards]  # escaped by to_html
    return template.render(ledger=found, boards=shown, pictures=pictures)


def _environment(*, autoescape: bool) -> Environment:
    environment = Environment(
        loader=PackageLoader("eitbench.reports.claims"),
        autoescape=autoescape,  # noqa: S701, Markdown has an escape of its own
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals |= {"titles": {name: title(name) for name in FIGURES}}
    environment.filters |= {
        "number": _number,
        "code": _code,
        "md": lambda text: escape_markdown(printable(str(text))),
    }
    return environment


def _number(value: float | str | None, digits: int = 4) -> str:
    """A figure as printed; words as they are."""
    if value is None:
        return "–"
    return value if isinstance(value, str) else f"{value:.{digits}g}"


def _code(text: str) -> Markup:
    """`text` as HTML, what stands between backticks as code."""
    return Markup(re.sub("`([^`]+)`", r"<code>\1</code>", str(escape(printable(text)))))


def table(found: Ledger) -> "Table":
    """The verdicts for a terminal."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    shown = Table(box=box.SIMPLE_HEAD)
    for heading in ("Claim", "Verdict", "Why"):
        shown.add_column(heading, no_wrap=heading != "Why")
    for claim in found["claims"]:
        shown.add_row(
            claim["id"],
            Text(claim["verdict"], style=_STYLES[claim["verdict"]]),
            Text(printable(claim["why"])),
        )
    return shown


_STYLES = {
    Verdict.holds: "bold green",
    Verdict.in_part: "bold yellow",
    Verdict.fails: "bold red",
    Verdict.untestable: "dim",
}
