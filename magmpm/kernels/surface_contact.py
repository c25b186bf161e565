"""Contact of the body's surface with obstacles.

The surface is a set of points (bodies.contact_surface) which move with the nodes of the cell they are in. Effects push each one as a
particle of the mass of the layer it stands for, and the force goes to the nodes by the same splines, so momentum is kept to rounding.
The points of a cell are a patch, left out until it has moved by its distance from the obstacles.
Friction acts on velocities, after all other forces of a step (effects.contact_force), and on a patch as a whole: on the mean velocity of
its points, weighed by the friction that their pushes allow, as finer slips than a cell are not resolved: `rub`.
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
from magmpm.effects.contact_force import (
    GRIP,
    KEPT,
    MOST,
    PARTS,
    own_grip,
    rubbed,
    slides,
    touches,
)
from magmpm.kernels.equilibrium import STENCIL, particle_splines, scatter_matrix
from magmpm.kernels.mass_correction import (
    NEARBY,
    SEEN,
    add_impulse,
    ahead_at,
    fields_at,
    give_of,
)

# What is kept of each patch: KEPT numbers of its friction, how far it can move before a point of it may touch (m), and the splines (27,) by
# which its friction acts on the nodes
ROOM = KEPT
SHARES = KEPT + 1
PATCH = SHARES + 27


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
def touch(slab, step, dt, surface, cells, state, calls, slabs):
    """Add the contact of a slab's surface to state.force, with the friction of the step before; keep what `rub` needs in state.touching.

    dt s: for which forces push. Writes to slabs (kernels.watch) how many patches have friction, and slide, and the sum of their pushes.
    """
    slabs.rubs[slab] = 0.0
    slabs.slides[slab] = 0.0
    slabs.push[slab] = 0.0
    if len(calls.contact) == 0:
        return
    most_points = _most_points(surface)
    places = np.empty((most_points, 3))
    found = np.empty(most_points)
    v = np.empty((1, 3))
    f = np.empty(PARTS)
    whole = np.empty(PARTS)
    mean = np.empty(27)
    share = np.empty(27)
    where = np.empty(27, np.int64)
    given = given_for()
    kept = state.touching
    for patch in range(surface.first_patch[slab], surface.first_patch[slab + 1]):
        own = PATCH * patch
        _around(surface.first_node[patch], cells.along_x, cells.along_y, where)
        if (
            step > 0 and kept[own + ROOM] > 0.0
        ):  # the last displacement was dt v; before the first step it may have been another
            kept[own + ROOM] -= dt * _fastest(state.v, where)
            if kept[own + ROOM] > 0.0:
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
        whole[:] = 0.0
        mean[:] = 0.0
        for k in range(count):
            p = first + k
            depth = found[k]
            most = max(most, depth)
            least = min(least, depth)
            if not depth > 0.0:
                continue
            v[:], f[:] = 0.0, 0.0
            _share(surface.weights, 9 * p, share)
            _add(state.v, where, share, v[0])
            point_from(given, places[k:], v, surface.mass[p:], f)
            call_each(calls.contact, step, 0, 1, dt, address(given, 0))
            own_grip(surface.friction[p], f)
            for i in range(PARTS):
                whole[i] += f[i]
            if f[GRIP] > 0.0:
                for j in range(27):
                    mean[j] += f[GRIP] * share[j]
            for j in range(27):
                for i in range(3):
                    state.force[where[j] + i] += share[j] * f[i]
        push = math.sqrt(whole[0] ** 2 + whole[1] ** 2 + whole[2] ** 2)
        if touches(whole, kept, own) > 0.0:
            slabs.rubs[slab] += 1.0
            slabs.push[slab] += push
            slabs.slides[slab] += slides(kept, own)
            for j in range(27):
                kept[own + SHARES + j] = mean[j] / whole[GRIP]
                for i in range(3):
                    state.force[where[j] + i] += kept[own + SHARES + j] * kept[own + i]
        clear = most < 0.0 and least > -np.inf  # -inf: past an obstacle's end, who knows how far
        kept[own + ROOM] = -most if clear else 0.0


class Place(NamedTuple):
    """A place of the body in the sweep of friction: indices (27,) of the nodes that it sees, their splines (27,), and fields and column
    of the mass correction there (kernels.mass_correction)."""

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
def velocity_at(place, first, push, correction, field):
    """Velocity (m/s) of a place, as the impulses so far have changed it."""
    x, y, z = ahead_at(correction, first, place.fields, push)
    for j in range(27):
        k = place.where[j]
        share = place.share[j]
        x += share * field[k]
        y += share * field[k + 1]
        z += share * field[k + 2]
    return x, y, z


@compiled
def give_at(place, first, correction, inverse_mass):
    """Return by how much (1/kg) a place is quicker after an impulse of 1 N s, at most."""
    give = give_of(correction, first, place.fields, place.column)
    for j in range(27):
        k = place.where[j]
        most = max(inverse_mass[k], inverse_mass[k + 1], inverse_mass[k + 2])
        give += place.share[j] ** 2 * most
    return give


@compiled
def quicken(place, first, push, correction, inverse_mass, f0, f1, f2, v):
    """Change the nodes' velocities v (3 nodes,) by the force (f0, f1, f2), N, on a place for push (s); note it for the correction."""
    p0 = push * f0
    p1 = push * f1
    p2 = push * f2
    for j in range(27):
        k = place.where[j]
        share = place.share[j]
        v[k] += share * inverse_mass[k] * p0
        v[k + 1] += share * inverse_mass[k + 1] * p1
        v[k + 2] += share * inverse_mass[k + 2] * p2
    add_impulse(correction, first, place.fields, place.column, f0, f1, f2)


