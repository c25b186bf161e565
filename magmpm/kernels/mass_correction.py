"""The correction of the lumped mass in a step of a motion: plane by plane, and along chains of hats (dynamics.nodal_mass).

Inverse mass = 1/m + A (C^-1 - L^-1) A', with the fields A = hat(x) (1, y, z), C = A'M A and L = A'm A. Along a chain both matrices couple
a knot with KNOTS_APART others on each side, so a step takes two solves with factors that never change.

Impulses that come one after another, of friction, must see what those before have changed, the correction as well: without it they stop
too much, up to twice, and what sticks vibrates without end. They take C^-1 - L^-1 itself, near the knots that they see.
"""

from typing import NamedTuple

from magmpm.compiled.arrays import Array, Index
from magmpm.compiled.jit import compiled, inlined, inner, task_body
from magmpm.compiled.parallel import over_parts, task
from magmpm.compiled.simd import eight, load, one_by_one, splat, store

FIELDS = 3  # 1, y and z in a plane of nodes
# knots: splines reach over two planes, so hats that are two knots from each other still overlap
KNOTS_APART = 2
KNOTS_SEEN = 4  # knots whose hats a place of a cell may see
# knots from those that an impulse sees: farther off it changes velocities by less than 4 % of that
NEARBY = 4


class Correction(NamedTuple):
    """Planes of nodes of a component that share one x; chains of knots along x, one chain a component.

    order (m,), first (planes + 1,): the nodes of each plane; arm (2 nodes,): y and z in cells from the component's center;
    plane (active,): of each of Nodes.active, the last one where nothing is corrected; left, share (planes,): knot before the plane, and
    the value of the next knot's hat; chain (components + 1,): first knot of each; pivot (2, knots, 3, 3), link (2, knots, KNOTS_APART, 3,
    3): factors of C and L; moving (3,): 1 for directions in which nodes can move; plane_of (nodes,): the plane of every node; chain_of
    (knots,): the chain of each knot; gain, gain_at (chains,): C^-1 - L^-1 of the chains, one after another, and where each begins. Work
    space: moment, added (planes + 1, 9), load, ahead (knots, 9), answer (2, knots, 9).
    """

    order: Index
    first: Index
    arm: Array
    plane: Index
    left: Index
    share: Array
    chain: Index
    pivot: Array
    link: Array
    moving: Array
    plane_of: Index
    chain_of: Index
    gain: Array
    gain_at: Index
    moment: Array
    added: Array
    load: Array
    ahead: Array
    answer: Array


@task_body
def _sum_plane(plane, given):
    """Moments of the nodes' forces in one plane: sums of f, y f and z f."""
    correction, force = given
    a0 = 0.0
    a1 = 0.0
    a2 = 0.0
    b0 = 0.0
    b1 = 0.0
    b2 = 0.0
    c0 = 0.0
    c1 = 0.0
    c2 = 0.0
    for k in range(correction.first[plane], correction.first[plane + 1]):
        node = correction.order[k]
        y = correction.arm[2 * node]
        z = correction.arm[2 * node + 1]
        f0 = force[3 * node]
        f1 = force[3 * node + 1]
        f2 = force[3 * node + 2]
        a0 = a0 + f0
        a1 = a1 + f1
        a2 = a2 + f2
        b0 = b0 + y * f0
        b1 = b1 + y * f1
        b2 = b2 + y * f2
        c0 = c0 + z * f0
        c1 = c1 + z * f1
        c2 = c2 + z * f2
    m = correction.moment
    m[plane, 0], m[plane, 1], m[plane, 2] = a0, a1, a2
    m[plane, 3], m[plane, 4], m[plane, 5] = b0, b1, b2
    m[plane, 6], m[plane, 7], m[plane, 8] = c0, c1, c2


@inner
def _solve(pivot, link, first, last, load, answer):
    """answer (knots, 9) of one chain, by block elimination with factors from dynamics.nodal_mass."""
    for k in range(first, last):
        for a in range(FIELDS):
            for i in range(3):
                value = load[k, 3 * a + i]
                for d in range(min(KNOTS_APART, k - first)):
                    for b in range(FIELDS):
                        value -= link[k, d, a, b] * answer[k - 1 - d, 3 * b + i]
                answer[k, 3 * a + i] = value
    for k in range(last - 1, first - 1, -1):
        for i in range(3):
            y0 = answer[k, i]
            y1 = answer[k, 3 + i]
            y2 = answer[k, 6 + i]
            for a in range(FIELDS):
                value = pivot[k, a, 0] * y0 + pivot[k, a, 1] * y1 + pivot[k, a, 2] * y2
                for d in range(min(KNOTS_APART, last - 1 - k)):
                    for b in range(FIELDS):
                        value -= link[k + 1 + d, d, b, a] * answer[k + 1 + d, 3 * b + i]
                answer[k, 3 * a + i] = value


@inner
def correct(correction, force):
    """Compute the correction of the accelerations in each plane from the nodes' forces: `added`, constant and slopes along y and z."""
    over_parts(len(correction.left), task(_sum_plane, (correction, force)))
    _spread(correction)


@inner
def _spread(correction):
    """Solve for `added` from the moments of all planes."""
    load = correction.load
    left = correction.left
    share = correction.share
    load[:] = 0.0
    for plane in range(len(left)):
        k = left[plane]
        s = share[plane]
        for j in range(9):
            load[k, j] += (1.0 - s) * correction.moment[plane, j]
            load[k + 1, j] += s * correction.moment[plane, j]
    spread_loads(correction)


