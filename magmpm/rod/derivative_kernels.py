"""Compiled derivatives of the rod's equilibrium, by the implicit function theorem. The formulas of the rod are in magmpm.rod.cosserat.

At an equilibrium the gradient g(d; p) of the energy with respect to the frames' rotations is zero, so the rotations change with a parameter
by d' = -H^-1 dg/dp, with the block-tridiagonal Hessian H that Newton's method factors anyway. A frame's potential has the gradient
b x m + w x e_1 + f x C f (f = w + m_1 b), and its derivative follows by the product rule.

Columns come in threes, one for each component: first the moments, dm_e = sizes[i, e] e_j, then the loads, dB_k = shares[g, 0, k] e_j with
dW_k = shares[g, 1, k] e_j (a uniform field has the shares 1 and 0, gravity 0 and the mass beyond each frame). `parameters` are sizes
(groups, n) and shares (groups, 2, n + 1).
"""

import numpy as np

from magmpm.compiled.jit import compiled, inner, task_body
from magmpm.compiled.parallel import over_parts, task
from magmpm.rod.kernels import (
    LoadedRod,
    _dot,
    _scaled,
    _to_frame,
    derivatives,
    factor,
    frames_of,
    matrix,
    relax,
    solve,
)


@inner
def _add_cross(h, a, b, out):
    """out += h a x b."""
    out[0] += h * (a[1] * b[2] - a[2] * b[1])
    out[1] += h * (a[2] * b[0] - a[0] * b[2])
    out[2] += h * (a[0] * b[1] - a[1] * b[0])


@inner
def _clear(a):
    """a (n, 3) = 0. (Array expressions would take seconds to compile.)"""
    for k in range(len(a)):
        for i in range(3):
            a[k, i] = 0.0


@inner
def _add_change(h, fields, m, c, changes, work, out):
    """out -= h times the change of a potential's gradient. fields: b, w (2, 3); changes: dm, db, dw (3, 3), all in the frame."""
    b = fields[0]
    w = fields[1]
    dm = changes[0]
    db = changes[1]
    dw = changes[2]
    f = work[0]
    Cf = work[1]
    df = work[2]
    Cdf = work[3]
    axis = work[4]
    for i in range(3):
        f[i] = w[i] + m[0] * b[i]
        df[i] = dw[i] + dm[0] * b[i] + m[0] * db[i]
        Cf[i], Cdf[i] = c[i] * f[i], c[i] * df[i]
        axis[i] = 1.0 if i == 0 else 0.0
    _add_cross(-h, b, dm, out)
    _add_cross(-h, db, m, out)
    _add_cross(-h, dw, axis, out)
    _add_cross(-h, df, Cf, out)
    _add_cross(-h, f, Cdf, out)


@inner
def _imaginary(a, d, factor, out):
    """out += factor times the vector part of a (0, d), a quaternion."""
    out[0] += factor * (a[0] * d[0] + a[2] * d[2] - a[3] * d[1])
    out[1] += factor * (a[0] * d[1] + a[3] * d[0] - a[1] * d[2])
    out[2] += factor * (a[0] * d[2] + a[1] * d[1] - a[2] * d[0])


@inner
def _between(p, q, a, b, mid):
    """Frame half-way between two, mid, and by what their rotations (own axes) turn it: Im(a (0, d_p) + b (0, d_q))."""
    dot = 0.0
    size = 0.0
    for i in range(4):
        dot += p[i] * q[i]
    sign = 1.0 if dot >= 0 else -1.0
    for i in range(4):
        mid[i] = p[i] + sign * q[i]
        size += mid[i] ** 2
    size = np.sqrt(size)
    for i in range(4):
        mid[i] /= size
    for side in range(2):
        r, out, factor = (p, a, 1.0 / size) if side == 0 else (q, b, sign / size)
        out[0] = factor * (mid[0] * r[0] + mid[1] * r[1] + mid[2] * r[2] + mid[3] * r[3])
        out[1] = factor * (mid[0] * r[1] - mid[1] * r[0] - mid[2] * r[3] + mid[3] * r[2])
        out[2] = factor * (mid[0] * r[2] - mid[2] * r[0] - mid[3] * r[1] + mid[1] * r[3])
        out[3] = factor * (mid[0] * r[3] - mid[3] * r[0] - mid[1] * r[2] + mid[2] * r[1])


