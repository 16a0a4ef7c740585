"""Names of files that Linux, macOS and Windows take, and tell apart."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eitbench.benchmark.rundir.cells import Cell
from eitbench.benchmark.rundir.file_names import file_name

NAMES = st.text(st.characters(exclude_categories=["Cs"]))


@pytest.mark.parametrize("name", ["noser", "gauss-newton-tv", "paper-2_x", "0.1.0"])
def test_a_plain_name_stays(name: str) -> None:
    assert file_name(name) == name


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("con", "%63on"),
        ("nul.txt", "%6Eul.txt"),
        ("com1", "%63om1"),
        ("..", "%2E%2E"),
        ("a.", "a%2E"),
        ("a ", "a%20"),
        ("a/b", "a%2Fb"),
        ("a:b", "a%3Ab"),
        ("", "%"),
    ],
)
def test_names_that_a_system_keeps_for_itself_are_encoded(name: str, expected: str) -> None:
    assert file_name(name) == expected


def test_methods_that_differ_in_case_alone_have_folders_of_their_own() -> None:
    """On macOS and Windows Foo and foo are one folder."""
    names = ["foo", "Foo", "FOO", file_name("Foo").lower()]
    assert len({Cell("s", name).folders[1].lower() for name in names}) == len(names)


@given(NAMES)
def test_any_text_is_one_file_name(text: str) -> None:
    name = file_name(text)
    assert re.fullmatch(r"[A-Za-z0-9_.%~-]{1,122}", name)
    assert name[0] != "." != name[-1]
    assert not re.match(r"(?i)(con|prn|aux|nul|com\d|lpt\d)(\.|$)", name)


@given(NAMES, NAMES)
def test_different_texts_have_different_names(one: str, other: str) -> None:
    assert (one == other) == (file_name(one).lower() == file_name(other).lower())
