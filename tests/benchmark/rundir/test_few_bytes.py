"""Numbers and images in few bytes."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from eitbench.benchmark.rundir.few_bytes import DIGITS, packed, rounded, unpacked
from eitbench.scenarios.arrays import Array

SHAPES = st.tuples(st.integers(0, 3), st.integers(1, 6), st.integers(1, 6))
SPECIAL = st.sampled_from([float("nan"), float("inf")])
VALUES = st.floats(-1e3, 1e3) | st.just(float("nan"))


@given(arrays(np.float64, 20, elements=st.floats(-1e300, 1e300) | SPECIAL))
def test_rounded_numbers_keep_their_digits_and_no_more(values: Array) -> None:
    found = rounded(values)
    normal = np.isfinite(values) & (np.abs(values) > 1e-290)
    assert np.allclose(found[normal], values[normal], rtol=2.0**-DIGITS, atol=0)
    infinite = np.isinf(values)
    assert np.array_equal(found[infinite], values[infinite])
    assert np.array_equal(np.isnan(found), np.isnan(values))
    assert np.array_equal(rounded(found), found, equal_nan=True)
    mantissa = np.frexp(found[normal])[0] * 2**DIGITS
    assert np.array_equal(mantissa, np.round(mantissa))


@given(arrays(np.float64, SHAPES, elements=VALUES), st.sampled_from([0.004, 0.1, 1.0]))
def test_packed_images_are_the_nearest_steps(images: Array, step: float) -> None:
    found = unpacked(packed(images, step), step)
    assert np.array_equal(np.isnan(found), np.isnan(images))
    least, most = (value * step for value in (-(2**15) + 1, 2**15 - 1))
    expected = np.round(images.clip(least, most) / step) * step
    assert np.allclose(found, expected, rtol=1e-12, equal_nan=True)


def test_a_smooth_image_takes_few_bytes() -> None:
    rows, columns = np.indices((80, 80))
    image = 0.3 + 0.002 * rows + 0.001 * columns
    assert np.count_nonzero(packed(image[None], 0.001)) < 200
