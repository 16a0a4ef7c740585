"""Scenarios: simulated or recorded data, declared in full."""

from dataclasses import replace
from functools import lru_cache
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, ValidationInfo, field_validator, model_validator

from eitbench.scenarios.catalogue import is_file
from eitbench.scenarios.catalogue import sensor as sensor_by_name
from eitbench.scenarios.declaration import Declaration, Name, beside
from eitbench.scenarios.errors import EitbenchError
from eitbench.scenarios.imperfections.imperfections import Imperfections, channels
from eitbench.scenarios.imperfections.noise import Noise
from eitbench.scenarios.phantoms.families import Family, family
from eitbench.scenarios.phantoms.press import FOAM
from eitbench.scenarios.physics.forward import ForwardModel, forward_model
from eitbench.scenarios.recordings import RecordedSet, is_recording, recorded_set
from eitbench.scenarios.sensors.sensor import Sensor, content_hash
from eitbench.scenarios.sensors.sensor_file import ConductivityRange, Side

# Raised by one whenever the same declared parameters give other numbers than before.
GENERATOR_VERSION = 1

Split = Literal["train", "validation", "test"]
MAX_SNR_DB = 200.0


def _noise(value: object) -> object:
    if value in ("clean", "mixture"):
        return value
    if isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value <= MAX_SNR_DB:
        return float(value)
    raise ValueError(f'noise is an SNR of 0 to {MAX_SNR_DB:g} dB, "clean" or "mixture"')


NoiseField = Annotated[Noise, BeforeValidator(_noise)]


class SplitNoise(Declaration):
    """Noise of every split: an SNR in dB, "clean", or "mixture" (half clean, half 30-60 dB)."""

    train: NoiseField = "clean"
    validation: NoiseField = "clean"
    test: NoiseField = "clean"


class SimulatedScenario(Declaration):
    """Phantoms on a simulated sensor.

    Attributes:
        name: registry name; noise is drawn from it.
        sensor: registry name of the nominal sensor, which methods know, or the path of a sensor
            file (.toml) or of a recording (.h5).
        image_shape: (H, W) of the nominal image grid; the sensor's own by default.
        conductivity_range: least and greatest conductivity that methods expect, as
            multiples of the background; the sensor's own by default.
        families: phantom families of the test split, in equal numbers.
        training_families: those of the other two splits; `families` by default.
        noise: of every split. The reference frame is measured once, with the noise of `test`.
        mesh_refinement: the data come from a mesh this many times finer than the image grid.
        train, validation, test: number of samples.
        phantoms: name that phantoms are drawn from; scenarios that share it share their phantoms.
        imperfections: how the sensor of the test split and of the reference frame differs from the
            nominal one, which methods know, learn from and are tuned on. Scenarios that
            declare any, even none, are rungs of a ladder from simulation to reality: they are
            tuned with the noise of `validation`, which all rungs share.
        calibrated: methods get frames corrected by `calibration`, from the reference frame alone.
    """

    kind: Literal["simulated"] = "simulated"
    name: Name
    sensor: str = "foam16"
    image_shape: tuple[Side, Side] | None = None
    conductivity_range: ConductivityRange | None = None
    families: tuple[str, ...] = Field(min_length=1)
    training_families: tuple[str, ...] | None = Field(default=None, min_length=1)
    noise: SplitNoise = SplitNoise()
    mesh_refinement: int = Field(default=1, ge=1, le=8)
    train: int = Field(ge=0)
    validation: int = Field(ge=0)
    test: int = Field(ge=0)
    phantoms: str = ""
    imperfections: Imperfections | None = None
    calibrated: bool = False

    @field_validator("sensor")
    @classmethod
    def _known_sensor(cls, value: str, info: ValidationInfo) -> str:
        value = beside(value, info) if is_file(value) else value
        sensor_by_name(value)
        return value

    @field_validator("families", "training_families")
    @classmethod
    def _known_families(cls, value: tuple[str, ...] | None) -> tuple[str, ...] | None:
        for name in value or ():
            family(name)
        return value

    @model_validator(mode="after")
    def _faults_exist(self) -> Self:
        if self.imperfections is None:
            return self
        sensor = self.nominal_sensor
        if any(k >= sensor.n_electrodes for k in self.imperfections.dead):
            raise ValueError(
                f"sensor {self.sensor!r} has electrodes 0 to {sensor.n_electrodes - 1}"
            )
        count = len(channels(sensor.pattern)[1])
        if (self.imperfections.saturated or 0) >= count:
            raise ValueError(f"sensor {self.sensor!r} has channels 0 to {count - 1}")
        return self

    @property
    def title(self) -> str:
        """One line for listings."""
        noise = f"{self.noise.test:g} dB" if isinstance(self.noise.test, float) else self.noise.test
        mesh = "finer mesh" if self.mesh_refinement > 1 else "same mesh"
        return f"{self.sensor}, {noise}, {mesh}: {', '.join(self.families)}"

    @property
    def nominal_sensor(self) -> Sensor:
        """The sensor that methods know."""
        return _nominal_sensor(self.sensor, self.image_shape, self.conductivity_range)

    def data_model(self, split: Split) -> ForwardModel:
        """The forward model that the data of `split` come from."""
        imperfections = self.split_imperfections(split)
        refinement = self.mesh_refinement * imperfections.mesh_refinement
        nominal = _nominal_sensor(self.sensor, self.image_shape)
        return forward_model(_data_sensor(nominal, refinement, imperfections))

    def split_imperfections(self, split: Split) -> Imperfections:
        """Imperfections of the sensor of `split`: those of the test split; none of the others."""
        return (split == "test" and self.imperfections) or Imperfections()

    @property
    def phantom_stream(self) -> str:
        """The name phantoms are drawn from."""
        return self.phantoms or self.name

    @property
    def inverse_crime(self) -> bool:
        """True if the data come from a mesh no finer than the one methods invert with."""
        data, nominal = self.data_model("test"), forward_model(self.nominal_sensor)
        return len(data.mesh.elements) <= len(nominal.mesh.elements)

    def split_families(self, split: Split) -> tuple[Family, ...]:
        """The phantom families of `split`."""
        names = self.families if split == "test" else self.training_families or self.families
        return tuple(family(name) for name in names)

    def split_noise(self, split: Split) -> Noise:
        """The noise of `split`."""
        noise: Noise = getattr(self.noise, split)
        return noise

    def clean_parameters(self, split: Split) -> dict[str, object]:
        """Parameters that decide the voltages of `split` before noise: the key of the cache."""
        model = self.data_model(split)
        imperfections = self.split_imperfections(split)
        material: dict[str, object] = {}
        if imperfections.drift or imperfections.relaxation:
            names = {"unit", "severity", "drift", "relaxation", "reference_age_s"}
            material = {"material": imperfections.model_dump(include=names)}
        return {
            "generator": GENERATOR_VERSION,
            "sensor": model.sensor.describe(),
            "mesh": model.mesh.content_hash,
            "families": [f.describe() for f in self.split_families(split)],
            "foam": vars(FOAM),
            "phantoms": self.phantom_stream,
            "split": split,
            **material,
        }

    def data_hash(self, split: Split) -> str:
        """SHA-256 (hex) of every declared parameter and all that decides the data of `split`."""
        return content_hash(
            {
                # The declarations in a file count, not its place.
                "scenario": _declared(self, {"sensor"} if is_file(self.sensor) else set()),
                "sensor": self.nominal_sensor.describe(),
                "clean": self.clean_parameters(split),
            }
        )


