"""Figures in sentences are read from a record; what else is typed is listed with its reason.

`typed_figures.toml` lists phrases by page and reason: "definition" (of a term, or of a format),
"setting" (of a suite, of the code, of what was done), "tested: FILE" (a bound that this test
asserts), "published: KEY" (of `references.bib`). A phrase that is the first line of a table stands
for all of it.
"""

import re
import tomllib
from pathlib import Path

import pytest
from docs.tables import DOCS, pages

ROOT = DOCS.parent
LISTED: dict[str, dict[str, list[str]]] = tomllib.loads(
    Path(__file__).with_name("typed_figures.toml").read_text()
)
PAGES = [
    str(page.relative_to(ROOT)) for page in pages() if not page.is_relative_to(DOCS / "studies")
]
_READ = r"<!-- table: .*?<!-- end of table -->|<!-- figure: .*?<!-- end -->|<!--.*?-->"
_CODE = r"^```.*?^```|`[^`]*`|\$\$.*?\$\$|\$[^$]*\$"
_ADDRESS = r"\]\([^)]*\)|\b(?:arXiv|doi):\S+"
_VERSION = r"\b(?:Python|Linux|EIDORS|Octave|MATLAB|Teensy) \(?[\d.]+\+?"
_LEFT_OUT = re.compile(f"{_READ}|{_CODE}|{_ADDRESS}|{_VERSION}", flags=re.DOTALL | re.MULTILINE)
_UNIT = (
    r"(?:dB|mm|cm|ms|s|minutes?|seconds?|hours?|days?|MB|GB|TB|kB|[KMGT]iB|times|kPa|Pa|N|S/m|nats|"
    r"frames a second|frames/s|core hours)\b|%"
)
_BEGIN = r"(?<![\w.])(?<!\w-)"  # not in a name
_TYPED = re.compile(
    rf"{_BEGIN}\d[\d,]*(?:\.\d+)?(?:e-?\d+)?\s?(?:{_UNIT})|{_BEGIN}\d+\.\d+(?![\w.]*\d)"
)
_NUMBER = re.compile(r"\|\s*[-+\d][\d.,]*(?:\s?[\d.,%()/]+)*\s*(?=\|)")


def typed(text: str, phrases: list[str]) -> list[str]:
    """Figures that a page has outside of records, code, formulas and the listed phrases."""
    rows, sentences = _split(text, phrases)
    for phrase in phrases:
        sentences = sentences.replace(_plain(phrase), " … ")
    around = (sentences[max(of.start() - 60, 0) : of.end()] for of in _TYPED.finditer(sentences))
    return [row for row in rows if _NUMBER.search(row) or _TYPED.search(row)] + list(around)


def _split(text: str, phrases: list[str]) -> tuple[list[str], str]:
    """Rows of tables whose first line is not among the phrases, and all else on one line."""
    rows, sentences = list[str](), list[str]()
    listed = False
    for line in _LEFT_OUT.sub(" … ", text).splitlines():
        if line.startswith("|"):
            listed = listed or _plain(line) in map(_plain, phrases)
            if not listed:
                rows.append(line)
        else:
            listed = False
            sentences.append(line)
    return rows, _plain(" ".join(sentences))


def _phrases(*pages: str) -> list[str]:
    """Listed for any of these pages, the longest first, as one may hold another."""
    found = [phrase for page in pages for some in LISTED.get(page, {}).values() for phrase in some]
    return sorted(found, key=len, reverse=True)


def _plain(text: str) -> str:
    return " ".join(_LEFT_OUT.sub(" … ", text).split())


@pytest.mark.parametrize("page", PAGES)
def test_no_figure_is_typed(page: str) -> None:
    found = typed((ROOT / page).read_text(), _phrases("everywhere", page))
    assert not found, f"read them from a record, or list why not (CONTRIBUTING.md): {found}"


@pytest.mark.parametrize(
    "added",
    [
        "With gains `noser` is off by 6.3 mm.",
        "Training takes 40\nminutes.",
        "It is 38 % smaller, at 50 dB.",
        "The score is 0.93.",
        "| method | ms |\n|---|---:|\n| `tv` | 34 |",
    ],
)
@pytest.mark.parametrize("page", ["README.md", "docs/results/skin.md"])
def test_a_figure_that_is_added_is_found(page: str, added: str) -> None:
    phrases = _phrases("everywhere", page)
    text = (ROOT / page).read_text()
    assert len(typed(f"{text}\n\n{added}\n", phrases)) == 1
    from_a_record = f"{text}\n\nIt is <!-- figure: x.csv y .1f -->6.3<!-- end --> mm.\n"
    assert not typed(from_a_record, phrases)


@pytest.mark.parametrize("page", sorted(LISTED.keys() - {"everywhere"}))
def test_what_is_listed_is_there(page: str) -> None:
    """Every phrase hides a figure of its page, and every reason is one."""
    text, phrases = (ROOT / page).read_text(), _phrases("everywhere", page)
    needless = [
        phrase
        for phrase in _phrases(page)
        if not typed(text, [other for other in phrases if other != phrase])
    ]
    assert not needless
    for reason in LISTED[page]:
        word, _, source = reason.partition(": ")
        assert word in ("definition", "setting", "tested", "published")
        if word == "tested":
            assert (ROOT / source).is_file()
        if word == "published":
            references = (ROOT / "reports" / "tables" / "references.bib").read_text()
            assert f"{{{source}," in references
