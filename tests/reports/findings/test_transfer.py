"""The table and the figure of the error over labelled presses."""

import numpy as np
import pytest
from scipy import stats

from eitbench.benchmark.findings.transfer import SkinError, over_skins
from eitbench.reports.findings.transfer import draw, grid


def errors(method: str, labelled: int, medians: list[float]) -> list[SkinError]:
    return [
        SkinError(f"skin-{k}", labelled, method, median, 2 * median, 500, 25.0 + k)
        for k, median in enumerate(medians)
    ]


MANY = [
    *errors("ridge", 0, [9.0, 20.0, 14.0]),
    *errors("ridge", 100, [3.0, 5.0, 40.0]),
    *errors("network", 100, [4.0, 2.0]),
]


def test_skins_count_alike() -> None:
    curves = over_skins(MANY)
    assert list(curves["median_mm"]) == [14.0, 3.0, 5.0]  # by number of presses, then by error
    assert list(curves["skins"]) == [3, 2, 3]
    low, high, p90 = curves[["low_mm", "high_mm", "p90_mm"]].to_numpy(np.float64).T
    assert np.isnan([low, high]).all()  # of three skins not even their range holds 95 %
    assert p90[2] == 10.0


@pytest.mark.parametrize("skins", [6, pytest.param(13, marks=pytest.mark.slow)])
def test_the_interval_of_a_median_holds_it_as_often_as_it_says(skins: int) -> None:
    """Of 400 draws of skins whose true median is 10 mm; of five skins no interval holds 95 %."""
    rng = np.random.default_rng(0)
    held = []
    for _ in range(400):
        medians = 10 * np.exp(0.4 * rng.standard_normal(skins))
        curve = over_skins(errors("ridge", 100, medians.tolist())).iloc[0]
        held.append(curve["low_mm"] <= 10 <= curve["high_mm"])
    assert 0.93 <= np.mean(held) <= 0.99


def test_the_table_has_what_was_run() -> None:
    heads, *rows = grid(over_skins(MANY))
    assert heads == ["method", "0 labelled [mm]", "100 labelled [mm]"]
    assert [row[0] for row in rows] == ["ridge", "network"]
    assert rows[1][1:] == ["–", "3.0, 2 of 3 skins"]


def test_methods_that_cannot_be_told_apart_share_a_letter() -> None:
    """Of 13 skins; p-values of SciPy, multiplied as Holm does: 3, 2 and 1 pairs are left."""
    worst = np.full(13, 15.0)
    less = 0.1 * np.array([1, 2, 3, -4, -5, -6, 7, 8, 9, 10, 11, 12, 13])
    # No two differences are equal: SciPy's test of ties takes long.
    values = {"worst": worst, "middle": worst - less, "best": 5 + 0.01 * np.arange(13)}
    many = [error for name, of in values.items() for error in errors(name, 25, of.tolist())]
    pairs = [("best", "middle"), ("best", "worst"), ("middle", "worst")]
    p = [stats.wilcoxon(values[a], values[b]).pvalue for a, b in pairs]
    assert 3 * max(p[:2]) < 0.05
    assert 0.05 / 3 < p[2] < 0.05
    letters = over_skins(many).set_index("method")["ties"]
    assert dict(letters) == {"best": "a", "middle": "b", "worst": "c"}
    # Two more skins where it is worse, and the last two share a letter.
    noisy = values | {"middle": worst - np.where(np.isin(less, [0.7, 0.8]), -less, less)}
    assert stats.wilcoxon(noisy["middle"], noisy["worst"]).pvalue > 0.05
    many = [error for name, of in noisy.items() for error in errors(name, 25, of.tolist())]
    curves = over_skins(many)
    assert dict(curves.set_index("method")["ties"]) == {"best": "a", "middle": "b", "worst": "b"}
    assert grid(curves)[1][1].endswith(") a")
    # Nine skins are too few, and a method that lacks a skin has no letter.
    few = [error for error in many if int(error.recording[5:]) < 9]
    assert set(over_skins(few)["ties"]) == {""}
    lacking = [e for e in many if (e.method, e.recording) != ("worst", "skin-0")]
    assert list(over_skins(lacking)["ties"]) == ["a", "b", ""]


def test_no_labelled_presses_have_a_place_on_the_axis() -> None:
    panels = draw(over_skins(MANY)).axes
    assert [axes.get_title() for axes in panels] == ["ridge", "network"]
    axes = panels[0]
    assert axes.get_xscale() == "log"
    assert [label.get_text() for label in axes.get_xticklabels()] == ["0", "100"]
    assert 0 < axes.get_xticks()[0] < 100
    assert [text.get_text() for text in axes.texts] == ["guessing one place"]
    assert any(np.allclose(line.get_ydata(), 26.0) for line in axes.lines)


@pytest.mark.parametrize("counts", [[0], [0, 10], [10, 400]])
def test_few_counts_are_drawn(counts: list[int]) -> None:
    some = [error for count in counts for error in errors("ridge", count, [1.0, 2.0])]
    assert draw(over_skins(some)).axes
