"""Compiled functions of the rod: energy, derivatives, block-tridiagonal Newton. The formulas are in magmpm.rod.cosserat.

Unknowns are rotations d_k (3) of frames 1 .. n about their own axes, q_k -> q_k exp(d_k / 2). Shapes: q (n + 1, 4) unit quaternions, scalar
first; g (n + 1, 3); Hd (n + 1, 3, 3) and Ho (n, 3, 3): the Hessian's blocks of frame e, and of frames e (row) and e + 1 (column).
"""

from typing import NamedTuple

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.compiled.jit import compiled, compiled_elsewhere, inlined, inner

MAX_STEPS = 200
LARGEST_TURN = 0.6  # rad: largest turn of a frame in one Newton step


class LoadedRod(NamedTuple):
    """Attributes of a rod.cosserat.RodModel as compiled functions take them; of many rods, those of the loads have a first axis."""

    length: Array
    twist_bend: Array
    compliance: Array
    moment: Array
    field: Array
    weight: Array


@inlined
def matrix(q, R):
    """Write the rotation matrix of a unit quaternion to R (3, 3)."""
    w = q[0]
    x = q[1]
    y = q[2]
    z = q[3]
    R[0, 0], R[0, 1], R[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    R[1, 0], R[1, 1], R[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    R[2, 0], R[2, 1], R[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)


@inlined
def relative(a, b, z):
    """z = conj(a) b, with z[0] >= 0."""
    z[0] = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]
    z[1] = a[0] * b[1] - a[1] * b[0] - a[2] * b[3] + a[3] * b[2]
    z[2] = a[0] * b[2] + a[1] * b[3] - a[2] * b[0] - a[3] * b[1]
    z[3] = a[0] * b[3] - a[1] * b[2] + a[2] * b[1] - a[3] * b[0]
    if z[0] < 0:
        for i in range(4):
            z[i] = -z[i]


@inlined
def half_way(p, q, mid):
    """Write the unit quaternion half-way between two to mid. Returns the length of their sum."""
    dot = p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3]
    size = 0.0
    for i in range(4):
        mid[i] = p[i] + (q[i] if dot >= 0 else -q[i])
        size += mid[i] ** 2
    size = np.sqrt(size)
    for i in range(4):
        mid[i] /= size
    return size


@compiled
def _turn(q, d, out):
    """out = q exp(d / 2), normalized."""
    angle = np.sqrt(d[0] ** 2 + d[1] ** 2 + d[2] ** 2)
    s = 0.5 if angle < 1e-8 else np.sin(angle / 2) / angle
    w = np.cos(angle / 2)
    x = s * d[0]
    y = s * d[1]
    z = s * d[2]
    a = q[0]
    b = q[1]
    c = q[2]
    e = q[3]
    out[0], out[1] = a * w - b * x - c * y - e * z, a * x + b * w + c * z - e * y
    out[2], out[3] = a * y - b * z + c * w + e * x, a * z + b * y - c * x + e * w
    size = np.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2 + out[3] ** 2)
    for i in range(4):
        out[i] /= size


@inlined
def in_frame(R, v):
    """R^T v, a tuple."""
    return (
        R[0, 0] * v[0] + R[1, 0] * v[1] + R[2, 0] * v[2],
        R[0, 1] * v[0] + R[1, 1] * v[1] + R[2, 1] * v[2],
        R[0, 2] * v[0] + R[1, 2] * v[1] + R[2, 2] * v[2],
    )


@inlined
def _mixed(part, a, b):
    """Vector half of `part` of the way from a to b, a tuple."""
    last = 0.5 * part
    first = 1.0 - last
    return first * a[0] + last * b[0], first * a[1] + last * b[1], first * a[2] + last * b[2]


@inlined
def pulling(b, w, m0):
    """Force f = w + m_0 b that stretches and shears, of weight and field in the frame, a tuple."""
    return w[0] + m0 * b[0], w[1] + m0 * b[1], w[2] + m0 * b[2]