@inner
def spread_loads(correction):
    """Solve for `added` from the loads of all knots."""
    load = correction.load
    answer = correction.answer
    left = correction.left
    share = correction.share
    for c in range(len(correction.chain) - 1):
        for which in range(2):
            _solve(
                correction.pivot[which],
                correction.link[which],
                correction.chain[c],
                correction.chain[c + 1],
                load,
                answer[which],
            )
    for plane in range(len(left)):
        k = left[plane]
        s = share[plane]
        for j in range(9):
            low = answer[0, k, j] - answer[1, k, j]
            high = answer[0, k + 1, j] - answer[1, k + 1, j]
            correction.added[plane, j] = correction.moving[j % 3] * ((1.0 - s) * low + s * high)


@inlined
def added_at(correction, plane, node, i):
    """Acceleration that the correction adds to component i of a node, m/s^2."""
    added = correction.added
    arm = correction.arm
    return (
        added[plane, i]
        + arm[2 * node] * added[plane, 3 + i]
        + arm[2 * node + 1] * added[plane, 6 + i]
    )


@compiled
def begin_impulses(correction):
    """Begin impulses that come one after another."""
    correction.load[:] = 0.0
    correction.ahead[:] = 0.0


@inner
def fields_at(correction, node, along_x, along_y, splines, at, fields, begun):
    """Write to fields, from index `begun` on, those of knots at a place of a cell, nine a knot: each of 1, y, z for three components.

    node: the cell's first one; splines: of the nodes that it sees, from index `at` on (kernels.impulses.Places). Returns the first of the
    knots, -1 where nothing is corrected.
    """
    none = len(correction.left)
    first = -1
    fields[begun : begun + 9 * KNOTS_SEEN] = 0.0
    for a in range(3):
        plane = none
        sums = (0.0, 0.0, 0.0)
        for b in range(3):
            for c in range(3):
                n = node + a * along_x + b * along_y + c
                if correction.plane_of[n] < none:
                    plane = correction.plane_of[n]  # nodes of one x and one component share it
                    share = splines[at + 27 * a + 9 * b + 3 * c]
                    y = correction.arm[2 * n]
                    z = correction.arm[2 * n + 1]
                    sums = (sums[0] + share, sums[1] + share * y, sums[2] + share * z)
        if plane == none:
            continue
        left = correction.left[plane]
        if first < 0:
            first = left  # nodes go along x: the first one's knot is the least
        over = correction.share[plane]
        k = begun + 9 * (left - first)
        for field in range(3):
            for i in range(3):
                fields[k + 3 * field + i] += (1.0 - over) * sums[field]
                fields[k + 9 + 3 * field + i] += over * sums[field]
    return first


@inner
def ahead_at(correction, first, fields, at):
    """Return the accelerations (m/s^2) that the correction of the impulses so far adds at a place; its fields begin at index `at`."""
    if first < 0:
        return 0.0, 0.0, 0.0
    ahead = correction.ahead
    low = splat(0.0)
    last = 0.0
    for k in range(min(KNOTS_SEEN, len(ahead) - first)):
        low = low + load(fields, at + 9 * k) * load(ahead, 9 * (first + k))
        last += fields[at + 9 * k + 8] * ahead[first + k, 8]
    a = one_by_one(low)
    moving = correction.moving
    return (
        moving[0] * (a[0] + a[3] + a[6]),
        moving[1] * (a[1] + a[4] + a[7]),
        moving[2] * (a[2] + a[5] + last),
    )


@inner
def give_of(correction, first, fields, at, column, to):
    """Return by how much (1/kg) the correction makes a place quicker after 1 N s. Writes to column, from index `to` on, what it does to
    the knots nearby, each number for three components."""
    if first < 0:
        return 0.0
    chain = correction.chain_of[first]
    begin = correction.chain[chain]
    end = correction.chain[chain + 1]
    wide = 3 * (end - begin)
    low = max(first - NEARBY, begin)
    high = min(first + KNOTS_SEEN + NEARBY, end)
    seen = 3 * (min(first + KNOTS_SEEN, end) - first)
    rows = 3 * (high - low)
    column[to : to + rows] = 0.0
    for j in range(seen):  # the matrix is symmetric: its rows are columns
        field = fields[at + 3 * j]
        begun = correction.gain_at[chain] + (3 * (first - begin) + j) * wide + 3 * (low - begin)
        for row in range(rows):
            column[to + row] += correction.gain[begun + row] * field
    give = 0.0
    for j in range(seen):
        give += fields[at + 3 * j] * column[to + 3 * (first - low) + j]
    for row in range(rows - 1, -1, -1):
        for i in range(3):
            column[to + 3 * row + 2 - i] = column[to + row]
    return give


@inner
def add_impulse(correction, first, fields, at, column, to, f):
    """Note an impulse of the force f, a triple, N, at a place whose fields and column (`give_of`) begin at indices `at` and `to`."""
    if first < 0:
        return
    chain = correction.chain_of[first]
    low = max(first - NEARBY, correction.chain[chain])
    high = min(first + KNOTS_SEEN + NEARBY, correction.chain[chain + 1])
    x, y, z = f
    lanes = eight(x, y, z, x, y, z, x, y)
    _add_rows(correction.ahead, low, high - low, column, to, lanes, z)
    _add_rows(correction.load, first, min(KNOTS_SEEN, high - first), fields, at, lanes, z)


@inlined
def _add_rows(rows, first, count, shares, at, f, last):
    """Add shares of a force to rows (knots, 9); f: its components in turn, and the `last` of them."""
    for k in range(count):
        store(rows, 9 * (first + k), load(rows, 9 * (first + k)) + load(shares, at + 9 * k) * f)
        rows[first + k, 8] += shares[at + 9 * k + 8] * last
