"""Eight floats at a time: every operation against NumPy."""

import numba
import numpy as np
import pytest

from magmpm.compiled import simd
from magmpm.materials import inverse_cube_root

ROUNDING = 4e-16  # a few units in the last place


@numba.njit
def arithmetic(a, b, out):  # type: ignore[no-untyped-def]
    x = simd.load(a, 0)
    y = simd.load(b, 0)
    simd.store(out, 0, x + y * 2.0 - 3.0 / x)
    simd.store(out, 8, (1.5 - x) / y)
    simd.store(out, 16, simd.smaller(x, y))
    simd.store(out, 24, simd.splat(0.25))
    simd.store(out, 32, simd.halves(1.0, -2.0))
    simd.store(out, 60, abs(x - y))
    out[80], out[81], out[82] = simd.lowest(x), simd.highest(x), simd.total(x)
    simd.store(out, 83, simd.sums(x, y, x * y, x - y, y / x, x * 2.0, y * y, x * x))


def test_operations(rng: np.random.Generator) -> None:
    a = rng.uniform(0.5, 2.0, 32)
    b = rng.uniform(0.5, 2.0, 32)
    out = np.zeros(96)
    arithmetic(a, b, out)
    x = a[:8]
    y = b[:8]
    np.testing.assert_allclose(out[:8], x + 2 * y - 3 / x, rtol=0, atol=8 * ROUNDING)
    np.testing.assert_allclose(out[8:16], (1.5 - x) / y, rtol=0, atol=8 * ROUNDING)
    assert np.array_equal(out[16:24], np.minimum(x, y))
    assert np.array_equal(out[24:32], np.full(8, 0.25))
    assert np.array_equal(out[32:40], np.repeat([1.0, -2.0], 4))
    assert np.array_equal(out[60:68], np.abs(x - y))
    assert (out[80], out[81]) == (x.min(), x.max())
    sums = [v.sum() for v in (x, x, y, x * y, x - y, y / x, 2 * x, y * y, x * x)]
    np.testing.assert_allclose(out[82:91], sums, rtol=8 * ROUNDING, atol=8 * ROUNDING)


@numba.njit
def cube_roots(a, out):  # type: ignore[no-untyped-def]
    for i in range(0, len(a), 8):
        simd.store(out, i, inverse_cube_root(simd.load(a, i)))


def test_inverse_cube_root_over_all_that_det_F_may_be(rng: np.random.Generator) -> None:
    a = np.exp(rng.uniform(-7, 7, 80_000))
    out = np.empty_like(a)
    cube_roots(a, out)
    assert np.abs(out * np.cbrt(a) - 1).max() < 2 * ROUNDING


@numba.njit
def least(a, b):  # type: ignore[no-untyped-def]
    return simd.lowest(simd.smaller(simd.load(a, 0), simd.load(b, 0)))


def test_smaller_takes_the_second_where_the_first_is_no_number() -> None:
    a = np.full(8, np.nan)
    b = np.arange(8.0)
    assert least(a, b) == 0.0


@pytest.mark.parametrize("start", range(8))
def test_loads_need_no_alignment(start: int) -> None:
    a = np.arange(32.0)
    out = np.zeros(8)
    copy(a, start, out)
    assert np.array_equal(out, a[start : start + 8])


@numba.njit
def copy(a, start, out):  # type: ignore[no-untyped-def]
    simd.store(out, 0, simd.load(a, start))