@inlined
def at_part(R, rod, e, part):
    """Field, and force that stretches and shears, in the frame R at an element's first end, middle or last end (part 0 to 2)."""
    b = in_frame(R, _mixed(part, rod.field[e], rod.field[e + 1]))
    w = in_frame(R, _mixed(part, rod.weight[e], rod.weight[e + 1]))
    return b, pulling(b, w, rod.moment[e, 0])


@compiled
def _energy(q, rod):
    """Energy of the rod, J."""
    R = np.empty((3, 3))
    z = np.empty(4)
    total = 0.0
    for e in range(len(rod.length)):
        relative(q[e], q[e + 1], z)
        for i in range(3):
            total += 2.0 / rod.length[e] * rod.twist_bend[e, i] * z[i + 1] ** 2
        for side in range(2):
            matrix(q[e + side], R)
            b = in_frame(R, rod.field[e + side])
            w = in_frame(R, rod.weight[e + side])
            density = (
                b[0] * rod.moment[e, 0] + b[1] * rod.moment[e, 1] + b[2] * rod.moment[e, 2] + w[0]
            )
            for i in range(3):
                density += 0.5 * rod.compliance[e, i] * (w[i] + rod.moment[e, 0] * b[i]) ** 2
            total -= 0.5 * rod.length[e] * density
    return total


@inlined
def _add_symmetric(H, diagonal, beside):
    """Add a symmetric matrix to H: its entries (0, 0), (1, 1), (2, 2), and (0, 1), (0, 2), (1, 2)."""
    H[0, 0] += diagonal[0]
    H[1, 1] += diagonal[1]
    H[2, 2] += diagonal[2]
    H[0, 1] += beside[0]
    H[1, 0] += beside[0]
    H[0, 2] += beside[1]
    H[2, 0] += beside[1]
    H[1, 2] += beside[2]
    H[2, 1] += beside[2]


@inlined
def _add_potential(h, b, w, m, c, g, H):
    """Add gradient and Hessian, times h, of a frame's potential. b, w: field and weight in the frame; m: moment; c: compliance.

    With f = w + m_0 b, F = C f and the first axis e: the gradient is b x m + w x e + f x F, the Hessian the symmetric part of
    (b . m + w . e + f . F) I - b m^T - w e^T - F f^T, less [f]^T C [f]. Every entry is written out, as loops over them keep
    nothing in registers and take many times as long.
    """
    f0, f1, f2 = pulling(b, w, m[0])
    g[0] += h * (b[1] * m[2] - b[2] * m[1] + (c[2] - c[1]) * f1 * f2)
    g[1] += h * (b[2] * m[0] - b[0] * m[2] + w[2] + (c[0] - c[2]) * f2 * f0)
    g[2] += h * (b[0] * m[1] - b[1] * m[0] - w[1] + (c[1] - c[0]) * f0 * f1)
    along = w[0] + b[0] * m[0]
    b1m1 = b[1] * m[1]
    b2m2 = b[2] * m[2]
    _add_symmetric(
        H,
        (
            h * (b1m1 + b2m2 + (c[1] - c[2]) * (f1 * f1 - f2 * f2)),
            h * (along + b2m2 + (c[0] - c[2]) * (f0 * f0 - f2 * f2)),
            h * (along + b1m1 + (c[0] - c[1]) * (f0 * f0 - f1 * f1)),
        ),
        (
            h * ((c[2] - 0.5 * (c[0] + c[1])) * f0 * f1 - 0.5 * (b[0] * m[1] + b[1] * m[0] + w[1])),
            h * ((c[1] - 0.5 * (c[0] + c[2])) * f0 * f2 - 0.5 * (b[0] * m[2] + b[2] * m[0] + w[2])),
            h * ((c[0] - 0.5 * (c[1] + c[2])) * f1 * f2 - 0.5 * (b[1] * m[2] + b[2] * m[1])),
        ),
    )


