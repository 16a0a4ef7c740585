"""From frames to live images: reference frame, methods in use and being fitted, contacts."""

import logging
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Generic, TypeVar

import numpy as np
from threadpoolctl import threadpool_limits

from eitbench.hardware.board import Frame
from eitbench.hardware.live.viewer import Contact, LiveImage
from eitbench.methods import Method, Problem, create, methods
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.data.datasets import Dataset
from eitbench.scenarios.docstrings import first_line
from eitbench.scenarios.errors import EitbenchError, InputError, unknown_name
from eitbench.scenarios.phantoms.contacts import contacts
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.recordings.frames import impossible, peak
from eitbench.scenarios.sensors.sensor import Sensor

_log = logging.getLogger(__name__)

T = TypeVar("T")

REFERENCE_FRAMES = 10
NO_DATA = (
    "it learns from simulated touches before its first image, and the live view has none: choose "
    "another method."
)


@dataclass(frozen=True, eq=False)
class Reference:
    """The reference frame of a board, and its noise.

    Attributes:
        values: (M,) the mean frame in the board's units.
        noise: rms over the values of the standard deviation of one frame [board's units].
    """

    values: Array
    noise: float

    def deviation(self, values: Array) -> float:
        """Distance of a frame (M,) from the reference frame, in standard deviations of noise."""
        distance = float(np.sqrt(np.mean((values - self.values) ** 2)))
        return distance / self.noise if self.noise > 0 else np.inf


def reference_of(sensor: Sensor, frames: Sequence[Array]) -> Reference:
    """The reference from `frames` (M,) of the untouched sensor, at least two.

    Raises:
        InputError: the frames do not match the sensor's drive pattern, or are impossible.
    """
    stack = np.array(frames)
    if (wrong := impossible(stack)).size:
        raise InputError(f"A reference frame holds {peak(stack[wrong[0]])}: take it again.")
    mean = stack.mean(axis=0)
    Problem(sensor, mean, no_data).difference(mean[None])  # as methods will take it
    noise = float(np.sqrt(np.mean(stack.var(axis=0, ddof=1))))
    return Reference(mean, noise)


def no_data(split: str, limit: int | None) -> Dataset:
    """Refuse: the live view has no data for methods that learn when they are fitted."""
    raise InputError(NO_DATA)


# A frame that differs from the reference by less than twice its noise, or an image whose contrast
# stays below 3 % of the background, shows no contact: the rule that finds contacts knows only how
# they stand out from the rest of the same image, and something always does.
TOUCHED_NOISE = 2.0
TOUCHED_CONTRAST = 0.03
MOST_CONTACTS = 10
NEED_TRAINING_DATA = frozenset(
    {"linear-learned", "linear-touch", "dnn-conformal", "greit-conformal"}
)
"""When they are fitted, they learn from simulated touches, which the live view does not have."""
_WAIT_S = 0.2


class LatestValue(Generic[T]):
    """A slot between two threads: a new value replaces one that was not taken yet."""

    def __init__(self) -> None:
        self._arrived = threading.Condition()
        self._value: T | None = None

    def put(self, value: T) -> None:
        """Replace the value."""
        with self._arrived:
            self._value = value
            self._arrived.notify()

    def take(self, wait_s: float) -> T | None:
        """Take the value out; None if none comes within `wait_s` [s]."""
        with self._arrived:
            self._arrived.wait_for(lambda: self._value is not None, wait_s)
            value, self._value = self._value, None
            return value


def usable_methods(sensor: Sensor) -> dict[str, str]:
    """Return names and descriptions of the methods that can be used on `sensor`."""
    return {name: first_line(cls) for name, cls in methods().items() if not _unusable(name, sensor)}


def _unusable(name: str, sensor: Sensor) -> str:
    """Reason why a known method cannot be used on `sensor`, as a sentence; "" if it can."""
    if name in NEED_TRAINING_DATA:
        return f"{name} cannot be used live: {NO_DATA}"
    return methods()[name].unusable(sensor)


