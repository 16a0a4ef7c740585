"""Scenarios: simulated or recorded data, declared in full."""

import hashlib
from dataclasses import asdict, replace
from functools import lru_cache
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import (
    BeforeValidator,
    Discriminator,
    Field,
    PrivateAttr,
    Tag,
    ValidationInfo,
    field_validator,
    model_validator,
)

from eitbench.scenarios.catalogue import is_file
from eitbench.scenarios.catalogue import sensor as sensor_by_name
from eitbench.scenarios.declaration import Declaration, Name, beside
from eitbench.scenarios.errors import EitbenchError
from eitbench.scenarios.imperfections.imperfections import Imperfections, MeshKind, channels
from eitbench.scenarios.imperfections.noise import Noise
from eitbench.scenarios.imperfections.training_units import TrainingImperfections
from eitbench.scenarios.phantoms.acuity import Acuity
from eitbench.scenarios.phantoms.families import DeclaredFamily, Family, family
from eitbench.scenarios.phantoms.phantom import Phantom
from eitbench.scenarios.phantoms.press import FOAM
from eitbench.scenarios.physics.forward import ForwardModel
from eitbench.scenarios.physics.mesh import Mesh, build_mesh, mesh_recipe, triangle_mesh
from eitbench.scenarios.physics.slab import SLAB, SlabModel
from eitbench.scenarios.recordings import RecordedSet, is_recording, recorded_set
from eitbench.scenarios.seeds import generator
from eitbench.scenarios.sensors.outlines import is_rectangle
from eitbench.scenarios.sensors.sensor import Electrode, Sensor, content_hash
from eitbench.scenarios.sensors.sensor_file import ConductivityRange, Side

# Raised by one whenever the same declared parameters give other numbers than before.
GENERATOR_VERSION = 2
BOARD_VERSION = 2
"""Of mains hum and lost frames; data without them have the hashes that they always had."""

TOUCHES = 3
"""Touches of a session: they share a unit of the sensor and a reference frame."""

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


FamilyField = Annotated[
    Annotated[str, Tag("name")] | Annotated[DeclaredFamily, Tag("declared")],
    Discriminator(lambda v: "declared" if isinstance(v, dict | DeclaredFamily) else "name"),
]


def _family(named: str | DeclaredFamily) -> Family:
    return family(named) if isinstance(named, str) else named.family()


