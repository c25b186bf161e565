"""Stress and load that effects add to the particles of a cell in motion, in groups of eight lanes.

A matrix of a group is a flat array (9 8,), row by row, each entry eight lanes. Effects whose hooks are wide take groups as they are; for
the others particles are laid out one by one, and what they add is brought back to the lanes.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from magmpm.compiled.arrays import Array
from magmpm.compiled.by_address import address
from magmpm.compiled.jit import compiled
from magmpm.compiled.simd import WIDTH
from magmpm.effects.calls import GIVEN, call_each

# numbers of a particle by itself but for its remanence: rho, x (from 1 on), F (4), dF (13), stress (22), force (31), and its lane (34)
SINGLE = 35


class GroupRoom(NamedTuple):
    """Work space for the groups of some cells, flat, in one piece of memory.

    F, added: stress of effects, Pa, dF: dF/dt 1/s (groups 9 8,); u m, x m, load f N/m^3 (groups 3 8,); J: det F (groups 8,); c: moments of
    det F - 1 of each cell (4 groups,). Of one group: P Pa, spare (9 8,), v m/s (3 8,). single: numbers of each particle, rho, x, F, dF,
    stress, force, lane and magnet. given: address of `addresses`, of groups and of particles one by one (effects.calls.GIVEN).
    """

    F: Array
    J: Array
    u: Array
    c: Array
    added: Array
    f: Array
    P: Array
    spare: Array
    v: Array
    x: Array
    dF: Array
    single: Array
    given: int
    addresses: NDArray[Any]


@compiled
def group_room(most, calls, particles, memory):
    """Work space for at most `most` groups, for what acts.

    particles: a record with remanence (groups 3 8,), or (groups 4 8,) where an effect marks particles (acting.marked), and density and
    volume (groups 8,); memory: kernels.total_lagrangian_step.State.
    """
    lanes = len(particles.density)
    columns = len(particles.remanence) // lanes
    acts = most if len(calls.wide) + len(calls.narrow) > 0 else 0
    rates = most if calls.rates > 0 else 0
    narrow = WIDTH * most if len(calls.narrow) > 0 else 0
    sizes = (72 * most, 8 * most, 24 * most, 4 * most, 72 * most, 24 * most)
    total = 196 + 204 * most + 24 * acts + 72 * rates + narrow * (columns + SINGLE)
    all_of_it = np.empty(total)
    at = 0
    F = all_of_it[: sizes[0]]
    at += sizes[0]
    J = all_of_it[at : at + sizes[1]]
    at += sizes[1]
    u = all_of_it[at : at + sizes[2]]
    at += sizes[2]
    added = all_of_it[at : at + sizes[4]]
    at += sizes[4]
    f = all_of_it[at : at + sizes[5]]
    at += sizes[5]
    P = all_of_it[at : at + 72]
    spare = all_of_it[at + 72 : at + 144]
    v = all_of_it[at + 144 : at + 168]
    at += 168
    x = all_of_it[at : at + 24 * acts]
    at += 24 * acts
    dF = all_of_it[at : at + 72 * rates]
    at += 72 * rates
    single = all_of_it[at : at + narrow * (columns + SINGLE)]
    at += narrow * (columns + SINGLE)
    c = all_of_it[at : at + sizes[3]]
    # no effect: no stress, and no load
    added[:], f[:] = 0.0, 0.0
    addresses = np.zeros(2, GIVEN)
    groups = addresses[0]
    groups.columns, groups.kept = columns, len(memory) // lanes
    groups.magnet, groups.rho = address(particles.remanence, 0), address(particles.density, 0)
    groups.memory = address(memory, 0)
    groups.x, groups.F, groups.dF = address(x, 0), address(F, 0), address(dF, 0)
    groups.stress, groups.force = address(added, 0), address(f, 0)
    each = addresses[1]
    each.columns = columns
    each.rho, each.x = address(single, 0), address(single, narrow)
    each.F, each.dF = address(single, 4 * narrow), address(single, 13 * narrow)
    each.stress, each.force = address(single, 22 * narrow), address(single, 31 * narrow)
    each.magnet = address(single, narrow * SINGLE)
    return GroupRoom(
        F, J, u, c, added, f, P, spare, v, x, dF, single, address(addresses, 0), addresses
    )


@compiled
def add_one_by_one(narrow, step, dt, first, count, particles, room):
    """Add the effects whose hooks take one particle at a time to the stress `added` (Pa) and load f (N/m^3) of groups in room, `count` from
    number `first` on."""
    columns = len(particles.remanence) // len(particles.density)
    single = room.single
    F = room.F
    most = len(single) // (columns + SINGLE)
    n = 0
    for k in range(WIDTH * count):
        if particles.volume[WIDTH * first + k] != 0.0:  # a lane with a particle
            single[34 * most + n] = k
            n += 1
    for p in range(n):
        k = int(single[34 * most + p])
        lane = k % WIDTH
        three = WIDTH * 3 * (k // WIDTH) + lane
        nine = WIDTH * 9 * (k // WIDTH) + lane
        magnet = WIDTH * columns * (first + k // WIDTH) + lane
        single[p] = particles.density[WIDTH * first + k]
        for i in range(3):
            single[most + 3 * p + i] = room.x[three + WIDTH * i]
            single[31 * most + 3 * p + i] = 0.0
        for i in range(9):
            single[4 * most + 9 * p + i] = F[nine + WIDTH * i]
            single[22 * most + 9 * p + i] = 0.0
        for i in range(9 if len(room.dF) > 0 else 0):
            single[13 * most + 9 * p + i] = room.dF[nine + WIDTH * i]
        for i in range(columns):
            single[SINGLE * most + columns * p + i] = particles.remanence[magnet + WIDTH * i]
    call_each(narrow, step, 0, n, dt, address(room.addresses, 1))
    for p in range(n):
        k = int(single[34 * most + p])
        three = WIDTH * 3 * (k // WIDTH) + k % WIDTH
        nine = WIDTH * 9 * (k // WIDTH) + k % WIDTH
        for i in range(3):
            room.f[three + WIDTH * i] += single[31 * most + 3 * p + i]
        for i in range(9):
            room.added[nine + WIDTH * i] += single[22 * most + 9 * p + i]
