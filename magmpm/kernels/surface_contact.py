"""Contact of the body's surface with obstacles.

The surface is a set of points (bodies.contact_surface) which move with the nodes of the cell they are in. Effects push each one as a
particle of the mass of the layer it stands for, and the force goes to the nodes by the same splines, so momentum is kept to rounding.
The points of a cell are a patch, left out until it has moved by its distance from the obstacles.
Friction acts on velocities, after all other forces of a step (effects.contact_force): `rub`.
At equilibrium points have the energy of their push, and a part in the tangent (statics.contact).
"""

import math
from typing import NamedTuple

import numpy as np

from magmpm.compiled.arrays import Array, Index
from magmpm.compiled.by_address import address
from magmpm.compiled.jit import compiled, inlined, inner
from magmpm.compiled.parallel import TOGETHER, over_parts, over_slabs, parts_of, task
from magmpm.effects.calls import call_each, depths, given_for, point_from
from magmpm.effects.contact_force import KEPT, MOST, PARTS, leaves, own_grip, rubbed, touches
from magmpm.kernels.equilibrium import STENCIL, particle_splines, scatter_matrix
from magmpm.kernels.mass_correction import (
    NEARBY,
    SEEN,
    add_impulse,
    ahead_at,
    fields_at,
    give_of,
)


class SortedSurfacePoints(NamedTuple):
    """Points of the surface, sorted by patch and slab.

    first_patch (slabs + 1,), first_point (patches + 1,): of each slab and patch; first_node (patches,); weights (9 points,): splines along
    x, y, z; place (3 points,) m in the undeformed body; mass (points,) kg, of a layer; friction (points,) of their own material, or nan.
    """

    first_patch: Index
    first_point: Index
    first_node: Index
    weights: Array
    place: Array
    mass: Array
    friction: Array


@compiled
def _around(node, along_x, along_y, where):
    """Write to where (27,) the index in a nodal field (3 nodes,) of each node that a cell with this first node sees."""
    for a in range(3):
        for b in range(3):
            for c in range(3):
                where[9 * a + 3 * b + c] = 3 * (node + a * along_x + b * along_y + c)


@compiled
def _share(weights, at, share):
    """Write to share (27,) the splines of these nodes at a point whose values along each axis begin at index `at`."""
    for a in range(3):
        for b in range(3):
            for c in range(3):
                share[9 * a + 3 * b + c] = (
                    weights[at + a] * weights[at + 3 + b] * weights[at + 6 + c]
                )


@inlined
def _add(field, where, share, out):
    """out (3,) += value of a nodal field (3 nodes,) at a point."""
    for j in range(27):
        for i in range(3):
            out[i] += share[j] * field[where[j] + i]


@compiled
def _fastest(v, where):
    """Speed (m/s) of the fastest of a cell's nodes: nothing in the cell is faster."""
    most = 0.0
    for k in where:
        most = max(most, v[k] ** 2 + v[k + 1] ** 2 + v[k + 2] ** 2)
    return math.sqrt(most)


@compiled
def _most_points(surface):
    """Number of points of the largest patch."""
    most = 0
    for patch in range(len(surface.first_node)):
        most = max(most, surface.first_point[patch + 1] - surface.first_point[patch])
    return most


