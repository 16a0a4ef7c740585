"""The test split is closed while methods learn and are tuned."""

import pytest

from eitbench.benchmark.workers.method_service import learning_splits
from eitbench.scenarios import guard, load
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.guard import check_open, close_test_split, closed_test_split, is_closed
from eitbench.scenarios.suites.scenario import SimulatedScenario

SMALL = SimulatedScenario(
    name="guarded", image_shape=(12, 12), families=("circle",), train=2, validation=2, test=2
)


def test_the_test_split_is_closed_inside_and_open_again_afterwards() -> None:
    assert not is_closed()
    with closed_test_split():
        assert is_closed()
        with closed_test_split():
            pass
        assert is_closed()  # the outer one still holds
        with pytest.raises(InputError, match="closed to methods and to tuning"):
            check_open("test")
        with pytest.raises(InputError, match="closed"):
            load(SMALL, "test")
        for split in ("train", "validation"):
            check_open(split)
            assert len(load(SMALL, split)) == 2
    assert not is_closed()
    check_open("test")
    assert len(load(SMALL, "test")) == 2


def test_it_opens_again_after_an_error() -> None:
    with pytest.raises(ZeroDivisionError), closed_test_split():
        raise ZeroDivisionError
    assert not is_closed()


def test_in_a_worker_it_is_closed_for_good(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guard, "_closed", 0)
    close_test_split()
    assert is_closed()
    with closed_test_split():
        pass
    assert is_closed()


def test_a_method_is_given_no_test_split() -> None:
    assert learning_splits(SMALL, "train", 1).split == "train"
    assert len(learning_splits(SMALL, "validation", None)) == 2
    for split in ("test", "tests", ""):
        with pytest.raises(InputError, match="train or validation split"):
            learning_splits(SMALL, split, None)
