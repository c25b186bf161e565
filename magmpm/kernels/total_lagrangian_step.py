"""The three steps of a motion, eight particles at a time: the grid lies in the undeformed body.

In every step, particles gather displacement and deformation gradient from the grid (G2P) and scatter the force of their stress back (P2G),
cell by cell. Splines are products of one-dimensional ones, so both go axis by axis. This takes 270 multiplications and additions in
place of 486, and 18 numbers for each particle in place of 108. The particles of a cell lie in groups of eight lanes
(dynamics.particle_groups). The plain formulas are in kernels.equilibrium, and in tests/reference.

Flat arrays, as `simd.load` takes them: field (3 nodes,) a value per node and component; splines (patterns 18 8,) values then slopes,
each axis by node; per_particle (groups 8,), remanence (groups 3 8,).
"""

import math
from typing import Any, NamedTuple

import numpy as np

from magmpm.compiled.arrays import Array, Index
from magmpm.compiled.jit import compiled, inlined, inner, task_body
from magmpm.compiled.parallel import once, over_parts, over_slabs, parts_of, task
from magmpm.compiled.simd import (
    WIDTH,
    above,
    larger,
    load,
    smaller,
    splat,
    store,
    sums,
    total,
)
from magmpm.effects.calls import MotionCalls, call_each
from magmpm.kernels.body_contact import (
    add_pairs,
    needs_list,
    passed,
    rub_pairs,
    touch_pairs,
)
from magmpm.kernels.fluid_drag import carry, immerse
from magmpm.kernels.flutter import count_swings
from magmpm.kernels.grid_step import move_nodes, push_nodes, push_time, update_grid
from magmpm.kernels.impulses import gather_value
from magmpm.kernels.mass_correction import begin_impulses, correct, spread_loads
from magmpm.kernels.particle_group import add_one_by_one, group_room
from magmpm.kernels.surface_contact import rub, rubbing_patches, touch
from magmpm.kernels.watch import clear, see, stops
from magmpm.materials import group_determinant, neo_hookean, stiffest


@inner
def gather(field, node, along_x, along_y, splines, first, gradient, to, value, at):
    """Gradient (9 8,) and value (3 8,) of a nodal field (3 nodes,) at a group of particles, from indices `to` and `at` on.

    node: the cell's first node; along_x, along_y: steps in node number along x and y; first: index of the group in splines.
    """
    zero = splat(0.0)
    u0 = zero
    u1 = zero
    u2 = zero
    x0 = zero
    x1 = zero
    x2 = zero
    y0 = zero
    y1 = zero
    y2 = zero
    z0 = zero
    z1 = zero
    z2 = zero
    nz0 = load(splines, first + 48)
    nz1 = load(splines, first + 56)
    nz2 = load(splines, first + 64)
    dz0 = load(splines, first + 120)
    dz1 = load(splines, first + 128)
    dz2 = load(splines, first + 136)
    for a in range(3):
        p0 = zero
        p1 = zero
        p2 = zero
        q0 = zero
        q1 = zero
        q2 = zero
        r0 = zero
        r1 = zero
        r2 = zero
        for b in range(3):
            k = 3 * (node + a * along_x + b * along_y)
            ny = load(splines, first + 24 + 8 * b)
            dy = load(splines, first + 96 + 8 * b)
            n0 = nz0 * field[k] + nz1 * field[k + 3] + nz2 * field[k + 6]
            n1 = nz0 * field[k + 1] + nz1 * field[k + 4] + nz2 * field[k + 7]
            n2 = nz0 * field[k + 2] + nz1 * field[k + 5] + nz2 * field[k + 8]
            d0 = dz0 * field[k] + dz1 * field[k + 3] + dz2 * field[k + 6]
            d1 = dz0 * field[k + 1] + dz1 * field[k + 4] + dz2 * field[k + 7]
            d2 = dz0 * field[k + 2] + dz1 * field[k + 5] + dz2 * field[k + 8]
            p0 = p0 + ny * n0
            p1 = p1 + ny * n1
            p2 = p2 + ny * n2
            q0 = q0 + dy * n0
            q1 = q1 + dy * n1
            q2 = q2 + dy * n2
            r0 = r0 + ny * d0
            r1 = r1 + ny * d1
            r2 = r2 + ny * d2
        nx = load(splines, first + 8 * a)
        dx = load(splines, first + 72 + 8 * a)
        u0 = u0 + nx * p0
        u1 = u1 + nx * p1
        u2 = u2 + nx * p2
        x0 = x0 + dx * p0
        x1 = x1 + dx * p1
        x2 = x2 + dx * p2
        y0 = y0 + nx * q0
        y1 = y1 + nx * q1
        y2 = y2 + nx * q2
        z0 = z0 + nx * r0
        z1 = z1 + nx * r1
        z2 = z2 + nx * r2
    store(gradient, to + 0, x0), store(gradient, to + 8, y0), store(gradient, to + 16, z0)
    store(gradient, to + 24, x1), store(gradient, to + 32, y1), store(gradient, to + 40, z1)
    store(gradient, to + 48, x2), store(gradient, to + 56, y2), store(gradient, to + 64, z2)
    store(value, at + 0, u0), store(value, at + 8, u1), store(value, at + 16, u2)