@inlined
def turned(k, count, back):
    """Number k of `count`, counted from the last where `back` is 1."""
    return count - 1 - k if back else k


class Rubbing(NamedTuple):
    """Patches (n,) with friction that can move: their numbers, the first knots that they see, and 1/kg by which an impulse makes each
    quicker, at most; where, share (n, 27), fields, column (n, k): of their places."""

    patch: Index
    knot: Index
    give: Array
    where: Index
    share: Array
    fields: Array
    column: Array


@compiled
def rubbing_patches(surface, cells, nodes, correction, state, rubs):
    """Find the patches with friction. rubs (slabs,): as `touch` writes it."""
    most = int(rubs.sum())
    found = Rubbing(
        np.empty(most, np.int64),
        np.empty(most, np.int64),
        np.empty(most),
        np.empty((most, 27), np.int64),
        np.empty((most, 27)),
        np.empty((most, 3 * SEEN)),
        np.empty((most, 3 * (2 * NEARBY + SEEN))),
    )
    kept = state.touching
    count = 0
    for slab in range(len(rubs)):
        if rubs[slab] == 0.0:
            continue
        for patch in range(surface.first_patch[slab], surface.first_patch[slab + 1]):
            own = PATCH * patch
            if not kept[own + MOST] > 0.0:
                continue
            place = Place(
                found.where[count], found.share[count], found.fields[count], found.column[count]
            )
            _around(surface.first_node[patch], cells.along_x, cells.along_y, place.where)
            place.share[:] = kept[own + SHARES : own + SHARES + 27]
            knot = fields_at(correction, place.where, place.share, place.fields)
            give = give_at(place, knot, correction, nodes.inverse_mass)
            if give > 0.0:  # not held
                found.patch[count] = patch
                found.knot[count] = knot
                found.give[count] = give
                count += 1
    return count, found


@compiled
def rub(push, rubbing, inverse_mass, correction, state, back):
    """Stop the sliding of patches, one after another, as far as their pushes allow; push s: for which forces push in the step.

    Changes the nodes' velocities by impulses on their lumped mass, and notes them for its correction. rubbing: of `rubbing_patches`;
    back: 1 to go from the last to the first.
    """
    count, found = rubbing
    for k in range(count):
        one = turned(k, count, back)
        place = Place(found.where[one], found.share[one], found.fields[one], found.column[one])
        knot = found.knot[one]
        v = velocity_at(place, knot, push, correction, state.v)
        heft = 1.0 / (push * found.give[one])
        f0, f1, f2 = rubbed(state.touching, PATCH * found.patch[one], v, heft)
        quicken(place, knot, push, correction, inverse_mass, f0, f1, f2, state.v)


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
