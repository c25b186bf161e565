"""The step of a motion without the mechanism of effects: the baseline for scenes without effects.

The functions of kernels.total_lagrangian_step line by line, without everything about effects and otherwise unchanged: the watch on
stiffness and det F is part of every step. tests/unit/project/test_benchmarks.py compares the results of the two.
"""

from typing import NamedTuple

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.compiled.jit import compiled, inlined, inner_kernel, prange
from magmpm.compiled.simd import larger, load, splat, store
from magmpm.kernels.mass_correction import added_at, correct
from magmpm.kernels.total_lagrangian_step import (
    State,
    _most_groups,
    _projected,
    grid_to_particles,
    scatter,
)
from magmpm.kernels.watch import clear, see, stops
from magmpm.materials import neo_hookean, stiffest


class CellRoom(NamedTuple):
    """Work space for the particles of one cell: F (groups 9 8,), det F (groups 8,), u (groups 3 8,) m, moments of det F - 1 (4,)."""

    F: Array
    J: Array
    u: Array
    c: Array


@inlined
def particles_to_grid(cell, cells, particles, state, room, P, f, spare, high, change):
    """As of kernels.total_lagrangian_step, without effects."""
    first = cells.first_group[cell]
    last = cells.first_group[cell + 1]
    node = cells.first_node[cell]
    along_x = cells.along_x
    along_y = cells.along_y
    splines = particles.splines
    for group in range(first, last):
        at = 72 * (group - first)
        pattern = particles.pattern[group]
        det = load(room.J, 8 * (group - first))
        swollen = det - 1.0
        if particles.mode_count > 0:
            swollen = _projected(
                particles.modes, particles.moments[group], particles.mode_count, room.c, 0
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
        for i in range(9):
            store(P, 8 * i, load(P, 8 * i) * V)
        scatter(state.force, node, along_x, along_y, splines, pattern, P, f, 0, V, spare)
    return high, change


@inlined
def update_grid(k, dt, nodes, correction, state):
    """As of kernels.total_lagrangian_step, without effects."""
    node = nodes.active[k]
    plane = correction.plane[k]
    n = 3 * node
    u = state.u
    v = state.v
    force = state.force
    inverse_mass = nodes.inverse_mass
    for i in range(3):
        v[n + i] += dt * (inverse_mass[n + i] * force[n + i] + added_at(correction, plane, node, i))
        force[n + i] = 0.0
    for i in range(3):
        u[n + i] += dt * v[n + i]


@inner_kernel
def _sum_forces(most, cells, particles, state, slabs):
    """As of kernels.total_lagrangian_step, without effects."""
    count = len(cells.slab_first) - 1
    for color in range(2):
        for half in prange((count + 1 - color) // 2):
            slab = 2 * half + color
            room = CellRoom(
                np.empty(72 * most), np.empty(8 * most), np.empty(24 * most), np.empty(4)
            )
            P = np.empty(72)
            f = np.zeros(24)
            spare = np.empty(72)
            least = splat(np.inf)
            bad = splat(0.0)
            high = splat(0.0)
            change = splat(0.0)
            for cell in range(cells.slab_first[slab], cells.slab_first[slab + 1]):
                least, bad = grid_to_particles(
                    cell, cell, cells, particles, state, room, least, bad
                )
                high, change = particles_to_grid(
                    cell, cells, particles, state, room, P, f, spare, high, change
                )
            see(slabs, slab, least, bad, high, change)


@inner_kernel
def _update_nodes(dt, nodes, correction, state):
    """As of kernels.total_lagrangian_step, without effects."""
    for k in prange(len(nodes.active)):
        update_grid(np.int64(k), dt, nodes, correction, state)


@compiled
def advance(steps, dt, cells, particles, nodes, correction, state, watch, slabs):
    """As of kernels.total_lagrangian_step, without effects."""
    most = _most_groups(cells)
    for step in range(steps):
        _sum_forces(most, cells, particles, state, slabs)
        if stops(watch, slabs):
            clear(state.force)
            return step
        correct(correction, state.force)
        _update_nodes(dt, nodes, correction, state)
    return steps


def steps_of(motion, steps, dt, u, v):  # type: ignore[no-untyped-def]
    """So many steps of dt (s) of a TotalMotion's body without effects, on displacements u and velocities v (3 nodes,), in place."""
    p = motion.packed
    state = State(u, v, motion.force, motion.stiffness, motion.touching, motion.memory)
    return advance(
        steps,
        dt,
        p.cells,
        p.particles,
        p.nodes,
        p.mass.correction,
        state,
        motion.watch,
        motion.slabs,
    )
