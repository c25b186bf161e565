"""Compiled functions of the rod: energy, derivatives, block-tridiagonal Newton. The formulas are in magmpm.rod.cosserat.

Unknowns are rotations d_k (3) of frames 1 .. n about their own axes, q_k -> q_k exp(d_k / 2). Shapes: q (n + 1, 4) unit quaternions, scalar
first; g (n + 1, 3); Hd (n + 1, 3, 3) and Ho (n, 3, 3): the Hessian's blocks of frame e, and of frames e (row) and e + 1 (column).
"""

from typing import NamedTuple

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.compiled.jit import compiled, compiled_elsewhere, inner

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


@inner
def matrix(q, R):
    """Write the rotation matrix of a unit quaternion to R (3, 3)."""
    w = q[0]
    x = q[1]
    y = q[2]
    z = q[3]
    R[0, 0], R[0, 1], R[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    R[1, 0], R[1, 1], R[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    R[2, 0], R[2, 1], R[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)


@inner
def _relative(a, b, z):
    """z = conj(a) b, with z[0] >= 0."""
    z[0] = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]
    z[1] = a[0] * b[1] - a[1] * b[0] - a[2] * b[3] + a[3] * b[2]
    z[2] = a[0] * b[2] + a[1] * b[3] - a[2] * b[0] - a[3] * b[1]
    z[3] = a[0] * b[3] - a[1] * b[2] + a[2] * b[1] - a[3] * b[0]
    if z[0] < 0:
        for i in range(4):
            z[i] = -z[i]


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


@inner
def _to_frame(R, v, out):
    """out = R^T v."""
    for i in range(3):
        out[i] = R[0, i] * v[0] + R[1, i] * v[1] + R[2, i] * v[2]


@compiled
def _energy(q, rod):
    """Energy of the rod, J."""
    R = np.empty((3, 3))
    z = np.empty(4)
    b = np.empty(3)
    w = np.empty(3)
    total = 0.0
    for e in range(len(rod.length)):
        _relative(q[e], q[e + 1], z)
        for i in range(3):
            total += 2.0 / rod.length[e] * rod.twist_bend[e, i] * z[i + 1] ** 2
        for side in range(2):
            matrix(q[e + side], R)
            _to_frame(R, rod.field[e + side], b)
            _to_frame(R, rod.weight[e + side], w)
            density = (
                b[0] * rod.moment[e, 0] + b[1] * rod.moment[e, 1] + b[2] * rod.moment[e, 2] + w[0]
            )
            for i in range(3):
                density += 0.5 * rod.compliance[e, i] * (w[i] + rod.moment[e, 0] * b[i]) ** 2
            total -= 0.5 * rod.length[e] * density
    return total


@inner
def _add_potential(h, b, w, m, c, g, H):
    """Add gradient and Hessian, times h, of a frame's potential. b, w: field and weight in the frame; m: moment; c: compliance."""
    f = np.empty(3)
    Cf = np.empty(3)
    for i in range(3):
        f[i] = w[i] + m[0] * b[i]
        Cf[i] = c[i] * f[i]
    bm = b[0] * m[0] + b[1] * m[1] + b[2] * m[2] + w[0]
    fCf = f[0] * Cf[0] + f[1] * Cf[1] + f[2] * Cf[2]
    for i in range(3):
        j = (i + 1) % 3
        k = (i + 2) % 3
        ej = 1.0 if j == 0 else 0.0
        ek = 1.0 if k == 0 else 0.0
        g[i] += h * (
            b[j] * m[k] - b[k] * m[j] + w[j] * ek - w[k] * ej + f[j] * Cf[k] - f[k] * Cf[j]
        )
        for n in range(3):
            en = 1.0 if n == 0 else 0.0
            ei = 1.0 if i == 0 else 0.0
            value = -0.5 * (
                b[i] * m[n] + m[i] * b[n] + w[i] * en + ei * w[n] + Cf[i] * f[n] + f[i] * Cf[n]
            )
            H[i, n] += h * (value + (bm + fCf if i == n else 0.0))
    # -[f]^T C [f], with [f] the cross-product matrix
    H[0, 0] -= h * (c[1] * f[2] ** 2 + c[2] * f[1] ** 2)
    H[1, 1] -= h * (c[0] * f[2] ** 2 + c[2] * f[0] ** 2)
    H[2, 2] -= h * (c[0] * f[1] ** 2 + c[1] * f[0] ** 2)
    H[0, 1] += h * c[2] * f[0] * f[1]
    H[1, 0] += h * c[2] * f[0] * f[1]
    H[0, 2] += h * c[1] * f[0] * f[2]
    H[2, 0] += h * c[1] * f[0] * f[2]
    H[1, 2] += h * c[0] * f[1] * f[2]
    H[2, 1] += h * c[0] * f[1] * f[2]


@inner
def _add_bending(e, q, rod, z, work, g, Hd, Ho):
    """Add gradient and Hessian of an element's bending and twist energy with respect to the rotations of its two frames."""
    _relative(q[e], q[e + 1], z)
    length = rod.length[e]
    D = rod.twist_bend[e]
    ga = g[e]
    gb = g[e + 1]
    Haa = Hd[e]
    Hbb = Hd[e + 1]
    Hab = Ho[e]
    w = z[0]
    Ba = work[0]
    Bb = work[1]
    M = work[2, 0]
    for i in range(3):
        M[i] = 4.0 / length * D[i] * z[i + 1]
        Ba[i, i], Bb[i, i] = -0.5 * w, 0.5 * w
        j = (i + 1) % 3
        k = (i + 2) % 3
        Ba[i, j], Bb[i, j] = -0.5 * z[k + 1], -0.5 * z[k + 1]
        Ba[i, k], Bb[i, k] = 0.5 * z[j + 1], 0.5 * z[j + 1]
    Mv = M[0] * z[1] + M[1] * z[2] + M[2] * z[3]
    for i in range(3):
        for n in range(3):
            ga[i] += Ba[n, i] * M[n]
            gb[i] += Bb[n, i] * M[n]
            aa = 0.0
            bb = 0.0
            ab = 0.0
            for k in range(3):
                s = 4.0 / length * D[k]
                aa += s * Ba[k, i] * Ba[k, n]
                bb += s * Bb[k, i] * Bb[k, n]
                ab += s * Ba[k, i] * Bb[k, n]
            Haa[i, n] += aa
            Hbb[i, n] += bb
            Hab[i, n] += ab + 0.25 * (M[i] * z[n + 1] + z[i + 1] * M[n])
        Haa[i, i] -= 0.25 * Mv
        Hbb[i, i] -= 0.25 * Mv
        Hab[i, i] -= 0.25 * Mv
        j = (i + 1) % 3
        k = (i + 2) % 3
        Hab[i, j] -= 0.25 * w * M[k]
        Hab[i, k] += 0.25 * w * M[j]


@compiled
def derivatives(q, rod, g, Hd, Ho):
    """Write the gradient and the Hessian of the energy to g, Hd and Ho."""
    R = np.empty((3, 3))
    z = np.empty(4)
    b = np.empty(3)
    w = np.empty(3)
    work = np.empty((3, 3, 3))
    g[:], Hd[:], Ho[:] = 0.0, 0.0, 0.0
    for e in range(len(rod.length)):
        _add_bending(e, q, rod, z, work, g, Hd, Ho)
        half = 0.5 * rod.length[e]
        for side in range(2):
            k = e + side
            matrix(q[k], R)
            _to_frame(R, rod.field[k], b)
            _to_frame(R, rod.weight[k], w)
            _add_potential(half, b, w, rod.moment[e], rod.compliance[e], g[k], Hd[k])


@inner
def _cholesky3(A):
    """Cholesky of a 3 x 3 block in place (lower). Returns False where it is not positive definite."""
    for j in range(3):
        d = A[j, j]
        for k in range(j):
            d -= A[j, k] ** 2
        if not d > 0.0:
            return False
        A[j, j] = np.sqrt(d)
        for i in range(j + 1, 3):
            s = A[i, j]
            for k in range(j):
                s -= A[i, k] * A[j, k]
            A[i, j] = s / A[j, j]
    return True


@inner
def factor(Hd, Ho, shift, Ld, Lo):
    """Block Cholesky of the Hessian of frames 1 .. n plus shift: Ld (n + 1, 3, 3) lower, Lo (n, 3, 3). False: not positive definite."""
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
                    Lo[k - 1, row, col] = s / Ld[k - 1, row, row]
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
            x[k, i] = s / Ld[k, i, i]
    for k in range(n, 0, -1):
        for i in range(2, -1, -1):
            s = x[k, i]
            if k < n:
                for t in range(3):
                    s -= Lo[k, i, t] * x[k + 1, t]
            for t in range(i + 1, 3):
                s -= Ld[k, t, i] * x[k, t]
            x[k, i] = s / Ld[k, i, i]


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


@compiled_elsewhere
def relax(q, rod):
    """Newton's method for a minimum of the energy, from q (changed in place).

    Returns status (0 found, 1 not within MAX_STEPS), steps, energy, stable (the Hessian is positive definite there).
    """
    n = len(rod.length)
    g = np.empty((n + 1, 3))
    Hd = np.empty((n + 1, 3, 3))
    Ho = np.empty((n, 3, 3))
    Ld = np.empty((n + 1, 3, 3))
    Lo = np.empty((n, 3, 3))
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
    b = np.empty(3)
    w = np.empty(3)
    v = np.empty(3)
    pull = np.empty(3)
    around = np.empty(3)
    for k in range(n + 1):
        matrix(q[k], frames[k])
    for e in range(n):
        _relative(q[e], q[e + 1], z)
        dot = 0.0
        size = 0.0
        for i in range(4):
            dot += q[e, i] * q[e + 1, i]
        for i in range(4):
            mid[i] = q[e, i] + (q[e + 1, i] if dot >= 0 else -q[e + 1, i])
            size += mid[i] ** 2
        for i in range(4):
            mid[i] /= np.sqrt(size)
        for part in range(
            3
        ):  # Simpson's rule along the element: its two frames and the one half-way
            if part == 1:
                matrix(mid, R)
                side = e
                other = e + 1
            else:
                side = other = e + part // 2
                for i in range(3):
                    for j in range(3):
                        R[i, j] = frames[side, i, j]
            for i in range(3):
                pull[i] = 0.5 * (rod.weight[side, i] + rod.weight[other, i])
                around[i] = 0.5 * (rod.field[side, i] + rod.field[other, i])
            _to_frame(R, around, b)
            _to_frame(R, pull, w)
            for i in range(3):
                v[i] = (1.0 if i == 0 else 0.0) + rod.compliance[e, i] * (
                    w[i] + rod.moment[e, 0] * b[i]
                )
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
