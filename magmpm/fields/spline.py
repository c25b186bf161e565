"""Tricubic B-splines through values on a regular grid: coefficients, and compiled evaluation with first and second derivatives.

A spline through N nodes along an axis has N + 2 coefficients; the two extra ones come from the not-a-knot condition (the fourth
difference of the coefficients vanishes at either end), so cubic polynomials are exact and the error is of fourth order up to the
faces of the box. The spline has two continuous derivatives. Source: de Boor, A Practical Guide to Splines, chapters 4 and 9.

Compiled functions take one 1-D array `data` and the place `at` where a table begins in it:
lower corner (3) m, nodes per meter (3), nodes (3), the table's axes (9), then the coefficients (N_x + 2, N_y + 2, N_z + 2, 4), last
index fastest. The fourth component is empty, so that the 4 x 3 numbers of a row of a cell along z are two vectors of eight
(magmpm.compiled.simd).
Beyond the box the functions return the value at the nearest point of its surface: finite, and refused by `Field.check`.
"""

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.compiled.jit import compiled, inner
from magmpm.compiled.simd import folded, halves, load, splat

HEADER = 18
AXES = 9  # where the table's axes begin in its header: a matrix whose columns they are, row by row
LEAST_NODES_OF_SPLINE = 4  # nodes along an axis: a cubic needs as many


def coefficients(values: Array) -> Array:
    """Coefficients (N + 2, M + 2, K + 2, c) of the spline through values (N, M, K, c), N, M, K >= 4."""
    out = np.asarray(values, dtype=float)
    for axis in range(3):
        out = _along(out, axis)
    return np.ascontiguousarray(out)


def _along(values: Array, axis: int) -> Array:
    from scipy.linalg import (
        solve_banded,  # only where a field has a table: its import takes a quarter of a second
    )

    moved = np.moveaxis(values, axis, 0)
    n = len(moved)
    if n < LEAST_NODES_OF_SPLINE:
        raise ValueError(
            f"a cubic spline needs {LEAST_NODES_OF_SPLINE} nodes along each axis, got {n}"
        )
    size = n + 2
    bands = np.zeros((9, size))  # solve_banded: bands[4 + i - j, j] = a[i, j]
    for j, entry in enumerate((1.0, -4.0, 6.0, -4.0, 1.0)):
        bands[4 - j, j] = entry
        bands[4 + (size - 1) - (size - 5 + j), size - 5 + j] = entry
    rows = np.arange(1, size - 1)
    for shift, entry in ((-1, 1 / 6), (0, 2 / 3), (1, 1 / 6)):
        bands[4 - shift, rows + shift] = entry
    right = np.zeros((size, moved[0].size))
    right[1:-1] = moved.reshape(n, -1)
    found = solve_banded(
        (4, 4), bands, right, overwrite_ab=True, overwrite_b=True, check_finite=False
    )
    return np.moveaxis(found.reshape(size, *moved.shape[1:]), 0, axis)


def packed(lower: Array, spacing: Array, values: Array, frame: Array | None = None) -> Array:
    """The table of values (N, M, K, 3) on a grid from `lower` (3,) m with `spacing` (3,) m, as the compiled functions take it.

    lower, spacing and values are along the table's axes, the columns of `frame` (3, 3) in the frame of the points; None: the same axes.
    """
    found = coefficients(values)
    rows = np.zeros((*found.shape[:3], 4))
    rows[..., :3] = found
    axes = np.eye(3) if frame is None else frame
    return np.concatenate(
        [lower, 1.0 / np.asarray(spacing), values.shape[:3], axes.ravel(), rows.ravel()]
    )


@inner
def inward(R, at, y0, y1, y2):
    """A vector along the axes that are the columns of the matrix (3, 3) in R from index `at` on, row by row."""
    return (
        R[at] * y0 + R[at + 3] * y1 + R[at + 6] * y2,
        R[at + 1] * y0 + R[at + 4] * y1 + R[at + 7] * y2,
        R[at + 2] * y0 + R[at + 5] * y1 + R[at + 8] * y2,
    )


