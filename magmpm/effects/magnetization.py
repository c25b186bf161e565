"""Magnetization of a deformed particle: F Br, which stretches with the material, or R Br, which only rotates with it.

A material chooses by its `magnetization_law`; where one rotates, particles carry their law as a fourth number of `magnet`: 0 or 1.
R is the rotation of F = R U. s = tr U is the largest root of (s^2 - I1)^2 = 4 I2 + 8 J s, with I1 = |F|^2, I2 = |cof F|^2, J = det F. For
J > 0 it is a simple root, and Newton's steps from above fall to it. R is its derivative: with i2 = (s^2 - I1)/2,

    R = ds/dF = [(i2 + I1) F - F F^T F + s cof F] / (s i2 - J)

R turns by dR = R [w]x with Y w = axial(R^T dF - dF^T R), Y = s 1 - U, whose determinant s i2 - J is positive for J > 0. So W = -h . R b,
with h = B/mu0, has dW/dF = R [q]x^T with Y q = b x R^T h: its rows are q x (rows of R). A pure stretch leaves W as it is.
Sources: Danas and Reis, arXiv 2403.03096; tr U: Franca, Comput. Math. Appl. 18 (1989) 459; dR: Chen, Wheeler, J. Elast. 32 (1993) 175.
"""

from typing import Any

import numpy as np
from numba.extending import overload

from magmpm.compiled.arrays import Mask
from magmpm.compiled.jit import compiled, inner
from magmpm.compiled.simd import cross, dot, highest, lanes, rows
from magmpm.effects.base import SceneLike

ROOT_TOLERANCE = (
    1e-9  # of tr U: the error left after a step of Newton's that is so short is its square
)
MOST_ROOT_STEPS = 60  # no deformation needs more than 12; without det F > 0 there may be no root


def rotating(scene: SceneLike) -> Mask:
    """Regions (k,) whose magnetization rotates and does not stretch."""
    materials = [scene.materials[region.material_name] for region in scene.regions()]
    return np.array(
        [one.magnetization_law == "rotates" and one.remanence > 0.0 for one in materials]
    )


def _largest(value: Any) -> Any:
    """The largest of eight lanes, or the number itself. Only within compiled code."""


@overload(_largest)
def _largest_of(value):  # type: ignore[no-untyped-def]
    return (lambda value: highest(value)) if value == lanes else (lambda value: value)


@inner
def _sum(p, a, q, b, r, c):
    """p a + q b + r c of triples a, b, c."""
    return (
        p * a[0] + q * b[0] + r * c[0],
        p * a[1] + q * b[1] + r * c[1],
        p * a[2] + q * b[2] + r * c[2],
    )


@compiled
def rotation(F):
    """Rows (triples) of R, tr U and det Y, of one particle or of eight. Without meaning where det F <= 0."""
    a, b, c = rows(F)
    # rows of cof F
    x = cross(b, c)
    y = cross(c, a)
    z = cross(a, b)
    aa = dot(a, a)
    bb = dot(b, b)
    cc = dot(c, c)
    ab = dot(a, b)
    ac = dot(a, c)
    bc = dot(b, c)
    J = dot(a, x)
    I1 = aa + bb + cc
    I2 = dot(x, x) + dot(y, y) + dot(z, z)
    s = 0.5 * (I1 + 3.0)  # at least sqrt(3 I1), which is at least tr U
    for _ in range(MOST_ROOT_STEPS):
        w = s * s - I1
        step = (w * w - 4.0 * I2 - 8.0 * J * s) / (4.0 * s * w - 8.0 * J)
        s = s - step
        if not _largest(step - ROOT_TOLERANCE * s) > 0.0:
            break
    i2 = 0.5 * (s * s - I1)
    size = s * i2 - J
    n = i2 + I1
    k = 1.0 / size
    p = _sum(n - aa, a, -ab, b, -ac, c)
    q = _sum(-ab, a, n - bb, b, -bc, c)
    r = _sum(-ac, a, -bc, b, n - cc, c)
    return (
        (
            (k * (p[0] + s * x[0]), k * (p[1] + s * x[1]), k * (p[2] + s * x[2])),
            (k * (q[0] + s * y[0]), k * (q[1] + s * y[1]), k * (q[2] + s * y[2])),
            (k * (r[0] + s * z[0]), k * (r[1] + s * z[1]), k * (r[2] + s * z[2])),
        ),
        s,
        size,
    )


