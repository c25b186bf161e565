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
from magmpm.compiled.jit import compiled, inner, task_body
from magmpm.compiled.parallel import TOGETHER, over_parts, over_slabs, parts_of, task
from magmpm.compiled.simd import WIDTH, highest, larger, load, lowest, smaller, store, total
from magmpm.compiled.simd_views import vector
from magmpm.effects.calls import call_each, given_for, points_from, pushes
from magmpm.effects.contact_force import (
    GRIP,
    KEPT,
    MOST_PUSH,
    PARTS,
    RIGIDITY,
    leaves,
    own_grip,
    rubbed,
    slides,
    touches,
)
from magmpm.kernels.equilibrium import STENCIL, particle_splines, scatter_matrix
from magmpm.kernels.fluid_drag import WettedPieces
from magmpm.kernels.impulses import (
    SPLINES,
    Places,
    add_force,
    gather_value,
    give_at,
    new_places,
    quicken,
    scatter_value,
    turned,
    velocity_at,
)

# What is kept of each patch: KEPT numbers of its friction, and until how long a way of the body (m) no point of it can touch
ROOM = KEPT
PATCH = KEPT + 1


class SortedSurfacePoints(NamedTuple):
    """Points of the surface, sorted by patch and slab.

    first_patch (slabs + 1,), first_point (patches + 1,): of each slab and patch; first_node (patches,); weights (9 points,): splines along
    x, y, z; place (3 points,) m in the undeformed body; mass (points,) kg, of a layer; friction (points,) of their own material, or nan.
    first_group (patches + 1,): points in groups of eight lanes, of which a last one that is not full repeats its first point; pattern
    (groups,): where the splines of a group begin in lanes (patterns 72,), shared by groups that are alike; rest (groups 3 8,): places;
    layer (groups 8,): mass, 0 of repetitions; grip (groups 8,): friction.
    wetted: what of it a fluid meets. splines (SPLINES patches,): room for those by which a patch's friction acts on its nodes in this step.
    """

    first_patch: Index
    first_point: Index
    first_node: Index
    weights: Array
    place: Array
    mass: Array
    friction: Array
    first_group: Index
    pattern: Index
    lanes: Array
    rest: Array
    layer: Array
    grip: Array
    splines: Array
    wetted: WettedPieces


@inner
def touch(slab, step, surface, cells, state, calls, slabs):
    """Add the contact of a slab's surface to state.force, with the friction of the step before; keep what `rub` needs in state.touching.

    Writes to slabs (kernels.watch) how many patches have friction, and slide, and the sum of their pushes.
    """
    slabs.rubs[slab] = 0.0
    slabs.slides[slab] = 0.0
    slabs.push[slab] = 0.0
    if len(calls.contact) == 0:
        return
    patches = range(surface.first_patch[slab], surface.first_patch[slab + 1])
    most_groups = 0
    for patch in patches:
        most_groups = max(most_groups, surface.first_group[patch + 1] - surface.first_group[patch])
    moved = np.empty(3 * WIDTH * most_groups)
    found = np.empty(WIDTH * most_groups)
    pushed = np.empty(PARTS * WIDTH * most_groups)
    whole = np.empty(PARTS)
    mean = np.empty(SPLINES)
    given = given_for()
    kept = state.touching
    way = kept[-1]
    along_x = cells.along_x
    along_y = cells.along_y
    for patch in patches:
        own = PATCH * patch
        if way < kept[own + ROOM]:
            continue
        node = surface.first_node[patch]
        begun = surface.first_group[patch]
        groups = surface.first_group[patch + 1] - begun
        for group in range(groups):
            at = surface.pattern[begun + group]
            to = 3 * WIDTH * group
            gather_value(state.u, node, along_x, along_y, surface.lanes, at, moved, to)
            for i in range(3):
                rest = load(surface.rest, WIDTH * (3 * (begun + group) + i))
                store(moved, to + WIDTH * i, load(moved, to + WIDTH * i) + rest)
        layer = (surface.layer, WIDTH * begun)
        pushes(calls.contact, step, given, groups, moved, layer, found, pushed)
        high = load(found, 0)
        low = high
        for group in range(1, groups):
            high = larger(load(found, WIDTH * group), high)
            low = smaller(load(found, WIDTH * group), low)
        most = highest(high)
        clear = (
            most < 0.0 and lowest(low) > -np.inf
        )  # -inf: past an obstacle's end, who knows how far
        kept[own + ROOM] = way - most if clear else 0.0
        if not most > 0.0:
            leaves(kept, own)
            continue
        whole[:] = 0.0
        mean[:] = 0.0
        for group in range(groups):
            f = vector(pushed, PARTS * WIDTH * group)
            own_grip(load(surface.grip, WIDTH * (begun + group)), f)
            for i in range(RIGIDITY):
                whole[i] += total(f[i])
            at = surface.pattern[begun + group]
            three = (f[0], f[1], f[2])
            scatter_value(state.force, node, along_x, along_y, surface.lanes, at, three)
            if whole[GRIP] > 0.0:
                three = (f[GRIP], f[GRIP], f[GRIP])
                scatter_value(mean, 0, 9, 3, surface.lanes, at, three)
        push = math.sqrt(whole[0] ** 2 + whole[1] ** 2 + whole[2] ** 2)
        if touches(whole, kept, own) > 0.0:
            slabs.rubs[slab] += 1.0
            slabs.push[slab] += push
            slabs.slides[slab] += slides(kept, own)
            for j in range(SPLINES):
                surface.splines[SPLINES * patch + j] = mean[j] / whole[GRIP]
            on = (surface.splines, SPLINES * patch)
            add_force(
                *on, node, along_x, along_y, (kept[own], kept[own + 1], kept[own + 2]), state.force
            )


