"""P2G, grid update and G2P of the updated formulation (MLS-MPM with APIC): the grid is fixed in space, and particles move through it.

A node holds four floats: mass and momentum, or 0 and velocity. Two nodes of a row along z are one register, so a particle scatters to its
27 nodes in 18 multiplications and additions, and no sum over lanes is needed; neighbours in one cell share the registers. All else
(splines, stress, effects, the move) is done for eight particles at a time; rows of a particle and lanes of eight are transposed in
registers. Particles are sorted by slabs of four planes of cells, each slab's number rounded up to
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
    floor,
    four,
    halves,
    load,
    load_rows,
    lowest,
    magnitude,
    smaller,
    splat,
    store,
    store_folded,
    store_rows,
    total,
)
from magmpm.transfer.lanes import add_effects, any_effect, determinant, neo_hookean

DRIFT = 0.95  # cells a particle may move before it must be sorted again; less than 1


@compiled
def _splines(x, block, axis, origin, cells, h):  # type: ignore[no-untyped-def]
    """First node of eight particles along an axis, their three splines, and the first node's place less the particle's, m.

    cells: 1 / h.
    """
    s = (load(x, 24 * block + 8 * axis) - origin[axis]) * cells
    first = floor(s)
    t = s - first
    u = 1.0 - t
    return first, 0.5 * (u * u), 0.5 + t * u, 0.5 * (t * t), (-0.5 - t) * h


@compiled
def _locate(x, block, origin, h, along_x, along_y, rows):  # type: ignore[no-untyped-def]
    """Rows of 16 floats for a block's particles, into rows (8 32,) from 16 on: first node, distances (3), splines (9)."""
    i, a0, a1, a2, da = _splines(x, block, 0, origin, 1.0 / h[0], h[0])
    j, b0, b1, b2, db = _splines(x, block, 1, origin, 1.0 / h[1], h[1])
    k, c0, c1, c2, dc = _splines(x, block, 2, origin, 1.0 / h[2], h[2])
    first = i * float(along_x) + j * float(along_y) + k
    store_rows(rows, 16, 32, first, da, db, dc, a0, a1, a2, b0)
    store_rows(rows, 24, 32, b1, b2, c0, c1, c2, c2, c2, c2)


@compiled
def _prepare(block, step, dt, h, x, v, C, F, volume, shear, bulk, magnet, density, effects, work, out):  # type: ignore[no-untyped-def]
    """Mass, momentum and affine momentum of a block of eight particles into out (8 32,): four rows of four each. Returns its det F.

    out: [m, m v + dt f], and [0, column k of m C - dt V P F^T 4/h_k^2] for k = x, y, z.
    """
    P, f, dF, velocity, place = work
    at = 72 * block
    J = determinant(F, at)
    neo_hookean(F, at, J, load(shear, 8 * block), (J - 1.0) * load(bulk, 8 * block), P)
    V = load(volume, 8 * block)
    f[:] = 0.0
    if any_effect(effects):
        for i in range(3):
            store(place, 8 * i, load(x, 24 * block + 8 * i))
            if has_contact(effects):
                store(velocity, 8 * i, load(v, 24 * block + 8 * i))
            for k in range(3 if has_rate_stress(effects) else 0):
                rate = splat(0.0)
                for m in range(3):
                    rate = rate + load(C, at + 8 * (3 * i + m)) * load(F, at + 8 * (3 * m + k))
                store(dF, 8 * (3 * i + k), rate)
        add_effects(effects, step, dt, block, F, at, P, dF, place, velocity, f, magnet, density, volume)
    mass, zero = load(density, 8 * block) * V, splat(0.0)
    push = V * dt
    p0 = mass * load(v, 24 * block) + push * load(f, 0)
    p1 = mass * load(v, 24 * block + 8) + push * load(f, 8)
    p2 = mass * load(v, 24 * block + 16) + push * load(f, 16)
    x0, x1, x2 = _affine(0, push * (4.0 / (h[0] * h[0])), mass, C, F, at, P)
    y0, y1, y2 = _affine(1, push * (4.0 / (h[1] * h[1])), mass, C, F, at, P)
    z0, z1, z2 = _affine(2, push * (4.0 / (h[2] * h[2])), mass, C, F, at, P)
    store_rows(out, 0, 32, mass, p0, p1, p2, zero, x0, x1, x2)
    store_rows(out, 8, 32, zero, y0, y1, y2, zero, z0, z1, z2)
    return J


