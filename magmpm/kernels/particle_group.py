"""Stress and load that effects add to the particles of a cell in motion, in groups of eight lanes.

A matrix of a group is a flat array (9 8,), row by row, each entry eight lanes. Effects whose hooks are wide take groups as they are; for
the others particles are laid out one by one, and what they add is brought back to the lanes.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from magmpm.compiled.arrays import Array
from magmpm.compiled.by_address import address
from magmpm.compiled.jit import inner
from magmpm.compiled.simd import WIDTH
from magmpm.effects.calls import GIVEN, call_each


class GroupRoom(NamedTuple):
    """Work space for the groups of some cells, flat, in one piece of memory.

    F, added: stress of effects, Pa, dF: dF/dt 1/s (groups 9 8,); u m, x m, load f N/m^3 (groups 3 8,); J: det F (groups 8,); c: moments of
    det F - 1 of each cell (4 groups,). Of one group: P Pa, spare (9 8,), v m/s (3 8,). single: so many `numbers` of each particle. given:
    address of `addresses`, of groups and of particles one by one (effects.calls.GIVEN).
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
    numbers: int
    given: int
    addresses: NDArray[Any]


@inner
def group_room(most, calls, particles, memory):
    """Work space for at most `most` groups, for what acts.

    particles: a record with remanence (groups 3 8,), or (groups 4 8,) where an effect marks particles (acting.marked), and density and
    volume (groups 8,); memory: kernels.total_lagrangian_step.State.
    """
    lanes = len(particles.density)
    columns = len(particles.remanence) // lanes
    numbers = columns + 35  # of one particle: see add_one_by_one
    n = WIDTH * most
    acting = n if len(calls.wide) + len(calls.narrow) > 0 else 0
    changing = n if calls.rates > 0 else 0
    narrow = n if len(calls.narrow) > 0 else 0
    room = np.empty(168 + 26 * n + 3 * acting + 9 * changing + narrow * numbers)
    added = room[168 + 9 * n : 168 + 18 * n]
    f = room[168 + 21 * n : 168 + 24 * n]
    # no effect: no stress, and no load
    added[:] = 0.0
    f[:] = 0.0
    rest = room[168 + 26 * n :]
    single = rest[3 * acting + 9 * changing :]
    addresses = np.zeros(2, GIVEN)
    groups = addresses[0]
    groups.columns = columns
    groups.kept = len(memory) // lanes
    groups.magnet = address(particles.remanence, 0)
    groups.rho = address(particles.density, 0)
    groups.memory = address(memory, 0)
    groups.x = address(rest, 0)
    groups.F = address(room, 168)
    groups.dF = address(rest, 3 * acting)
    groups.stress = address(added, 0)
    groups.force = address(f, 0)
    each = addresses[1]
    each.columns = columns
    each.rho = address(single, 0)
    each.x = address(single, narrow)
    each.F = address(single, 4 * narrow)
    each.dF = address(single, 13 * narrow)
    each.stress = address(single, 22 * narrow)
    each.force = address(single, 31 * narrow)
    each.magnet = address(single, 35 * narrow)
    return GroupRoom(
        room[168 : 168 + 9 * n],
        room[168 + 24 * n : 168 + 25 * n],
        room[168 + 18 * n : 168 + 21 * n],
        room[168 + 25 * n : 168 + 26 * n],
        added,
        f,
        room[:72],
        room[72:144],
        room[144:168],
        rest[: 3 * acting],
        rest[3 * acting : 3 * acting + 9 * changing],
        single,
        numbers,
        address(addresses, 0),
        addresses,
    )


@inner
def add_one_by_one(narrow, step, dt, first, count, particles, room):
    """Add the effects whose hooks take one particle at a time to the stress `added` (Pa) and load f (N/m^3) of groups in room, `count` from
    number `first` on. Room for one of them is left for rho, x, F, dF, stress, force, lane and magnet, in this order."""
    columns = len(particles.remanence) // len(particles.density)
    single = room.single
    F = room.F
    most = len(single) // room.numbers
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
            single[35 * most + columns * p + i] = particles.remanence[magnet + WIDTH * i]
    call_each(narrow, step, 0, n, dt, address(room.addresses, 1))
    for p in range(n):
        k = int(single[34 * most + p])
        three = WIDTH * 3 * (k // WIDTH) + k % WIDTH
        nine = WIDTH * 9 * (k // WIDTH) + k % WIDTH
        for i in range(3):
            room.f[three + WIDTH * i] += single[31 * most + 3 * p + i]
        for i in range(9):
            room.added[nine + WIDTH * i] += single[22 * most + 9 * p + i]
