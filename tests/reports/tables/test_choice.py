"""The sentence of a choice, and its table."""

import pytest
from tests.support.choices import made_choice, tried

from eitbench.benchmark.choice.decision import Figure, Pick
from eitbench.reports.tables.choice import choice_rows, sentence

GPU = "every method tried runs without a GPU (times are of one core of Some CPU)"


def test_the_best_is_named_with_its_error_and_its_time() -> None:
    assert sentence(made_choice()) == (
        "Put `noser` behind foam16: it finds simulated touches to 5.0 mm (median of 60) in 0.7 ms "
        f"a frame; when drift as simulated is expected keep it (7.0 mm); {GPU}."
    )


def test_another_method_for_drift_defaults_and_what_was_not_tried_are_named() -> None:
    choice = made_choice(
        asked="ohmc16",
        decided_on="frames",
        drift="recorded",
        best_with_drift=Pick(method="greit"),
        tried=(tried("noser", 5.0, 0.7), tried("greit", 8.0, 0.6, chosen_by="default")),
        not_tried=("tv", "gauss-newton-noser", "gauss-newton-tv"),
    )
    assert sentence(choice) == (
        "Put `noser` behind ohmc16: it finds presses to 5.0 mm (median of 60) in 0.7 ms a frame; "
        f"when drift as recorded is expected take `greit` (10.0 mm); {GPU}; too little time was "
        "left to tune `greit`, compared as they come; 300 s ended before `tv`, "
        "`gauss-newton-noser` and `gauss-newton-tv` were tried."
    )
    stopped = choice.model_copy(update={"not_tried": ("tv",), "stopped": True})
    assert sentence(stopped).endswith("; it was stopped before `tv` was tried.")


def test_drift_that_takes_most_of_what_a_method_tells_is_said() -> None:
    lost = Figure(value=38.0, low=35.0, high=40.0)
    choice = made_choice(tried=(tried("noser", 6.0, 0.7, with_drift=lost),))
    assert "keep it (38.0 mm: of little use, so take new reference frames)" in sentence(choice)


@pytest.mark.parametrize(
    ("chosen", "other", "said"),
    [
        ("noser", "greit", " a frame, and cannot be told from `greit`; "),
        (
            "greit",
            "noser",
            " a frame, and cannot be told from `noser`, but is faster than the best of them; ",
        ),
    ],
)
def test_ties_are_said(chosen: str, other: str, said: str) -> None:
    choice = made_choice(best=Pick(method=chosen, not_told_from=(other,)))
    assert said in sentence(choice)


def test_a_deadline_that_nothing_keeps_is_said() -> None:
    rows = (tried("noser", 5.0, 120.0), tried("tv", 4.0, 500.0), tried("greit", 9.0, None))
    choice = made_choice(best=None, best_with_drift=None, tried=rows)
    assert sentence(choice).startswith(
        "No method tried makes 10 frames/s here: the fastest, `noser`, takes 1.2e+02 ms a frame; "
    )


def test_the_table_has_a_column_of_simulated_touches_where_presses_decide() -> None:
    first, second = choice_rows(made_choice())
    assert first == {
        "method": "noser",
        "place error, mm (95 %)": "5.0 (4.0–6.0)",
        "with drift": "7.0 (6.0–8.0)",
        "S": "5.00",
        "B": "0.700",
        "frame p95": "0.7 ms",
        "in time": "yes",
        "images": "100 %",
        "parameters": "tuned before",
    }
    assert second["method"] == "greit"
    assert "simulated" in choice_rows(made_choice(decided_on="frames"))[0]