@compiled
def _affine(k, scale, mass, C, F, at, P):  # type: ignore[no-untyped-def]
    """Column k of m C - scale P F^T, of a block of eight particles."""
    a, b, c = load(F, at + 24 * k), load(F, at + 24 * k + 8), load(F, at + 24 * k + 16)
    t0 = load(P, 0) * a + load(P, 8) * b + load(P, 16) * c
    t1 = load(P, 24) * a + load(P, 32) * b + load(P, 40) * c
    t2 = load(P, 48) * a + load(P, 56) * b + load(P, 64) * c
    q0, q1, q2 = load(C, at + 8 * k), load(C, at + 24 + 8 * k), load(C, at + 48 + 8 * k)
    return mass * q0 - scale * t0, mass * q1 - scale * t1, mass * q2 - scale * t2


@compiled
def _add(grid, k, low, high):  # type: ignore[no-untyped-def]
    """Adds two registers, three nodes' worth, to a row of nodes."""
    store(grid, k, load(grid, k) + low)
    store(grid, k + 8, load(grid, k + 8) + high)


@compiled
def _scatter(grid, along_x, along_y, h, rows):  # type: ignore[no-untyped-def]
    """Adds mass and momentum of a block's particles (rows (8 32,)) to their 27 nodes.

    Neighbours in the order are mostly of one cell: their sums stay in 18 registers until the next cell.
    """
    p, zero = 0, splat(0.0)
    while p < 8:
        first = rows[32 * p + 16]
        a0, a1, a2, a3, a4, a5, a6, a7, a8 = zero, zero, zero, zero, zero, zero, zero, zero, zero
        b0, b1, b2, b3, b4, b5, b6, b7, b8 = zero, zero, zero, zero, zero, zero, zero, zero, zero
        while p < 8 and rows[32 * p + 16] == first:
            at = 32 * p
            base, qx, qy, qz = four(rows, at), four(rows, at + 4), four(rows, at + 8), four(rows, at + 12)
            dx, dy, dz = rows[at + 17], rows[at + 18], rows[at + 19]
            nx0, nx1, nx2 = rows[at + 20], rows[at + 21], rows[at + 22]
            ny0, ny1, ny2 = rows[at + 23], rows[at + 24], rows[at + 25]
            na, nb = halves(rows[at + 26], rows[at + 27]), halves(rows[at + 28], 0.0)
            za, zb = qz * na * halves(dz, dz + h[2]), qz * nb * (dz + 2.0 * h[2])
            row0, row1, row2 = base + qx * dx, base + qx * (dx + h[0]), base + qx * (dx + 2.0 * h[0])
            ya0, ya1, ya2 = qy * dy, qy * (dy + h[1]), qy * (dy + 2.0 * h[1])
            yb0, yb1, yb2 = ya0 * nb, ya1 * nb, ya2 * nb
            ya0, ya1, ya2 = ya0 * na, ya1 * na, ya2 * na
            low, high = row0 * na + za, row0 * nb + zb
            a0, a1, a2 = a0 + (low + ya0) * (nx0 * ny0), a1 + (low + ya1) * (nx0 * ny1), a2 + (low + ya2) * (nx0 * ny2)
            b0, b1, b2 = b0 + (high + yb0) * (nx0 * ny0), b1 + (high + yb1) * (nx0 * ny1), b2 + (high + yb2) * (nx0 * ny2)
            low, high = row1 * na + za, row1 * nb + zb
            a3, a4, a5 = a3 + (low + ya0) * (nx1 * ny0), a4 + (low + ya1) * (nx1 * ny1), a5 + (low + ya2) * (nx1 * ny2)
            b3, b4, b5 = b3 + (high + yb0) * (nx1 * ny0), b4 + (high + yb1) * (nx1 * ny1), b5 + (high + yb2) * (nx1 * ny2)
            low, high = row2 * na + za, row2 * nb + zb
            a6, a7, a8 = a6 + (low + ya0) * (nx2 * ny0), a7 + (low + ya1) * (nx2 * ny1), a8 + (low + ya2) * (nx2 * ny2)
            b6, b7, b8 = b6 + (high + yb0) * (nx2 * ny0), b7 + (high + yb1) * (nx2 * ny1), b8 + (high + yb2) * (nx2 * ny2)
            p += 1
        k, x, y = 4 * int(first), 4 * along_x, 4 * along_y
        _add(grid, k, a0, b0), _add(grid, k + y, a1, b1), _add(grid, k + 2 * y, a2, b2)
        k += x
        _add(grid, k, a3, b3), _add(grid, k + y, a4, b4), _add(grid, k + 2 * y, a5, b5)
        k += x
        _add(grid, k, a6, b6), _add(grid, k + y, a7, b7), _add(grid, k + 2 * y, a8, b8)


