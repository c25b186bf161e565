"""P2G, grid update and G2P of the updated formulation (MLS-MPM with APIC): the grid is fixed in space, and particles move through it.

A node holds four floats: mass and momentum, or 0 and velocity; a particle's values are rows of four as well. Two nodes of a row along z are
one register, so a particle scatters to its 27 nodes in 18 multiplications and additions, and no sum over lanes is needed. Stress and
effects are done for eight particles at a time. Particles are sorted by slabs of four planes of cells, each slab's number rounded up to
eight by particles without mass; a particle drifts by less than a cell before it is sorted again, so two slabs of one colour never
touch the same node, and every sum is made in one order: the same bits at any number of threads.

Sources: Hu et al., ACM Trans. Graph. 37 (2018) 150 (MLS-MPM); Jiang et al., ACM Trans. Graph. 34 (2015) 51 (APIC).
"""

from __future__ import annotations

import numpy as np

from magmpm.effects.hooks import change_node, has_contact, has_node, has_rate_stress
from magmpm.jit import compiled, kernel, prange
from magmpm.simd import (
    flag_unless_positive,
    four,
    halves,
    load,
    lowest,
    smaller,
    splat,
    store,
    store_folded,
    store_strided,
    strided,
    total,
)
from magmpm.transfer.lanes import add_effects, any_effect, determinant, neo_hookean

DRIFT = 0.95  # cells a particle may move before it must be sorted again; less than 1


@compiled
def _splines(s, h, N, d):  # type: ignore[no-untyped-def]
    """First node of a particle at s (cells from the origin) along an axis; N (3,) splines, d (3,) m nodes' places less the particle's."""
    first = int(s)
    t = s - first
    N[0] = 0.5 * (1.0 - t) * (1.0 - t)
    N[1] = 0.5 + t * (1.0 - t)
    N[2] = 0.5 * t * t
    for k in range(3):
        d[k] = (k - 0.5 - t) * h
    return first


@compiled
def _locate(x, p, origin, h, N, d):  # type: ignore[no-untyped-def]
    """Splines and distances of particle p along the three axes into N, d (3, 3); returns its first node's index along each."""
    i = _splines((x[4 * p] - origin[0]) / h[0], h[0], N[0], d[0])
    j = _splines((x[4 * p + 1] - origin[1]) / h[1], h[1], N[1], d[1])
    k = _splines((x[4 * p + 2] - origin[2]) / h[2], h[2], N[2], d[2])
    return i, j, k


@compiled
def _prepare(block, step, dt, h, x, v, C, F, volume, shear, bulk, magnet, density, effects, work, out):  # type: ignore[no-untyped-def]
    """Mass, momentum and affine momentum of a block of eight particles into out (8 16,): four rows of four each. Returns its det F.

    out: [m, m v + dt f], and [0, column k of m C - dt V P F^T 4/h_k^2] for k = x, y, z.
    """
    P, f, dF, velocity, place = work
    at = 72 * block
    J = determinant(F, at)
    neo_hookean(F, at, J, load(shear, 8 * block), (J - 1.0) * load(bulk, 8 * block), P)
    V = load(volume, 8 * block)
    f[:] = 0.0
    rows, columns = 32 * block, 96 * block
    if any_effect(effects):
        for i in range(3):
            store(place, 8 * i, strided(x, rows + i, 4))
            if has_contact(effects):
                store(velocity, 8 * i, strided(v, rows + i + 1, 4))
            for k in range(3 if has_rate_stress(effects) else 0):
                rate = splat(0.0)
                for m in range(3):
                    rate = rate + strided(C, columns + 4 * m + i + 1, 12) * load(F, at + 8 * (3 * m + k))
                store(dF, 8 * (3 * i + k), rate)
        add_effects(effects, step, dt, block, F, at, P, dF, place, velocity, f, magnet, density, volume)
    mass = load(density, 8 * block) * V
    store_strided(out, 0, 16, mass)
    for i in range(3):
        p = mass * strided(v, rows + i + 1, 4) + dt * (V * load(f, 8 * i))
        store_strided(out, i + 1, 16, p)
        for k in range(3):
            tau = load(P, 24 * i) * load(F, at + 24 * k)
            tau = tau + load(P, 24 * i + 8) * load(F, at + 24 * k + 8) + load(P, 24 * i + 16) * load(F, at + 24 * k + 16)
            q = mass * strided(C, columns + 4 * k + i + 1, 12) - (dt * 4.0 / (h[k] * h[k])) * (V * tau)
            store_strided(out, 4 * (k + 1) + i + 1, 16, q)
    for k in range(3):
        store_strided(out, 4 * (k + 1), 16, splat(0.0))
    return J