class SimulatedScenario(Declaration):
    """Phantoms on a simulated sensor.

    Attributes:
        name: registry name; noise is drawn from it.
        sensor: registry name of the nominal sensor, which methods know, or the path of a sensor
            file (.toml) or of a recording (.h5).
        image_shape: (H, W) of the nominal image grid; the sensor's own by default.
        conductivity_range: least and greatest conductivity that methods expect, as
            multiples of the background; the sensor's own by default.
        families: phantom families of the test split, in equal numbers: names, or families of its
            own.
        training_families: those of the other two splits; `families` by default.
        noise: of every split, its reference frames included.
        train, validation, test: number of samples; a design counts those of the test split itself.
        phantoms: name that phantoms are drawn from; scenarios that share it share their phantoms.
        imperfections: how sensors and boards of the test and validation splits differ from the
            nominal ones, which methods know. Every `TOUCHES` samples are a session: on a unit of
            its own, with a reference frame of its own.
        training_imperfections: the same of the training split, on units of its own. Without them
            training data are of the nominal sensor, on the mesh that methods invert with.
        ladder: a rung of the ladder from simulation to reality. Its validation data are of the
            nominal sensor too, and methods are tuned with their noise: all rungs share them.
        calibrated: methods get frames corrected by `calibration`, from reference frames alone.
        familiar: the scenario of the suite whose frames methods know, where those of this one are
            of another condition: methods learn and are tuned on its data, and the novelty of a
            frame is to tell the two apart.
        acuity: the test split is this design instead of drawn phantoms, in its own number.
    """

    kind: Literal["simulated"] = "simulated"
    name: Name
    sensor: str = "foam16"
    image_shape: tuple[Side, Side] | None = None
    conductivity_range: ConductivityRange | None = None
    families: tuple[FamilyField, ...] = Field(min_length=1)
    training_families: tuple[FamilyField, ...] | None = Field(default=None, min_length=1)
    noise: SplitNoise = SplitNoise()
    train: int = Field(ge=0)
    validation: int = Field(ge=0)
    test: int = Field(default=0, ge=0)
    phantoms: str = ""
    imperfections: Imperfections = Imperfections()
    training_imperfections: TrainingImperfections | None = None
    ladder: bool = False
    calibrated: bool = False
    familiar: str = ""
    acuity: Acuity | None = None
    # No field: it is in no file and no manifest.
    _key: bytes = PrivateAttr(b"")

    @field_validator("sensor")
    @classmethod
    def _known_sensor(cls, value: str, info: ValidationInfo) -> str:
        value = beside(value, info) if is_file(value) else value
        sensor_by_name(value)
        return value

    @field_validator("families", "training_families")
    @classmethod
    def _known_families(
        cls, value: tuple[str | DeclaredFamily, ...] | None
    ) -> tuple[str | DeclaredFamily, ...] | None:
        for named in value or ():
            _family(named)
        return value

    @model_validator(mode="after")
    def _faults_exist(self) -> Self:
        sensor = self.nominal_sensor
        count = len(channels(sensor.pattern)[1])
        for declared in (self.imperfections, self.training_imperfections or Imperfections()):
            last = sensor.n_electrodes - 1
            if any(k > last for k in declared.dead):
                raise ValueError(f"`dead` names one of the electrodes 0 to {last} of the sensor")
            if np.isin(sensor.pattern.table, declared.dead).any(axis=1).all():
                raise ValueError("`dead` leaves no measurement: name fewer electrodes")
            of = (sensor.pattern.table[:, :, None] == np.arange(last + 1)).any(axis=1)
            spared = (~of).astype(int)
            if getattr(declared, "dead_share", 0) and (spared.T @ spared == 0).any():
                raise ValueError(
                    "`dead_share` may draw two electrodes that leave no measurement: leave it out"
                )
            if (declared.saturated or 0) >= count:
                raise ValueError(f"`saturated` names one of the channels 0 to {count - 1}")
            if declared.mesh == "slab" and not is_rectangle(sensor.outline):
                raise ValueError(f'mesh = "slab" is for rectangles, and {sensor.name!r} is none')
        return self

    @model_validator(mode="after")
    def _sized(self) -> Self:
        if self.acuity is not None:
            if not isinstance(self.noise.test, float):
                raise ValueError(
                    "acuity depends on the noise: give the SNR of your frames in dB, such as noise "
                    "= { test = 50 }"
                )
            object.__setattr__(self, "test", len(_design(self.acuity, self.nominal_sensor)))
        return self

    @property
    def nominal_sensor(self) -> Sensor:
        """The sensor that methods know."""
        return _nominal_sensor(self.sensor, self.image_shape, self.conductivity_range)

    def drawn_with(self, key: bytes) -> Self:
        """The scenario with its test split drawn with a secret `key`; b"" for the open one.

        Phantoms, units of the sensor and noise, reference frames included, are others of the same
        families, tolerances and levels. The other splits stay as they are.
        """
        found = self.model_copy()
        found._key = key
        return found

    def key(self, split: Split) -> bytes:
        """The secret key that `split` is drawn with; b"" without one."""
        return self._key if split == "test" else b""

    @property
    def hidden(self) -> str:
        """SHA-256 (hex) of the secret key of a hidden test split; "" of the open one."""
        return hashlib.sha256(self._key).hexdigest() if self._key else ""

    def data_model(self, split: Split, session: int = 0) -> ForwardModel | SlabModel:
        """The forward model that the data of a session of `split` come from."""
        imperfections = self.split_imperfections(split, session)
        nominal = _nominal_sensor(self.sensor, self.image_shape)
        return _data_model(nominal, imperfections.mesh, imperfections.built(nominal))

    def split_imperfections(self, split: Split, session: int = 0) -> Imperfections:
        """Imperfections of the unit of a session; none where the sensor is the nominal one."""
        if split == "train" and self.training_imperfections is not None:
            return self.training_imperfections.of_session(session, self.nominal_sensor.pattern)
        if split == "train" or (split == "validation" and self.ladder):
            return Imperfections()
        unit = self.imperfections.unit + session
        if key := self.key(split):
            unit = int(generator("unit", unit, key=key).integers(2**63))
        # No unit is in two splits.
        return self.imperfections.model_copy(
            update={"unit": unit if split == "test" else -1 - unit}
        )

    def sessions_differ(self, split: Split) -> bool:
        """True if touches of one session have more in common than those of two."""
        return self.split_noise(split) != "clean" or self.split_imperfections(split).drawn

    @property
    def phantom_stream(self) -> str:
        """The name phantoms are drawn from."""
        return self.phantoms or self.name

    @property
    def without_imperfections(self) -> Self:
        """The same touches on the nominal sensor, by the model that methods are given."""
        return self.model_copy(update={"imperfections": Imperfections()})

    @property
    def inverse_crime(self) -> bool:
        """True if the data come from the mesh that methods invert with."""
        return self.imperfections.mesh == "image"

    def split_families(self, split: Split) -> tuple[Family, ...]:
        """The phantom families of `split`."""
        names = self.families if split == "test" else self.training_families or self.families
        return tuple(_family(named) for named in names)

    def split_noise(self, split: Split) -> Noise:
        """The noise of `split`."""
        noise: Noise = getattr(self.noise, split)
        return noise

    def designed(self, split: Split, sample: int) -> Phantom | None:
        """The phantom of a sample that is designed; None of those that are drawn."""
        if split == "test" and self.acuity is not None:
            return _design(self.acuity, self.nominal_sensor)[sample]
        return None

    def clean_parameters(self, split: Split) -> dict[str, object]:
        """Parameters that decide the voltages of `split` before noise: the key of the cache."""
        imperfections = self.split_imperfections(split)
        if split == "train" and self.training_imperfections is not None:
            imperfections = self.training_imperfections  # what units are drawn from
        nominal = _nominal_sensor(self.sensor, self.image_shape)
        designed = split == "test"
        return {
            "generator": GENERATOR_VERSION,
            "sensor": nominal.describe(),
            "mesh": [
                imperfections.mesh,
                mesh_recipe(nominal, triangles=imperfections.mesh == "unstructured"),
                *([asdict(SLAB)] if imperfections.mesh == "slab" else []),
            ],
            "sessions": [TOUCHES, imperfections.of_voltages()],
            "families": [f.describe() for f in self.split_families(split)],
            "foam": asdict(FOAM),
            "phantoms": self.phantom_stream,
            "split": split,
            **({"hidden": self.hidden} if self.key(split) else {}),
            **({"acuity": self.acuity.model_dump(mode="json")} if designed and self.acuity else {}),
        }

    def data_hash(self, split: Split) -> str:
        """SHA-256 (hex) of every declared parameter and all that decides the data of `split`."""
        # The declarations in a file count, not its place.
        apart = {"familiar"} | ({"sensor"} if is_file(self.sensor) else set())
        boards = [self.imperfections]
        if split == "train":
            boards += [self.training_imperfections] if self.training_imperfections else []
        else:
            apart |= {"training_imperfections"}
        changed = any(board.mains * board.severity or board.lost_every for board in boards)
        return content_hash(
            {
                "scenario": _declared(self, apart),
                "sensor": self.nominal_sensor.describe(),
                "clean": self.clean_parameters(split),
                **({"board": BOARD_VERSION} if changed else {}),
            }
        )