@inner
def _element(e, q, rod, A, P, Q):
    """Derivatives of an element's span: A (2, 3, 3) by the rotations of its frames, P (2, 3, 3) by the fields there, Q (3) by the axial m0.

    P without its factor m0 answers to the weights. The span is Simpson's rule over the frames and the one half-way of R (e_1 + C f).
    """
    c = rod.compliance[e]
    m0 = rod.moment[e, 0]
    R = np.empty((3, 3))
    mid = np.empty(4)
    ra = np.empty(4)
    rb = np.empty(4)
    b = np.empty(3)
    w = np.empty(3)
    v = np.empty(3)
    Cb = np.empty(3)
    turn = np.empty(3)
    dv = np.empty(3)
    span = np.empty(3)
    unit = np.zeros(3)
    for side in range(2):
        _clear(A[side])
        _clear(P[side])
    for i in range(3):
        Q[i] = 0.0
    _between(q[e], q[e + 1], ra, rb, mid)
    for part in range(3):
        first = (
            1.0 if part == 0 else (0.5 if part == 1 else 0.0)
        )  # share of the first frame's field
        matrix(mid if part == 1 else q[e + part // 2], R)
        for i in range(3):
            b[i] = w[i] = 0.0
            for j in range(3):
                b[i] += R[j, i] * (first * rod.field[e, j] + (1.0 - first) * rod.field[e + 1, j])
                w[i] += R[j, i] * (first * rod.weight[e, j] + (1.0 - first) * rod.weight[e + 1, j])
        for i in range(3):
            v[i] = (1.0 if i == 0 else 0.0) + c[i] * (w[i] + m0 * b[i])
            Cb[i] = c[i] * b[i]
        share = rod.length[e] * (4.0 if part == 1 else 1.0) / 6.0
        for i in range(3):
            for j in range(3):
                Q[i] += share * R[i, j] * Cb[j]
                for t in range(3):
                    value = share * R[i, t] * c[t] * R[j, t]
                    P[0, i, j] += first * value
                    P[1, i, j] += (1.0 - first) * value
        for side in range(2):
            if (side == 0 and part == 2) or (side == 1 and part == 0):
                continue
            for j in range(3):
                for i in range(3):
                    unit[i] = 1.0 if i == j else 0.0
                    turn[i] = dv[i] = span[i] = 0.0
                if part == 1:
                    _imaginary(ra if side == 0 else rb, unit, 1.0, turn)
                else:
                    turn[j] = 1.0
                _add_cross(-1.0, turn, w, dv)
                _add_cross(-m0, turn, b, dv)
                for i in range(3):
                    span[i] = c[i] * dv[i]
                _add_cross(1.0, turn, v, span)
                for i in range(3):
                    for t in range(3):
                        A[side, i, j] += share * R[i, t] * span[t]


@inner
def _right_side(frames, rod, parameters, column, x):
    """x (n + 1, 3): minus the change of the gradient for a column."""
    sizes, shares = parameters
    fields = np.empty((2, 3))
    changes = np.empty((3, 3))
    work = np.empty((5, 3))
    group = column // 3
    j = column % 3
    moments = len(sizes)
    _clear(x)
    for e in range(len(rod.length)):
        if group < moments and sizes[group, e] == 0.0:
            continue
        for side in range(2):
            k = e + side
            R = frames[k]
            _to_frame(R, rod.field[k], fields[0])
            _to_frame(R, rod.weight[k], fields[1])
            _clear(changes)
            if group < moments:
                changes[0, j] = sizes[group, e]
            else:
                for i in range(3):
                    changes[1, i] = shares[group - moments, 0, k] * R[j, i]
                    changes[2, i] = shares[group - moments, 1, k] * R[j, i]
            _add_change(
                0.5 * rod.length[e], fields, rod.moment[e], rod.compliance[e], changes, work, x[k]
            )


@inner
def _add_column(spans, moment, parameters, column, slopes):
    """Positions' slopes, slopes[1] (n + 1, 3), of a column from the rotations slopes[0] and the elements' answers `spans`."""
    A, P, Q = spans
    sizes, shares = parameters
    turn = slopes[0]
    place = slopes[1]
    group = column // 3
    j = column % 3
    moments = len(sizes)
    for i in range(3):
        place[0, i] = 0.0
    for e in range(len(moment)):
        for i in range(3):
            value = place[e, i]
            for t in range(3):
                value += A[e, 0, i, t] * turn[e, t] + A[e, 1, i, t] * turn[e + 1, t]
            if group < moments:
                if j == 0:
                    value += Q[e, i] * sizes[group, e]
            else:
                for side in range(2):
                    k = e + side
                    load = (
                        moment[e, 0] * shares[group - moments, 0, k] + shares[group - moments, 1, k]
                    )
                    value += P[e, side, i, j] * load
            place[e + 1, i] = value


@inner
def _slopes(q, rod, parameters, frames, slopes):
    """All columns: slopes (columns, 2, n + 1, 3), of the rotations (rad, own axes) and of the positions. False: no minimum."""
    n = len(rod.length)
    g = np.empty((n + 1, 3))
    Hd = np.empty((n + 1, 3, 3))
    Ho = np.empty((n, 3, 3))
    Ld = np.empty((n + 1, 3, 3))
    Lo = np.empty((n, 3, 3))
    derivatives(q, rod, g, Hd, Ho)
    if not factor(Hd, Ho, 0.0, Ld, Lo):
        return False
    A = np.empty((n, 2, 3, 3))
    P = np.empty((n, 2, 3, 3))
    Q = np.empty((n, 3))
    for e in range(n):
        _element(e, q, rod, A[e], P[e], Q[e])
    for column in range(len(slopes)):
        _right_side(frames, rod, parameters, column, slopes[column, 0])
        solve(Ld, Lo, slopes[column, 0])
        _add_column((A, P, Q), rod.moment, parameters, column, slopes[column])
    return True


@inner
def _inertia(frames, length, x, moved, out):
    """out = M x, all (n + 1, 3): forces of inertia, 1 kg per m, of the displacements that rotations x (own axes) make, to rotations.

    moved: work space. A rotation d of a frame R moves what is beyond it by R (d x e_1) times half the lengths of its elements.
    """
    n = len(length)
    _clear(moved)
    for k in range(n):
        for i in range(3):
            step = 0.0
            for side in range(2):
                R = frames[k + side]
                step += 0.5 * length[k] * (R[i, 1] * x[k + side, 2] - R[i, 2] * x[k + side, 1])
            moved[k + 1, i] = moved[k, i] + step
    _clear(out)
    force = np.zeros(3)
    for k in range(n - 1, -1, -1):
        share = 0.5 * (length[k] + (length[k + 1] if k + 1 < n else 0.0))
        for i in range(3):
            force[i] += share * moved[k + 1, i]
        for side in range(2):
            R = frames[k + side]
            for i in range(3):
                out[k + side, 2] += 0.5 * length[k] * R[i, 1] * force[i]
                out[k + side, 1] -= 0.5 * length[k] * R[i, 2] * force[i]
    for i in range(3):
        out[0, i] = 0.0


@compiled
def softest(q, rod):
    """Smallest eigenvalue, N/m^2 per kg/m, of a rod's Hessian H with the mass M of its displacements, 1 kg per m; 0: no minimum.

    By iterating x = H^-1 M x: turning about its own tangent has no mass, so H x = (eigenvalue) M x is taken the other way around.
    """
    n = len(rod.length)
    g = np.empty((n + 1, 3))
    Hd = np.empty((n + 1, 3, 3))
    Ho = np.empty((n, 3, 3))
    Ld = np.empty((n + 1, 3, 3))
    Lo = np.empty((n, 3, 3))
    frames = np.empty((n + 1, 3, 3))
    x = np.empty((n + 1, 3))
    Mx = np.empty((n + 1, 3))
    moved = np.empty((n + 1, 3))
    for k in range(n + 1):
        matrix(q[k], frames[k])
        x[k, 0], x[k, 1], x[k, 2] = 0.1, 1.0, 0.6
    derivatives(q, rod, g, Hd, Ho)
    if not factor(Hd, Ho, 0.0, Ld, Lo):
        return 0.0
    value = 0.0
    for _ in range(60):
        _inertia(frames, rod.length, x, moved, Mx)
        mass = _dot(x, Mx)
        _scaled(Mx, 1.0, x)
        solve(Ld, Lo, x)
        # Rayleigh's quotient of the iteration before, from below its error squared
        before = value
        value = mass / _dot(x, Mx)
        if abs(value - before) < 1e-4 * value:
            break
        _scaled(x, 1.0 / np.sqrt(_dot(x, x)), x)
    return value


@task_body
def _relax_one(r, given):
    """`relax_all` of one rod."""
    q, rods, parameters, position, slopes, found = given
    rod = LoadedRod(
        rods.length,
        rods.twist_bend,
        rods.compliance,
        rods.moment[r],
        rods.field[r],
        rods.weight[r],
    )
    status, _, _, stable = relax(q[r], rod)
    place, frames, _, _ = frames_of(q[r], rod)
    for k in range(len(place)):
        for i in range(3):
            position[r, k, i] = place[k, i]
    found[r] = status == 0 and stable
    if found[r] and slopes.shape[1] > 0:
        found[r] = _slopes(q[r], rod, parameters, frames, slopes[r])


@compiled
def relax_all(q, rods, parameters, position, slopes, found):
    """Equilibria of many rods with their slopes, each from its q (rods, n + 1, 4), changed in place.

    rods: moment (rods, n, 3), field and weight (rods, n + 1, 3); parameters: `sizes` and `shares`. Written: position (rods, n + 1, 3),
    slopes (rods, columns, 2, n + 1, 3; none where there are no columns), found (rods,): whether it is a stable equilibrium.
    """
    over_parts(len(q), task(_relax_one, (q, rods, parameters, position, slopes, found)))