@inlined
def _add_bending(length, D, z, ga, gb, Haa, Hbb, Hab):
    """Add gradient and Hessian of an element's bending and twist energy with respect to the rotations of its two frames, a and b.

    The relative rotation has the scalar w and the vector v = (x, y, z); with S = 4 D / length, M = S v and X = [v] / 2 (the matrix of the
    cross product), rotations turn v by A = X - w / 2 and B = X + w / 2. So g_a = A^T M, H_aa = A^T S A - (M . v) / 4, H_bb alike, and
    H_ab = A^T S B + (M v^T + v M^T - M . v + w [M]) / 4. As in `_add_potential`, every entry is written out.
    """
    w = z[0]
    x = z[1]
    y = z[2]
    z = z[3]
    s0 = 4.0 / length * D[0]
    s1 = 4.0 / length * D[1]
    s2 = 4.0 / length * D[2]
    ga[0] -= 0.5 * (w * s0 * x + (s2 - s1) * y * z)
    ga[1] -= 0.5 * (w * s1 * y + (s0 - s2) * z * x)
    ga[2] -= 0.5 * (w * s2 * z + (s1 - s0) * x * y)
    gb[0] += 0.5 * (w * s0 * x - (s2 - s1) * y * z)
    gb[1] += 0.5 * (w * s1 * y - (s0 - s2) * z * x)
    gb[2] += 0.5 * (w * s2 * z - (s1 - s0) * x * y)
    diagonal = (
        0.25 * (s0 * (w * w - x * x) + (s1 - s2) * (z * z - y * y)),
        0.25 * (s1 * (w * w - y * y) + (s0 - s2) * (z * z - x * x)),
        0.25 * (s2 * (w * w - z * z) + (s0 - s1) * (y * y - x * x)),
    )
    for H, w_side in ((Haa, -w), (Hbb, w)):
        _add_symmetric(
            H,
            diagonal,
            (
                -0.25 * (s2 * x * y + w_side * (s0 - s1) * z),
                -0.25 * (s1 * x * z - w_side * (s0 - s2) * y),
                -0.25 * (s0 * y * z + w_side * (s1 - s2) * x),
            ),
        )
    Hab[0, 0] = diagonal[0] - 0.5 * s0 * (w * w - x * x)
    Hab[1, 1] = diagonal[1] - 0.5 * s1 * (w * w - y * y)
    Hab[2, 2] = diagonal[2] - 0.5 * s2 * (w * w - z * z)
    Hab[0, 1] = 0.25 * (s0 + s1 - s2) * (x * y + w * z)
    Hab[1, 0] = 0.25 * (s0 + s1 - s2) * (x * y - w * z)
    Hab[0, 2] = 0.25 * (s0 + s2 - s1) * (x * z - w * y)
    Hab[2, 0] = 0.25 * (s0 + s2 - s1) * (x * z + w * y)
    Hab[1, 2] = 0.25 * (s1 + s2 - s0) * (y * z + w * x)
    Hab[2, 1] = 0.25 * (s1 + s2 - s0) * (y * z - w * x)


@compiled
def derivatives(q, rod, g, Hd, Ho):
    """Write the gradient and the Hessian of the energy to g, Hd and Ho."""
    R = np.empty((3, 3))
    z = np.empty(4)
    n = len(rod.length)
    g[:], Hd[:] = 0.0, 0.0
    for e in range(n):
        relative(q[e], q[e + 1], z)
        _add_bending(rod.length[e], rod.twist_bend[e], z, g[e], g[e + 1], Hd[e], Hd[e + 1], Ho[e])
    for k in range(n + 1):
        matrix(q[k], R)
        b = in_frame(R, rod.field[k])
        w = in_frame(R, rod.weight[k])
        for e in range(max(k - 1, 0), min(k + 1, n)):
            _add_potential(0.5 * rod.length[e], b, w, rod.moment[e], rod.compliance[e], g[k], Hd[k])


@inner
def _cholesky3(A):
    """Cholesky of a 3 x 3 block in place (lower, its diagonal inverted). Returns False where it is not positive definite."""
    for j in range(3):
        d = A[j, j]
        for k in range(j):
            d -= A[j, k] ** 2
        if not d > 0.0:
            return False
        A[j, j] = 1.0 / np.sqrt(d)
        for i in range(j + 1, 3):
            s = A[i, j]
            for k in range(j):
                s -= A[i, k] * A[j, k]
            A[i, j] = s * A[j, j]
    return True