@inner
def _stretch(F, R):
    """U = R^T F as xx, yy, zz, xy, xz, yz."""
    a, b, c = rows(F)
    x = _sum(R[0][0], a, R[1][0], b, R[2][0], c)
    y = _sum(R[0][1], a, R[1][1], b, R[2][1], c)
    z = _sum(R[0][2], a, R[1][2], b, R[2][2], c)
    return x[0], y[1], z[2], x[1], x[2], y[2]


@inner
def _inverse(U, s, size):
    """Inverse of Y = s 1 - U, both as U; size: det Y."""
    x = s - U[0]
    y = s - U[1]
    z = s - U[2]
    a = U[3]
    b = U[4]
    c = U[5]
    k = 1.0 / size
    return (
        k * (y * z - c * c),
        k * (x * z - b * b),
        k * (x * y - a * a),
        k * (a * z + b * c),
        k * (b * y + a * c),
        k * (c * x + a * b),
    )


@inner
def _times(A, v):
    """Symmetric matrix (xx, yy, zz, xy, xz, yz) times a triple."""
    return (
        A[0] * v[0] + A[3] * v[1] + A[4] * v[2],
        A[3] * v[0] + A[1] * v[1] + A[5] * v[2],
        A[4] * v[0] + A[5] * v[1] + A[2] * v[2],
    )


@inner
def followed(magnet, F):
    """F Br (triple), T, of a particle or of eight: the magnetization that follows all of F."""
    x, y, z = rows(F)
    return dot(x, magnet), dot(y, magnet), dot(z, magnet)


@inner
def carried(magnet, F):
    """Magnetization (triple) of a particle, or of eight, each by its law, T."""
    R = rotation(F)[0]
    law = magnet[3]
    m0, m1, m2 = followed(magnet, F)
    return (
        m0 + law * (dot(R[0], magnet) - m0),
        m1 + law * (dot(R[1], magnet) - m1),
        m2 + law * (dot(R[2], magnet) - m2),
    )


@inner
def energy(h, magnet, F):
    """-h . m, J/m^3, with m the magnetization by the particle's law; h = B/mu0, A/m, anything with three entries."""
    return -dot(h, carried(magnet, F))


@inner
def _turning(magnet, F, h):
    """R, U, Y^-1, R^T h, b and q (of zero b where the law is to stretch): what the derivatives of -h . R b are made of."""
    R, s, size = rotation(F)
    U = _stretch(F, R)
    g = _sum(h[0], R[0], h[1], R[1], h[2], R[2])
    Y = _inverse(U, s, size)
    b = (magnet[3] * magnet[0], magnet[3] * magnet[1], magnet[3] * magnet[2])
    return R, U, Y, g, b, _times(Y, cross(b, g))


@compiled
def add_stress(h, magnet, F, P):
    """P += d(-h . m)/dF, Pa; arguments as in `energy`, of one particle or of eight."""
    R, _, _, _, b, q = _turning(magnet, F, h)
    for k in range(3):
        x = cross(q, R[k])
        for i in range(3):
            P[k, i] = P[k, i] + x[i] - h[k] * (magnet[i] - b[i])


@inner
def add_tangent(h, magnet, F, A):
    """A (9, 9) += d2(-h . m)/dF2, Pa. F_kM turns R by dR = R [w]x with Y w = e_M x (row k of R)."""
    if magnet[3] == 0.0:
        return
    R, U, Y, g, b, q = _turning(magnet, F, h)
    Uq = _times(U, q)
    unit = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    for k in range(3):
        for m in range(3):
            w = _times(Y, cross(unit[m], R[k]))
            # -dc, and what dY q has of it
            turned = cross(b, cross(w, g))
            bent = cross(w, Uq)
            dY = _sum(R[k][m], q, -q[m], R[k], 1.0, bent)
            dq = _times(Y, (-turned[0] - dY[0], -turned[1] - dY[1], -turned[2] - dY[2]))
            for j in range(3):
                one = cross(dq, R[j])
                other = cross(q, cross(w, R[j]))
                for n in range(3):
                    A[3 * j + n, 3 * k + m] += one[n] - other[n]
