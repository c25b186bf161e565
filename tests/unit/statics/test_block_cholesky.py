"""The two-sided block Cholesky against numpy.linalg, for every small number of planes and several block sizes.

Random symmetric matrices with two blocks beside each diagonal block, made positive definite by their diagonal.
"""

import numpy as np
import pytest

from magmpm.statics.block_cholesky import (
    factor,
    new_panels,
    rounded,
    solve,
    solve_columns,
    split_plane,
)

SIZES = pytest.mark.parametrize(
    ("planes", "m"), [(p, m) for p in range(3, 10) for m in (1, 2, 3, 12)] + [(41, 27)]
)


def random_banded(rng: np.random.Generator, planes: int, m: int) -> np.ndarray:
    """Symmetric positive definite (planes m, planes m), zero beyond two blocks from the diagonal; condition number about 10."""
    A = rng.standard_normal((planes * m, planes * m))
    block = np.repeat(np.arange(planes), m)
    A = np.where(np.abs(block[:, None] - block) <= 2, A + A.T, 0.0)
    return A + 1.2 * np.abs(np.linalg.eigvalsh(A)).max() * np.eye(planes * m)


def to_panels(A: np.ndarray, planes: int, m: int) -> np.ndarray:
    """Panels as in the docstring of statics.block_cholesky, entry by entry; the rest is filled with invalid numbers."""
    split = split_plane(planes)
    panels = new_panels(planes, m)
    panels[:planes] = 7e7  # so that a kernel that reads too much is detected
    panels[planes:] = np.nan
    blocks = A.reshape(planes, m, planes, m)
    for column in range(planes):
        if column < split:
            rows = [column, column + 1, column + 2]
        elif column == split:
            rows = [split, split + 1]
        elif column == split + 1:
            rows = [split + 1]
        else:
            rows = [column, column - 1, column - 2]
        for k, row in enumerate(rows):
            if 0 <= row < planes:
                block = blocks[row, :, column, :].copy()
                if k == 0:
                    block[np.triu_indices(m, 1)] = 7e7  # only the lower triangle counts
                panels[column, :, k * m : (k + 1) * m] = block.T  # row index fastest
    return panels


@SIZES
def test_solves(rng: np.random.Generator, planes: int, m: int) -> None:
    """factor, then solve for one right-hand side or for columns, gives numpy.linalg.solve, as often as it is asked; in single precision,
    rounded in the same memory, as many digits as that has, for right-hand sides below its smallest number too.
    """
    A = random_banded(rng, planes, m)
    panels = to_panels(A, planes, m)
    split = split_plane(planes)
    assert factor(panels, split) == -1
    for columns in (0, 1, 2, 5):
        b = rng.standard_normal((planes, columns, m))
        kept = b.copy()
        expected = (
            np.linalg.solve(A, b.transpose(0, 2, 1).reshape(planes * m, columns))
            .reshape(planes, m, columns)
            .transpose(0, 2, 1)
        )
        # condition number about 10, and as many rounding errors as unknowns in a band
        allowed = 1e-14 * m * np.abs(expected).max(initial=0.0)
        np.testing.assert_allclose(solve_columns(panels, split, b), expected, rtol=0, atol=allowed)
        for k in range(columns):
            np.testing.assert_allclose(
                solve(panels, split, np.ascontiguousarray(b[:, k])),
                expected[:, k],
                rtol=0,
                atol=allowed,
            )
        assert np.array_equal(b, kept), "the right-hand sides are left alone"
    single = rounded(panels := to_panels(A, planes, m))
    assert np.shares_memory(single, panels)
    assert factor(single, split) == -1
    for size in (1.0, 1e-60):
        x = solve(single, split, size * np.ascontiguousarray(b[:, 0]))
        assert x.dtype == np.float64
        np.testing.assert_allclose(
            x / size, expected[:, 0], rtol=0, atol=6e-7 * m * np.abs(expected).max()
        )  # roundings of 6e-8


@pytest.mark.parametrize("planes", range(3, 10))
def test_indefinite_matrices_are_found_out(rng: np.random.Generator, planes: int) -> None:
    """A negative eigenvalue is detected in every plane, in either precision: its own plane fails, or one of them where there are two."""
    m = 4
    split = split_plane(planes)
    A = random_banded(rng, planes, m)
    for bad in [(plane,) for plane in range(planes)] + [(0, planes - 1)]:
        B = A.copy()
        for plane in bad:
            B[plane * m + 2, plane * m + 2] = -1.0
        assert factor(to_panels(B, planes, m), split) in bad
        assert factor(rounded(to_panels(B, planes, m)), split) in bad


@pytest.mark.parametrize("planes", [3, 4, 7])
def test_barely_indefinite(rng: np.random.Generator, planes: int) -> None:
    """A matrix shifted a thousandth beyond its lowest eigenvalue fails; a thousandth less, it does not."""
    m = 6
    A = random_banded(rng, planes, m)
    values = np.linalg.eigvalsh(A)
    for side, fails in ((-1e-3, False), (1e-3, True)):
        B = A - (values[0] + side * values[-1]) * np.eye(planes * m)
        assert (factor(to_panels(B, planes, m), split_plane(planes)) >= 0) == fails


def test_split_leaves_two_planes_and_even_halves() -> None:
    for planes in range(3, 60):
        before = split_plane(planes)
        after = planes - 2 - split_plane(planes)
        assert before >= 0
        assert after >= 0
        assert abs(before - after) <= 1