@inner
def factor(Hd, Ho, shift, Ld, Lo):
    """Block Cholesky of the Hessian of frames 1 .. n plus shift: Ld (n + 1, 3, 3) lower, its diagonals inverted; Lo (n, 3, 3).

    False: not positive definite.
    """
    n = len(Ho)
    for k in range(1, n + 1):
        for i in range(3):
            for j in range(3):
                Ld[k, i, j] = Hd[k, i, j]
            Ld[k, i, i] += shift
        if k > 1:
            for row in range(3):  # Lo[k-1] = L[k-1]^-1 Ho[k-1]
                for col in range(3):
                    s = Ho[k - 1, row, col]
                    for t in range(row):
                        s -= Ld[k - 1, row, t] * Lo[k - 1, t, col]
                    Lo[k - 1, row, col] = s * Ld[k - 1, row, row]
            for i in range(3):
                for j in range(3):
                    for t in range(3):
                        Ld[k, i, j] -= Lo[k - 1, t, i] * Lo[k - 1, t, j]
        if not _cholesky3(Ld[k]):
            return False
    return True


@inner
def solve(Ld, Lo, x):
    """x (n + 1, 3) in place: right-hand side -> solution; frame 0 stays at rest."""
    n = len(Lo)
    x[0] = 0.0
    for k in range(1, n + 1):
        for i in range(3):
            s = x[k, i]
            if k > 1:
                for t in range(3):
                    s -= Lo[k - 1, t, i] * x[k - 1, t]
            for t in range(i):
                s -= Ld[k, i, t] * x[k, t]
            x[k, i] = s * Ld[k, i, i]
    for k in range(n, 0, -1):
        for i in range(2, -1, -1):
            s = x[k, i]
            if k < n:
                for t in range(3):
                    s -= Lo[k, i, t] * x[k + 1, t]
            for t in range(i + 1, 3):
                s -= Ld[k, t, i] * x[k, t]
            x[k, i] = s * Ld[k, i, i]


@inner
def _dot(a, b):
    """Sum of the products of two (n, 3) arrays. (Array expressions would take seconds to compile.)"""
    total = 0.0
    for k in range(len(a)):
        total += a[k, 0] * b[k, 0] + a[k, 1] * b[k, 1] + a[k, 2] * b[k, 2]
    return total


@inner
def _scaled(a, factor, out):
    """out = factor a, (n, 3)."""
    for k in range(len(a)):
        for i in range(3):
            out[k, i] = factor * a[k, i]


@inner
def _copy(a, out):
    """out = a, quaternions (n, 4)."""
    for k in range(len(a)):
        for i in range(4):
            out[k, i] = a[k, i]


@inner
def _softest(Ld, Lo, d):
    """Direction (n + 1, 3) of least curvature, by inverse iteration from a fixed vector, so the result is always the same."""
    for k in range(len(d)):
        d[k, 0], d[k, 1], d[k, 2] = (
            1e-5,
            -1.0,
            1e-5,
        )  # a rotation about -y: a straight rod buckles toward +z
    for _ in range(60):
        solve(Ld, Lo, d)
        _scaled(d, 1.0 / np.sqrt(_dot(d, d)), d)


@inner
def work_space(n):
    """Arrays for the gradient g, the Hessian Hd and Ho, and its factors Ld and Lo, of n elements."""
    return (
        np.empty((n + 1, 3)),
        np.empty((n + 1, 3, 3)),
        np.empty((n, 3, 3)),
        np.empty((n + 1, 3, 3)),
        np.empty((n, 3, 3)),
    )


