"""Points of a body between its nodes: nodal fields there, forces on them, and impulses that come one after another.

A cell sees 27 nodes, in nine rows of three along z. The nine numbers of a row lie side by side: eight lanes and one.
"""

from typing import NamedTuple

import numpy as np

from magmpm.compiled.arrays import Array, Index
from magmpm.compiled.jit import inlined, inner
from magmpm.compiled.simd import eight, load, one_by_one, splat, store, sums, total
from magmpm.kernels.mass_correction import (
    KNOTS_SEEN,
    NEARBY,
    add_impulse,
    ahead_at,
    fields_at,
    give_of,
)

SPLINES = (
    81  # of a place: the share of each of 27 nodes, three times, as fields have three components
)


@inlined
def _components(low, last):
    """Sums over three nodes of the lanes `low` and the number `last` of a row, by component."""
    a = one_by_one(low)
    return a[0] + a[3] + a[6], a[1] + a[4] + a[7], a[2] + a[5] + last


@inlined
def gather_value(field, node, along_x, along_y, splines, first, value, to):
    """Value (3 8,), from index `to` on, of a nodal field (3 nodes,) at eight places in a cell, whose splines begin at splines[first]."""
    zero = splat(0.0)
    u0 = zero
    u1 = zero
    u2 = zero
    nz0 = load(splines, first + 48)
    nz1 = load(splines, first + 56)
    nz2 = load(splines, first + 64)
    for a in range(3):
        p0 = zero
        p1 = zero
        p2 = zero
        for b in range(3):
            k = 3 * (node + a * along_x + b * along_y)
            ny = load(splines, first + 24 + 8 * b)
            p0 = p0 + ny * (nz0 * field[k] + nz1 * field[k + 3] + nz2 * field[k + 6])
            p1 = p1 + ny * (nz0 * field[k + 1] + nz1 * field[k + 4] + nz2 * field[k + 7])
            p2 = p2 + ny * (nz0 * field[k + 2] + nz1 * field[k + 5] + nz2 * field[k + 8])
        nx = load(splines, first + 8 * a)
        u0 = u0 + nx * p0
        u1 = u1 + nx * p1
        u2 = u2 + nx * p2
    store(value, to, u0), store(value, to + 8, u1), store(value, to + 16, u2)


@inlined
def scatter_value(field, node, along_x, along_y, splines, first, f):
    """Add f, a triple of lanes, at a group of eight places to a nodal field (3 nodes,): what `gather_value` reads, backward."""
    nz0 = load(splines, first + 48)
    nz1 = load(splines, first + 56)
    nz2 = load(splines, first + 64)
    for a in range(3):
        nx = load(splines, first + 8 * a)
        for b in range(3):
            k = 3 * (node + a * along_x + b * along_y)
            share = nx * load(splines, first + 24 + 8 * b)
            n0 = share * f[0]
            n1 = share * f[1]
            n2 = share * f[2]
            added = sums(
                n0 * nz0, n1 * nz0, n2 * nz0, n0 * nz1, n1 * nz1, n2 * nz1, n0 * nz2, n1 * nz2
            )
            store(field, k, load(field, k) + added)
            field[k + 8] += total(n2 * nz2)


class Places(NamedTuple):
    """Places (n,) of the body on which impulses act: the first node of the cell of each; splines (SPLINES n,) of its nodes, row by row; of
    the mass correction (kernels.mass_correction) the first knot that it sees, -1 for none, fields (9 KNOTS_SEEN n,), and column
    (9 (2 NEARBY + KNOTS_SEEN) n,).
    """

    node: Index
    splines: Array
    knot: Index
    fields: Array
    column: Array


FIELDS = 9 * KNOTS_SEEN
COLUMN = 9 * (2 * NEARBY + KNOTS_SEEN)


@inner
def new_places(count):
    """Room for so many places."""
    return Places(
        np.empty(count, np.int64),
        np.empty(SPLINES * count),
        np.empty(count, np.int64),
        np.empty(FIELDS * count),
        np.empty(COLUMN * count),
    )