@inner
def scatter(force, node, along_x, along_y, splines, first, stress, load_, at, V, work):
    """force (3 nodes,) -= sum over a group of stress (9 8,) grad N - V load (3 8,) N, load from index `at` on; V: volumes, by which
    stress is multiplied already."""
    t00 = load(stress, 0)
    t01 = load(stress, 8)
    t02 = load(stress, 16)
    t10 = load(stress, 24)
    t11 = load(stress, 32)
    t12 = load(stress, 40)
    t20 = load(stress, 48)
    t21 = load(stress, 56)
    t22 = load(stress, 64)
    f0 = load(load_, at + 0) * V
    f1 = load(load_, at + 8) * V
    f2 = load(load_, at + 16) * V
    nz0 = load(splines, first + 48)
    nz1 = load(splines, first + 56)
    nz2 = load(splines, first + 64)
    dz0 = load(splines, first + 120)
    dz1 = load(splines, first + 128)
    dz2 = load(splines, first + 136)
    for a in range(3):
        nx = load(splines, first + 8 * a)
        dx = load(splines, first + 72 + 8 * a)
        p0 = f0 * nx - t00 * dx
        p1 = f1 * nx - t10 * dx
        p2 = f2 * nx - t20 * dx
        q0 = t01 * nx
        q1 = t11 * nx
        q2 = t21 * nx
        r0 = t02 * nx
        r1 = t12 * nx
        r2 = t22 * nx
        for b in range(3):
            ny = load(splines, first + 24 + 8 * b)
            dy = load(splines, first + 96 + 8 * b)
            n0 = p0 * ny - q0 * dy
            n1 = p1 * ny - q1 * dy
            n2 = p2 * ny - q2 * dy
            d0 = r0 * ny
            d1 = r1 * ny
            d2 = r2 * ny
            k = 3 * (node + a * along_x + b * along_y)
            added = sums(
                n0 * nz0 - d0 * dz0,
                n1 * nz0 - d1 * dz0,
                n2 * nz0 - d2 * dz0,
                n0 * nz1 - d0 * dz1,
                n1 * nz1 - d1 * dz1,
                n2 * nz1 - d2 * dz1,
                n0 * nz2 - d0 * dz2,
                n1 * nz2 - d1 * dz2,
            )
            store(force, k, load(force, k) + added)
            store(work, 8 * (3 * a + b), n2 * nz2 - d2 * dz2)
    k = 3 * node + 8  # the last component of the last node of each of the nine rows
    added = sums(
        load(work, 0),
        load(work, 8),
        load(work, 16),
        load(work, 24),
        load(work, 32),
        load(work, 40),
        load(work, 48),
        load(work, 56),
    )
    last = total(load(work, 64))
    store(work, 0, added)
    for i in range(8):
        force[k + 3 * (i // 3 * along_x + i % 3 * along_y)] += work[i]
    force[k + 6 * (along_x + along_y)] += last


@inner
def _project(particles, group, det, c, moment):
    """c (modes,), from index `moment` on, += moments of J - 1 over a group (model.volume_modes); det: lanes of J."""
    at = particles.moments[group]
    change = load(particles.volume, 8 * group) * (det - 1.0)
    for k in range(particles.mode_count):
        c[moment + k] += total(load(particles.modes, at + 8 * k) * change)


@inner
def _projected(modes, at, count, c, moment):
    """J - 1 of a group, projected on the modes of its cell."""
    value = splat(0.0)
    for k in range(count):
        value = value + load(modes, at + 8 * k) * c[moment + k]
    return value


class CellSlabs(NamedTuple):
    """Cells that hold particles, in slabs of at least two planes of cells. Slabs of one color share no node.

    slab_first (slabs + 1,): first cell of each slab; first_group (cells + 1,): first group of particles of each cell; first_node (cells,);
    shear, bulk (cells,) Pa; along_x, along_y: steps in node number along x and y.
    """

    slab_first: Index
    first_group: Index
    first_node: Index
    shear: Array
    bulk: Array
    along_x: int
    along_y: int


class ParticleGroups(NamedTuple):
    """Particles in groups of eight, flat. A lane without a particle has volume 0.

    pattern, moments (groups,): where the splines and modes of a group begin, shared by groups that are alike; splines (patterns 18 8,);
    modes (patterns modes 8,) of the volume part (model.volume_modes), mode_count 0 or 4; volume m^3, density kg/m^3 (groups 8,); remanence
    (groups 3 8,) T, or (groups 4 8,) if marked (acting.marked); reference (groups 3 8,) m: positions in the undeformed body.
    """

    pattern: Index
    splines: Array
    moments: Index
    modes: Array
    mode_count: int
    volume: Array
    density: Array
    remanence: Array
    reference: Array


class Nodes(NamedTuple):
    """Nodes of the grid, x slowest. active: nodes with mass; inverse_mass (3 nodes,) 1/kg, lumped, 0 where held; place (3 nodes,) m."""

    active: Index
    inverse_mass: Array
    place: Array


class State(NamedTuple):
    """Arrays changed by a step. u m, v m/s, force N (3 nodes,): force is zero between steps; stiffness (groups 8,) m^2/s^2:
    materials.stiffest over density in the last step, NaN before the first step; touching (PATCH patches + 1,): of the surface
    (kernels.surface_contact), and the way (m) that any point of it may have gone."""

    u: Array
    v: Array
    force: Array
    stiffness: Array
    touching: Array
    # (groups k 8,): what effects with a `relax` remember of the particles, k numbers each; empty
    # where there are none
    memory: Array


@inlined
def grid_to_particles(cell, begun, cells, particles, state, room, least, bad):
    """Write to room the displacement, F and det F of a cell's particles, gathered from the nodes, and the cell's moments of det F - 1.

    begun: the first of the cells that share the room. Returns lanes: the smallest det F so far, and 1 where some det F was 0, negative or
    NaN.
    """
    first = cells.first_group[cell]
    last = cells.first_group[cell + 1]
    node = cells.first_node[cell]
    F = room.F
    J = room.J
    u = room.u
    c = room.c
    zero = cells.first_group[begun]
    moment = 4 * (cell - begun)
    for k in range(particles.mode_count):
        c[moment + k] = 0.0
    for group in range(first, last):
        at = 72 * (group - zero)
        gather(
            state.u,
            node,
            cells.along_x,
            cells.along_y,
            particles.splines,
            particles.pattern[group],
            F,
            at,
            u,
            at // 3,
        )
        for i in range(3):
            store(F, at + 32 * i, load(F, at + 32 * i) + 1.0)
        det = group_determinant(F, at)
        store(J, 8 * (group - zero), det)
        least = smaller(det, least)
        bad = above(det, 0.0, bad, 1.0)  # (the compiler would replace a - a by 0)
        _project(particles, group, det, c, moment)
    return least, bad


@inlined
def add_effects(begun, end, step, dt, cells, particles, state, calls, room):
    """Write to room the stress and load that effects add to the particles of cells from number `begun` to before `end`."""
    zero = cells.first_group[begun]
    count = cells.first_group[end] - zero
    f = room.f
    x = room.x
    added = room.added
    for k in range(count):
        at = 24 * k
        for i in range(3):
            store(f, at + 8 * i, splat(0.0))
            moved = load(room.u, at + 8 * i)
            store(x, at + 8 * i, moved + load(particles.reference, 24 * (zero + k) + 8 * i))
        for i in range(9):
            store(added, 3 * at + 8 * i, splat(0.0))
    for cell in range(begun, end if calls.rates > 0 else begun):
        for group in range(cells.first_group[cell], cells.first_group[cell + 1]):
            gather(
                state.v,
                cells.first_node[cell],
                cells.along_x,
                cells.along_y,
                particles.splines,
                particles.pattern[group],
                room.dF,
                72 * (group - zero),
                room.v,
                0,
            )
    call_each(calls.wide, step, zero, count, dt, room.given)
    if len(calls.narrow) > 0:
        add_one_by_one(calls.narrow, step, dt, zero, count, particles, room)


@inlined
def particles_to_grid(cell, begun, cells, particles, state, room, high, change):
    """Add to state.force the force of a cell's particles on its nodes, from stress and loads.

    begun: as of `grid_to_particles`. Returns lanes: the largest stiffness over density so far, m^2/s^2, and the largest change of it since
    the last step.
    """
    zero = cells.first_group[begun]
    node = cells.first_node[cell]
    added = room.added
    P = room.P
    f = room.f
    for group in range(cells.first_group[cell], cells.first_group[cell + 1]):
        at = 72 * (group - zero)
        pattern = particles.pattern[group]
        det = load(room.J, 8 * (group - zero))
        swollen = det - 1.0
        if particles.mode_count > 0:
            swollen = _projected(
                particles.modes,
                particles.moments[group],
                particles.mode_count,
                room.c,
                4 * (cell - begun),
            )
        pressure = swollen * cells.bulk[cell]
        scale, I1, I2 = neo_hookean(room.F, at, det, cells.shear[cell], pressure, P)
        stiff = stiffest(det, scale, I1, I2, pressure, cells.bulk[cell]) / load(
            particles.density, 8 * group
        )
        high = larger(stiff, high)
        change = larger(abs(stiff - load(state.stiffness, 8 * group)), change)
        store(state.stiffness, 8 * group, stiff)
        V = load(particles.volume, 8 * group)
        # without effects these are zeros: to add them costs less than to ask
        for i in range(9):
            store(P, 8 * i, (load(P, 8 * i) + load(added, at + 8 * i)) * V)
        scatter(
            state.force,
            node,
            cells.along_x,
            cells.along_y,
            particles.splines,
            pattern,
            P,
            f,
            24 * (group - zero),
            V,
            room.spare,
        )
    return high, change


@inner
def _together(begun, last, groups, cells):
    """End of the cells from number `begun` on, before `last`, that have no more than so many groups, or of one cell."""
    end = begun + 1
    while end < last and cells.first_group[end + 1] - cells.first_group[begun] <= groups:
        end += 1
    return end


@task_body
def _forces_of_slab(slab, given):
    """Add to state.force the forces of a slab; most: groups in a cell."""
    step, dt, push, most, cells, particles, surface, meeting, state, calls, slabs = given
    acts = len(calls.wide) + len(calls.narrow) > 0
    groups = max(
        most, WIDTH
    )  # so many that to call effects costs little, and so few that they stay in the nearest memory
    room = group_room(groups, calls, particles, state.memory)
    least = splat(np.inf)
    bad = splat(0.0)
    high = splat(0.0)
    change = splat(0.0)
    begun = cells.slab_first[slab]
    while begun < cells.slab_first[slab + 1]:
        end = _together(begun, cells.slab_first[slab + 1], groups, cells)
        for cell in range(begun, end):
            least, bad = grid_to_particles(cell, begun, cells, particles, state, room, least, bad)
        if acts:
            add_effects(begun, end, step, dt, cells, particles, state, calls, room)
        for cell in range(begun, end):
            high, change = particles_to_grid(
                cell, begun, cells, particles, state, room, high, change
            )
        begun = end
    touch(slab, step, surface, cells, state, calls, slabs)
    immerse(slab, step, dt, surface.wetted, cells, state, calls)
    count = len(cells.slab_first) - 1
    touch_pairs(slab, count, push, meeting, surface, cells.along_x, cells.along_y, state)
    see(slabs, slab, least, bad, high, change)


@inner
def _most_groups(cells):
    """Number of groups in the fullest cell. On its own: within `advance` its type would be open at first, and kernels compile for both."""
    most = 1
    for cell in range(len(cells.first_node)):
        most = max(most, cells.first_group[cell + 1] - cells.first_group[cell])
    return most


@task_body
def _rub_all(_, given):
    """Give the impulses of friction to the correction's loads: there and back through the points, which takes energy, however stiff the
    body. rubs (slabs,): above 0 where points of a slab are pushed."""
    push, cells, nodes, correction, surface, meeting, state, rubs = given
    begin_impulses(correction)
    rubbing = rubbing_patches(surface, cells, nodes, correction, state, rubs)
    inverse_mass = nodes.inverse_mass
    rub(push, rubbing, cells, inverse_mass, correction, state, 0)
    rub_pairs(push, meeting, surface, cells, nodes, correction, state, 0)
    rub_pairs(push, meeting, surface, cells, nodes, correction, state, 1)
    rub(push, rubbing, cells, inverse_mass, correction, state, 1)
    spread_loads(correction)


@compiled
def advance(
    steps,
    dt,
    cells,
    particles,
    nodes,
    correction,
    surface,
    meeting,
    state,
    calls,
    watch,
    slabs,
):
    """Take up to `steps` steps of dt (s). Changes State in place. correction: kernels.mass_correction; surface: kernels.surface_contact;
    meeting: kernels.body_contact, or (); calls: effects.calls.MotionCalls; watch, slabs: see kernels.watch.

    Returns the number of steps taken; if fewer than `steps`, the watch says why, or pairs of a meeting must be listed again.
    """
    most = _most_groups(cells)
    count = len(cells.slab_first) - 1
    parts = parts_of(len(nodes.active))
    pace = np.zeros(parts)
    for step in range(steps):
        if needs_list(meeting):
            return step
        push = push_time(calls, step, dt)
        body = (cells, particles, surface, meeting, state, calls, slabs)
        over_slabs(count, task(_forces_of_slab, (step, dt, push, most, *body)))
        if stops(watch, slabs):
            clear(state.force)
            return step
        count_swings(slabs.flutter, slabs.push.sum(), slabs.slides.sum(), dt)
        pairs = add_pairs(meeting, surface, cells.along_x, cells.along_y, state.force)
        if len(calls.drag) > 0:
            over_parts(parts, task(carry, (surface.wetted, nodes, state)))
        correct(correction, state.force)
        moving = (nodes, correction, meeting, state, calls, pace)
        if slabs.rubs.max() + pairs > 0.0:
            over_parts(parts, task(push_nodes, (step, dt, push, nodes, correction, state, calls)))
            rubbing = (push, cells, nodes, correction, surface, meeting, state, slabs.rubs)
            once(task(_rub_all, rubbing))
            over_parts(parts, task(move_nodes, (step, dt, push, *moving)))
        else:
            over_parts(parts, task(update_grid, (step, dt, push, *moving)))
        way = dt * math.sqrt(pace.max())
        passed(meeting, way)
        if len(calls.contact) > 0:
            state.touching[-1] += way
    return steps


def tasks(
    body: tuple[Any, ...], state: State, calls: MotionCalls, slabs: Any
) -> dict[str, list[tuple[Any, Any]]]:
    """The tasks of `advance` with arguments as it makes them, in parts that are compiled beside each other; body: its records, cells to
    meeting."""
    cells, particles, nodes, correction, surface, meeting = body
    now = (0, 0.0, 0.0)
    moving = (nodes, correction, meeting, state, calls, np.zeros(1))
    of_slab = (cells, particles, surface, meeting, state, calls, slabs)
    rubbing = (0.0, cells, nodes, correction, surface, meeting, state, slabs.rubs)
    return {
        "forces": [(_forces_of_slab, (*now, 0, *of_slab))],
        "friction": [(_rub_all, rubbing)],
        "nodes": [
            (carry, (surface.wetted, nodes, state)),
            (push_nodes, (*now, nodes, correction, state, calls)),
            (move_nodes, (*now, *moving)),
            (update_grid, (*now, *moving)),
        ],
    }


class ParticleMotion(NamedTuple):
    """Place x m, velocity v m/s (n, 3) and F (n, 3, 3) of a model's particles, in its order."""

    x: Array
    v: Array
    F: Array


@task_body
def _cell_at_particles(cell, given):
    """`at_particles` of one cell."""
    cells, particles, particle, u, v, reference, out = given
    along_x = cells.along_x
    along_y = cells.along_y
    splines = particles.splines
    gradient = np.empty(72)
    moved = np.empty(24)
    speed = np.empty(24)
    node = cells.first_node[cell]
    for group in range(cells.first_group[cell], cells.first_group[cell + 1]):
        gather(u, node, along_x, along_y, splines, particles.pattern[group], gradient, 0, moved, 0)
        gather_value(v, node, along_x, along_y, splines, particles.pattern[group], speed, 0)
        for lane in range(WIDTH):
            p = particle[group, lane]
            if p >= 0:
                for i in range(3):
                    out.x[p, i] = reference[p, i] + moved[8 * i + lane]
                    out.v[p, i] = speed[8 * i + lane]
                    for j in range(3):
                        out.F[p, i, j] = gradient[8 * (3 * i + j) + lane]
                    out.F[p, i, i] += 1.0


@compiled
def at_particles(cells, particles, particle, u, v, reference, out):
    """Write to `out`, a ParticleMotion, what moves with u, v (3 nodes,); reference (n, 3) m: positions in the undeformed body.

    particle (groups, 8): the particle in each lane, -1 for none.
    """
    given = (cells, particles, particle, u, v, reference, out)
    over_parts(len(cells.first_node), task(_cell_at_particles, given))
