"""P2G, grid update and G2P of the updated formulation (APIC): the grid is fixed in space, and particles move through it.

Both the force of the stress on the nodes and the growth of F use the gradients of the splines. So the strain belongs to the same motion
that carries the particles. (MLS-MPM uses APIC's C for both, a mean of the gradient over a cell. Bodies at rest under load then creep;
docs/stability.md.)

Eight particles are worked on at a time (kernels.apic_transfer). Particles are sorted by slabs of four planes of cells. Particles without
mass fill each slab up to a multiple of eight. A particle drifts by less than a cell before it is sorted again, so two slabs of one color
never touch the same node. Every sum is made in one order: results have the same bits at any number of threads.

Source: Jiang et al., ACM Trans. Graph. 34 (2015) 51 (APIC).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from magmpm.compiled.arrays import Array, Index
from magmpm.compiled.jit import compiled, inlined, kernel, prange
from magmpm.compiled.simd import (
    flag_unless_positive,
    larger,
    load,
    load_rows,
    lowest,
    magnitude,
    smaller,
    splat,
    store,
    store_rows,
    total,
)  # fmt: skip
from magmpm.compiled.simd_views import row, vector
from magmpm.effects.hooks import change_node, has_contact, has_node, has_rate_stress, push_time
from magmpm.kernels.apic_transfer import ROW, gather, locate, scatter
from magmpm.kernels.multi_grid_contact import meet
from magmpm.kernels.particle_group import add_contacts, add_effects, any_effect, group_room, touches
from magmpm.kernels.watch import BROKEN, WHY, clear, see, stops
from magmpm.materials import group_determinant, neo_hookean, stiffest_in_space

DRIFT = 0.95  # cells a particle may move before it must be sorted again; less than 1


class Grid(NamedTuple):
    """Nodes of a box, z fastest. Each of the k components of the body has its own grid of `nodes` nodes; the grids follow one another.

    origin, spacing (3,) m; along_x, along_y: steps in node number along x and y. momentum (4 k nodes + 8,): mass in kg and momentum in N s
    of each node, zero between steps; velocity (4 k nodes + 8,): 0 and velocity in m/s of each node.
    planes: planes of nodes, of all k grids, that may get mass; fixed (k nodes,): 1 for nodes held at rest; mirrors (pairs, 2): nodes
    outside and inside a face at rest, the first `next_to_faces` pairs right next to it; flat: nothing moves along y; place (3 nodes,) m:
    positions, needed only where an effect changes nodes.
    """

    origin: Array
    spacing: Array
    along_x: int
    along_y: int
    nodes: int
    momentum: Array
    velocity: Array
    planes: Index
    fixed: NDArray[np.int8]
    mirrors: Index
    next_to_faces: int
    flat: bool
    place: Array


class Particles(NamedTuple):
    """Particles in blocks of eight, flat, sorted by slab and by component of the body. Padding has volume 0.

    slab_first (slabs + 1,): first block of each slab; lift (blocks,): first node of the grid of the block's component; volume m^3,
    shear, bulk Pa, density kg/m^3 (n,); remanence (3 n,) T, or (4 n,) where an effect marks particles (effects.marked).
    """

    slab_first: Index
    lift: Array
    volume: Array
    shear: Array
    bulk: Array
    density: Array
    remanence: Array


class State(NamedTuple):
    """Arrays changed by a step, in blocks of eight: x m, v m/s (3 n,), APIC's C and L = dv/dx 1/s, F (9 n,); stiffness (n,) m^2/s^2.

    L is used only where an effect has a rate stress; elsewhere it may be empty. stiffness: materials.stiffest_in_space over density in the
    last step, NaN before the first step. anchor (3 n,) m: where friction holds the particles (effects.contact_force), empty where no effect
    has contact.
    """

    x: Array
    v: Array
    C: Array
    L: Array
    F: Array
    stiffness: Array
    anchor: Array


@inlined
def _prepare(block, step, dt, particles, state, effects, work, out):
    """Contribution of a block of eight particles to its nodes, written to out (8 ROW,): seven rows of four for each particle.

    Returns det F, and stiffness over density, m^2/s^2, lane by lane.

    out: [m, m v + dt f], [0, column k of m C] for k = x, y, z, and [0, column k of dt V P F^T].
    """
    F, P, dF, place, velocity, f, _ = work
    x, v, C, at = state.x, state.v, state.C, 72 * block
    J, K = group_determinant(F, at), load(particles.bulk, 8 * block)
    pressure = (J - 1.0) * K
    scale, I1, _ = neo_hookean(F, at, J, load(particles.shear, 8 * block), pressure, P)
    density = load(particles.density, 8 * block)
    stiff = stiffest_in_space(J, scale, I1, pressure, K) / density
    V = load(particles.volume, 8 * block)
    for i in range(3):
        store(f, 8 * i, splat(0.0))
    if any_effect(effects) or has_contact(effects):
        for i in range(3):
            store(place, 8 * i, load(x, 24 * block + 8 * i))
            if has_contact(effects):
                store(velocity, 8 * i, load(v, 24 * block + 8 * i))
            for k in range(3 if has_rate_stress(effects) else 0):
                rate = splat(0.0)
                for m in range(3):
                    rate = rate + load(state.L, at + 8 * (3 * i + m)) * load(F, at + 8 * (3 * m + k))
                store(dF, 8 * (3 * i + k), rate)
        touched = has_contact(effects) and touches(effects, step, block, place, particles.volume)
        add_effects(effects, step, block, at, particles, work)
        add_contacts(effects, step, dt, block, touched, particles, vector(state.anchor, 24 * block), work)
    mass, zero = density * V, splat(0.0)
    push = V * dt
    p0 = mass * load(v, 24 * block) + push * load(f, 0)
    p1 = mass * load(v, 24 * block + 8) + push * load(f, 8)
    p2 = mass * load(v, 24 * block + 16) + push * load(f, 16)
    x0, x1, x2 = mass * load(C, at), mass * load(C, at + 24), mass * load(C, at + 48)
    y0, y1, y2 = mass * load(C, at + 8), mass * load(C, at + 32), mass * load(C, at + 56)
    z0, z1, z2 = mass * load(C, at + 16), mass * load(C, at + 40), mass * load(C, at + 64)
    store_rows(out, 0, ROW, mass, p0, p1, p2, zero, x0, x1, x2)
    store_rows(out, 8, ROW, zero, y0, y1, y2, zero, z0, z1, z2)
    x0, x1, x2 = _stress_column(0, push, F, at, P)
    y0, y1, y2 = _stress_column(1, push, F, at, P)
    z0, z1, z2 = _stress_column(2, push, F, at, P)
    store_rows(out, 16, ROW, zero, x0, x1, x2, zero, y0, y1, y2)
    store_rows(out, 24, ROW, zero, z0, z1, z2, zero, zero, zero, zero)
    return J, stiff


@compiled
def _stress_column(k, scale, F, at, P):
    """Column k of scale P F^T for a block of eight particles."""
    a, b, c = load(F, at + 24 * k), load(F, at + 24 * k + 8), load(F, at + 24 * k + 16)
    t0 = load(P, 0) * a + load(P, 8) * b + load(P, 16) * c
    t1 = load(P, 24) * a + load(P, 32) * b + load(P, 40) * c
    t2 = load(P, 48) * a + load(P, 56) * b + load(P, 64) * c
    return scale * t0, scale * t1, scale * t2


@compiled
def _move(block, dt, h, rows, state, keep):
    """x += dt v and F <- (I + dt L) F for a block of eight particles, with v, C and L from rows. Returns the cells each one moves."""
    x, v, C, L, F, _, _ = state
    _, v0, v1, v2, _, c00, c10, c20 = load_rows(rows, 0, ROW)
    _, c01, c11, c21, _, c02, c12, c22 = load_rows(rows, 8, ROW)
    at, first = 72 * block, 24 * block
    store(v, first, v0), store(v, first + 8, v1), store(v, first + 16, v2)
    m0, m1, m2 = v0 * dt, v1 * dt, v2 * dt
    store(x, first, load(x, first) + m0)
    store(x, first + 8, load(x, first + 8) + m1)
    store(x, first + 16, load(x, first + 16) + m2)
    store(C, at, c00), store(C, at + 8, c01), store(C, at + 16, c02)
    store(C, at + 24, c10), store(C, at + 32, c11), store(C, at + 40, c12)
    store(C, at + 48, c20), store(C, at + 56, c21), store(C, at + 64, c22)
    _, c00, c10, c20, _, c01, c11, c21 = load_rows(rows, 16, ROW)
    _, c02, c12, c22, _, _, _, _ = load_rows(rows, 24, ROW)
    if keep:
        store(L, at, c00), store(L, at + 8, c01), store(L, at + 16, c02)
        store(L, at + 24, c10), store(L, at + 32, c11), store(L, at + 40, c12)
        store(L, at + 48, c20), store(L, at + 56, c21), store(L, at + 64, c22)
    for k in range(3):
        a, b, c = load(F, at + 8 * k), load(F, at + 24 + 8 * k), load(F, at + 48 + 8 * k)
        store(F, at + 8 * k, a + (c00 * a + c01 * b + c02 * c) * dt)
        store(F, at + 24 + 8 * k, b + (c10 * a + c11 * b + c12 * c) * dt)
        store(F, at + 48 + 8 * k, c + (c20 * a + c21 * b + c22 * c) * dt)
    return magnitude(m0) * (1.0 / h[0]), magnitude(m1) * (1.0 / h[1]), magnitude(m2) * (1.0 / h[2])


@inlined
def _update_node(n, step, dt, grid, effects, still):
    """Velocity of a node with mass, from its momentum. The momentum is set to zero for the next step."""
    momentum, velocity = grid.momentum, grid.velocity
    mass, free = momentum[4 * n], grid.fixed[n] == 0
    for i in range(1, 4):
        velocity[4 * n + i] = momentum[4 * n + i] / mass if free else 0.0
    if has_node(effects) and free:
        change_node(effects, step, row(grid.place, 3 * n % len(grid.place)), row(still, 0), row(velocity, 4 * n + 1), dt)
    for i in range(4):
        momentum[4 * n + i] = 0.0
    if grid.flat:
        velocity[4 * n + 2] = 0.0


@compiled
def _fold(momentum, mirrors, count):
    """Faces at rest: for the first `count` pairs (pairs, 2), the outer node's mass joins the inner node, and its momentum is subtracted."""
    for pair in range(count):
        outer, inner = 4 * mirrors[pair, 0], 4 * mirrors[pair, 1]
        momentum[inner] += momentum[outer]
        for i in range(1, 4):
            momentum[inner + i] -= momentum[outer + i]