@compiled_elsewhere
def relax(q, rod):
    """Newton's method for a minimum of the energy, from q (changed in place).

    Returns status (0 found, 1 not within MAX_STEPS), steps, energy, stable (the Hessian is positive definite there).
    """
    n = len(rod.length)
    g, Hd, Ho, Ld, Lo = work_space(n)
    d = np.empty((n + 1, 3))
    turn = np.empty((n + 1, 3))
    trial = np.empty((n + 1, 4))
    _copy(q, trial)
    energy = _energy(q, rod)
    scale = 0.0
    total = 0.0
    for e in range(n):
        scale += 0.5 * rod.length[e] * rod.twist_bend[e, 1]
        total += rod.length[e]
    scale /= total**2  # energy of bending by one radian
    noise = 1e-14 * (
        abs(energy) + scale
    )  # rounding error of the sum: smaller differences of energies mean nothing
    for step in range(MAX_STEPS):
        derivatives(q, rod, g, Hd, Ho)
        shift = 0.0
        least = 1e-4 * scale / n
        while not factor(Hd, Ho, shift, Ld, Lo):
            shift = max(least, 4.0 * shift)
        _scaled(g, -1.0, d)
        solve(Ld, Lo, d)
        decrement = -_dot(g, d)
        if decrement < 1e-14 * scale:
            if shift == 0.0:
                for k in range(1, n + 1):
                    _turn(q[k], d[k], trial[k])
                _copy(trial, q)
                return 0, step + 1, _energy(q, rod), True
            _softest(Ld, Lo, d)  # leave an unstable equilibrium
            if _dot(g, d) > 0.0:
                _scaled(d, -1.0, d)
            decrement = 0.0
        largest = 0.0
        for k in range(1, n + 1):
            largest = max(largest, np.sqrt(d[k, 0] ** 2 + d[k, 1] ** 2 + d[k, 2] ** 2))
        a = LARGEST_TURN / largest if largest > LARGEST_TURN or decrement == 0.0 else 1.0
        while True:
            _scaled(d, a, turn)
            for k in range(1, n + 1):
                _turn(q[k], turn[k], trial[k])
            reached = _energy(trial, rod)
            if reached <= energy - 1e-4 * a * decrement + noise:
                break
            a *= 0.5
            if a < 1e-10:
                return 1, step + 1, energy, False
        _copy(trial, q)
        energy = reached
    return 1, MAX_STEPS, energy, False


@compiled_elsewhere
def frames_of(q, rod):
    """Positions (n + 1, 3) m, frames (n + 1, 3, 3), curvature (n + 1, 3) 1/m and strain (n + 1, 3) of a rod's quaternions."""
    n = len(rod.length)
    position = np.zeros((n + 1, 3))
    frames = np.empty((n + 1, 3, 3))
    curvature = np.zeros((n + 1, 3))
    strain = np.zeros((n + 1, 3))
    count = np.zeros(n + 1)
    R = np.empty((3, 3))
    z = np.empty(4)
    mid = np.empty(4)
    v = np.empty(3)
    for k in range(n + 1):
        matrix(q[k], frames[k])
    for e in range(n):
        relative(q[e], q[e + 1], z)
        half_way(q[e], q[e + 1], mid)
        for part in range(3):  # Simpson's rule: the element's two frames and the one half-way
            if part == 1:
                matrix(mid, R)
            else:
                matrix(q[e + part // 2], R)
            _, f = at_part(R, rod, e, part)
            for i in range(3):
                v[i] = rod.compliance[e, i] * f[i]
            v[0] += 1.0
            share = rod.length[e] * (4.0 if part == 1 else 1.0) / 6.0
            for i in range(3):
                position[e + 1, i] += share * (R[i, 0] * v[0] + R[i, 1] * v[1] + R[i, 2] * v[2])
            if part != 1:
                k = e + part // 2
                count[k] += 1.0
                for i in range(3):
                    strain[k, i] += v[i]
                    curvature[k, i] += 2.0 / rod.length[e] * z[i + 1]
        for i in range(3):
            position[e + 1, i] += position[e, i]
    for k in range(n + 1):
        for i in range(3):
            strain[k, i] /= count[k]
            curvature[k, i] /= count[k]
    return position, frames, curvature, strain