@inner
def come_to(places, k, node, weights, at):
    """Set place k by its cell's first node, and its splines along each axis from index `at` of weights on."""
    places.node[k] = node
    z0 = weights[at + 6]
    z1 = weights[at + 7]
    z2 = weights[at + 8]
    low = eight(z0, z0, z0, z1, z1, z1, z2, z2)
    for a in range(3):
        for b in range(3):
            share = weights[at + a] * weights[at + 3 + b]
            to = SPLINES * k + 27 * a + 9 * b
            store(places.splines, to, share * low)
            places.splines[to + 8] = share * z2


@inner
def give_at(places, k, along_x, along_y, correction, inverse_mass):
    """Compute what the correction sees of place k, and return by how much (1/kg) it is quicker after an impulse of 1 N s, at most."""
    node = places.node[k]
    splines = places.splines
    at = SPLINES * k
    fields = places.fields
    knot = fields_at(correction, node, along_x, along_y, splines, at, fields, FIELDS * k)
    places.knot[k] = knot
    give = give_of(correction, knot, fields, FIELDS * k, places.column, COLUMN * k)
    for a in range(3):
        for b in range(3):
            for c in range(3):
                n = 3 * (node + a * along_x + b * along_y + c)
                most = max(inverse_mass[n], inverse_mass[n + 1], inverse_mass[n + 2])
                give += splines[at + 27 * a + 9 * b + 3 * c] ** 2 * most
    return give


@inlined
def sum_at(splines, at, node, along_x, along_y, field):
    """Sum of a nodal field (3 nodes,) times the splines of a place, as of Places, from index `at` on; node: the cell's first one."""
    low = splat(0.0)
    last = 0.0
    for row in range(9):
        n = 3 * (node + row // 3 * along_x + row % 3 * along_y)
        low = low + load(splines, at + 9 * row) * load(field, n)
        last += splines[at + 9 * row + 8] * field[n + 8]
    return _components(low, last)


@inner
def velocity_at(places, k, along_x, along_y, push, correction, field):
    """Velocity (m/s) of place k, as the impulses so far have changed it."""
    x, y, z = sum_at(places.splines, SPLINES * k, places.node[k], along_x, along_y, field)
    s, t, u = ahead_at(correction, places.knot[k], places.fields, FIELDS * k)
    return x + push * s, y + push * t, z + push * u


@inner
def add_force(splines, at, node, along_x, along_y, f, force):
    """Add a force f, a triple, N, to those of the nodes; splines: as of Places, from index `at` on."""
    x, y, z = f
    low = eight(x, y, z, x, y, z, x, y)
    for row in range(9):
        n = 3 * (node + row // 3 * along_x + row % 3 * along_y)
        store(force, n, load(force, n) + load(splines, at + 9 * row) * low)
        force[n + 8] += splines[at + 9 * row + 8] * z


@inner
def quicken(places, k, along_x, along_y, push, correction, inverse_mass, f, v):
    """Change the nodes' velocities v (3 nodes,) by the force f, a triple, N, on place k for push (s); note it for the correction."""
    p0 = push * f[0]
    p1 = push * f[1]
    p2 = push * f[2]
    p = eight(p0, p1, p2, p0, p1, p2, p0, p1)
    for row in range(9):
        n = 3 * (places.node[k] + row // 3 * along_x + row % 3 * along_y)
        at = SPLINES * k + 9 * row
        store(v, n, load(v, n) + load(places.splines, at) * load(inverse_mass, n) * p)
        v[n + 8] += places.splines[at + 8] * inverse_mass[n + 8] * p2
    knot = places.knot[k]
    add_impulse(correction, knot, places.fields, FIELDS * k, places.column, COLUMN * k, f)


@inlined
def turned(k, count, back):
    """Number k of `count`, counted from the last where `back` is 1."""
    return count - 1 - k if back else k
