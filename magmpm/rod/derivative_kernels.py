"""Compiled derivatives of the rod's equilibrium, by the implicit function theorem. The formulas of the rod are in magmpm.rod.cosserat.

At an equilibrium the gradient g(d; p) of the energy with respect to the frames' rotations is zero, so the rotations change with a parameter
by d' = -H^-1 dg/dp, with the block-tridiagonal Hessian H that Newton's method factors anyway. A frame's potential has the gradient
b x m + w x e_1 + f x C f (f = w + m_1 b), and its derivative follows by the product rule.

Columns come in threes, one for each component: first the moments, dm_e = sizes[i, e] e_j, then the loads, dB_k = shares[g, 0, k] e_j with
dW_k = shares[g, 1, k] e_j (a uniform field has the shares 1 and 0, gravity 0 and the mass beyond each frame). `parameters` are sizes
(groups, n) and shares (groups, 2, n + 1).
"""

import numpy as np

from magmpm.compiled.jit import compiled_elsewhere, inlined, inner, task_body
from magmpm.compiled.parallel import over_parts, task
from magmpm.rod.kernels import (
    LoadedRod,
    _dot,
    _scaled,
    at_part,
    derivatives,
    factor,
    frames_of,
    half_way,
    in_frame,
    matrix,
    pulling,
    relative,
    relax,
    solve,
    work_space,
)


@inner
def _clear(a):
    """a (n, 3) = 0. (Array expressions would take seconds to compile.)"""
    for k in range(len(a)):
        for i in range(3):
            a[k, i] = 0.0


@inlined
def _product(h, A, B, out):
    """out = h A B, all (3, 3)."""
    for i in range(3):
        for j in range(3):
            out[i, j] = h * (A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j])


@inlined
def _add(A, out):
    """out += A, both (3, 3)."""
    for i in range(3):
        for j in range(3):
            out[i, j] += A[i, j]


@inlined
def _crossing(w, v, out):
    """out = w I + [v], (3, 3): w d + v x d of a vector d."""
    out[0, 0], out[0, 1], out[0, 2] = w, -v[2], v[1]
    out[1, 0], out[1, 1], out[1, 2] = v[2], w, -v[0]
    out[2, 0], out[2, 1], out[2, 2] = -v[1], v[0], w


@inlined
def _turned_by(mid, r, size, a, out):
    """out (3, 3): by what a rotation of r (own axes) turns the frame mid half-way to another; size: as of `half_way`; a: work space.

    It is the vector part of a (0, d), with the quaternion a = conj(mid) r / size.
    """
    relative(mid, r, a)
    _crossing(a[0] / size, (a[1] / size, a[2] / size, a[3] / size), out)


@inlined
def _stretched(c, f, out):
    """out (3, 3): by what a rotation d of a frame changes v = e_1 + C f, in axes that stay: d x v + C (f x d)."""
    out[0, 0], out[0, 1], out[0, 2] = 0.0, (c[2] - c[0]) * f[2], (c[0] - c[1]) * f[1]
    out[1, 0], out[1, 1], out[1, 2] = (c[1] - c[2]) * f[2], 0.0, 1.0 + (c[0] - c[1]) * f[0]
    out[2, 0], out[2, 1], out[2, 2] = (c[1] - c[2]) * f[1], (c[2] - c[0]) * f[0] - 1.0, 0.0


