"""The families of phantoms: one table of shapes and ranges.

The publication names its six families but gives no ranges; these are ours. Sizes are fractions of
the sensor's side (the shorter side of its bounding box), conductivities fractions of its
background (foam16: 1 S/m, so they read as S/m). Every value is uniform in its range.

| family | shape | sizes | conductivity |
|---|---|---|---|
| `circle` | disc | radius 0.08-0.22 | 0.1-0.9 |
| `two-circles` | two discs at least 0.03 apart | radii 0.08-0.18 | 0.1-0.9, each its own |
| `l-shape` | L with two equal arms | arm 0.25-0.5, width 0.1-0.2 | 0.1-0.9 |
| `triangle` | right isosceles triangle | leg 0.25-0.5 | 0.1-0.9 |
| `rectangle` | rectangle | sides 0.12-0.45 | 0.1-0.9 |
| `ring` | concentric ring | outer radius 0.18-0.3, inner 0.4-0.65 of it | 0.1-0.9 |
| `ellipse` | ellipse | semi-axes 0.12-0.28 and 0.06-0.11 | 0.1-0.9 |
| `star` | five points | outer radius 0.15-0.28, inner 0.4-0.55 of it | 0.1-0.9 |
| `three-contacts` | three discs at least 0.03 apart | radii 0.06-0.12 | 0.1-0.9, each its own |
| `four-contacts` | four discs at least 0.03 apart | radii 0.05-0.1 | 0.1-0.9, each its own |
| `conductive` | disc or rectangle | radius 0.08-0.22, sides 0.12-0.45 | 1.1-1.9 |
| `soft-press` | disc or rectangular indenter | radius 0.06-0.15, sides 0.1-0.3 | 2-60 kPa |
| `tank-1`, `-2`, `-3` | so many of `_TANK_SHAPES` | 1, 0.85, 0.72 times theirs | 0.01 or 100 |
| `object-disc` | disc of 4 cm on a side of 10 cm | radius 0.198-0.202 | 0.3-0.7 |
| `object-small-disc` | disc of 2 cm | radius 0.099-0.101 | 0.3-0.7 |
| `object-triangle` | right isosceles triangle of 4 cm | leg 0.396-0.404 | 0.3-0.7 |
| `object-l-shape` | L of 5 cm, 2 cm wide | arm 0.495-0.505, width 0.198-0.202 | 0.3-0.7 |
| `object-ring` | ring, 6 and 3 cm | outer radius 0.297-0.303, inner 0.495-0.505 of it | 0.3-0.7 |
| `object-rectangle` | 4 by 2 cm | sides 0.396-0.404 and 0.198-0.202 | 0.3-0.7 |

The objects are those that the publication presses on its sensor (cases 8 to 13), uniformly. Their
sizes are published but for the rectangle's; 1 % of them is drawn, and the conductivities are ours.
`conductive` mirrors the contrasts of the published families. `soft-press` turns pressure into
conductivity by the law in `eitbench.scenarios.phantoms.press`. A scenario may declare families of
its own, of the same shapes.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, Field, ValidationInfo, field_validator

from eitbench.scenarios.declaration import Declaration, Name
from eitbench.scenarios.errors import unknown_name
from eitbench.scenarios.phantoms.press import PRESSURE_PA
from eitbench.scenarios.phantoms.regions import Circle, Ellipse, Polygonal, Pose, Region, Ring

Range = tuple[float, float]
Sizes = Mapping[str, float]
Corners = tuple[tuple[Any, Any], ...]
"""Places (x, y) [m] about the pose's place, of numbers or of arrays of one shape, or both."""


@dataclass(frozen=True)
class Shape:
    """A kind of region.

    Attributes:
        name: what the samples table calls it.
        sizes: range of every size, as fractions of the sensor's side; a size whose name ends in
            `ratio` is a fraction of another size.
        build: from sizes [m] and a pose to the region.
        corners: from sizes [m], numbers or arrays, to the corners of a polygon; None of others.
    """

    name: str
    sizes: Mapping[str, Range]
    build: Callable[[Sizes, Pose], Region]
    corners: Callable[[Mapping[str, Any]], Corners] | None = None


@dataclass(frozen=True)
class Family:
    """A family of phantoms.

    Attributes:
        shapes: what an inclusion may be, each as likely as the others.
        conductivity: range as fractions of the background; for a soft press see `pressure`.
        count: number of inclusions.
        gap: least distance between inclusions, as a fraction of the sensor's side.
        levels: conductivities that each inclusion draws one of, and its shape, too; none where all
            have one shape and conductivities of the range.
        pressure: range [Pa] of a soft press; None for inclusions of given conductivity.
    """

    name: str
    shapes: tuple[Shape, ...]
    conductivity: Range = (0.1, 0.9)
    count: int = 1
    gap: float = 0.0
    levels: tuple[float, ...] = ()
    pressure: Range | None = None

    def covers(self, other: "Family") -> bool:
        """True if draws of `other` look like draws of this family, in shape, number and contrast.

        Sizes are not compared.
        """
        (low, high), (least, greatest) = self.conductivity, other.conductivity
        return (
            {shape.name for shape in other.shapes} <= {shape.name for shape in self.shapes}
            and (self.count, self.pressure, self.levels)
            == (other.count, other.pressure, other.levels)
            and low <= least <= greatest <= high
        )

    def describe(self) -> dict[str, object]:
        """The ranges as plain values, for hashing and printing."""
        return {
            "name": self.name,
            "shapes": [[s.name, {k: list(v) for k, v in s.sizes.items()}] for s in self.shapes],
            "conductivity": list(self.conductivity),
            "count": self.count,
            "gap": self.gap,
            "pressure": None if self.pressure is None else list(self.pressure),
            **({"levels": list(self.levels)} if self.levels else {}),
        }


