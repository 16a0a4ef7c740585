"""Designs compared: patterns, numbers of electrodes, time and what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from eitbench.benchmark.design.bounds import Touch
from eitbench.benchmark.design.designs import (
    best,
    compare,
    independent_measurements,
    median,
    with_design,
)
from eitbench.reports.figures.design import design_figure, drawn_designs
from eitbench.reports.tables.design import design_rows, design_table, places_table
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.sensors.patterns import offset_pattern
from eitbench.scenarios.sensors.sensor import Sensor, foam16

TOUCH = Touch(0.008, -0.3)


@pytest.fixture(scope="module")
def small() -> Sensor:
    return replace(foam16(), image_shape=(40, 40))


def test_independent_measurements_are_those_that_are_known() -> None:
    """E (E - 3) / 2 of adjacent pairs, 104 and 62 of offsets 3 and 4 of 16 electrodes."""
    for count in (8, 16):
        adjacent = offset_pattern(count, 1)
        assert independent_measurements(adjacent) == count * (count - 3) // 2
    assert independent_measurements(offset_pattern(16, 3)) == 104
    assert independent_measurements(offset_pattern(16, 4)) == 62


def test_other_electrodes_cover_the_same_share_of_the_rim() -> None:
    given = foam16()
    for count in (8, 12, 32):
        sensor = with_design(given, "offset=3", count)
        assert sum(e.width for e in sensor.electrodes) == pytest.approx(0.16)
        assert sensor.electrodes[0].centre == pytest.approx(0.4 / count / 2)
    assert with_design(given, "own", 16) == given


def test_maps_of_many_designs_are_those_of_the_best_and_of_the_sensor_as_given(
    small: Sensor,
) -> None:
    (made,) = compare(small, 70, touch=TOUCH, patterns=["offset=3"])
    assert made.given  # offset=3 is its own pattern
    assert not compare(small, 70, touch=TOUCH, patterns=["offset=1"])[0].given
    assert made.maps is not None
    ranked = [
        replace(
            made, pattern=str(k), given=k == 8, maps=replace(made.maps, place=made.maps.place * k)
        )
        for k in (9, 8, 7, 6, 5, 4, 3, 2)
    ]
    slow = replace(made, given=False, frames=0, maps=None)
    drawn = drawn_designs([slow, *ranked])
    assert [of.pattern for of in drawn] == ["8", "6", "5", "4", "3", "2"]
    assert drawn_designs([slow, *ranked[:6]]) == ranked[:6]
    texts = [text.get_text() for text in design_figure([slow, *ranked]).texts]
    assert any("6 best of 8 designs" in text and "as it is given" in text for text in texts)


def test_a_frame_rate_averages_fast_designs_and_leaves_out_slow_ones(small: Sensor) -> None:
    def of(rate: float | None, pattern: str) -> tuple[int, float, bool]:
        (made,) = compare(
            small, 70, touch=TOUCH, patterns=[pattern], electrodes=[8], measurement_s=1e-3,
            frame_rate=rate,
        )  # fmt: skip
        place = None if made.maps is None else made.maps.place
        return made.frames, median(place), best([made]) is made

    one, four, none = (of(rate, "offset=1") for rate in (None, 5.0, 30.0))  # 40 values, 40 ms
    assert one[0] == 1
    assert four[0] == 5
    assert four[1] == pytest.approx(one[1] / np.sqrt(5), rel=1e-6)
    assert none[0] == 0
    assert np.isnan(none[1])
    assert not none[2]


def test_offset_3_beats_adjacent_at_the_same_noise_in_volts(small: Sensor) -> None:
    """Adler, Gaggero and Maimaitijiang 2011: adjacent pairs tell least in the middle."""
    designs = compare(small, 60, touch=TOUCH, patterns=["offset=1", "offset=3"])
    adjacent, third = (of.maps for of in designs)
    assert adjacent is not None
    assert third is not None
    middle = len(third.x) // 2, len(third.y) // 2
    assert third.detectability[middle] > 3 * adjacent.detectability[middle]
    assert best(designs) is designs[1]
    table = design_table(designs)
    assert table["design"].tolist() == ["16 electrodes, offset=1", "16 electrodes, offset=3"]
    assert table["place_mm"][1] == pytest.approx(1e3 * median(third.place))
    assert len(places_table(designs)) == 2 * np.isfinite(third.place).sum()
    assert {len(row) for row in design_rows(table)} == {len(design_rows(table)[0])}


def test_reversed_pairs_feel_as_much(small: Sensor) -> None:
    """Offset -3 changes the order and the signs of the values of offset 3, not what they tell."""
    given, reversed_ = compare(small, 60, touch=TOUCH, patterns=["offset=3", "offset=-3"])
    assert given.maps is not None
    assert reversed_.maps is not None
    assert not np.array_equal(reversed_.sensor.pattern.table, given.sensor.pattern.table)
    np.testing.assert_allclose(reversed_.maps.place, given.maps.place, rtol=1e-9)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"snr_db": None}, "give the SNR"),
        ({"snr_db": 60, "patterns": ["zigzag"]}, "Unknown pattern"),
        ({"snr_db": 60, "patterns": ["offset=16"]}, "An offset is"),
        ({"snr_db": 60, "electrodes": [8]}, "belongs to its 16 electrodes"),
        ({"snr_db": 60, "electrodes": [2], "patterns": ["offset=1"]}, "at least 4"),
        ({"snr_db": 60, "electrodes": [9], "patterns": ["opposition"]}, "even number"),
        ({"snr_db": 60, "frame_rate": 0.0}, "above 0"),
        ({"snr_db": 60, "drift": -0.1}, "needs noise"),
    ],
)
def test_what_cannot_be_designed_is_refused_in_a_sentence(
    small: Sensor, options: dict[str, object], words: str
) -> None:
    with pytest.raises(InputError, match=words):
        compare(small, **options)  # type: ignore[arg-type]