@compiled
def _mirror(velocity, mirrors):
    """The outer node of each pair gets minus the velocity of the inner one, so the face between them is at rest."""
    for pair in range(len(mirrors)):
        outer, inner = 4 * mirrors[pair, 0], 4 * mirrors[pair, 1]
        for i in range(1, 4):
            velocity[outer + i] = -velocity[inner + i]


@kernel
def particles_to_grid(step, push, grid, particles, state, effects, slabs):
    """P2G: all particles add to the nodes their mass, momentum, and the momentum from stress and loads in the time `push` (s).

    slabs: kernels.watch.
    """
    count = len(particles.slab_first) - 1
    for color in range(2):
        for half in prange((count + 1 - color) // 2):
            slab = 2 * half + color
            work, rows = group_room(state.F), np.empty(8 * ROW)
            least, bad, high, change = splat(np.inf), splat(0.0), splat(0.0), splat(0.0)
            for block in range(particles.slab_first[slab], particles.slab_first[slab + 1]):
                J, stiff = _prepare(block, step, push, particles, state, effects, work, rows)
                least, bad = smaller(J, least), flag_unless_positive(J, bad)
                high = larger(stiff, high)
                change = larger(magnitude(stiff - load(state.stiffness, 8 * block)), change)
                store(state.stiffness, 8 * block, stiff)
                locate(block, grid, particles, state, rows)
                scatter(grid.momentum, grid.along_x, grid.along_y, rows)
            see(slabs, slab, least, bad, high, change)


@kernel
def update_grid(step, dt, grid, contact, effects):
    """Grid update: velocities of the nodes from their momentum, with contact between components, faces at rest, and effects on nodes."""
    _fold(grid.momentum, grid.mirrors, grid.next_to_faces)
    if contact.may_meet:
        meet(grid.momentum, grid.fixed, contact, grid.spacing, (grid.along_x, grid.along_y, 1), grid.nodes)
    still, along_x = np.zeros(3), grid.along_x
    for k in prange(len(grid.planes)):
        for n in range(grid.planes[k] * along_x, (grid.planes[k] + 1) * along_x):
            if grid.momentum[4 * n] > 0.0:  # no particle reads the velocity of the others
                _update_node(n, step, dt, grid, effects, still)
    _mirror(grid.velocity, grid.mirrors)


@kernel
def grid_to_particles(dt, grid, particles, state, keep, moved):
    """G2P: all particles take their velocities from the nodes, move for dt (s), and update F.

    keep: whether to store L for the stress of the next step; moved (slabs,): largest move along an axis, in cells.
    """
    for slab in prange(len(particles.slab_first) - 1):
        rows = np.empty(8 * ROW)
        slow, bad = splat(0.0), splat(0.0)
        for block in range(particles.slab_first[slab], particles.slab_first[slab + 1]):
            locate(block, grid, particles, state, rows)
            gather(grid.velocity, grid.along_x, grid.along_y, grid.spacing, rows)
            for part in _move(block, dt, grid.spacing, rows, state, keep):
                slow, bad = smaller(-part, slow), flag_unless_positive(DRIFT - part, bad)  # also where it is NaN
        moved[slab] = -lowest(slow) if total(bad) == 0.0 else np.inf


@compiled
def advance(steps, dt, grid, contact, particles, state, effects, watch, slabs, moved, drift):
    """Take up to `steps` steps of dt (s). It stops early where particles must be sorted again, or where some det F is 0, negative or NaN.

    Changes State and Grid in place. contact: multi_grid_contact.Contact; watch, slabs: see kernels.watch; moved (slabs,); drift: cells
    that particles may have moved since they were sorted.
    Returns the number of steps taken, and drift. The watch says why steps ended: BROKEN also where a particle crosses a cell in one step.
    """
    for step in range(steps):
        particles_to_grid(step, push_time(effects, step, dt), grid, particles, state, effects, slabs)
        if stops(watch, slabs):
            clear(grid.momentum)
            return step, drift
        update_grid(step, dt, grid, contact, effects)
        grid_to_particles(dt, grid, particles, state, has_rate_stress(effects), moved)
        most = 0.0
        for slab in range(len(moved)):
            if not moved[slab] <= DRIFT:
                watch[WHY] = BROKEN
                return step + 1, drift
            most = max(most, moved[slab])
        drift += most
        if drift > DRIFT:
            return step + 1, drift
    return steps, drift


@kernel
def rearrange(rows, width, old, new):
    """Reorder rows of `width` values: new row r is old row rows[r], rows (n,). old, new: flat, in blocks of eight."""
    for block in prange(len(rows) // 8):
        for lane in range(8):
            row = rows[8 * block + lane]
            begin = width * (row - row % 8) + row % 8
            for k in range(width):
                new[8 * (width * block + k) + lane] = old[begin + 8 * k]
