"""Phantoms: their ranges, their place inside any outline, and their image on any grid."""

import re

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from tests.support.families import PUBLISHED_FAMILIES, TANK_FAMILIES

from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.imperfections.imperfections import TYPICAL
from eitbench.scenarios.phantoms import families
from eitbench.scenarios.phantoms.families import FAMILIES, DeclaredFamily, family
from eitbench.scenarios.phantoms.phantom import Phantom, draw, rasterise
from eitbench.scenarios.phantoms.regions import Circle, Ellipse, Polygonal, Pose, Region, Ring
from eitbench.scenarios.seeds import generator
from eitbench.scenarios.sensors.outlines import Disc, Outline, Polygon, rectangle
from eitbench.scenarios.sensors.patterns import offset_pattern
from eitbench.scenarios.sensors.sensor import Sensor, even_electrodes, foam16
from eitbench.scenarios.suites.scenario import SimulatedScenario, SplitNoise

OUTLINES: dict[str, Outline] = {
    "square": rectangle(0.1, 0.1),
    "flat": rectangle(0.3, 0.1),
    "disc": Disc(0.05),
    "l": Polygon(((0, 0), (0.16, 0), (0.16, 0.08), (0.08, 0.08), (0.08, 0.16), (0, 0.16))),
}
SQUARE = foam16()
ALIKE = sorted(set(FAMILIES) - set(TANK_FAMILIES))
"""Families whose inclusions have one shape, and conductivities of one range."""


def sensor_on(outline: Outline, background: float = 1.0) -> Sensor:
    electrodes = even_electrodes(outline, 16, outline.perimeter / 64, 1e-3)
    return Sensor("test", outline, electrodes, offset_pattern(16, 3), background, (40, 40))


def regions(phantom: Phantom) -> list[Region]:
    return [inclusion.region for inclusion in phantom.inclusions]


@pytest.mark.parametrize("outline", OUTLINES)
@settings(max_examples=40, deadline=None)
@example(name="circle", sample=3857)  # between two points of its rim lay the tip of the notch
@given(name=st.sampled_from(ALIKE), sample=st.integers(0, 10**6))
def test_inclusions_lie_wholly_inside(outline: str, name: str, sample: int) -> None:
    if outline == "l":
        # In a notched outline the widest shapes have hardly any place.
        name = "circle"
    sensor = sensor_on(OUTLINES[outline])
    phantom = draw(family(name), sensor, generator("inside", name, sample))
    x0, y0, x1, y1 = sensor.outline.bounds
    x, y = np.meshgrid(
        np.linspace(x0 - 0.05, x1 + 0.05, 200), np.linspace(y0 - 0.05, y1 + 0.05, 200)
    )
    outside = ~sensor.outline.contains(x, y)
    for region in regions(phantom):
        assert region.contains(x, y).any()
        assert not (region.contains(x, y) & outside).any()


@settings(max_examples=100, deadline=None)
@given(name=st.sampled_from(["two-circles", "three-contacts", "four-contacts"]), k=st.integers(0))
def test_contacts_keep_their_gap_and_have_their_own_values(name: str, k: int) -> None:
    phantom = draw(family(name), SQUARE, generator("gap", k))
    p = phantom.parameters
    numbers = range(1, family(name).count + 1)
    for i in numbers:
        for j in range(1, i):
            apart = np.hypot(p[f"x_{i}_m"] - p[f"x_{j}_m"], p[f"y_{i}_m"] - p[f"y_{j}_m"])
            assert apart - p[f"radius_{i}_m"] - p[f"radius_{j}_m"] >= 0.03 * 0.1
    assert len({p[f"conductivity_{i}"] for i in numbers}) == len(numbers)


@pytest.mark.parametrize("name", TANK_FAMILIES)
def test_objects_in_a_tank_differ_in_shape_and_are_of_either_kind(name: str) -> None:
    tank = sensor_on(OUTLINES["disc"])
    drawn = [draw(family(name), tank, generator("tank", name, k)) for k in range(60)]
    levels, shapes = set(), set()
    x, y = tank.pixel_centres
    for phantom in drawn:
        found = regions(phantom)
        assert len(found) == family(name).count
        assert np.sum([of.contains(x, y) for of in found], axis=0).max() <= 1  # none overlaps
        assert not any((of.contains(x, y) & ~tank.mask).any() for of in found)
        levels |= {value for key, value in phantom.parameters.items() if "conductivity" in key}
        shapes |= set(phantom.shape.split(", "))
    assert levels == {0.01, 100.0}
    assert shapes == {shape.name for shape in family(name).shapes}
    mixed = [p for p in drawn if len({i.conductivity for i in p.inclusions}) > 1]  # type: ignore[union-attr]
    assert (len(mixed) > 10) == (family(name).count > 1)