class ImageMaker:
    """Makes a live image from a frame, in the thread that asks for it.

    A method is fitted with the model's frame of the untouched sensor for a reference, and told that
    of the board with each frame, as the interface of methods allows: a new one needs no new fit.

    Attributes:
        sensor: the nominal sensor.
        reference: of the untouched sensor; without it live images hold no image.
    """

    def __init__(
        self, sensor: Sensor, parameters: Mapping[str, Mapping[str, Any]] = MappingProxyType({})
    ) -> None:
        """Make images of `sensor`; `parameters` are those of constructors, by method."""
        self.sensor = sensor
        self._parameters = parameters
        self.reference: Reference | None = None
        self._fitted: tuple[str, Method, Problem] | None = None
        self._told = ""

    @property
    def method(self) -> str:
        """Name of the method that makes the images; "" before the first is ready."""
        return self._fitted[0] if self._fitted else ""

    def check(self, name: str) -> None:
        """Refuse a method that cannot be used.

        Raises:
            InputError: there is none called `name`, or it cannot be used on the sensor.
        """
        known = methods()
        if name not in known:
            raise unknown_name("method", name, known)
        if why := _unusable(name, self.sensor):
            raise InputError(why)

    def fit(self, name: str) -> None:
        """Fit the method `name`, and make images with it from now on.

        Raises:
            InputError: it raised an error.
        """
        model = forward_model(self.sensor)
        problem = Problem(self.sensor, model.voltages(model.background), no_data)
        try:
            method = create(name, **self._parameters.get(name, {}))
            method.fit(problem)
        except Exception as error:  # a method may be anybody's
            raise InputError(f"{name} cannot be used: {sentence_of(error)}") from error
        use_one_thread()  # what was loaded only now, too
        self._fitted = (name, method, problem)

    def live_image(self, frame: Frame) -> LiveImage:
        """Make the image of `frame` and find its contacts; what fails is said in it."""
        began = time.perf_counter()
        fitted, reference = self._fitted, self.reference
        name = fitted[0] if fitted else ""
        image: Array | None = None
        found: tuple[Contact, ...] = ()
        failed = ""
        if impossible(frame.values[None]).size:
            failed = f"The frame holds {peak(frame.values)}."
        elif fitted is not None and reference is not None:
            _, method, problem = fitted
            try:
                problem.reference = reference.values
                image = self._image(method, frame)
                found = self._contacts(image, reference, frame)
            except Exception as error:  # costs the image of this frame only
                failed = f"{name} failed on this frame: {sentence_of(error)}"
                if failed != self._told:  # or every frame would tell it
                    _log.warning("%s", failed, exc_info=error)
                self._told = failed
        return LiveImage(
            frame=frame,
            method=name,
            image=image,
            reference=reference.values if reference else None,
            contacts=found,
            failed=failed,
            image_ms=1e3 * (time.perf_counter() - began),
        )

    def _image(self, method: Method, frame: Frame) -> Array:
        image = np.asarray(method.reconstruct(frame.values[None]))
        if image.shape != (1, *self.sensor.image_shape):
            raise InputError(f"it returned an image of shape {image.shape}.")
        if not np.isfinite(image[0, self.sensor.mask]).all():
            raise InputError("its image holds a value that is not a finite number.")
        return np.asarray(image[0])

    def _contacts(self, image: Array, reference: Reference, frame: Frame) -> tuple[Contact, ...]:
        sensor = self.sensor
        contrast = image - sensor.background
        peak = np.abs(contrast[sensor.mask]).max()
        if reference.deviation(frame.values) < TOUCHED_NOISE or (
            peak < TOUCHED_CONTRAST * sensor.background
        ):
            return ()
        found = contacts(contrast[None], sensor)
        return tuple(
            Contact(x_m=float(x), y_m=float(y), strength=float(strength), area_m2=float(area))
            for (x, y), strength, area in zip(
                found.position[:MOST_CONTACTS], found.strength, found.area, strict=False
            )
        )


class Imaging(ImageMaker):
    """Images of the newest frames, made in a thread of their own; methods are fitted in another.

    Attributes:
        fitting: name of the method that is being fitted; "" if none is.
        failed: reason why the last method chosen cannot be used; "" if it can.
    """

    def __init__(
        self,
        sensor: Sensor,
        show: Callable[[LiveImage], None],
        parameters: Mapping[str, Mapping[str, Any]] = MappingProxyType({}),
    ) -> None:
        """Call `show` with every image; for `parameters` see `ImageMaker`."""
        super().__init__(sensor, parameters)
        self.fitting = self.failed = ""
        self._show = show
        self._frames: LatestValue[Frame] = LatestValue()
        self._chosen: LatestValue[str] = LatestValue()
        self._ended = threading.Event()
        self._threads = [
            threading.Thread(target=work, name=f"eitbench-{name}", daemon=True)
            for name, work in (("images", self._make_images), ("fit", self._fit_chosen))
        ]

    def start(self) -> None:
        """Start both threads; until `stop` this process computes on a single thread."""
        self._limits = use_one_thread()
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        """End both threads; a fit under way is not waited for."""
        self._ended.set()
        self._threads[0].join()
        self._limits.restore_original_limits()

    def choose(self, name: str) -> None:
        """Use the method `name` as soon as it is fitted.

        Raises:
            InputError: there is none of that name, or it cannot be used on the sensor.
        """
        self.check(name)
        self.failed = ""
        self.fitting = name
        self._chosen.put(name)

    def add(self, frame: Frame) -> None:
        """Make an image of `frame`, unless a newer frame comes first."""
        self._frames.put(frame)

    def _fit_chosen(self) -> None:
        while not self._ended.is_set():
            name = self._chosen.take(_WAIT_S)
            if name is None:
                continue
            try:
                self.fit(name)
            except InputError as error:  # it must not end the view
                self.failed = str(error)
                _log.warning("%s", self.failed, exc_info=error.__cause__)
            if self.fitting == name:
                self.fitting = ""

    def _make_images(self) -> None:
        while not self._ended.is_set():
            frame = self._frames.take(_WAIT_S)
            if frame is not None:
                self._show(self.live_image(frame))


def use_one_thread() -> threadpool_limits:
    """Limit linear algebra and torch, as far as they are loaded, to a single thread.

    A frame is so small that more threads win nothing, and where other programs keep the cores busy
    they wait for each other: `tv` made one image a second instead of ten. Returns the old limits.
    """
    if (torch := sys.modules.get("torch")) is not None:
        torch.set_num_threads(1)
    return threadpool_limits(1)


def sentence_of(error: Exception) -> str:
    """Return the error's own sentence; for one that was not foreseen, its type, too."""
    return str(error) if isinstance(error, EitbenchError) else f"{type(error).__name__}: {error}."
