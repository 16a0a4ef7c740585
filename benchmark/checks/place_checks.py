"""The checks of methods of places: every public function, in the order they run."""

import numpy as np

from eitbench.benchmark.checks.harness import (
    NO_NETWORK,
    NO_PROGRAMS,
    NO_WRITING,
    BrokenError,
    require,
    require_own_generators,
    require_quiet,
    require_refusal,
    require_unseen,
    steady_memory,
)
from eitbench.benchmark.checks.place_under_test import PlaceUnderTest

SAME_MM = 1e-2
"""Sums in another order, and iterations that stop at a tolerance, move a place by less."""
OTHER_SEED = 12345
REFUSES = "PlaceProblem.unit(differences) raises one."
LEARNED = 0.7
"""Share of the error of guessing that a method may keep after 60 labelled presses."""


def shape(tested: PlaceUnderTest) -> None:
    """Returns (n, 2)."""
    _require_sound(tested, "shape")


def dtype(tested: PlaceUnderTest) -> None:
    """Returns real numbers."""
    _require_sound(tested, "dtype")


def unchanged_input(tested: PlaceUnderTest) -> None:
    """Leaves its input unchanged."""
    _require_sound(tested, "mutated")


def _require_sound(tested: PlaceUnderTest, kind: str) -> None:
    """Require that plain differences cause no failure, above all none of `kind`."""
    if failure := tested.worker.request("locate", tested.differences).failure:
        who = "locate " if kind in failure.kinds else ""
        raise BrokenError(f"{who}{failure.message}.", failure.trace)


def finite(tested: PlaceUnderTest) -> None:
    """Returns finite values."""
    bad = int((~np.isfinite(tested.places).all(axis=1)).sum())
    require(bad == 0, f"{bad} of {len(tested.places)} places are NaN or infinite.")


def batch_equals_single(tested: PlaceUnderTest) -> str:
    """A batch equals its single presses."""
    alone = np.concatenate([tested.ask(one[None]) for one in tested.differences[:3]])
    what = "places of a press alone and in a batch"
    return tested.close(tested.places[:3], alone, SAME_MM, what)


def order(tested: PlaceUnderTest) -> str:
    """The order of presses does not matter."""
    backwards = tested.ask(np.ascontiguousarray(tested.differences[::-1]))[::-1]
    what = "places of a batch, and of the same presses in reverse order,"
    return tested.close(tested.places, backwards, SAME_MM, what)


def learns(tested: PlaceUnderTest) -> str:
    """Labelled presses are learned from."""
    true = tested.located.places
    error, guess = (
        1e3 * float(np.median(np.hypot(*(places - true).T)))
        for places in (tested.places, true.mean(axis=0))
    )
    said = f"the median error is {error:.1f} mm, of guessing {guess:.1f} mm"
    require(error <= LEARNED * guess, f"{said}; at most {LEARNED * guess:.1f} is allowed.")
    return f"{said}; {LEARNED * guess:.1f} is allowed."


def without_labelled(tested: PlaceUnderTest) -> None:
    """Works without labelled presses."""
    found = tested.refit(labelled=False)
    require(bool(np.isfinite(found).all()), "without labelled presses it says no finite places.")


def wrong_length(tested: PlaceUnderTest) -> None:
    """Refuses differences of the wrong length."""
    reply = tested.worker.request("locate", tested.differences[:, :-1])
    require_refusal(reply, "differences with a value too few", REFUSES)


def nan_differences(tested: PlaceUnderTest) -> None:
    """Refuses differences with NaN."""
    differences = tested.differences.copy()
    differences[1, 0] = np.nan
    reply = tested.worker.request("locate", differences)
    require_refusal(reply, "differences with a NaN", REFUSES)


def seed(tested: PlaceUnderTest) -> str:
    """The global seed does not matter."""
    what = "places with two seeds of the global random generators"
    return tested.close(tested.places, tested.refit(seed=OTHER_SEED), SAME_MM, what)


def random_state(tested: PlaceUnderTest) -> None:
    """Leaves the global random state alone."""
    require_own_generators(tested.answer(dict[str, list[str]], "random_state", tested.differences))


def memory(tested: PlaceUnderTest) -> str:
    """Memory does not grow."""
    return steady_memory(tested.answer, tested.differences, "presses")


# It takes another worker, so it comes after what compares with the first one's places.
def deterministic(tested: PlaceUnderTest) -> str:
    """The same twice."""
    first = tested.places
    tested.worker.renew()
    what = "places after two fits on the same problem"
    return tested.close(first, tested.ask(tested.differences), SAME_MM, what)


def quiet(tested: PlaceUnderTest) -> None:
    """Prints nothing."""
    require_quiet(tested.log, lambda: tested.ask(tested.differences), "locate")


def threads(tested: PlaceUnderTest) -> str:
    """The thread count does not matter."""
    two = tested.refit(threads=2)
    return tested.close(tested.places, two, SAME_MM, "places found with one thread and with two")


# What the processes were seen to do comes after all that makes them do something.
def no_network(tested: PlaceUnderTest) -> None:
    """Uses no network."""
    require_unseen(tested.watch.noted("network"), *NO_NETWORK)


def no_writing(tested: PlaceUnderTest) -> None:
    """Writes nothing elsewhere."""
    require_unseen(tested.watch.noted("write"), *NO_WRITING)


def no_programs(tested: PlaceUnderTest) -> None:
    """Starts no other program."""
    require_unseen(tested.watch.noted("program"), *NO_PROGRAMS)


def in_time(tested: PlaceUnderTest) -> str:
    """Answers within the time limit."""
    reply = tested.worker.request("locate", tested.differences)
    return (
        f"fitted in {tested.worker.set_up_s:.2g} s, {len(tested.differences)} presses in "
        f"{reply.seconds:.2g} s; {tested.limit_s:g} s each are allowed."
    )
