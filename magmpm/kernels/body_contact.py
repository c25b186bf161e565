"""Contact of the body with itself: points of its surface touch the solids of its components.

A pair is a point and a solid that it may touch. The place X in the undeformed solid that is now at the point, X + u(X) = x, follows from
Newton's method in a cell of the solid's grid. The point touches where X lies below the solid's surface, at the distance d < 0. The energy
is that of springs along d, so the force is along F^-T n of the solid, acts at x on both, and is equal and opposite: momentum and angular
momentum are exact. So is friction, of the difference of both velocities at x (effects.contact_force). Every surface has points and is a
solid for the others, and both bodies give, so each side has a quarter of the stiffness that obstacles have: then no frequency is above
theirs. Held parts have no points, and are obstacles.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import types

from magmpm.bodies.contact_solid import Solids, solid_distance
from magmpm.compiled.arrays import Array, Index
from magmpm.compiled.jit import compiled, inlined, inner, only_where
from magmpm.effects.contact_force import (
    KEPT,
    MOST_PUSH,
    PARTS,
    leaves,
    push,
    rubbed,
    touches,
)
from magmpm.kernels.impulses import (
    add_force,
    come_to,
    give_at,
    new_places,
    quicken,
    sum_at,
    turned,
    velocity_at,
)

# where each begins in the memory of a pair (Meeting)
PLACE = 0
FRICTION = 3  # KEPT numbers
ROOM = FRICTION + KEPT
CELL = ROOM + 1
FORCE = ROOM + 2
DEPTH = ROOM + 5
BEGUN = ROOM + 6
MEMORY = ROOM + 7
PLACE_TOLERANCE = 1e-12  # of a cell: distance of X + u(X) from the point; momentum is kept to it
MOST_PLACE_ITERATIONS = 20
# of the distance d of a point from the surface: if the place below it has moved by less, d is good
# to some percent
GOOD_WHILE_MOVED = 0.25
LEAST_SHARE_OF_DISTANCE = (
    0.5  # of the way, as strained now, to the plane below across the normal: no face is nearer
)


class SolidCells(NamedTuple):
    """The cells (c,) of all solids: first node, low corner and width (3 c,) m, splines (27 c,) as coefficients of 1, xi, xi^2 of the three
    splines along x, y, z, the next cells (6 c,) of the same solid, below and above along each axis, -1 for none, the share (c,) of the
    stiffness that points have there, and the friction (c,) of their own material, or nan.
    """

    node: Index
    low: Array
    width: Array
    splines: Array
    next: Index
    share: Array
    friction: Array


class Meeting(NamedTuple):
    """Pairs (n,) of points and solids.

    point: index in kernels.surface_contact.Surface; node: its first node; solid; memory (MEMORY n + 1,), changed by steps: a pair's place
    X (3,) m, what is kept of its friction (KEPT,; effects.contact_force), the value of `memory[-1]` until which it cannot touch, cell,
    force (3,) N on the point, depth m, and the distance m at which it begins to touch, 0 or less; at last the length (m) of the way that
    any point may have moved; most (1,): m, of it, until pairs may be missing; law (2,): stiffness 1/s^2 (effects.contact_law), and
    friction where neither material names one; pace (active nodes,): no point is faster than the largest pace times speed of a node; then
    the fields of SolidCells and Solids, flat, for parallel loops.
    """

    point: Index
    node: Index
    solid: Index
    memory: Array
    most: Array
    law: Array
    pace: Array
    cell_node: Index
    cell_low: Array
    cell_width: Array
    cell_splines: Array
    cell_next: Index
    cell_share: Array
    cell_friction: Array
    size: Array
    points: Index
    first: Index
    coefficients: Array
    near: Index
    faces: Array


@inlined
def _cells(meeting):
    return SolidCells(
        meeting.cell_node,
        meeting.cell_low,
        meeting.cell_width,
        meeting.cell_splines,
        meeting.cell_next,
        meeting.cell_share,
        meeting.cell_friction,
    )


@inlined
def _splines(cells, cell, x, value, slope):
    """Write to value, slope (9,) the splines of a cell along x, y, z at a place x (3,) m, and their slopes, 1/m."""
    for i in range(3):
        width = cells.width[3 * cell + i]
        xi = (x[i] - cells.low[3 * cell + i]) / width
        for a in range(3):
            k = 27 * cell + 9 * i + 3 * a
            c0 = cells.splines[k]
            c1 = cells.splines[k + 1]
            c2 = cells.splines[k + 2]
            value[3 * i + a] = c0 + xi * (c1 + xi * c2)
            slope[3 * i + a] = (c1 + 2.0 * xi * c2) / width


@inlined
def _gather(field, node, along_x, along_y, value, slope, u, F):
    """Write a nodal field (3 nodes,) to u (3,), and its gradient to F (3, 3), at a place with these splines."""
    u[:], F[:] = 0.0, 0.0
    for a in range(3):
        for b in range(3):
            n = value[a] * value[3 + b]
            dx = slope[a] * value[3 + b]
            dy = value[a] * slope[3 + b]
            for c in range(3):
                k = 3 * (node + a * along_x + b * along_y + c)
                w = value[6 + c]
                for i in range(3):
                    u[i] += n * w * field[k + i]
                    F[i, 0] += dx * w * field[k + i]
                    F[i, 1] += dy * w * field[k + i]
                    F[i, 2] += n * slope[6 + c] * field[k + i]


@inner
def _inverted(F, out):
    """Write the inverse of F (3, 3) to out."""
    for i in range(3):
        for j in range(3):
            a = (i + 1) % 3
            b = (i + 2) % 3
            c = (j + 1) % 3
            d = (j + 2) % 3
            out[j, i] = F[a, c] * F[b, d] - F[a, d] * F[b, c]
    det = F[0, 0] * out[0, 0] + F[0, 1] * out[1, 0] + F[0, 2] * out[2, 0]
    for i in range(3):
        for j in range(3):
            out[i, j] /= det


@inner
def _find(cells, cell, along_x, along_y, field, x, X, solids, s, work, F, inverse):
    """Move X (3,) m to the place of solid s that is now at x (3,) m. Returns its cell, and its distance (m) from the surface. work (27,):
    values of the splines there, room, from 21 on the normal, and room.

    A place out of the solid is found from the surface below it, whose motion goes on there: nodes that are farther out are light, and say
    nothing. X then is that place of the surface, and the normal leads away from it. The distance is 0 if nothing is found. In a crushed
    edge steps lead to and fro: if they have not ended halfway, they go on as long as they lead nearer, and back by a half where not.
    """
    value = work[:9]
    slope = work[9:18]
    u = work[18:21]
    normal = work[21:24]
    before = work[24:]
    nearest = np.inf
    for step in range(MOST_PLACE_ITERATIONS):
        for k in range(6):  # two cells farther along each axis
            xi = (X[k % 3] - cells.low[3 * cell + k % 3]) / cells.width[3 * cell + k % 3]
            after = cells.next[6 * cell + 2 * (k % 3) + (1 if xi > 0.5 else 0)]
            cell = after if after >= 0 and abs(xi - 0.5) > 0.5 + 1e-9 else cell
        _splines(cells, cell, X, value, slope)
        _gather(field, cells.node[cell], along_x, along_y, value, slope, u, F)
        off = 0.0
        for i in range(3):
            F[i, i] += 1.0
            u[i] = x[i] - X[i] - u[i]
            off = max(off, abs(u[i]) / cells.width[3 * cell + i])
        _inverted(F, inverse)
        if off < PLACE_TOLERANCE:
            return cell, solid_distance(solids, s, X, normal)
        if step >= MOST_PLACE_ITERATIONS // 2:
            if off > nearest:
                for i in range(3):
                    X[i] = 0.5 * (X[i] + before[i])
                continue
            nearest = off
            before[:] = X
        slope[:3] = X
        for i in range(3):
            X[i] += inverse[i, 0] * u[0] + inverse[i, 1] * u[1] + inverse[i, 2] * u[2]
        slope[3:6] = X
        below = d = solid_distance(solids, s, X, normal)
        for _ in range(3):  # at an edge, one face after another
            if below > 0.0:
                for i in range(3):
                    X[i] -= below * normal[i]
                below = solid_distance(solids, s, X, normal)
        if d > 0.0 and not below < 0.5 * d:  # too far for a table
            X[:] = slope[:3]
            d = min(d, cells.width[3 * cell])
        moved = 0.0
        away = 0.0
        for i in range(3):
            moved += (X[i] - slope[i]) ** 2
            away += (slope[3 + i] - X[i]) ** 2
        if d > 0.0 and moved < (GOOD_WHILE_MOVED * d) ** 2:
            for i in range(3):  # beyond an edge no face's own
                normal[i] = (slope[3 + i] - X[i]) / np.sqrt(away)
            return cell, d
    return cell, 0.0


@compiled
def _touch(first, apart, dt, meeting, surface, along_x, along_y, state):
    """Write to memory the place, force and depth of each pair from `first` on, `apart` numbers apart; dt s: for which forces push."""
    memory = meeting.memory
    law = meeting.law
    cells = _cells(meeting)
    work = np.empty(27)
    solids = Solids(
        meeting.size,
        meeting.points,
        meeting.first,
        meeting.coefficients,
        meeting.near,
        meeting.faces,
    )
    x = np.empty(3)
    X = np.empty(3)
    normal = work[21:24]
    F = np.empty((3, 3))
    inverse = np.empty((3, 3))
    f = np.empty(PARTS)
    n = np.empty(3)
    own = new_places(1)
    for pair in range(first, len(meeting.point), apart):
        at = MEMORY * pair
        p = meeting.point[pair]
        s = meeting.solid[pair]
        memory[at + DEPTH] = 0.0
        if memory[-1] < memory[at + ROOM]:
            continue
        cell = int(memory[at + CELL])
        X[:] = memory[at + PLACE : at + PLACE + 3]
        come_to(own, 0, meeting.node[pair], surface.weights, 9 * p)
        u = sum_at(own.splines, 0, meeting.node[pair], along_x, along_y, state.u)
        for i in range(3):
            x[i] = surface.place[3 * p + i] + u[i]
        cell, d = _find(cells, cell, along_x, along_y, state.u, x, X, solids, s, work, F, inverse)
        memory[at + PLACE : at + PLACE + 3], memory[at + CELL], d = X, cell, d - memory[at + BEGUN]
        steep = 0.0  # of the distance, along the present normal
        for i in range(3):
            n[i] = inverse[0, i] * normal[0] + inverse[1, i] * normal[1] + inverse[2, i] * normal[2]
            steep += n[i] ** 2
        if not d < 0.0:
            leaves(memory, at + FRICTION)
            room = 0.5 * LEAST_SHARE_OF_DISTANCE * d / np.sqrt(max(steep, 1.0))
            memory[at + ROOM] = memory[-1] + room
            continue
        named = np.fmin(surface.friction[p], cells.friction[cell])
        friction = named if named >= 0.0 else law[1]
        f[:] = 0.0
        rigidity = cells.share[cell] * surface.mass[p] * law[0]
        push(-d, n[0], n[1], n[2], rigidity, friction, f)
        touches(f, memory, at + FRICTION)
        memory[at + DEPTH] = -d
        memory[at + FORCE : at + FORCE + 3] = f[:3]


@compiled
def _add_all(meeting, surface, along_x, along_y, force):
    """Add the forces of all pairs to the nodes of both sides, in the order of the pairs: the same sums on any number of threads.

    Returns the number of pairs with friction.
    """
    memory = meeting.memory
    cells = _cells(meeting)
    value = np.empty(9)
    slope = np.empty(9)
    place = new_places(1)
    rubs = 0.0
    for pair in range(len(meeting.point)):
        at = MEMORY * pair
        if not memory[at + DEPTH] > 0.0:
            continue
        rubs += 1.0 if memory[at + FRICTION + MOST_PUSH] > 0.0 else 0.0
        p = meeting.point[pair]
        cell = int(memory[at + CELL])
        f0 = memory[at + FORCE]
        f1 = memory[at + FORCE + 1]
        f2 = memory[at + FORCE + 2]
        come_to(place, 0, meeting.node[pair], surface.weights, 9 * p)
        add_force(place.splines, 0, meeting.node[pair], along_x, along_y, (f0, f1, f2), force)
        _splines(cells, cell, memory[at + PLACE : at + PLACE + 3], value, slope)
        come_to(place, 0, cells.node[cell], value, 0)
        add_force(place.splines, 0, cells.node[cell], along_x, along_y, (-f0, -f1, -f2), force)
    return rubs


@compiled
def _rub(push, meeting, surface, body, nodes, correction, state, back):
    """Stop the sliding of all pairs, one after another, as far as their pushes allow (kernels.surface_contact.rub)."""
    memory = meeting.memory
    cells = _cells(meeting)
    along_x = body.along_x
    along_y = body.along_y
    value = np.empty(9)
    slope = np.empty(9)
    inverse_mass = nodes.inverse_mass
    both = new_places(2)
    count = len(meeting.point)
    for k in range(count):
        pair = turned(k, count, back)
        at = MEMORY * pair
        if not (memory[at + DEPTH] > 0.0 and memory[at + FRICTION + MOST_PUSH] > 0.0):
            continue
        cell = int(memory[at + CELL])
        _splines(cells, cell, memory[at + PLACE : at + PLACE + 3], value, slope)
        own = 9 * meeting.point[pair]
        come_to(both, 0, meeting.node[pair], surface.weights, own)
        come_to(both, 1, cells.node[cell], value, 0)
        give = give_at(both, 0, along_x, along_y, correction, inverse_mass)
        give += give_at(both, 1, along_x, along_y, correction, inverse_mass)
        if not give > 0.0:  # both are held
            continue
        x, y, z = velocity_at(both, 0, along_x, along_y, push, correction, state.v)
        there_x, there_y, there_z = velocity_at(
            both, 1, along_x, along_y, push, correction, state.v
        )
        v = (x - there_x, y - there_y, z - there_z)
        f = rubbed(memory, at + FRICTION, v, 1.0 / (push * give))
        for i in range(3):
            memory[at + FORCE + i] += f[i]
        on = (along_x, along_y, push, correction, inverse_mass)
        quicken(both, 0, *on, f, state.v)
        quicken(both, 1, *on, (-f[0], -f[1], -f[2]), state.v)


@compiled
def _passed(meeting, way):
    """Count the length (m) of the way that any point may have moved in a step."""
    meeting.memory[-1] += way


@inlined
def _pace_of(meeting, k, n, v):
    """Square of a bound on how fast (m/s) an active node k, with velocity v[n : n + 3], lets any point move."""
    return meeting.pace[k] ** 2 * (v[n] ** 2 + v[n + 1] ** 2 + v[n + 2] ** 2)


@inlined
def _needs_list(meeting):
    """True if the body has moved so far that pairs may be missing."""
    return meeting.memory[-1] > meeting.most[0]


class RestingPlaces(NamedTuple):
    """Places of pairs (n,) at rest.

    depth m, 0 where they do not touch; X (n, 3) m: the place in the undeformed solid; cell: that of X; value, slope (n, 9): of the splines
    there, and 1/m; normal (n, 3): F^-T n; inverse (n, 3, 3): F^-1; bend (n, 3, 3) 1/m: the second derivative of the distance by the way of
    the point, without that by the turn of the solid.
    """

    depth: Array
    X: Array
    cell: Index
    value: Array
    slope: Array
    normal: Array
    inverse: Array
    bend: Array

    def chosen(self, on: Index) -> RestingPlaces:
        """Return those of some pairs."""
        chosen: list[Any] = [each[on] for each in self]
        return RestingPlaces(*chosen)


@compiled
def places_at_rest(cells, solids, strides, u, x, solid, begun, places):
    """Complete `places`, which begin with X and cell near those sought, for points at x (n, 3) m and solids (n,).

    strides: nodes from one to the next along x and y; u (3 nodes,) m; begun (n,): the distance m, 0 or less, at which each begins to touch.
    """
    work = np.empty(27)
    F = np.empty((3, 3))
    inverse = np.empty((3, 3))
    curved = np.empty((3, 3))
    for k in range(len(solid)):
        X = places.X[k]
        cell = places.cell[k]
        cell, d = _find(
            cells, cell, strides[0], strides[1], u, x[k], X, solids, solid[k], work, F, inverse
        )
        places.cell[k] = cell
        places.depth[k] = max(begun[k] - d, 0.0)
        if not places.depth[k] > 0.0:
            continue
        places.value[k] = work[:9]
        places.slope[k] = work[9:18]
        places.inverse[k] = inverse
        g = places.normal[k]
        for i in range(3):
            g[i] = 0.0
            for j in range(3):
                g[i] += inverse[j, i] * work[21 + j]
        _curvature(solids, solid[k], X, cells.width[3 * cell], curved)
        _less_bent(cells, cell, strides, u, places.value[k], places.slope[k], g, curved)
        for i in range(3):
            for j in range(3):
                total = 0.0
                for a in range(3):
                    for b in range(3):
                        total += inverse[a, i] * curved[a, b] * inverse[b, j]
                places.bend[k, i, j] = total


@inner
def _curvature(solids, s, X, width, out):
    """Write the second derivative (3, 3) 1/m of the distance from solid s at X (3,) m: differences of its slope over 1e-5 of a cell."""
    step = 1e-5 * width
    slopes = np.empty((3, 2, 3))
    x = np.empty(3)
    for j in range(3):
        for side in range(2):
            x[:] = X
            x[j] += step if side == 1 else -step
            solid_distance(solids, s, x, slopes[j, side])
    for i in range(3):
        for j in range(3):
            ahead = slopes[j, 1, i] - slopes[j, 0, i] + slopes[i, 1, j] - slopes[i, 0, j]
            out[i, j] = ahead / (4.0 * step)


@inner
def _less_bent(cells, cell, strides, u, value, slope, g, out):
    """Subtract from out (3, 3) the second derivative 1/m of g . u at the place in a cell with these splines."""
    bend = np.empty(9)
    for i in range(3):
        for a in range(3):
            width = cells.width[3 * cell + i]
            bend[3 * i + a] = 2.0 * cells.splines[27 * cell + 9 * i + 3 * a + 2] / width**2
    for a in range(3):
        for b in range(3):
            for c in range(3):
                k = 3 * (cells.node[cell] + a * strides[0] + b * strides[1] + c)
                along = g[0] * u[k] + g[1] * u[k + 1] + g[2] * u[k + 2]
                xy = along * slope[a] * slope[3 + b] * value[6 + c]
                xz = along * slope[a] * value[3 + b] * slope[6 + c]
                yz = along * value[a] * slope[3 + b] * slope[6 + c]
                out[0, 0] -= along * bend[a] * value[3 + b] * value[6 + c]
                out[1, 1] -= along * value[a] * bend[3 + b] * value[6 + c]
                out[2, 2] -= along * value[a] * value[3 + b] * bend[6 + c]
                out[0, 1] -= xy
                out[1, 0] -= xy
                out[0, 2] -= xz
                out[2, 0] -= xz
                out[1, 2] -= yz
                out[2, 1] -= yz


@compiled
def add_pairs_tangent(share, lean, normal, across, push, table, group, blocks):
    """Add the tangent of pairs (n,) at rest to blocks (k, 3, 3) N/m of a matrix (statics.own_contact).

    share (n, 54), lean (n, 54, 3) 1/m: of their nodes; normal (n, 3); across (n, 3, 3) N/m; push (n,) N; table (groups, 54, 54): the block
    of each two nodes of a group of pairs, or -1; group (n,).
    """
    for pair in range(len(group)):
        g = normal[pair]
        for a in range(share.shape[1]):
            for b in range(share.shape[1]):
                block = table[group[pair], a, b]
                if block < 0:
                    continue
                both = share[pair, a] * share[pair, b]
                for i in range(3):
                    for j in range(3):
                        turned = g[i] * lean[pair, a, j] * share[pair, b]
                        turned += lean[pair, b, i] * g[j] * share[pair, a]
                        blocks[block, i, j] += both * across[pair, i, j] + push[pair] * turned


def _meets(meeting: Any) -> bool:
    """Return True if this is the type of a Meeting: a body that does not touch itself has ()."""
    return isinstance(meeting, types.BaseNamedTuple)


touch_pairs = only_where("meeting", _meets, _touch)
add_pairs = only_where("meeting", _meets, _add_all, "0.0")
rub_pairs = only_where("meeting", _meets, _rub)
pace_of = only_where("meeting", _meets, _pace_of, "v[n] ** 2 + v[n + 1] ** 2 + v[n + 2] ** 2")
passed = only_where("meeting", _meets, _passed)
needs_list = only_where("meeting", _meets, _needs_list, "False")
