"""Novelty of frames from what images leave unexplained, and from their strength."""

from dataclasses import replace

import numpy as np
import pytest

from eitbench.methods import Problem
from eitbench.methods.classical.noser import Noser
from eitbench.methods.learned.novelty import FrameNovelty
from eitbench.methods.method import reconstructed
from eitbench.methods.problem import no_split
from eitbench.scenarios.data.datasets import Dataset, load
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.imperfections.imperfections import Imperfections
from eitbench.scenarios.phantoms.families import DeclaredFamily
from eitbench.scenarios.suites.scenario import SimulatedScenario, SplitNoise

DISC = DeclaredFamily(
    name="disc", shape="circle", sizes={"radius": (0.1, 0.2)}, conductivity=(0.4, 0.9)
)
KNOWN = SimulatedScenario(
    name="known", image_shape=(20, 20), conductivity_range=(0.05, 20.0), families=(DISC,),
    noise=SplitNoise(validation=50.0, test=50.0), imperfections=Imperfections(mesh="fine"),
    train=0, validation=240, test=90,
)  # fmt: skip


class Judge:
    """NOSER, with the novelty of its frames."""

    def __init__(self, count: int | None = None) -> None:
        data = load(KNOWN, "validation", count)
        self.problem = Problem(data.sensor, data.references[0], no_split)
        self.method = Noser(0.1)
        self.method.fit(self.problem)
        images = reconstructed(self.method, self.problem, data)
        self.novelty = FrameNovelty(self.problem, data, images, 0.0)

    def scores(self, data: Dataset) -> np.ndarray:
        found = []
        for k in range(len(data)):
            self.problem.reference = data.references[k]
            frame = data.voltages[k : k + 1]
            found.append(self.novelty.of(frame, self.method.reconstruct(frame))[0])
        return np.array(found)


@pytest.fixture(scope="module")
def judge() -> Judge:
    return Judge()


def test_a_threshold_of_the_frames_learned_from_holds_on_new_ones(judge: Judge) -> None:
    """Sizes come from frames that the covariance has not seen: 80 of 240 here."""
    learned, new = (judge.scores(load(KNOWN, split)) for split in ("validation", "test"))
    limit = np.quantile(learned[160:], 0.95)
    assert np.mean(new > limit) < 0.15


@pytest.mark.parametrize(
    "unknown",
    [
        {"imperfections": Imperfections(mesh="fine", dead=(3,))},
        {"families": (DISC.model_copy(update={"name": "weak", "conductivity": (0.999, 1.0)}),)},
        {"noise": SplitNoise(validation=50.0, test=30.0)},
    ],
    ids=["dead electrode", "weak touch", "noise"],
)
def test_frames_that_are_not_known_are_farther(judge: Judge, unknown: dict[str, object]) -> None:
    familiar = judge.scores(load(KNOWN, "test"))
    novel = judge.scores(load(KNOWN.model_copy(update=unknown), "test", 30))
    assert np.mean(novel[:, None] > familiar) > 0.85


def test_a_frame_without_any_change_is_finite_and_far(judge: Judge) -> None:
    data = load(KNOWN, "test", 3)
    still = replace(data, voltages=data.references.copy())
    scores = judge.scores(still)
    assert np.isfinite(scores).all()
    assert scores.min() > judge.scores(data).max()


def test_no_frame_has_no_novelty(judge: Judge) -> None:
    none = judge.problem.reference[None][:0]
    assert judge.novelty.of(none, judge.method.reconstruct(none)).shape == (0,)


def test_few_frames_are_refused() -> None:
    with pytest.raises(InputError, match="at least 15 familiar frames, got 14"):
        Judge(14)
