"""Choices inside the metrics: what they change is what their definitions say."""

from pathlib import Path

import numpy as np
import pytest

from eitbench.benchmark.analysis.results import read_run
from eitbench.benchmark.analysis.sensitivity import METRIC_VARIANTS, sensitivity
from eitbench.benchmark.run.runner import make_plan, start_run
from eitbench.scenarios.suites.suite import Suite


@pytest.mark.slow
def test_every_choice_is_computed_as_it_says(tmp_path: Path, tiny: Suite) -> None:
    plan = make_plan(tiny, methods=["noser", "back-projection"])
    run = read_run(start_run(plan, tmp_path / "run").path)
    found = {s.says: s for s in sensitivity({m: (run, m) for m in plan.names}, "tiny")}
    own = found["as in this benchmark"]
    for method, score in own.score.items():
        assert score == pytest.approx(run.cell("tiny", method)["score"].mean())
    assert (own.score_tau, own.ssim_tau) == (1, 1)
    # Twice the range adds 20 log10(2) dB to every PSNR, so that S orders methods as before.
    wide = found["data range doubled"]
    for method in own.score:
        gain = 0.25 * 20 * np.log10(2) + 0.25 * (wide.ssim[method] - own.ssim[method])
        assert wide.score[method] - own.score[method] == pytest.approx(gain)
    different = {round(choice.ssim["noser"], 6) for choice in found.values()}
    assert len(different) == len(METRIC_VARIANTS)


@pytest.mark.parametrize(
    ("shape", "left_out"),
    [((10, 10), {"SSIM window 11 x 11"}), ((16, 80), {"rim of 10% left out"})],
)
def test_choices_without_room_are_left_out(
    tmp_path: Path, tiny: Suite, shape: tuple[int, int], left_out: set[str]
) -> None:
    small = tiny.scenarios[0].model_copy(update={"image_shape": shape})
    suite = tiny.model_copy(update={"scenarios": (small,)})
    run = read_run(start_run(make_plan(suite, methods=["noser"]), tmp_path / "run").path)
    found = {one.says for one in sensitivity({"noser": (run, "noser")}, small.name)}
    assert {variant.says for variant in METRIC_VARIANTS} - found == left_out
