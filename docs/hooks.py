"""Hooks of MkDocs: generated Markdown, and formulas as MathML, without a network."""

import html
import re
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert

from eitbench.benchmark.findings.acuity_specs import ACUITY_SPECS
from eitbench.benchmark.metrics.metric_spec import MetricSpec
from eitbench.benchmark.metrics.novelty import NOVELTY, SCORES
from eitbench.benchmark.metrics.operator_metrics import OPERATOR_COSTS, OPERATOR_METRICS
from eitbench.benchmark.metrics.specs import METRICS
from eitbench.benchmark.metrics.uncertainty import UNCERTAINTY

_ROOT = Path(__file__).resolve().parents[1]
# Arithmatex's markup of $...$ and $$...$$, outside code.
_FORMULA = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', flags=re.DOTALL)
_BAR = re.compile(r"<mo>(&#x02016;|&#x0007C;)</mo>")  # would grow as tall as all that follows
_PLACE = re.compile(r"^<!-- generated: (.*?) -->$", flags=re.MULTILINE)
_MARK = re.compile(r"<!-- (?:figure: .*?|end) -->")  # see docs/tables/figures.py
_BEST = {"max": "more is better", "min": "less is better", None: "neither more nor less is better"}


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Put generated Markdown where `<!-- generated: NAME -->` stands alone on a line.

    The marks of figures are left out.
    """
    return _MARK.sub("", _PLACE.sub(lambda place: GENERATED[place[1]](), markdown))


def on_post_build(config: Any, **_: Any) -> None:
    """Leave out the page for addresses that are wrong: its links are right on one host alone."""
    (Path(config["site_dir"]) / "404.html").unlink(missing_ok=True)


def on_page_content(content: str, **_: Any) -> str:
    """Turn formulas into MathML, which browsers draw by themselves."""
    return _FORMULA.sub(_mathml, content)


def _mathml(formula: re.Match[str]) -> str:
    block = formula[1] == "div"
    drawn = convert(html.unescape(formula[2]).strip(), display="block" if block else "inline")
    if unknown := re.search(r"<m[io]>\\\w+", drawn):
        raise ValueError(f"A formula has an unknown command, {unknown[0]}: {formula[2]}")
    drawn = _BAR.sub(r'<mo stretchy="false">\1</mo>', drawn)
    return f'<div class="formula">{drawn}</div>' if block else drawn


def _cards(specs: Iterable[MetricSpec]) -> str:
    return "\n\n".join(
        f"### {spec.title} {{ #{spec.name} }}\n\n"
        f"`{spec.name}`, {'no unit' if spec.unit == '1' else spec.unit}, "
        f"{_BEST[spec.card()['best']]}.\n\n"
        f'<p class="definition">{html.escape(spec.formula)}</p>\n\n'
        f"- Computed for: {spec.domain}\n"
        f"- Counts: {spec.mask}\n"
        f"- Data range: {spec.data_range}\n"
        f"- Summed up as: {spec.card()['average']}\n\n"
        f"**Traps.** {spec.traps}"
        for spec in specs
    )


def _command_line() -> str:
    """Return the output of `typer utils docs`, one heading deeper."""
    text = subprocess.run(
        [sys.executable, "-m", "typer", "eitbench.cli", "utils", "docs", "--name", "eitbench"],
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    without_title = text.split("\n", 1)[1]
    # The lists of commands shorten their descriptions, which follow in full.
    without_title = re.sub(r"\*\*Commands\*\*:\n\n(\* .*\n)+", "", without_title)
    return re.sub(r"^Example: (.*)$", r"Example: `\1`", without_title, flags=re.MULTILINE)


def _from_root(name: str) -> str:
    """Return a page beside the folder `docs`, with links as from inside it."""
    text = (_ROOT / name).read_text().replace("](docs/", "](")
    text = text.replace("](CONTRIBUTING.md)", "](contributing.md)")
    return re.sub(r"\[(CITATION\.cff)\]\(CITATION\.cff\)", r"`\1`", text)


GENERATED = {
    "README.md": lambda: _from_root("README.md"),
    "CONTRIBUTING.md": lambda: _from_root("CONTRIBUTING.md"),
    "metrics of images": lambda: _cards(METRICS.values()),
    "metrics of operators": lambda: _cards(OPERATOR_METRICS.values()),
    "figures of uncertainty": lambda: _cards(UNCERTAINTY.values()),
    "figures of novelty": lambda: _cards((NOVELTY | SCORES).values()),
    "figures of acuity": lambda: _cards(ACUITY_SPECS.values()),
    "costs of operators": lambda: _cards(OPERATOR_COSTS.values()),
    "command line": _command_line,
    # `make site` puts the documentation below it; where files are read as they are, there is none.
    "link to the leaderboard": lambda: '<a href="../index.html">The leaderboard of this site</a>',
}