def test_published_families_have_the_published_ranges() -> None:
    ranges = {
        name: {key: limits for shape in family(name).shapes for key, limits in shape.sizes.items()}
        for name in PUBLISHED_FAMILIES
    }
    assert ranges == {
        "circle": {"radius": (0.08, 0.22)},
        "two-circles": {"radius": (0.08, 0.18)},
        "l-shape": {"arm": (0.25, 0.5), "width": (0.1, 0.2)},
        "triangle": {"leg": (0.25, 0.5)},
        "rectangle": {"width": (0.12, 0.45), "height": (0.12, 0.45)},
        "ring": {"outer": (0.18, 0.3), "inner_ratio": (0.4, 0.65)},
    }
    assert {family(name).conductivity for name in PUBLISHED_FAMILIES} == {(0.1, 0.9)}


@pytest.mark.parametrize("name", ALIKE)
def test_documented_table_is_the_one_in_use(name: str) -> None:
    (row,) = [line for line in (families.__doc__ or "").splitlines() if f"| `{name}` |" in line]
    kind = family(name)
    used = {limits for shape in kind.shapes for limits in shape.sizes.values()}
    low, high = kind.pressure or kind.conductivity
    used.add((low / 1e3, high / 1e3) if kind.pressure else (low, high))
    documented = {(float(a), float(b)) for a, b in re.findall(r"([\d.]+)-([\d.]+)", row)}
    assert used <= documented
    assert ("at least 0.03 apart" in row) == (kind.gap == 0.03)


@pytest.mark.parametrize("name", ALIKE)
def test_draws_fill_their_ranges_and_nothing_more(name: str) -> None:
    kind = family(name)
    drawn = [draw(kind, SQUARE, generator("range", name, k)).parameters for k in range(300)]
    level = "conductivity" if kind.pressure is None else "pressure"
    ranges = {level: kind.pressure or kind.conductivity}
    if len(kind.shapes) == 1:
        ranges |= kind.shapes[0].sizes
    for key, (low, high) in ranges.items():
        values = np.array([v for p in drawn for n, v in p.items() if n.startswith(key)])
        if key not in (level, "inner_ratio"):
            values = values / 0.1
        assert low <= values.min() < low + 0.03 * (high - low)
        assert high - 0.03 * (high - low) < values.max() <= high
        assert np.mean(values) == pytest.approx((low + high) / 2, abs=0.06 * (high - low))


@pytest.mark.parametrize("name", ALIKE)
def test_places_do_not_favour_small_inclusions(name: str) -> None:
    # All sizes are drawn before a place is tried, and the place is found for every one of them.
    for k in range(100):
        rng = generator("size", name, k)
        shape = family(name).shapes[rng.integers(len(family(name).shapes))]
        first, limits = next(iter(shape.sizes.items()))
        expected = rng.uniform(*limits) * 0.1
        p = draw(family(name), SQUARE, generator("size", name, k)).parameters
        assert p[f"{first}_1_m" if family(name).count > 1 else f"{first}_m"] == expected


def test_conductivity_is_relative_to_the_background() -> None:
    low = draw(family("circle"), sensor_on(OUTLINES["square"], 0.2), generator("b"))
    unit = draw(family("circle"), sensor_on(OUTLINES["square"], 1.0), generator("b"))
    assert low.parameters["conductivity"] == pytest.approx(0.2 * unit.parameters["conductivity"])
    assert rasterise(low, sensor_on(OUTLINES["square"], 0.2)).max() == 0.2


@pytest.mark.parametrize("name", ALIKE)
def test_image_has_the_right_area_on_every_grid(name: str) -> None:
    phantom = draw(family(name), SQUARE, generator("area", name))
    images = [rasterise(phantom, SQUARE.refined(k)) for k in (1, 2, 4)]
    contrast = [float(np.mean(image - 1.0)) for image in images]
    assert abs(contrast[0]) > 1e-3
    assert contrast[1] == pytest.approx(contrast[2], rel=0.02)
    assert contrast[0] == pytest.approx(contrast[2], rel=0.06)
    assert (images[0] > 0).all()
    if name == "conductive":
        assert images[0].min() == 1.0
        assert images[0].max() > 1.0
    else:
        assert images[0].max() <= 1.0


def test_row_grows_with_y_and_column_with_x() -> None:
    phantom = draw(family("circle"), SQUARE, generator("axes"))
    row, column = np.argwhere(rasterise(phantom, SQUARE) < 1).mean(axis=0)
    assert (column + 0.5) * 0.1 / 80 == pytest.approx(phantom.parameters["x_m"], abs=5e-4)
    assert (row + 0.5) * 0.1 / 80 == pytest.approx(phantom.parameters["y_m"], abs=5e-4)


def polygon_of(sizes: dict[str, float], name: str) -> Region:
    return family(name).shapes[0].build(sizes, Pose(0.05, 0.04, 0.3))