@inner
def outward(R, at, y0, y1, y2):
    """A vector of those axes along those of the points: `inward`, backward."""
    return (
        R[at] * y0 + R[at + 1] * y1 + R[at + 2] * y2,
        R[at + 3] * y0 + R[at + 4] * y1 + R[at + 5] * y2,
        R[at + 6] * y0 + R[at + 7] * y1 + R[at + 8] * y2,
    )


@inner
def _cell(data, at, axis, y):
    """Cell, and place in it (0 to 1), of a coordinate."""
    s = (y - data[at + axis]) * data[at + 3 + axis]
    last = data[at + 6 + axis] - 1.0
    s = min(max(s, 0.0), last)
    cell = min(int(s), int(last) - 1)
    return cell, s - cell


@inner
def _place(data, at, y0, y1, y2):
    """Cell and place in it, axis by axis, of a point along the table's axes; the coefficients along the second and third axis."""
    i, r = _cell(data, at, 0, y0)
    j, s = _cell(data, at, 1, y1)
    k, t = _cell(data, at, 2, y2)
    return i, r, j, s, k, t, int(data[at + 7]) + 2, int(data[at + 8]) + 2


@inner
def _weight(i, t):
    """Cubic B-spline i of a cell's four at t."""
    if i == 0:
        return (1.0 - t) ** 3 / 6.0
    if i == 1:
        return (4.0 + t * t * (3.0 * t - 6.0)) / 6.0
    if i == 2:
        return (1.0 + t * (3.0 + t * (3.0 - 3.0 * t))) / 6.0
    return t * t * t / 6.0


@inner
def _slope(i, t):
    """Its derivative with respect to t."""
    if i == 0:
        return -0.5 * (1.0 - t) ** 2
    if i == 1:
        return t * (1.5 * t - 2.0)
    if i == 2:
        return 0.5 + t * (1.0 - 1.5 * t)
    return 0.5 * t * t


@inner
def _bend(i, t):
    """Its second derivative."""
    if i == 0:
        return 1.0 - t
    if i == 1:
        return 3.0 * t - 2.0
    if i == 2:
        return 1.0 - 3.0 * t
    return t


@compiled
def size_of(data, at):
    """Number of floats in the table that begins at `at`."""
    return HEADER + 4 * int(data[at + 6] + 2) * int(data[at + 7] + 2) * int(data[at + 8] + 2)


@compiled
def value(data, at, y0, y1, y2):
    """B (3) at a point, T."""
    axes = at + AXES
    y0, y1, y2 = inward(data, axes, y0, y1, y2)
    i, r, j, s, k, t, rows, columns = _place(data, at, y0, y1, y2)
    # the row's first two nodes, and its last two
    near = splat(0.0)
    far = splat(0.0)
    for a in range(4):
        wa = _weight(a, r)
        for b in range(4):
            w = wa * _weight(b, s)
            c = at + HEADER + 4 * (((i + a) * rows + j + b) * columns + k)
            near = near + w * load(data, c)
            far = far + w * load(data, c + 8)
    b0, b1, b2 = folded(
        near * halves(_weight(0, t), _weight(1, t)) + far * halves(_weight(2, t), _weight(3, t))
    )
    return outward(data, axes, b0, b1, b2)