def _span(value: Range) -> Range:
    low, high = value
    if not 0 < low <= high:
        raise ValueError("a range is two numbers above 0, the smaller first")
    return value


Span = Annotated[
    tuple[
        Annotated[float, Field(allow_inf_nan=False)], Annotated[float, Field(allow_inf_nan=False)]
    ],
    AfterValidator(_span),
]


class DeclaredFamily(Declaration):
    """A family that a scenario declares itself; see `Family`.

    Attributes:
        shape: a name of `SHAPES`.
        sizes: range of every size of the shape.
    """

    name: Name
    shape: str
    sizes: dict[str, Span]
    conductivity: Span = (0.1, 0.9)
    count: int = Field(default=1, ge=1, le=10)
    gap: float = Field(default=0.0, ge=0, le=1)

    @field_validator("name")
    @classmethod
    def _new(cls, value: str) -> str:
        if value in FAMILIES:
            raise ValueError(f"there is a family {value!r} already: choose another name")
        return value

    @field_validator("shape")
    @classmethod
    def _known(cls, value: str) -> str:
        if value not in SHAPES:
            raise unknown_name("shape", value, SHAPES)
        return value

    @field_validator("sizes")
    @classmethod
    def _of_the_shape(cls, value: dict[str, Range], info: ValidationInfo) -> dict[str, Range]:
        shape = info.data.get("shape")
        if shape is None:  # wrong, and named already
            return value
        if value.keys() != SHAPES[shape].sizes.keys():
            raise ValueError(f"the sizes of {shape!r} are {', '.join(SHAPES[shape].sizes)}")
        if any(high > 1 for _, high in value.values()):
            raise ValueError(
                "a size is a fraction of the sensor's side, a ratio one of another size: at most 1"
            )
        if shape == "l-shape" and value["width"][1] >= value["arm"][0]:
            raise ValueError("the arm of an L is longer than it is wide")
        if shape == "ring" and value["inner_ratio"][1] >= 1:
            raise ValueError("the hole of a ring is smaller than the ring")
        return value

    def family(self) -> Family:
        """The family."""
        shape = replace(SHAPES[self.shape], sizes=self.sizes)
        return Family(self.name, (shape,), self.conductivity, self.count, self.gap)


def _rectangle(sizes: Mapping[str, Any]) -> Corners:
    x, y = sizes["width"] / 2, sizes["height"] / 2
    return (-x, -y), (x, -y), (x, y), (-x, y)


def _triangle(sizes: Mapping[str, Any]) -> Corners:
    # About the centroid, so that the pose's place is the middle of the contact.
    leg = sizes["leg"]
    third = leg / 3
    return (-third, -third), (leg - third, -third), (-third, leg - third)


def _l_shape(sizes: Mapping[str, Any]) -> Corners:
    arm, width = sizes["arm"], sizes["width"]
    # Centroid of the L with its outer corner at the origin, alike in x and y.
    middle = (arm**2 + arm * width - width**2) / (2 * (2 * arm - width))
    corners = ((0.0, 0.0), (arm, 0.0), (arm, width), (width, width), (width, arm), (0.0, arm))
    return tuple((x - middle, y - middle) for x, y in corners)


def _star(sizes: Mapping[str, Any]) -> Corners:
    radii = sizes["outer"], sizes["outer"] * sizes["inner_ratio"]
    return tuple(
        (radii[k % 2] * float(np.cos(angle)), radii[k % 2] * float(np.sin(angle)))
        for k, angle in enumerate(np.pi * np.arange(10) / 5)
    )


def _polygonal(
    name: str, sizes: Mapping[str, Range], corners: Callable[[Mapping[str, Any]], Corners]
) -> Shape:
    return Shape(name, sizes, lambda of, pose: Polygonal(corners(of), pose), corners)


def _disc(low: float, high: float) -> Shape:
    return Shape("circle", {"radius": (low, high)}, lambda size, pose: Circle(size["radius"], pose))


def _box(low: float, high: float) -> Shape:
    return _polygonal("rectangle", {"width": (low, high), "height": (low, high)}, _rectangle)


