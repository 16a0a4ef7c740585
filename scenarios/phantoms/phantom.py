"""Phantoms as values: inclusions on a sensor, drawn at random and rasterised."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.phantoms.families import Family, Shape
from eitbench.scenarios.phantoms.press import FOAM
from eitbench.scenarios.phantoms.regions import Indenter, Pose, Region
from eitbench.scenarios.sensors.outlines import Outline
from eitbench.scenarios.sensors.sensor import Sensor

# Four contacts on foam16 need about 20 tries; a hundred times more means there is no place.
MAX_TRIES = 10_000


@dataclass(frozen=True)
class Patch:
    """A region of one `conductivity` [S/m]."""

    region: Region
    conductivity: float

    def paint(self, sigma: Array, x: Array, y: Array) -> None:
        """Set the conductivity inside the region."""
        sigma[self.region.contains(x, y)] = self.conductivity


@dataclass(frozen=True)
class SoftPress:
    """An indenter, `region`, that presses on the foam with `pressure` [Pa]."""

    region: Indenter
    pressure: float

    def paint(self, sigma: Array, x: Array, y: Array) -> None:
        """Lower the conductivity under the indenter, and beside it as the foam gives way."""
        sigma *= FOAM.pressed(self.pressure, self.region.distance(x, y))


@dataclass(frozen=True)
class Phantom:
    """Inclusions on a homogeneous sensor.

    Attributes:
        family: the family it was drawn from.
        shape: kind of its inclusions; the family's name where the family has only one.
        background: conductivity [S/m] of the untouched sensor.
        inclusions: painted in order.
        parameters: what was drawn, for the table of samples; lengths in m, conductivity in S/m.
    """

    family: str
    shape: str
    background: float
    inclusions: tuple[Patch | SoftPress, ...]
    parameters: Mapping[str, float]


def rasterise(phantom: Phantom, sensor: Sensor) -> Array:
    """Conductivity (H, W) [S/m] of `phantom` at the pixel centres of `sensor`."""
    x, y = sensor.pixel_centres
    sigma = np.full(sensor.image_shape, phantom.background)
    for inclusion in phantom.inclusions:
        inclusion.paint(sigma, x, y)
    return sigma


def draw(family: Family, sensor: Sensor, rng: np.random.Generator) -> Phantom:
    """A random phantom of `family`: its inclusions lie wholly inside `sensor` and apart.

    Sizes and conductivities are drawn first, then places and rotations are tried, uniform over the
    sensor, until they fit: the place never favours small inclusions.

    Raises:
        InputError: no place was found in MAX_TRIES tries.
    """
    side = sensor.outline.shorter_side
    several = 1 if not family.levels else family.count
    shapes = [family.shapes[rng.integers(len(family.shapes))] for _ in range(several)]
    shapes *= family.count // several
    sizes = [_sizes(shape, side, rng) for shape in shapes]
    if family.levels:
        levels = rng.choice(family.levels, size=family.count)
    else:
        levels = rng.uniform(*(family.pressure or family.conductivity), size=family.count)
    built = [shape.build(s, Pose()) for shape, s in zip(shapes, sizes, strict=True)]
    poses = _places(built, sensor.outline, family.gap * side, rng)
    if poses is None:
        raise InputError(
            f"No place for a phantom of family {family.name!r} inside sensor {sensor.name!r} after "
            f"{MAX_TRIES} tries: its outline is too narrow for the sizes of that family."
        )
    if family.pressure is None:
        levels = levels * sensor.background
    inclusions = []
    parameters: dict[str, float] = {}
    for k, (shape, size, pose, level) in enumerate(
        zip(shapes, sizes, poses, levels.tolist(), strict=True)
    ):
        inclusions.append(_inclusion(family, shape.build(size, pose), level))
        number = f"_{k + 1}" if family.count > 1 else ""
        parameters |= {
            f"x{number}_m": pose.x,
            f"y{number}_m": pose.y,
            f"angle{number}_rad": pose.angle,
            f"conductivity{number}" if family.pressure is None else f"pressure{number}_pa": level,
        }
        parameters |= {size_column(n, number): v for n, v in size.items()}
    kinds = dict.fromkeys(shape.name for shape in shapes)
    name = ", ".join(kinds) if len(family.shapes) > 1 else family.name
    return Phantom(family.name, name, sensor.background, tuple(inclusions), parameters)


def _inclusion(family: Family, region: Region, level: float) -> Patch | SoftPress:
    """An inclusion of conductivity or pressure `level`, whichever the family varies."""
    if family.pressure is None:
        return Patch(region, level)
    assert isinstance(region, Indenter)
    return SoftPress(region, level)


def size_column(size: str, number: str) -> str:
    """The name of a size of an inclusion among a phantom's parameters, by its `number`, "_1".

    Lengths say their unit; what is a ratio says so.
    """
    if size.endswith("_ratio"):
        return f"{size.removesuffix('_ratio')}{number}_ratio"
    return f"{size}{number}_m"


def _sizes(shape: Shape, side: float, rng: np.random.Generator) -> dict[str, float]:
    """Sizes [m] of a `shape` on a sensor of the given `side` [m]."""
    drawn = {name: float(rng.uniform(*limits)) for name, limits in shape.sizes.items()}
    return {n: v if n.endswith("_ratio") else v * side for n, v in drawn.items()}


def _places(
    shapes: list[Region], outline: Outline, gap: float, rng: np.random.Generator
) -> list[Pose] | None:
    """Poses of the `shapes`, all in the `outline` and `gap` [m] apart; None if none were found."""
    x0, y0, x1, y1 = outline.bounds
    rims = [shape.rim() for shape in shapes]
    # Inclusions that must keep apart are discs, so the circles around them are what must not touch.
    reaches = [float(np.hypot(*rim.T).max()) for rim in rims]
    # Where the outline is notched, the tip of the notch may lie between two points of a rim.
    corners = outline.point(outline.corners).T
    for _ in range(MAX_TRIES):
        low, high = (x0, y0, 0.0), (x1, y1, 2 * np.pi)
        poses = [Pose(*pose) for pose in rng.uniform(low, high, size=(len(shapes), 3)).tolist()]
        apart = all(
            np.hypot(poses[i].x - poses[j].x, poses[i].y - poses[j].y)
            >= reaches[i] + reaches[j] + gap
            for i in range(len(poses))
            for j in range(i)
        )
        if not apart:
            continue
        points = np.concatenate([pose.place(rim) for pose, rim in zip(poses, rims, strict=True)])
        if not outline.contains(*points.T).all():
            continue
        placed = zip(shapes, poses, strict=True)
        if not any(shape.contains(*pose.local(*corners)).any() for shape, pose in placed):
            return poses
    return None


Contents = NDArray[np.uint64]
"""(n,): the first 64 bits of a SHA-256 for each sample."""


def contents(phantoms: Sequence[Phantom], voltages: NDArray[np.float64] | None) -> Contents:
    """Return the fingerprint of each sample: of its simulated phantom, or of its recorded frame.

    A simulated sample is the same touch whatever its noise, its mesh and the name of its split or
    scenario; of a recorded one only the frame is known.

    Args:
        phantoms: of simulated samples; empty for recorded ones.
        voltages: (n, M) recorded frames; not looked at where there are phantoms.
    """
    # Regions and patches are values, whose representation holds every number in full.
    texts = [repr((phantom.background, phantom.inclusions)).encode() for phantom in phantoms]
    if voltages is not None and not texts:
        texts = [frame.tobytes() for frame in voltages]
    digests = b"".join(hashlib.sha256(text).digest()[:8] for text in texts)
    return np.frombuffer(digests, dtype="<u8").astype(np.uint64)