@compiled
def gradient(data, at, y0, y1, y2):
    """dB_i/dy_j (9), row i, T/m."""
    axes = at + AXES
    y0, y1, y2 = inward(data, axes, y0, y1, y2)
    i, r, j, s, k, t, rows, columns = _place(data, at, y0, y1, y2)
    near_x = splat(0.0)
    far_x = splat(0.0)
    near_y = splat(0.0)
    far_y = splat(0.0)
    near_z = splat(0.0)
    far_z = splat(0.0)
    for a in range(4):
        wa = _weight(a, r)
        sa = _slope(a, r)
        for b in range(4):
            wb = _weight(b, s)
            x = sa * wb
            y = wa * _slope(b, s)
            z = wa * wb
            c = at + HEADER + 4 * (((i + a) * rows + j + b) * columns + k)
            near = load(data, c)
            far = load(data, c + 8)
            near_x = near_x + x * near
            far_x = far_x + x * far
            near_y = near_y + y * near
            far_y = far_y + y * far
            near_z = near_z + z * near
            far_z = far_z + z * far
    first = halves(_weight(0, t), _weight(1, t))
    second = halves(_weight(2, t), _weight(3, t))
    x0, x1, x2 = folded(near_x * first + far_x * second)
    z0, z1, z2 = folded(near_y * first + far_y * second)
    first = halves(_slope(0, t), _slope(1, t))
    second = halves(_slope(2, t), _slope(3, t))
    u0, u1, u2 = folded(near_z * first + far_z * second)
    p = _per_cell(data, at, 0, y0)
    q = _per_cell(data, at, 1, y1)
    u = _per_cell(data, at, 2, y2)
    # R G R^T: its rows turned, then its columns
    a0, a1, a2 = outward(data, axes, p * x0, q * z0, u * u0)
    b0, b1, b2 = outward(data, axes, p * x1, q * z1, u * u1)
    c0, c1, c2 = outward(data, axes, p * x2, q * z2, u * u2)
    x0, x1, x2 = outward(data, axes, a0, b0, c0)
    y0, y1, y2 = outward(data, axes, a1, b1, c1)
    z0, z1, z2 = outward(data, axes, a2, b2, c2)
    return x0, y0, z0, x1, y1, z1, x2, y2, z2


@inner
def _per_cell(data, at, axis, y):
    """Cells per meter along an axis, 1/m; 0 beyond the box, where the value no longer changes."""
    s = (y - data[at + axis]) * data[at + 3 + axis]
    return data[at + 3 + axis] if 0.0 <= s <= data[at + 6 + axis] - 1.0 else 0.0


@compiled
def curvature(data, at, y0, y1, y2, m0, m1, m2):
    """Second derivatives xx, yy, zz, xy, xz, yz of m . B, T/m^2 times the unit of m."""
    axes = at + AXES
    y0, y1, y2 = inward(data, axes, y0, y1, y2)
    m0, m1, m2 = inward(data, axes, m0, m1, m2)
    i, r, j, s, k, t, rows, columns = _place(data, at, y0, y1, y2)
    xx = 0.0
    yy = 0.0
    zz = 0.0
    xy = 0.0
    xz = 0.0
    yz = 0.0
    for a in range(4):
        wa = _weight(a, r)
        sa = _slope(a, r)
        ba = _bend(a, r)
        for b in range(4):
            wb = _weight(b, s)
            sb = _slope(b, s)
            bb = _bend(b, s)
            c = at + HEADER + 4 * (((i + a) * rows + j + b) * columns + k)
            for d in range(4):
                wd = _weight(d, t)
                sd = _slope(d, t)
                f = m0 * data[c + 4 * d] + m1 * data[c + 4 * d + 1] + m2 * data[c + 4 * d + 2]
                xx += ba * wb * wd * f
                yy += wa * bb * wd * f
                zz += wa * wb * _bend(d, t) * f
                xy += sa * sb * wd * f
                xz += sa * wb * sd * f
                yz += wa * sb * sd * f
    p = _per_cell(data, at, 0, y0)
    q = _per_cell(data, at, 1, y1)
    u = _per_cell(data, at, 2, y2)
    xx = xx * p * p
    yy = yy * q * q
    zz = zz * u * u
    xy = xy * p * q
    xz = xz * p * u
    yz = yz * q * u
    # R H R^T: its rows turned, then its columns
    a0, a1, a2 = outward(data, axes, xx, xy, xz)
    b0, b1, b2 = outward(data, axes, xy, yy, yz)
    c0, c1, c2 = outward(data, axes, xz, yz, zz)
    x0, x1, x2 = outward(data, axes, a0, b0, c0)
    _, y1, y2 = outward(data, axes, a1, b1, c1)
    _, _, z2 = outward(data, axes, a2, b2, c2)
    return x0, y1, z2, x1, x2, y2