class Rubbing(NamedTuple):
    """Patches (n,) with friction that can move: their numbers, 1/kg by which an impulse makes each quicker, at most, and their places."""

    patch: Index
    give: Array
    places: Places


@inner
def rubbing_patches(surface, cells, nodes, correction, state, rubs):
    """Find the patches with friction. rubs (slabs,): as `touch` writes it. Returns their number, and a Rubbing with room for more."""
    most = int(rubs.sum())
    places = new_places(most)
    found = Rubbing(np.empty(most, np.int64), np.empty(most), places)
    kept = state.touching
    count = 0
    for slab in range(len(rubs)):
        if rubs[slab] == 0.0:
            continue
        for patch in range(surface.first_patch[slab], surface.first_patch[slab + 1]):
            if not kept[PATCH * patch + MOST_PUSH] > 0.0:
                continue
            places.node[count] = surface.first_node[patch]
            for j in range(SPLINES):
                places.splines[SPLINES * count + j] = surface.splines[SPLINES * patch + j]
            give = give_at(
                places, count, cells.along_x, cells.along_y, correction, nodes.inverse_mass
            )
            if give > 0.0:  # not held
                found.patch[count] = patch
                found.give[count] = give
                count += 1
    return count, found


@inner
def rub(push, rubbing, cells, inverse_mass, correction, state, back):
    """Stop the sliding of patches, one after another, as far as their pushes allow; push s: for which forces push in the step.

    Changes the nodes' velocities by impulses on their lumped mass, and notes them for its correction. rubbing: of `rubbing_patches`;
    back: 1 to go from the last to the first.
    """
    count, found = rubbing
    places = found.places
    along_x = cells.along_x
    along_y = cells.along_y
    for k in range(count):
        one = turned(k, count, back)
        v = velocity_at(places, one, along_x, along_y, push, correction, state.v)
        heft = 1.0 / (push * found.give[one])
        f = rubbed(state.touching, PATCH * found.patch[one], v, heft)
        quicken(places, one, along_x, along_y, push, correction, inverse_mass, f, state.v)


@task_body
def _block_at_rest(block, given):
    """`touch_at_rest` of some points."""
    calls, x, mass, energy, f, H = given
    first = TOGETHER * block
    last = min(first + TOGETHER, len(x))
    given = given_for()
    points_from(given, x[first:], mass[first:], energy[first:], f[first:])
    given[0].bend = address(H, 9 * first)
    call_each(calls, 0, 0, last - first, 0.0, address(given, 0))


@compiled
def touch_at_rest(calls, x, mass, energy, f, H):
    """Add the energy (n,) J, force f (n, 3) N and tangent H (n, 3, 3) N/m of points at x (n, 3) m that touch; mass (n,) kg.

    calls: rows of the hook `touch` (effects.calls).
    """
    over_parts(parts_of(len(x)), task(_block_at_rest, (calls, x, mass, energy, f, H)))


@task_body
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
