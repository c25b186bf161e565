"""Compiled evaluation of a field of any sources at a point: value, force on a moment, derivatives.

`data` holds the sources in a frame of their own: number of dipoles, number of tables, the dipoles (fields.dipole), the tables
(fields.spline). A record `place` with the fields of PLACE puts that frame into space, and says how strong it is:

    B(x) = uniform + strength R B0(R^T (x - origin)),   R = frame (row by row)

It changes from step to step if the field changes in time; `data` does not. Results are tuples: no array is made.
"""

from typing import Any

import numpy as np

from magmpm.compiled.jit import compiled, compiled_elsewhere, inner
from magmpm.fields import dipole, spline
from magmpm.fields.spline import inward, outward

PLACE: list[Any] = [
    ("uniform", np.float64, (3,)),  # T
    ("strength", np.float64),
    ("frame", np.float64, (9,)),
    ("origin", np.float64, (3,)),  # m
]
_dipole_value = dipole.value
_dipole_gradient = dipole.gradient
_dipole_curvature = dipole.curvature
_spline_value = spline.value
_spline_gradient = spline.gradient
_spline_curvature = spline.curvature
_spline_size = spline.size_of
DIPOLE = dipole.DIPOLE_SIZE


@inner
def _local(place, x):
    """The point in the sources' frame."""
    o = place.origin
    return inward(place.frame, 0, x[0] - o[0], x[1] - o[1], x[2] - o[2])


@compiled
def field(place, data, x):
    """B (3) at x (3,) m, T."""
    y0, y1, y2 = _local(place, x)
    b0 = 0.0
    b1 = 0.0
    b2 = 0.0
    at = 2
    for _ in range(int(data[0])):
        c0, c1, c2 = _dipole_value(data, at, y0, y1, y2)
        b0 = b0 + c0
        b1 = b1 + c1
        b2 = b2 + c2
        at = at + DIPOLE
    for _ in range(int(data[1])):
        c0, c1, c2 = _spline_value(data, at, y0, y1, y2)
        b0 = b0 + c0
        b1 = b1 + c1
        b2 = b2 + c2
        at = at + _spline_size(data, at)
    b0, b1, b2 = outward(place.frame, 0, b0, b1, b2)
    u = place.uniform
    s = place.strength
    return u[0] + s * b0, u[1] + s * b1, u[2] + s * b2


@inner
def _local_gradient(data, y0, y1, y2):
    """dB0_i/dy_j (9) in the sources' frame, T/m."""
    total = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    at = 2
    for _ in range(int(data[0])):
        total = _sum_of_nine(total, _dipole_gradient(data, at, y0, y1, y2))
        at = at + DIPOLE
    for _ in range(int(data[1])):
        total = _sum_of_nine(total, _spline_gradient(data, at, y0, y1, y2))
        at = at + _spline_size(data, at)
    return total


@inner
def _sum_of_nine(p, q):
    """Sum of nine numbers each."""
    a, b, c, d, e, f, g, h, i = p
    j, k, m, n, o, r, s, t, u = q
    return a + j, b + k, c + m, d + n, e + o, f + r, g + s, h + t, i + u


@compiled
def pull(place, data, x, m0, m1, m2):
    """(grad B)^T m (3), the gradient of m . B: the force on a moment m (A m^2), N."""
    y0, y1, y2 = _local(place, x)
    n0, n1, n2 = inward(place.frame, 0, m0, m1, m2)
    a, b, c, d, e, f, g, h, i = _local_gradient(data, y0, y1, y2)
    s = place.strength
    return outward(
        place.frame,
        0,
        s * (a * n0 + d * n1 + g * n2),
        s * (b * n0 + e * n1 + h * n2),
        s * (c * n0 + f * n1 + i * n2),
    )


@inner
def gradient(place, data, x, G):
    """G (3, 3) += dB_i/dx_j, T/m."""
    y0, y1, y2 = _local(place, x)
    local = _local_gradient(data, y0, y1, y2)
    R = place.frame
    s = place.strength
    for i in range(3):
        for j in range(3):
            total = 0.0
            for p in range(3):
                row = (
                    local[3 * p] * R[3 * j]
                    + local[3 * p + 1] * R[3 * j + 1]
                    + local[3 * p + 2] * R[3 * j + 2]
                )
                total += R[3 * i + p] * row
            G[i, j] += s * total


@inner
def _sum_of_six(p, q):
    """Sum of six numbers each."""
    return p[0] + q[0], p[1] + q[1], p[2] + q[2], p[3] + q[3], p[4] + q[4], p[5] + q[5]


@compiled
def curvature(place, data, x, m0, m1, m2, scale, H):
    """H (3, 3) += scale d^2(m . B)/dx_i dx_j, with m in A m^2: N/m."""
    y0, y1, y2 = _local(place, x)
    n0, n1, n2 = inward(place.frame, 0, m0, m1, m2)
    total = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    at = 2
    for _ in range(int(data[0])):
        total = _sum_of_six(total, _dipole_curvature(data, at, y0, y1, y2, n0, n1, n2))
        at += DIPOLE
    for _ in range(int(data[1])):
        total = _sum_of_six(total, _spline_curvature(data, at, y0, y1, y2, n0, n1, n2))
        at += _spline_size(data, at)
    xx, yy, zz, xy, xz, yz = total
    R = place.frame
    s = scale * place.strength
    for i in range(3):
        p = R[3 * i]
        q = R[3 * i + 1]
        r = R[3 * i + 2]
        h0 = p * xx + q * xy + r * xz
        h1 = p * xy + q * yy + r * yz
        h2 = p * xz + q * yz + r * zz
        for j in range(3):
            H[i, j] += s * (h0 * R[3 * j] + h1 * R[3 * j + 1] + h2 * R[3 * j + 2])


@compiled_elsewhere
def fields_at(place, data, x, B):
    """B (n, 3) T at points x (n, 3) m."""
    for p in range(len(x)):
        B[p, 0], B[p, 1], B[p, 2] = field(place, data, x[p])


@compiled_elsewhere
def gradients_at(place, data, x, G):
    """G (n, 3, 3) = dB_i/dx_j T/m at points x (n, 3) m."""
    for p in range(len(x)):
        G[p] = 0.0
        gradient(place, data, x[p], G[p])
