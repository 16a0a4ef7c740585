"""A method under test on one problem, and the frames that it is shown."""

from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from eitbench.benchmark.checks.checking import BrokenError, RestartingWorker, require
from eitbench.benchmark.checks.method_test_service import MethodTestService
from eitbench.benchmark.workers.audit_hook import Watch
from eitbench.benchmark.workers.method_service import Frames, Images, MethodSpec, scenario_splits
from eitbench.benchmark.workers.process import THREADS
from eitbench.benchmark.workers.worker import Reply
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.sensors.symmetry import Motion, motions
from eitbench.scenarios.suites.scenario import SimulatedScenario

# A small image on which electrodes still begin and end at pixel corners, and a finer mesh for data.
SCENARIO = SimulatedScenario(
    name="check",
    image_shape=(40, 40),
    conductivity_range=(0.05, 20.0),  # contacts of both signs are shown
    families=("circle", "rectangle"),
    mesh_refinement=2,
    train=64,
    validation=16,
    test=0,
)
# For methods that exist for certain sensors only, such as those that weights were trained for.
OWN_GRID = SCENARIO.model_copy(update={"image_shape": None, "conductivity_range": None})

CONTRAST = 0.5
"""How much conductivity falls inside the contact that most checks show."""


class MethodUnderTest:
    """The method under test on one problem, in a worker that is renewed when it is lost.

    Attributes:
        sensor: the nominal sensor.
        worker: to be asked directly where the same question must be asked again.
        log: what the method prints.
        watch: what it was seen to do.
        limit_s: seconds that fitting, and each answer, may take.
    """

    def __init__(
        self,
        scenario: SimulatedScenario,
        method: str,
        plugin: Path | None,
        limit_s: float,
        folder: Path,
    ) -> None:
        self.sensor = scenario.nominal_sensor
        self.log = folder / "log"
        self.watch = Watch(folder)
        self.limit_s = limit_s
        self._scenario = scenario
        task = MethodSpec(
            self.sensor, self.reference[0], scenario_splits(scenario), method, {}, plugin
        )
        self.worker = RestartingWorker(MethodTestService(task, self.watch), limit_s, self.log)
        self._replies: dict[bytes, Reply] = {}

    @property
    def reference(self) -> Frames:
        """The reference frame (1, M)."""
        return self.inclusion(1.0)

    def inclusion(self, factor: float) -> Frames:
        """A frame (1, M) with the conductivity multiplied by `factor` inside a disc."""
        return _inclusion(self._scenario, factor)

    @property
    def contact(self) -> Frames:
        """A frame (1, M) of a contact of the contrast `CONTRAST`."""
        return self.inclusion(1 - CONTRAST)

    @cached_property
    def frames(self) -> Frames:
        """Three different frames (3, M)."""
        return np.concatenate([self.contact, self.inclusion(0.8), self.inclusion(1.3)])

    @property
    def motions(self) -> list[Motion]:
        """The symmetries of the nominal sensor; the first changes nothing."""
        return _motions(self._scenario)

    def ask(self, frames: Frames) -> Reply:
        """What the fitted method answers to `frames`; each question is put once.

        Raises:
            BrokenError: it could not be fitted, hung or died.
        """
        key = repr(frames.shape).encode() + frames.tobytes()
        if key not in self._replies:
            self._replies[key] = self.worker.ask("reconstruct", frames)
        return self._replies[key]

    @property
    def refuses_sensor(self) -> bool:
        """Whether the method says that it cannot be fitted here."""
        try:
            self.ask(self.frames)
        except BrokenError:
            return self.worker.refused("EitbenchError")
        return False

    def images(self, frames: Frames) -> Images:
        """Images (n, H, W) of `frames`.

        Raises:
            BrokenError: there are none.
        """
        return images_of(self.ask(frames))

    def again(self, frames: Frames) -> Images:
        """The same, asked again."""
        return images_of(self.worker.ask("reconstruct", frames))

    def refit(
        self, frames: Frames, *, gain: float = 1.0, seed: int | None = None, threads: int = THREADS
    ) -> Images:
        """Images of `frames` by another of its kind, see `MethodTestService.refit`."""
        return images_of(self.worker.ask("refit", frames, gain, seed, threads))

    def contrast(self, frames: Frames) -> NDArray[np.float64]:
        """Contrast (n, P) [S/m] of the pixels inside the sensor."""
        images = self.images(frames)[:, self.sensor.mask]
        return np.asarray(images, dtype=np.float64) - self.sensor.background

    def close(self, one: Images, other: Images, fraction: float, what: str) -> str:
        """Require that images differ by no more than a `fraction` of the sensor's data range."""
        mask = self.sensor.mask
        apart = float(np.max(np.abs(one[:, mask] - other[:, mask])))
        allowed = fraction * self.sensor.data_range
        said = f"{what} differ by up to {apart:.2g} S/m; {allowed:.1g} is allowed."
        require(apart <= allowed, said)
        return said


def images_of(reply: Reply) -> Images:
    """The images of a `reply`.

    Raises:
        BrokenError: there are none.
    """
    if reply.failure is not None:
        raise BrokenError(f"{reply.failure.message.rstrip('.')}.")
    images: Images = reply.value
    return images


def disc(shape: tuple[int, int]) -> NDArray[np.bool_]:
    """(H, W): a disc off the centre, in fractions of the image."""
    y, x = (np.indices(shape) + 0.5) / np.array(shape)[:, None, None]
    return np.asarray(np.hypot(x - 0.35, y - 0.6) < 0.18)


# Checks of many methods in one process share what they are shown.
@lru_cache(maxsize=64)
def _inclusion(scenario: SimulatedScenario, factor: float) -> Frames:
    model, background = scenario.data_model("test"), scenario.nominal_sensor.background
    image = np.where(disc(model.sensor.image_shape), factor, 1.0)
    with threadpool_limits(THREADS):  # more threads make so small a solve slower
        frame = model.voltages(background * image)[None]
    frame.setflags(write=False)
    return frame


@lru_cache(maxsize=8)
def _motions(scenario: SimulatedScenario) -> list[Motion]:
    model = forward_model(scenario.nominal_sensor)
    return motions(model.sensor, model.jacobian(model.background))