@compiled
def _scatter(grid, first, along_x, along_y, N, d, rows, at):  # type: ignore[no-untyped-def]
    """Adds a particle's mass and momentum (rows (8 16,), from `at`) to its 27 nodes."""
    base, qx, qy, qz = four(rows, at), four(rows, at + 4), four(rows, at + 8), four(rows, at + 12)
    za, zb = qz * halves(d[2, 0], d[2, 1]), qz * d[2, 2]
    na, nb = halves(N[2, 0], N[2, 1]), halves(N[2, 2], 0.0)
    for i in range(3):
        row = base + qx * d[0, i]
        for j in range(3):
            n = N[0, i] * N[1, j]
            value = row + qy * d[1, j]
            k = 4 * (first + i * along_x + j * along_y)
            store(grid, k, load(grid, k) + (value + za) * (na * n))
            store(grid, k + 8, load(grid, k + 8) + (value + zb) * (nb * n))


@compiled
def _gather(grid, first, along_x, along_y, N, d, h, v, C, p):  # type: ignore[no-untyped-def]
    """Velocity (v[4 p + 1 :]) and its gradient (C[12 p :], columns of four) of a particle from its 27 nodes."""
    na, nb = halves(N[2, 0], N[2, 1]), halves(N[2, 2], 0.0)
    da, db = halves(N[2, 0] * d[2, 0], N[2, 1] * d[2, 1]), halves(N[2, 2] * d[2, 2], 0.0)
    zero = splat(0.0)
    velocity, x, y, z = zero, zero, zero, zero
    for i in range(3):
        r, ry, rz = zero, zero, zero
        for j in range(3):
            k = 4 * (first + i * along_x + j * along_y)
            a, b = load(grid, k), load(grid, k + 8)
            s = a * na + b * nb
            r, ry = r + s * N[1, j], ry + s * (N[1, j] * d[1, j])
            rz = rz + (a * da + b * db) * N[1, j]
        velocity, x = velocity + r * N[0, i], x + r * (N[0, i] * d[0, i])
        y, z = y + ry * N[0, i], z + rz * N[0, i]
    store_folded(v, 4 * p, velocity)
    store_folded(C, 12 * p, x * (4.0 / (h[0] * h[0])))
    store_folded(C, 12 * p + 4, y * (4.0 / (h[1] * h[1])))
    store_folded(C, 12 * p + 8, z * (4.0 / (h[2] * h[2])))


@compiled
def _deform(block, dt, C, F):  # type: ignore[no-untyped-def]
    """F <- (I + dt C) F for a block of eight particles."""
    at, columns = 72 * block, 96 * block
    for k in range(3):
        a, b, c = load(F, at + 8 * k), load(F, at + 24 + 8 * k), load(F, at + 48 + 8 * k)
        for i in range(3):
            row = columns + i + 1
            change = strided(C, row, 12) * a + strided(C, row + 4, 12) * b + strided(C, row + 8, 12) * c
            store(F, at + 8 * (3 * i + k), load(F, at + 8 * (3 * i + k)) + dt * change)


@compiled
def _update_node(n, step, dt, momentum, velocity, fixed, place, effects, still):  # type: ignore[no-untyped-def]
    """Velocity of a node from its mass and momentum, which are emptied for the next step."""
    mass = momentum[4 * n]
    velocity[4 * n] = 0.0
    for i in range(1, 4):
        velocity[4 * n + i] = momentum[4 * n + i] / mass if mass > 0.0 and fixed[n] == 0 else 0.0
    if has_node(effects) and mass > 0.0 and fixed[n] == 0:
        change_node(effects, step, place[n], still, velocity[4 * n + 1 : 4 * n + 4], dt)
    for i in range(4):
        momentum[4 * n + i] = 0.0


@compiled
def _fold(momentum, clamp, along_x):  # type: ignore[no-untyped-def]
    """A clamped face: momentum of the plane of nodes before it (first node `clamp`) is taken from the plane after it."""
    for n in range(along_x):
        before, after = 4 * (clamp + n), 4 * (clamp + along_x + n)
        momentum[after] += momentum[before]
        for i in range(1, 4):
            momentum[after + i] -= momentum[before + i]