@compiled
def _gather(grid, along_x, along_y, h, rows):  # type: ignore[no-untyped-def]
    """Velocities and their gradients of a block's particles, into rows (8 32,): [-, v] and [-, dv/dx], [-, dv/dy], [-, dv/dz]."""
    scale_x, scale_y, scale_z = 4.0 / (h[0] * h[0]), 4.0 / (h[1] * h[1]), 4.0 / (h[2] * h[2])
    zero = splat(0.0)
    for p in range(8):
        at = 32 * p
        dy, dz = rows[at + 18], rows[at + 19]
        ny0, ny1, ny2 = rows[at + 23], rows[at + 24], rows[at + 25]
        my0, my1, my2 = ny0 * dy, ny1 * (dy + h[1]), ny2 * (dy + 2.0 * h[1])
        na, nb = halves(rows[at + 26], rows[at + 27]), halves(rows[at + 28], 0.0)
        ma, mb = na * halves(dz, dz + h[2]), nb * (dz + 2.0 * h[2])
        velocity, x, y, z = zero, zero, zero, zero
        for i in range(3):
            k, step = 4 * (int(rows[at + 16]) + i * along_x), 4 * along_y
            a0, a1, a2 = load(grid, k), load(grid, k + step), load(grid, k + 2 * step)
            b0, b1, b2 = load(grid, k + 8), load(grid, k + step + 8), load(grid, k + 2 * step + 8)
            a, b = a0 * ny0 + a1 * ny1 + a2 * ny2, b0 * ny0 + b1 * ny1 + b2 * ny2
            c, d = a0 * my0 + a1 * my1 + a2 * my2, b0 * my0 + b1 * my1 + b2 * my2
            n = rows[at + 20 + i]
            r = (a * na + b * nb) * n
            velocity, x = velocity + r, x + r * (rows[at + 17] + i * h[0])
            y, z = y + (c * na + d * nb) * n, z + (a * ma + b * mb) * n
        store_folded(rows, at, velocity)
        store_folded(rows, at + 4, x * scale_x)
        store_folded(rows, at + 8, y * scale_y)
        store_folded(rows, at + 12, z * scale_z)


