"""References of the paper package."""

import re

from eitbench.reports.tables.references import entries


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