@compiled
def _mirror(velocity, clamp, along_x):  # type: ignore[no-untyped-def]
    """A clamped face: velocities before it are the mirror, with the other sign, of those after it: the face is at rest."""
    for plane in range(clamp // along_x + 1):
        before, after = clamp - plane * along_x, clamp + (plane + 1) * along_x
        for n in range(along_x):
            for i in range(1, 4):
                velocity[4 * (before + n) + i] = -velocity[4 * (after + n) + i]


@kernel
def advance(
    steps, dt, origin, h, along_x, along_y, nodes, slab_first, x, v, C, F, volume, shear, bulk, magnet, density, effects,
    momentum, velocity, fixed, place, clamp, flat, low, fast, drift,
):  # fmt: skip
    """Take up to `steps` steps of dt (s); fewer where particles have to be sorted again or some det F is 0 or less, or no number.

    Flat arrays, changed in place: x, v (4 n,) rows [x, y, z, -] and [-, v]; C (12 n,) columns [-, dv/dx], 1/s; F (9 n,) in blocks of
    eight. slab_first (slabs + 1,) first block of eight of each slab; volume, shear, bulk, density (n,), magnet (3 n,) in blocks of eight;
    momentum, velocity (4 nodes + 8,), momentum empty; fixed (nodes,); place (nodes, 3) m; clamp: first node of the plane before the
    clamped face, or -1; flat: nothing moves along y; low, fast (slabs,): smallest det F, largest speed along an axis in cells a step;
    drift: cells that particles may have moved since they were sorted.
    Returns steps taken, drift, and whether the motion broke: det F, or a particle that crosses a cell in one step.
    """
    slabs = len(slab_first) - 1
    still = np.zeros(3)
    for step in range(steps):
        for colour in range(2):
            for half in prange((slabs + 1 - colour) // 2):
                slab = 2 * half + colour
                work = (np.empty(72), np.empty(24), np.empty(72), np.empty(24), np.empty(24))
                N, d, rows = np.empty((3, 3)), np.empty((3, 3)), np.empty(128)
                least, bad = splat(np.inf), splat(0.0)
                for block in range(slab_first[slab], slab_first[slab + 1]):
                    J = _prepare(
                        block, step, dt, h, x, v, C, F, volume, shear, bulk, magnet, density, effects, work, rows,
                    )  # fmt: skip
                    least, bad = smaller(J, least), flag_unless_positive(J, bad)
                    for p in range(8):
                        i, j, k = _locate(x, 8 * block + p, origin, h, N, d)
                        _scatter(momentum, i * along_x + j * along_y + k, along_x, along_y, N, d, rows, 16 * p)
                low[slab] = lowest(least) if total(bad) == 0.0 else np.nan
        if clamp >= 0:
            _fold(momentum, clamp, along_x)
        for plane in prange(nodes // along_x):
            for n in range(plane * along_x, (plane + 1) * along_x):
                _update_node(n, step, dt, momentum, velocity, fixed, place, effects, still)
                if flat:
                    velocity[4 * n + 2] = 0.0
        if clamp >= 0:
            _mirror(velocity, clamp, along_x)
        for slab in range(slabs):
            if not low[slab] > 0.0:
                return step, drift, True
        for slab in prange(slabs):
            N, d = np.empty((3, 3)), np.empty((3, 3))
            most, broken = 0.0, False
            for block in range(slab_first[slab], slab_first[slab + 1]):
                for p in range(8 * block, 8 * block + 8):
                    i, j, k = _locate(x, p, origin, h, N, d)
                    _gather(velocity, i * along_x + j * along_y + k, along_x, along_y, N, d, h, v, C, p)
                    for axis in range(3):
                        move = dt * v[4 * p + 1 + axis]
                        x[4 * p + axis] += move
                        part = abs(move) / h[axis]
                        most = max(most, part)
                        if not part <= DRIFT:  # also where it is no number
                            broken = True
                _deform(block, dt, C, F)
            fast[slab] = np.inf if broken else most
        most = 0.0
        for slab in range(slabs):
            if not fast[slab] <= DRIFT:
                return step + 1, drift, True
            most = max(most, fast[slab])
        drift += most
        if drift > DRIFT:
            return step + 1, drift, False
    return steps, drift, False
