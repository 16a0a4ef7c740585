"""The bibliography of a report: complete entries, those of others in it, and none that harms."""

import re
from typing import Any

import pytest

from eitbench.methods import methods
from eitbench.methods.registry import operators
from eitbench.reports.page.bibliography import bibliography
from eitbench.reports.tables.references import KEYS, RECORDINGS, entries
from eitbench.scenarios.recordings import RECORDED_SETS

NEEDED = {
    "article": {"author", "title", "journal", "year"},
    "inproceedings": {"author", "title", "booktitle", "year"},
    "misc": {"author", "title", "year"},
    "unpublished": {"author", "title", "note"},
}
OWN = """@article{mine2026,
  author = {M{\\"u}ller, A. and B\\o{}e, C.},
  title = {Mine \\& yours},
  journal = {A Journal},
  year = {2026},
  doi = {10.1000/182}
}"""


def report(sources: dict[str, str], **run: Any) -> Any:
    rows = [{"method": name} for name in sources]
    manifest = {
        "plan": {"suite": {"name": "other", "scenarios": []}},
        "data": {},
        "versions": {},
        "started": "2026-01-01",
        "sources": sources,
    }
    return {"boards": [{"views": [{"rows": rows}]}], "runs": [manifest | run]}


def test_every_entry_is_complete() -> None:
    for key, entry in entries().items():
        kind = entry[1 : entry.index("{")]
        fields = set(re.findall(r"^  (\w+) = \{.+\},?$", entry, re.MULTILINE))
        assert fields >= NEEDED[kind], key


def test_every_method_operator_and_recording_of_ours_has_its_entry() -> None:
    known = entries()
    ours: dict[str, Any] = {**methods(), **operators()}
    assert {name for name, cls in ours.items() if cls.__module__.startswith("eitbench.")} <= set(
        KEYS
    )
    assert set(RECORDINGS) == set(RECORDED_SETS)
    assert {*KEYS.values(), *RECORDINGS.values()} <= set(known)
    for name, key in KEYS.items():
        author = re.search(r"author = \{(\w+)", known[key])
        assert author is not None
        source = ours[name].source if name in ours else ""
        assert not source or author[1] in source or "Manuscript" in known[key]


def test_the_source_of_somebody_else_is_an_entry_or_a_note_with_its_doi() -> None:
    text = bibliography(report({"noser": "", "mine": OWN, "yours": "B. C., 2025, doi:10.1000/7."}))
    assert OWN in text
    assert "@misc{method-yours,\n" in text
    assert "note = {B. C., 2025, doi:10.1000/7.}" in text
    assert "  doi = {10.1000/7}\n" in text
    assert "@article{cheney1990," in text


def test_sources_of_several_methods_with_one_key_are_all_there() -> None:
    other, third = OWN.replace("Mine", "Another"), OWN.replace("mine2026", "Mine2026")
    text = bibliography(report({"mine": OWN, "same": OWN, "other": other, "third": third}))
    assert text.count("@article{mine2026,\n") == 1
    assert text.count("@article{mine2026-own,\n") == 1
    assert text.count("@article{Mine2026-own-2,\n") == 1
    assert text.count("Another") == 1


def test_recordings_and_suites_are_cited() -> None:
    suite = {
        "name": "quick",
        "title": "Two & more",
        "scenarios": [
            {"name": "ohmc16", "recording": "ohmc16"},
            {"name": "left-out", "recording": "ktc2023"},
            {"name": "own", "recording": "/home/me/touch.h5"},
        ],
    }
    text = bibliography(
        report(
            {"noser": ""},
            plan={"suite": suite},
            data={"ohmc16": {"hash": "ab" * 32}, "own": {"hash": "cd" * 32}},
            versions={"eitbench": "0.1.0"},
            started="2026-11-23T10:00:00+00:00",
        )
    )
    assert re.findall(r"@\w+\{([\w-]+),", text) == [
        "eitbench", "cheney1990", "hardman2023", "suite-quick",
    ]  # fmt: skip
    assert r"Suite quick of eitbench: Two \& more" in text
    assert "Version 0.1.0; SHA-256 of the data begins with: ohmc16 abababababab, own cdcd" in text


@pytest.mark.parametrize(
    "source",
    [
        OWN.replace("Mine", r"\input{/etc/passwd}"),
        OWN.replace("Mine", r"\write18{rm}"),
        OWN + "@misc{more, title={x}}",
        OWN.replace("Mine", "Mine } @misc{more, title={x"),
        OWN.replace("2026}", "2026"),
        "}@preamble{x",
        "100 % of \\ {",
    ],
)
def test_an_entry_that_could_do_more_is_but_a_note(source: str) -> None:
    text = bibliography(report({"mine": source}))
    _, _, own = text.partition("@misc{method-mine,")
    own, _, _ = own.partition("@misc{suite-other,")
    assert own.count("@") == 0
    escaped = own.replace(r"\textbackslash{}", "")
    assert "\\" not in re.sub(r"\\[&%_#$]|\\textasciitilde\{\}", "", escaped)
    assert own.count("{") == own.count("}") - 1  # that of the entry


def test_what_has_no_source_is_a_line() -> None:
    text = bibliography(report({"mine\n@misc": ""}))
    assert text.startswith("% mine\\n\\x40misc: no reference is known here.\n")


def test_every_work_that_the_paper_cites_has_a_reference(paper_text: str) -> None:
    titles = [
        _letters(title)
        for title in re.findall(r"^ +title *= *\{(.*)\},$", paper_text, re.MULTILINE)
    ]
    known = [_letters(entry) for entry in entries().values()]
    assert len(titles) == 17
    assert [title for title in titles if not any(title in entry for entry in known)] == []


def _letters(text: str) -> str:
    return re.sub(r"[^a-z]", "", text.lower())