@pytest.mark.parametrize(
    ("region", "area"),
    [
        (Circle(0.02, Pose(0.05, 0.04)), np.pi * 4e-4),
        (Ellipse(0.03, 0.01, Pose(0.05, 0.04, 0.3)), np.pi * 3e-4),
        (Ring(0.02, 0.01, Pose(0.05, 0.04)), np.pi * 3e-4),
        (polygon_of({"width": 0.03, "height": 0.02}, "rectangle"), 6e-4),
        (polygon_of({"leg": 0.04}, "triangle"), 8e-4),
        (polygon_of({"arm": 0.04, "width": 0.015}, "l-shape"), 2 * 6e-4 - 2.25e-4),
        (
            polygon_of({"outer": 0.03, "inner_ratio": 0.5}, "star"),
            10 * 0.5 * 0.03 * 0.015 * np.sin(np.pi / 5),
        ),
    ],
)
def test_regions_have_their_area_about_their_centre(region: Region, area: float) -> None:
    step = 1e-4
    x, y = np.meshgrid(np.arange(0, 0.1, step) + step / 2, np.arange(0, 0.1, step) + step / 2)
    inside = region.contains(x, y)
    assert inside.sum() * step**2 == pytest.approx(area, rel=0.005)
    assert x[inside].mean() == pytest.approx(0.05, abs=step)
    assert y[inside].mean() == pytest.approx(0.04, abs=step)


@pytest.mark.parametrize(
    "indenter",
    [Circle(0.02, Pose(0.05, 0.05)), polygon_of({"width": 0.03, "height": 0.02}, "rectangle")],
)
def test_distance_is_that_to_the_nearest_point_of_the_rim(indenter: Circle | Polygonal) -> None:
    x, y = np.random.default_rng(0).uniform(0, 0.1, size=(2, 200))
    angle = np.linspace(0, 2 * np.pi, 4000)
    if isinstance(indenter, Circle):
        rim = indenter.pose.place(
            indenter.radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        )
    else:
        rim = indenter.polygon.point(np.linspace(0, indenter.polygon.perimeter, 4000))
    nearest = np.hypot(x[:, None] - rim[:, 0], y[:, None] - rim[:, 1]).min(axis=1)
    expected = np.where(indenter.contains(x, y), 0.0, nearest)
    assert np.allclose(indenter.distance(x, y), expected, atol=2e-5)


def test_first_phantom_of_the_paper_is_pinned() -> None:
    # A change here changes every data set: raise GENERATOR_VERSION.
    p = draw(family("circle"), SQUARE, generator("phantom", "paper", "test", 0)).parameters
    pinned = {
        "x_m": 0.046124886,
        "y_m": 0.032670665,
        "angle_rad": 3.956171563,
        "radius_m": 0.012141,
        "conductivity": 0.42608609,
    }
    assert p == pytest.approx(pinned, rel=1e-6)


def test_frames_of_imperfect_units_with_noise_are_pinned() -> None:
    """Their noise, units and reference frames; other numbers need a new GENERATOR_VERSION, too."""
    scenario = SimulatedScenario(
        name="pinned",
        image_shape=(16, 16),
        families=("circle", "star"),
        noise=SplitNoise(test=40),
        train=0,
        validation=0,
        test=4,
        imperfections=TYPICAL,
    )
    data = load(scenario)
    of_two_units = data.voltages[[0, 3]][:, [0, 77, 150]]
    pinned = [[1.05877662, -0.158862698, -0.364560909], [1.14262631, -0.181881359, -0.274356378]]
    assert of_two_units == pytest.approx(np.array(pinned), rel=1e-6)
    pinned = [[1.01689769, -0.152477947], [1.07681561, -0.16956518]]
    assert data.references[[0, 3]][:, [0, 77]] == pytest.approx(np.array(pinned), rel=1e-6)


def test_too_narrow_an_outline_is_refused_in_one_sentence() -> None:
    cross = Polygon(((0.0, 0.0), (1.0, 0.98), (1.0, 1.0), (0.98, 1.0)))
    electrodes = even_electrodes(cross, 4, 0.001, 1e-3)
    sensor = Sensor("sliver", cross, electrodes, offset_pattern(4, 1))
    with pytest.raises(InputError, match=r"No place for a phantom of family 'rectangle'.*'sliver'"):
        draw(family("rectangle"), sensor, generator("narrow"))


@pytest.mark.parametrize(
    ("shape", "sizes", "sentence"),
    [
        ("l-shape", {"arm": (0.2, 0.3), "width": (0.1, 0.2)}, "longer than it is wide"),
        ("ring", {"outer": (0.2, 0.3), "inner_ratio": (0.5, 1.0)}, "smaller than the ring"),
    ],
)
def test_a_shape_that_is_none_is_refused(
    shape: str, sizes: dict[str, tuple[float, float]], sentence: str
) -> None:
    with pytest.raises(ValueError, match=sentence):
        DeclaredFamily(name="mine", shape=shape, sizes=sizes)