class RecordedScenario(Declaration):
    """Frames of a recorded set.

    Attributes:
        name: registry name.
        recording: registry name of the recorded set, or the path of a recording of one's own (.h5).
        calibrated: methods get frames corrected by `calibration`, from the reference frame alone.
        familiar: as of `SimulatedScenario`.
    """

    kind: Literal["recorded"] = "recorded"
    name: Name
    recording: str
    calibrated: bool = False
    familiar: str = ""

    @field_validator("recording")
    @classmethod
    def _known_recording(cls, value: str, info: ValidationInfo) -> str:
        return _recording(value, info)

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
        validation = recorded.validation.source if recorded.validation else None
        return content_hash(
            {
                # The content of a recording of one's own counts, not its name.
                "scenario": _declared(self, {"familiar"} | ({"recording"} if own else set())),
                "files": [[*([] if own else [f.path]), f.sha256] for f in recorded.files],
                "source": [recorded.repository, recorded.source.commit, recorded.truth],
                "sensor": self.nominal_sensor.describe(),
                "split": split,
                **({"validation": [f.sha256 for f in validation.files]} if validation else {}),
            }
        )


class TransferScenario(Declaration):
    """Presses of one skin, to be located after few labelled presses of it: leave one skin out.

    Methods that learn places get `labelled` presses with their places, unlabelled ones, and the
    presses of other skins; see `scenarios.data.transfer`. Without labelled presses, their
    places are registered with the robot's coordinates afterwards.

    Attributes:
        name: registry name.
        recording: registry name of the recorded set, or the path of a recording of one's own (.h5).
        labelled: number of presses whose places methods learn from.
        others: recorded sets of other skins, all presses of which are labelled.
    """

    kind: Literal["transfer"] = "transfer"
    name: Name
    recording: str
    labelled: int = Field(ge=0)
    others: tuple[str, ...] = ()

    @field_validator("recording")
    @classmethod
    def _known_recording(cls, value: str, info: ValidationInfo) -> str:
        return _pressed(_recording(value, info))

    @field_validator("others")
    @classmethod
    def _known_others(cls, value: tuple[str, ...], info: ValidationInfo) -> tuple[str, ...]:
        others = tuple(_pressed(_recording(other, info)) for other in value)
        if info.data.get("recording") in others:
            raise ValueError("the skin that is tested cannot be one of the others")
        return others

    @property
    def recorded(self) -> RecordedScenario:
        """The recorded set on its own, whose presses methods may simulate."""
        return RecordedScenario(name="tested", recording=self.recording)

    @property
    def nominal_sensor(self) -> Sensor:
        """The sensor that methods know."""
        return self.recorded.nominal_sensor

    @property
    def calibrated(self) -> bool:
        """False: frames are given as they were measured."""
        return False

    @property
    def same_skin(self) -> str:
        """A sentence where two of the recorded sets hold the same file; else ""."""
        found: dict[str, str] = {}
        for name in (self.recording, *self.others):
            for file in recorded_set(name).files:
                if (first := found.setdefault(file.sha256, name)) != name:
                    return (
                        f"{first!r} and {name!r} hold the same file (the same SHA-256), so they "
                        "are no different skins: leave one of them out."
                    )
        return ""

    def data_hash(self, split: Split) -> str:
        """SHA-256 (hex) of what is declared, of the recorded sets, their files and sensors."""
        sets = [RecordedScenario(name="set", recording=name) for name in self.others]
        return content_hash(
            {
                "labelled": self.labelled,
                "sets": [one.data_hash(split) for one in (self.recorded, *sets)],
            }
        )