@compiled
def _move(block, dt, h, rows, x, v, C, F):  # type: ignore[no-untyped-def]
    """x += dt v and F <- (I + dt C) F for a block of eight particles, with v and C from rows. Returns the cells each one moves."""
    _, v0, v1, v2, _, c00, c10, c20 = load_rows(rows, 0, 32)
    _, c01, c11, c21, _, c02, c12, c22 = load_rows(rows, 8, 32)
    at, first = 72 * block, 24 * block
    store(v, first, v0), store(v, first + 8, v1), store(v, first + 16, v2)
    m0, m1, m2 = v0 * dt, v1 * dt, v2 * dt
    store(x, first, load(x, first) + m0)
    store(x, first + 8, load(x, first + 8) + m1)
    store(x, first + 16, load(x, first + 16) + m2)
    store(C, at, c00), store(C, at + 8, c01), store(C, at + 16, c02)
    store(C, at + 24, c10), store(C, at + 32, c11), store(C, at + 40, c12)
    store(C, at + 48, c20), store(C, at + 56, c21), store(C, at + 64, c22)
    for k in range(3):
        a, b, c = load(F, at + 8 * k), load(F, at + 24 + 8 * k), load(F, at + 48 + 8 * k)
        store(F, at + 8 * k, a + (c00 * a + c01 * b + c02 * c) * dt)
        store(F, at + 24 + 8 * k, b + (c10 * a + c11 * b + c12 * c) * dt)
        store(F, at + 48 + 8 * k, c + (c20 * a + c21 * b + c22 * c) * dt)
    return magnitude(m0) * (1.0 / h[0]), magnitude(m1) * (1.0 / h[1]), magnitude(m2) * (1.0 / h[2])


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

    Flat arrays in blocks of eight particles, x, v (3 n,), C = dv/dx (9 n,) 1/s and F (9 n,) changed in place: volume, shear, bulk, density
    (n,), magnet (3 n,). slab_first (slabs + 1,) first block of each slab; momentum, velocity (4 nodes + 8,), momentum empty; fixed
    (nodes,); place (nodes, 3) m; clamp: first node of the plane before the clamped face, or -1; flat: nothing moves along y; low, fast
    (slabs,): smallest det F, largest move along an axis in cells a step; drift: cells that particles may have moved since they were
    sorted.
    Returns steps taken, drift, and whether the motion broke: det F, or a particle that crosses a cell in one step.
    """
    slabs = len(slab_first) - 1
    still = np.zeros(3)
    for step in range(steps):
        for colour in range(2):
            for half in prange((slabs + 1 - colour) // 2):
                slab = 2 * half + colour
                work = (np.empty(72), np.empty(24), np.empty(72), np.empty(24), np.empty(24))
                rows = np.empty(256)
                least, bad = splat(np.inf), splat(0.0)
                for block in range(slab_first[slab], slab_first[slab + 1]):
                    J = _prepare(
                        block, step, dt, h, x, v, C, F, volume, shear, bulk, magnet, density, effects, work, rows,
                    )  # fmt: skip
                    least, bad = smaller(J, least), flag_unless_positive(J, bad)
                    _locate(x, block, origin, h, along_x, along_y, rows)
                    _scatter(momentum, along_x, along_y, h, rows)
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
            rows = np.empty(256)
            slow, bad = splat(0.0), splat(0.0)
            for block in range(slab_first[slab], slab_first[slab + 1]):
                _locate(x, block, origin, h, along_x, along_y, rows)
                _gather(velocity, along_x, along_y, h, rows)
                for part in _move(block, dt, h, rows, x, v, C, F):
                    slow, bad = smaller(-part, slow), flag_unless_positive(DRIFT - part, bad)  # also where it is no number
            fast[slab] = -lowest(slow) if total(bad) == 0.0 else np.inf
        most = 0.0
        for slab in range(slabs):
            if not fast[slab] <= DRIFT:
                return step + 1, drift, True
            most = max(most, fast[slab])
        drift += most
        if drift > DRIFT:
            return step + 1, drift, False
    return steps, drift, False


@kernel
def rearrange(rows, width, old, new):  # type: ignore[no-untyped-def]
    """Rows of `width` values in another order: new row r is the old one rows[r] (n,); old, new flat in blocks of eight."""
    for block in prange(len(rows) // 8):
        for lane in range(8):
            row = rows[8 * block + lane]
            begin = width * (row - row % 8) + row % 8
            for k in range(width):
                new[8 * (width * block + k) + lane] = old[begin + 8 * k]