@compiled
def touch(slab, step, dt, surface, cells, state, calls, rubs):
    """Add the contact of a slab's surface to state.force, with the friction of the step before; keep what `rub` needs in state.touching.

    dt s: for which forces push. Writes to rubs[slab] how many points have friction.
    """
    rubs[slab] = 0.0
    if len(calls.contact) == 0:
        return
    most_points = _most_points(surface)
    places = np.empty((most_points, 3))
    found = np.empty(most_points)
    v = np.empty((1, 3))
    f = np.empty(PARTS)
    share = np.empty(27)
    where = np.empty(27, np.int64)
    given = given_for()
    kept = state.touching
    room = KEPT * len(
        surface.mass
    )  # then a number a patch: how far it can move before a point of it may touch, m
    for patch in range(surface.first_patch[slab], surface.first_patch[slab + 1]):
        _around(surface.first_node[patch], cells.along_x, cells.along_y, where)
        if (
            step > 0 and kept[room + patch] > 0.0
        ):  # the last displacement was dt v; before the first step it may have been another
            kept[room + patch] -= dt * _fastest(state.v, where)
            if kept[room + patch] > 0.0:
                continue
        first = surface.first_point[patch]
        count = surface.first_point[patch + 1] - first
        for k in range(count):
            _share(surface.weights, 9 * (first + k), share)
            x = places[k]
            for i in range(3):
                x[i] = surface.place[3 * (first + k) + i]
            _add(state.u, where, share, x)
        depths(calls.near, step, given, places, found[:count])
        most = -np.inf
        least = 0.0
        for k in range(count):
            p = first + k
            depth = found[k]
            most = max(most, depth)
            least = min(least, depth)
            if not depth > 0.0:
                leaves(kept, KEPT * p)
                continue
            v[:], f[:] = 0.0, 0.0
            _share(surface.weights, 9 * p, share)
            _add(state.v, where, share, v[0])
            point_from(given, places[k:], v, surface.mass[p:], f)
            call_each(calls.contact, step, 0, 1, dt, address(given, 0))
            own_grip(surface.friction[p], f)
            rubs[slab] += touches(f, kept, KEPT * p)
            for j in range(27):
                for i in range(3):
                    state.force[where[j] + i] += share[j] * f[i]
        clear = most < 0.0 and least > -np.inf  # -inf: past an obstacle's end, who knows how far
        kept[room + patch] = -most if clear else 0.0


class Place(NamedTuple):
    """Room for a place of the body in the sweep of friction: indices (27,) of the nodes that it sees, their splines (27,), and fields and
    column of the mass correction there (kernels.mass_correction)."""

    where: Index
    share: Array
    fields: Array
    column: Array


@compiled
def new_place():
    """Room for a place."""
    column = np.empty(3 * (2 * NEARBY + SEEN))
    return Place(np.empty(27, np.int64), np.empty(27), np.empty(3 * SEEN), column)


@compiled
def come_to(place, node, along_x, along_y, weights, at, correction):
    """Set a place by its cell's first node and its splines along each axis, from index `at` on. Returns the first knot that it sees."""
    _around(node, along_x, along_y, place.where)
    _share(weights, at, place.share)
    return fields_at(correction, place.where, place.share, place.fields)


@compiled
def velocity_at(place, first, push, correction, field, v):
    """v (3,) m/s += velocity at a place, as the impulses so far have changed it."""
    _add(field, place.where, place.share, v)
    ahead_at(correction, first, place.fields, push, v)


@compiled
def give_at(place, first, correction, inverse_mass):
    """By how much (1/kg) a place is quicker after an impulse of 1 N s, at most."""
    give = give_of(correction, first, place.fields, place.column)
    for j in range(27):
        k = place.where[j]
        most = max(inverse_mass[k], inverse_mass[k + 1], inverse_mass[k + 2])
        give += place.share[j] ** 2 * most
    return give


@compiled
def quicken(place, first, push, correction, inverse_mass, sign, force, v):
    """Change the nodes' velocities v (3 nodes,) by an impulse of sign times force (3,) N in push (s); note it for the correction."""
    for j in range(27):
        for i in range(3):
            k = place.where[j] + i
            v[k] += push * inverse_mass[k] * (sign * place.share[j] * force[i])
    add_impulse(correction, first, place.fields, place.column, sign, force)


@inlined
def turned(k, first, last, back):
    """Number k of those from `first` to before `last`; counted from the last where `back` is 1."""
    return last - 1 - k if back else first + k


