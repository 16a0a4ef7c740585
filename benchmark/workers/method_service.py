"""Service of a worker: a method, which is fitted and asked for images."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import Field, asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from eitbench.benchmark.workers.messages import MAX_ARRAYS, Reply
from eitbench.benchmark.workers.worker import seed_everything, timed_answer
from eitbench.methods.method import DRAWS, Method
from eitbench.methods.problem import Problem, Splits
from eitbench.methods.registry import METHOD_REGISTRY, Registry, create, load_plugin
from eitbench.scenarios.data.datasets import Dataset, load, same_reference
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.guard import close_test_split
from eitbench.scenarios.sensors.sensor import Sensor
from eitbench.scenarios.suites.scenario import Scenario
from eitbench.scenarios.suites.suite import learned_from

Frames = NDArray[np.float64]
Statement = tuple[Callable[..., object], tuple[tuple[int, ...], ...]]
"""What states something of frames, and the shapes that it may have for each frame."""
BATCH = 32
"""Frames that a run asks for at once."""


NEW_FRAME = 1e-7
"""Relative change that makes another frame of one, in float32, too. The most that are asked for, a
thousand, change it by as much as noise of 80 dB."""


class FrameService:
    """Loads the file of a method of any kind, and times the frames of a request one by one.

    Attributes:
        registry: of the methods of this kind.
        method: its name.
        plugin: the file that registers it; None for one of the product.
        definition: gives the class of a method that this process defined, as a notebook does.
    """

    registry: ClassVar[Registry[Any]]
    method: str
    plugin: Path | None
    definition: Callable[[], type[Any]] | None

    def load_plugin(self) -> None:
        """Run the file that the method is registered in; from here on the test split is closed."""
        close_test_split()
        if self.plugin is not None:
            load_plugin(self.plugin)
        if self.definition is not None:
            self.registry.register(self.method)(self.definition())

    def times(self, most: int, seconds: float, request: str, *inputs: Frames) -> Reply:
        """Return the times [s] of a `request` with single rows of its `inputs` (n, ...), in turn.

        The first input, the frames, has its last digits changed, so that nothing is won by keeping
        answers to frames that came before. It ends after `most` of them, or with the one that
        makes them as long as `seconds`, or before one that fails; where that is the first, its
        reply is returned.
        """
        found, spent = list[float](), 0.0
        while not found or (len(found) < most and spent < seconds):
            row = len(found) % len(inputs[0])
            seed_everything()
            new = 1 + (len(found) + 1) * NEW_FRAME
            frame, *others = (array[row : row + 1] for array in inputs)
            reply: Reply = getattr(self, request)(new * frame, *others)
            if reply.failure is not None and not found:
                return reply
            if reply.failure is not None:
                break
            found.append(reply.seconds)
            spent += reply.seconds
        return Reply(found, spent)


@dataclass(eq=False)
class MethodService(FrameService):
    """Makes and fits a method for a problem, and reconstructs images.

    Attributes:
        splits: gives the training and validation splits, never the test split.
        plugin: the file that the method is registered in; no other is loaded, since loading one
            may change what is there already.
        definition: gives the class of a method that this process defined, as a notebook does.
    """

    registry: ClassVar = METHOD_REGISTRY

    sensor: Sensor
    reference: Frames
    splits: Splits
    method: str
    parameters: Mapping[str, Any]
    plugin: Path | None = None
    definition: Callable[[], type[Method]] | None = None
    _method: Method | None = field(default=None, init=False)

    @cached_property
    def problem(self) -> Problem:
        """The problem of the method."""
        return Problem(self.sensor, self.reference, self.splits)

    @property
    def _draws_fit(self) -> bool:
        """True if the draws of a batch go into one message."""
        return 4 * BATCH * (DRAWS + 1) * math.prod(self.sensor.image_shape) <= MAX_ARRAYS

    def set_up(self) -> Reply:
        """Fit the method; the reply holds its `parameters`, and attributes for the cell."""
        self.load_plugin()
        method, reply = self.fitted(self.parameters)
        said = {
            "parameters": known_parameters(method) | dict(self.parameters),
            "train_s": float(method.train_s),
            "differs": method.differs,
        }
        return replace(reply, value=said)

    def fitted(self, parameters: Mapping[str, Any]) -> tuple[Method, Reply]:
        """Return the method, fitted with `parameters`, and a reply with the time it took."""
        method = create(self.method, **parameters)
        start = time.perf_counter()
        method.fit(self.problem)
        self._method = method
        return method, Reply(None, time.perf_counter() - start)

    def prior_knowledge(self) -> Reply:
        """Return the method's `access` to its problem, and `trained_on`, of its weights."""
        assert self._method is not None
        access = asdict(self.problem.access_record())
        return Reply({"access": access, "trained_on": dict(self._method.trained_on)}, 0.0)

    def reconstruct(self, frames: Frames, references: Frames) -> Reply:
        """Return images (n, H, W), in float32, of `frames` (n, M) with `references` (n, M).

        The method is asked for the frames of one reference frame at once.
        """
        return self._images(frames, references, stating=())

    def reconstruct_and_state(self, frames: Frames, references: Frames) -> Reply:
        """Return the same with what the method states beside, if it states anything.

        Then the value has the `images`, the `uncertainty` (n, H, W) or (n, DRAWS, H, W), the
        `novelty` (n,), all in float32, and the `seconds` that each of the latter two took.
        """
        return self._images(frames, references, stating=("uncertainty", "novelty"))

    def _images(self, frames: Frames, references: Frames, *, stating: Sequence[str]) -> Reply:
        assert self._method is not None
        whole = self.sensor.image_shape
        images, seconds = np.empty((len(frames), *whole), np.float32), 0.0
        statements = {name: of for name, of in self._statements().items() if name in stating}
        stated: dict[str, NDArray[np.float32]] = {}
        more = dict.fromkeys(statements, 0.0)
        for rows in same_reference(references):
            self.problem.reference = references[rows.start]
            n = rows.stop - rows.start
            reply = timed_answer(self._method.reconstruct, [frames[rows]], (n, *whole))
            if reply.failure is not None:
                return reply
            seconds += reply.seconds
            _put(images, rows, reply.value)
            for name, (state, shapes) in statements.items():
                if name in stated:  # of one frame, that of an image would fill all draws
                    shapes = (stated[name].shape[1:],)
                reply = timed_answer(state, [frames[rows]], *((n, *shape) for shape in shapes))
                if reply.failure is not None:
                    of = replace(reply.failure, message=f"{name} {reply.failure.message}")
                    return replace(reply, failure=of)
                more[name] += reply.seconds
                if name not in stated:
                    shape = reply.value.shape[1:]
                    stated[name] = np.empty((len(frames), *shape), np.float32)
                _put(stated[name], rows, reply.value)
        if not stated:
            return Reply(images, seconds)
        return Reply({"images": images, **stated, "seconds": more}, seconds)

    def _statements(self) -> dict[str, Statement]:
        """What is asked for beside images, with the shapes that it may have for each frame."""
        method, whole = self._method, self.sensor.image_shape
        assert method is not None
        found: dict[str, Statement] = {}
        if method.states_uncertainty() and self._draws_fit:
            found["uncertainty"] = method.uncertainty, (whole, (DRAWS, *whole))
        if method.states_novelty():
            found["novelty"] = method.novelty, ((),)
        return found


def _put(kept: NDArray[np.float32], rows: slice, values: NDArray[Any]) -> None:
    # What does not fit becomes inf and is reported as such.
    with np.errstate(over="ignore"):
        kept[rows] = values


def known_parameters(method: object) -> dict[str, Any]:
    """Every constructor parameter of a method that is a dataclass, with defaults."""
    declared: dict[str, Field[Any]] = getattr(method, "__dataclass_fields__", {})
    return {name: getattr(method, name) for name, field in declared.items() if field.init}


def learning_splits(scenario: Scenario, split: str, limit: int | None) -> Dataset:
    """Return training or validation data for `scenario`; a method is never given the test split.

    For recorded presses, simulated ones are learned from, see `learned_from`.

    Raises:
        InputError: any other split was asked for.
    """
    if split not in ("train", "validation"):
        raise InputError(f"A method may ask for the train or validation split, not for {split!r}.")
    source = learned_from(scenario) if split == "train" else scenario
    return load(source, split=split, limit=limit)