def _polygon(corners: int) -> Shape:
    """An irregular polygon: its corners at even angles, each at a part of the radius."""
    parts = {f"corner_{k}_ratio": (0.55, 1.0) for k in range(1, corners + 1)}

    def build(sizes: Sizes, pose: Pose) -> Region:
        angle = 2 * np.pi * np.arange(corners) / corners
        radius = sizes["radius"] * np.array([sizes[name] for name in parts])
        x, y = (radius * np.cos(angle)).tolist(), (radius * np.sin(angle)).tolist()
        return Polygonal(tuple(zip(x, y, strict=True)), pose)

    return Shape(f"polygon-{corners}", {"radius": (0.1, 0.24), **parts}, build)


_RING = Shape(
    "ring",
    {"outer": (0.18, 0.3), "inner_ratio": (0.4, 0.65)},
    lambda size, pose: Ring(size["outer"], size["outer"] * size["inner_ratio"], pose),
)
_ELLIPSE = Shape(
    "ellipse",
    {"long": (0.12, 0.28), "short": (0.06, 0.11)},
    lambda size, pose: Ellipse(size["long"], size["short"], pose),
)
_RECTANGLE = _box(0.12, 0.45)
_L_SHAPE = _polygonal("l-shape", {"arm": (0.25, 0.5), "width": (0.1, 0.2)}, _l_shape)
_TRIANGLE = _polygonal("triangle", {"leg": (0.25, 0.5)}, _triangle)
_STAR = _polygonal("star", {"outer": (0.15, 0.28), "inner_ratio": (0.4, 0.55)}, _star)

SHAPES = {
    shape.name: shape
    for shape in (_disc(0.08, 0.22), _ELLIPSE, _L_SHAPE, _RECTANGLE, _RING, _STAR, _TRIANGLE)
}
"""The kinds of regions, with the sizes of the packaged families."""

_PUBLISHED = (
    Family("circle", (_disc(0.08, 0.22),)),
    Family("two-circles", (_disc(0.08, 0.18),), count=2, gap=0.03),
    Family("l-shape", (_L_SHAPE,)),
    Family("triangle", (_TRIANGLE,)),
    Family("rectangle", (_RECTANGLE,)),
    Family("ring", (_RING,)),
)
_OTHERS = (
    Family("ellipse", (_ELLIPSE,)),
    Family("star", (_STAR,)),
    Family("three-contacts", (_disc(0.06, 0.12),), count=3, gap=0.03),
    Family("four-contacts", (_disc(0.05, 0.1),), count=4, gap=0.03),
    Family("conductive", (_disc(0.08, 0.22), _box(0.12, 0.45)), conductivity=(1.1, 1.9)),
    Family("soft-press", (_disc(0.06, 0.15), _box(0.1, 0.3)), pressure=PRESSURE_PA),
)
_PRESSED = (0.3, 0.7)
_TANK_SHAPES = (
    _disc(0.06, 0.2),
    _box(0.1, 0.35),
    replace(_TRIANGLE, sizes={"leg": (0.2, 0.45)}),
    replace(_L_SHAPE, sizes={"arm": (0.22, 0.45), "width": (0.09, 0.18)}),
    replace(_STAR, sizes={"outer": (0.12, 0.25), "inner_ratio": (0.4, 0.7)}),
    replace(_ELLIPSE, sizes={"long": (0.1, 0.22), "short": (0.05, 0.1)}),
    _polygon(4),
    _polygon(5),
    _polygon(7),
)


def _smaller(shape: Shape, factor: float) -> Shape:
    sizes = {
        name: limits if name.endswith("ratio") else (factor * limits[0], factor * limits[1])
        for name, limits in shape.sizes.items()
    }
    return replace(shape, sizes=sizes)


_TANK = tuple(
    Family(
        f"tank-{count}",
        tuple(_smaller(shape, factor) for shape in _TANK_SHAPES),
        (0.01, 100.0),
        count,
        0.02,
        levels=(0.01, 100.0),
    )
    for count, factor in ((1, 1.0), (2, 0.85), (3, 0.72))
)
_OBJECTS = (
    Family("object-disc", (_disc(0.198, 0.202),), conductivity=_PRESSED),
    Family("object-small-disc", (_disc(0.099, 0.101),), conductivity=_PRESSED),
    Family(
        "object-triangle",
        (replace(_TRIANGLE, sizes={"leg": (0.396, 0.404)}),),
        conductivity=_PRESSED,
    ),
    Family(
        "object-l-shape",
        (replace(_L_SHAPE, sizes={"arm": (0.495, 0.505), "width": (0.198, 0.202)}),),
        conductivity=_PRESSED,
    ),
    Family(
        "object-ring",
        (replace(_RING, sizes={"outer": (0.297, 0.303), "inner_ratio": (0.495, 0.505)}),),
        conductivity=_PRESSED,
    ),
    Family(
        "object-rectangle",
        (replace(_RECTANGLE, sizes={"width": (0.396, 0.404), "height": (0.198, 0.202)}),),
        conductivity=_PRESSED,
    ),
)
FAMILIES = {family.name: family for family in (*_PUBLISHED, *_OTHERS, *_TANK, *_OBJECTS)}


def family(name: str) -> Family:
    """The family called `name`.

    Raises:
        InputError: unknown name (the nearest one is suggested).
    """
    if name not in FAMILIES:
        raise unknown_name("phantom family", name, FAMILIES)
    return FAMILIES[name]