@compiled
def rub(push, surface, cells, nodes, correction, state, rubs, back):
    """Stop the sliding of touching points, one after another, as far as their pushes allow; push s: for which forces push in the step.

    Changes the nodes' velocities by impulses on their lumped mass, and notes them for its correction. rubs (slabs,): as `touch` writes it;
    back: 1 to go through the points from the last to the first.
    """
    v = np.empty(3)
    change = np.empty(3)
    place = new_place()
    kept = state.touching
    for s in range(len(rubs)):
        slab = turned(s, 0, len(rubs), back)
        if rubs[slab] == 0.0:
            continue
        low = surface.first_point[surface.first_patch[slab]]
        high = surface.first_point[surface.first_patch[slab + 1]]
        patch = surface.first_patch[slab + back] - back
        for k in range(high - low):
            p = turned(k, low, high, back)
            if not kept[KEPT * p + MOST] > 0.0:
                continue
            while not surface.first_point[patch] <= p < surface.first_point[patch + 1]:
                patch += 1 - 2 * back
            first = come_to(
                place,
                surface.first_node[patch],
                cells.along_x,
                cells.along_y,
                surface.weights,
                9 * p,
                correction,
            )
            give = give_at(place, first, correction, nodes.inverse_mass)
            if not give > 0.0:  # held
                continue
            v[:] = 0.0
            velocity_at(place, first, push, correction, state.v, v)
            rubbed(kept, KEPT * p, v, 1.0 / (push * give), change)
            quicken(place, first, push, correction, nodes.inverse_mass, 1.0, change, state.v)


@inner
def _block_at_rest(block, given):
    """`touch_at_rest` of some points."""
    near, touching, x, mass, energy, f, H = given
    first = TOGETHER * block
    last = min(first + TOGETHER, len(x))
    _touch_at_rest(
        near,
        touching,
        x[first:last],
        mass[first:last],
        energy[first:last],
        f[first:last],
        H[first:last],
    )


@compiled
def touch_at_rest(near, touching, x, mass, energy, f, H):
    """Write the energy (n,) J, force f (n, 3) N and tangent H (n, 3, 3) N/m of those points at x (n, 3) m that touch; mass (n,) kg.

    near, touching: rows of these hooks (effects.calls).
    """
    over_parts(parts_of(len(x)), task(_block_at_rest, (near, touching, x, mass, energy, f, H)))


@compiled
def _touch_at_rest(near, touching, x, mass, energy, f, H):
    """`touch_at_rest` of some points."""
    depth = np.empty(len(x))
    given = given_for()
    depths(near, 0, given, x, depth)
    at = given[0]
    for p in range(len(x)):
        if depth[p] > 0.0:
            point_from(given, x[p:], x, mass[p:], f[p])
            at.value = address(energy, p)
            at.bend = address(H, 9 * p)
            call_each(touching, 0, 0, 1, 0.0, address(given, 0))


@inner
def _contact_of_slab(slab, given):
    """`contact_to_matrix` of one slab."""
    cells, weights, H, matrix = given
    K = np.empty((STENCIL, 3, 3, STENCIL))
    N = np.empty(STENCIL)
    for cell in range(cells.slab_first[slab], cells.slab_first[slab + 1]):
        touched = False
        for p in range(cells.first[cell], cells.first[cell + 1]):
            if H[p, 0, 0] + H[p, 1, 1] + H[p, 2, 2] == 0.0:
                continue
            if not touched:
                K[:], touched = 0.0, True
            particle_splines(weights[p], N)
            for node in range(STENCIL):
                for i in range(3):
                    for k in range(3):
                        h = N[node] * H[p, i, k]
                        for other in range(STENCIL if h != 0.0 else 0):
                            K[node, i, k, other] += h * N[other]
        if touched:
            scatter_matrix(cell, cells.plane[cell], cells.row[cell], K, matrix)


@compiled
def contact_to_matrix(cells, weights, H, matrix):
    """P2G: add the sum of N_a H N_b over points, N/m, to a matrix, Panels or Blocks.

    weights (n, 3, 3): of the splines N; H (n, 3, 3): often 0.
    """
    over_slabs(len(cells.slab_first) - 1, task(_contact_of_slab, (cells, weights, H, matrix)))