@inner
def _elements(q, rod, A, P, Q):
    """Add to zeros the derivatives of the elements' spans by rotations of their frames A, fields there P (both (n, 2, 3, 3)), m_0 Q (n, 3).

    P without its factor m_0 answers to the weights. The span is Simpson's rule over the frames and the one half-way of R (e_1 + C f).
    """
    R = np.empty((3, 3))
    mid = np.empty(4)
    a = np.empty(4)
    turned = np.empty((2, 3, 3))
    stretched = np.empty((3, 3))
    moved = np.empty((3, 3))
    step = np.empty((3, 3))
    for e in range(len(rod.length)):
        c = rod.compliance[e]
        size = half_way(q[e], q[e + 1], mid)
        for side in range(2):
            _turned_by(mid, q[e + side], size, a, turned[side])
        for part in range(3):
            if part == 1:
                matrix(mid, R)
            else:
                matrix(q[e + part // 2], R)
            b, f = at_part(R, rod, e, part)
            share = rod.length[e] * (4.0 if part == 1 else 1.0) / 6.0
            _stretched(c, f, stretched)
            _product(share, R, stretched, moved)
            if part == 1:
                for side in range(2):
                    _product(1.0, moved, turned[side], step)
                    _add(step, A[e, side])
            else:
                _add(moved, A[e, part // 2])
            for i in range(3):
                C = (share * R[i, 0] * c[0], share * R[i, 1] * c[1], share * R[i, 2] * c[2])
                Q[e, i] += C[0] * b[0] + C[1] * b[1] + C[2] * b[2]
                for j in range(3):
                    value = C[0] * R[j, 0] + C[1] * R[j, 1] + C[2] * R[j, 2]
                    P[e, 0, i, j] += (1.0 - 0.5 * part) * value
                    P[e, 1, i, j] += 0.5 * part * value


@inner
def _changes(frames, rod, by_moment, by_field, by_weight):
    """Minus the change of the gradient of frame e + side by the moment of element e, and by field and weight there, all (n, 2, 3, 3).

    In the frame, b x m + w x e + f x C f (f = w + m_0 b) changes by b x dm + U b dm_0, by m_0 U db - m x db, and by U dw - e x dw, with
    U = [f] C - [C f], the derivative of f x C f.
    """
    U = np.zeros((3, 3))
    near = np.empty((3, 3))
    turned = np.empty((3, 3))
    for e in range(len(rod.length)):
        m = rod.moment[e]
        c = rod.compliance[e]
        h = -0.5 * rod.length[e]
        for side in range(2):
            R = frames[e + side]
            b = in_frame(R, rod.field[e + side])
            w = in_frame(R, rod.weight[e + side])
            f = pulling(b, w, m[0])
            U[0, 1], U[0, 2] = (c[2] - c[1]) * f[2], (c[2] - c[1]) * f[1]
            U[1, 0], U[1, 2] = (c[0] - c[2]) * f[2], (c[0] - c[2]) * f[0]
            U[2, 0], U[2, 1] = (c[1] - c[0]) * f[1], (c[1] - c[0]) * f[0]
            _crossing(0.0, (h * b[0], h * b[1], h * b[2]), by_moment[e, side])
            _crossing(0.0, (-m[0], -m[1], -m[2]), near)
            for i in range(3):
                by_moment[e, side, i, 0] += h * (U[i, 0] * b[0] + U[i, 1] * b[1] + U[i, 2] * b[2])
                for j in range(3):
                    near[i, j] += m[0] * U[i, j]
                    turned[i, j] = R[j, i]
            _product(h, near, turned, by_field[e, side])
            U[1, 2] += 1.0
            U[2, 1] -= 1.0
            _product(h, U, turned, by_weight[e, side])


@inner
def _right_side(changes, parameters, column, x):
    """x (n + 1, 3): minus the change of the gradient for a column."""
    by_moment, by_field, by_weight = changes
    sizes, shares = parameters
    group = column // 3
    j = column % 3
    moments = len(sizes)
    _clear(x)
    for e in range(len(by_moment)):
        for side in range(2):
            k = e + side
            if group < moments:
                size = sizes[group, e]
                for i in range(3):
                    x[k, i] += size * by_moment[e, side, i, j]
            else:
                field = shares[group - moments, 0, k]
                weight = shares[group - moments, 1, k]
                for i in range(3):
                    x[k, i] += field * by_field[e, side, i, j] + weight * by_weight[e, side, i, j]


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
    g, Hd, Ho, Ld, Lo = work_space(n)
    derivatives(q, rod, g, Hd, Ho)
    if not factor(Hd, Ho, 0.0, Ld, Lo):
        return False
    A = np.zeros((n, 2, 3, 3))
    P = np.zeros((n, 2, 3, 3))
    Q = np.zeros((n, 3))
    _elements(q, rod, A, P, Q)
    changes = (np.empty((n, 2, 3, 3)), np.empty((n, 2, 3, 3)), np.empty((n, 2, 3, 3)))
    _changes(frames, rod, changes[0], changes[1], changes[2])
    for column in range(len(slopes)):
        _right_side(changes, parameters, column, slopes[column, 0])
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


@compiled_elsewhere
def softest(q, rod):
    """Smallest eigenvalue, N/m^2 per kg/m, of a rod's Hessian H with the mass M of its displacements, 1 kg per m; 0: no minimum.

    By iterating x = H^-1 M x: turning about its own tangent has no mass, so H x = (eigenvalue) M x is taken the other way around.
    """
    n = len(rod.length)
    g, Hd, Ho, Ld, Lo = work_space(n)
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


@compiled_elsewhere
def relax_all(q, rods, parameters, position, slopes, found):
    """Equilibria of many rods with their slopes, each from its q (rods, n + 1, 4), changed in place.

    rods: moment (rods, n, 3), field and weight (rods, n + 1, 3); parameters: `sizes` and `shares`. Written: position (rods, n + 1, 3),
    slopes (rods, columns, 2, n + 1, 3; none where there are no columns), found (rods,): whether it is a stable equilibrium.
    """
    over_parts(len(q), task(_relax_one, (q, rods, parameters, position, slopes, found)))