def _recording(value: str, info: ValidationInfo) -> str:
    """The name of a public set, or the absolute path of a recording of one's own."""
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


def _pressed(value: str) -> str:
    if not is_recording(value) and recorded_set(value).truth != "position":
        raise ValueError(f"the recorded set {value!r} does not know where it was pressed")
    return value


def _declared(scenario: SimulatedScenario | RecordedScenario, apart: set[str]) -> dict[str, Any]:
    """Declared fields of a scenario but `apart`, and but optional ones at their default."""
    declared = scenario.model_dump(mode="json", exclude=apart)
    optional: dict[str, object] = {
        "training_imperfections": None,
        "ladder": False,
        "calibrated": False,
        "acuity": None,
    }
    return {k: v for k, v in declared.items() if k not in optional or v != optional[k]}


Scenario = Annotated[
    SimulatedScenario | RecordedScenario | TransferScenario, Field(discriminator="kind")
]


def opened(scenario: Scenario) -> Scenario:
    """The scenario without the secret key of a hidden test split, as methods may have it."""
    return scenario.drawn_with(b"") if isinstance(scenario, SimulatedScenario) else scenario


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


@lru_cache(maxsize=8)
def _design(acuity: Acuity, sensor: Sensor) -> list[Phantom]:
    """The phantom of every sample."""
    return acuity.design(sensor)


_REFINEMENT: dict[MeshKind, int] = {"image": 1, "fine": 2, "unstructured": 3}


@lru_cache(maxsize=8)
def _data_model(
    nominal: Sensor, kind: MeshKind, electrodes: tuple[Electrode, ...]
) -> ForwardModel | SlabModel:
    """The model of one unit of the sensor `nominal`."""
    if kind == "slab":
        return SlabModel(replace(nominal, electrodes=electrodes))
    sensor = nominal if kind == "image" else nominal.refined(_REFINEMENT[kind])
    return ForwardModel(replace(sensor, electrodes=electrodes), _data_mesh(sensor, kind))


@lru_cache(maxsize=2)
def _data_mesh(sensor: Sensor, kind: MeshKind) -> Mesh:
    """The mesh of the nominal sensor; all units share it."""
    return triangle_mesh(sensor) if kind == "unstructured" else build_mesh(sensor)