class RecordedScenario(Declaration):
    """Frames of a recorded set.

    Attributes:
        name: registry name.
        recording: registry name of the recorded set, or the path of a recording of one's own (.h5).
        calibrated: methods get frames corrected by `calibration`, from the reference frame alone.
    """

    kind: Literal["recorded"] = "recorded"
    name: Name
    recording: str
    calibrated: bool = False

    @field_validator("recording")
    @classmethod
    def _known_recording(cls, value: str, info: ValidationInfo) -> str:
        if not is_recording(value):
            recorded_set(value)
            return value
        path = beside(value, info)
        # A suite file must name what is there; a run is readable without its recordings.
        if info.context:
            try:
                recorded_set(path)
            except EitbenchError as error:
                raise ValueError(str(error)) from error
        return path

    @property
    def title(self) -> str:
        """One line for listings."""
        return self.recorded_set.title

    @property
    def recorded_set(self) -> RecordedSet:
        """The set's descriptor."""
        return recorded_set(self.recording)

    @property
    def nominal_sensor(self) -> Sensor:
        """The sensor that methods know."""
        return _nominal_sensor(self.recorded_set.sensor_name)

    def data_hash(self, split: Split) -> str:
        """SHA-256 (hex) of the descriptor, its files and the sensor."""
        recorded = self.recorded_set
        own = recorded.own is not None
        return content_hash(
            {
                "generator": GENERATOR_VERSION,
                # The content of a recording of one's own counts, not its name.
                "scenario": _declared(self, {"recording"} if own else set()),
                "files": [[*([] if own else [f.path]), f.sha256] for f in recorded.files],
                "source": [recorded.repository, recorded.source.commit, recorded.truth],
                "sensor": self.nominal_sensor.describe(),
                "split": split,
            }
        )


def _declared(scenario: SimulatedScenario | RecordedScenario, apart: set[str]) -> dict[str, Any]:
    """Declared fields of a scenario but `apart`, and but optional ones at their default."""
    declared = scenario.model_dump(mode="json", exclude=apart)
    optional = {"imperfections": None, "calibrated": False}
    return {k: v for k, v in declared.items() if k not in optional or v != optional[k]}


Scenario = Annotated[SimulatedScenario | RecordedScenario, Field(discriminator="kind")]


def _nominal_sensor(
    name: str,
    image_shape: tuple[int, int] | None = None,
    conductivity_range: tuple[float, float] | None = None,
) -> Sensor:
    sensor = sensor_by_name(name)
    return _adapted(sensor, sensor.name, image_shape, conductivity_range)


# Forward models, pixel centres and masks are cached per sensor object, so equal scenarios should
# share one. Equal sensors may have several names.
@lru_cache(maxsize=64)
def _adapted(
    sensor: Sensor,
    name: str,
    image_shape: tuple[int, int] | None,
    conductivity_range: tuple[float, float] | None,
) -> Sensor:
    return replace(
        sensor,
        name=name,
        image_shape=image_shape or sensor.image_shape,
        conductivity_range=conductivity_range or sensor.conductivity_range,
    )


@lru_cache(maxsize=64)
def _data_sensor(nominal: Sensor, refinement: int, imperfections: Imperfections) -> Sensor:
    built = replace(nominal, electrodes=imperfections.built(nominal))
    return built if refinement == 1 else built.refined(refinement)
