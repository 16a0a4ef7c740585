"""How far work has come is said on stderr."""

import pytest

from eitbench.scenarios import progress


def test_without_a_terminal_what_takes_long_says_how_far_it_is(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(progress, "LINE_SECONDS", 0.0)
    assert list(progress.with_bar("abc", "Drawing [x]", 3, show=True)) == ["a", "b", "c"]
    shown = capsys.readouterr()
    assert shown.err.splitlines() == [f"Drawing [x]: {n} of 3" for n in (1, 2, 3)]
    assert shown.out == ""
    assert list(progress.with_bar("abc", "Drawing", 3, show=False)) == ["a", "b", "c"]
    assert capsys.readouterr().err == ""
