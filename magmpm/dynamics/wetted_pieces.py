"""The pieces of a model's surface that a fluid meets, sorted for the kernel of a motion."""

from itertools import product

import numpy as np

from magmpm.bodies.grid import spread
from magmpm.bodies.wetted_surface import END, ROUND
from magmpm.compiled.arrays import Array, Index
from magmpm.effects.fluid import Fluid
from magmpm.kernels.equilibrium import STENCIL
from magmpm.kernels.fluid_drag import WettedPieces
from magmpm.kernels.total_lagrangian_step import Nodes
from magmpm.model import Model, Wetted


def wetted_pieces(
    model: Model, axis: int, least: int, slabs: Index, strides: tuple[int, int], nodes: Nodes
) -> WettedPieces:
    """The pieces of a model in slabs across an axis, none where no fluid is named.

    least: first node along the axis; slabs: first cell of each; strides: steps in node number along x and y.
    """
    fluid = model.scene.effects.fluid
    if fluid is None:
        nothing = np.zeros(0)
        none = np.zeros(0, np.int64)
        first = np.zeros(len(slabs), np.int64)
        return WettedPieces(
            first=first,
            node=none,
            place=nothing,
            axial=none,
            weights=nothing,
            along=nothing,
            over=nothing,
            tangents=nothing,
            law=nothing,
            normal=nothing,
            of=none,
            carried=nothing,
        )
    at = model.wetted
    slab = np.searchsorted(slabs, at.first[:, axis] - least, side="right") - 1
    order = np.lexsort((*at.first.T[::-1], slab))
    value, along, over = (part[order] for part in _node_weights(at))
    surface = at.surface
    of, carried = _carried(model, fluid, order, nodes)
    law = fluid.law(surface)[order]
    return WettedPieces(
        first=np.searchsorted(slab[order], np.arange(len(slabs))).astype(np.int64),
        node=(at.first[order] @ np.array([*strides, 1])).astype(np.int64),
        place=surface.place[order].ravel(),
        axial=(surface.kind[order] == ROUND).astype(np.int64),
        weights=np.repeat(value, 3, axis=1).ravel(),
        along=np.repeat(along, 3, axis=1).ravel(),
        over=np.repeat(over, 3, axis=1).ravel(),
        tangents=surface.tangents[order].ravel(),
        law=np.ascontiguousarray(law).ravel(),
        normal=np.cross(*surface.tangents[order].transpose(1, 0, 2)).ravel(),
        of=of,
        carried=carried.ravel(),
    )


def _node_weights(at: Wetted) -> tuple[Array, Array, Array]:
    """Values (n, 27) of the splines of each piece's nodes, and their slopes (1/m) along its two tangents."""
    value = np.empty((len(at.first), STENCIL))
    slope = np.empty((len(at.first), STENCIL, 3))
    w = at.weights
    for k, (a, b, c) in enumerate(product(range(3), repeat=3)):
        value[:, k] = w[:, 0, a] * w[:, 1, b] * w[:, 2, c]
        slope[:, k, 0] = at.slopes[:, 0, a] * w[:, 1, b] * w[:, 2, c]
        slope[:, k, 1] = w[:, 0, a] * at.slopes[:, 1, b] * w[:, 2, c]
        slope[:, k, 2] = w[:, 0, a] * w[:, 1, b] * at.slopes[:, 2, c]
    tangents = at.surface.tangents
    along = np.einsum("nkj,nj->nk", slope, tangents[:, 0])
    over = np.einsum("nkj,nj->nk", slope, tangents[:, 1])
    return value, along, over


def _carried(model: Model, fluid: Fluid, order: Index, nodes: Nodes) -> tuple[Index, Array]:
    """The number of the piece of the body's side nearest to each active node (m,), in this order, and the node's added mass over its own
    (m, 2): along the piece's direction, and beside it."""
    from scipy.spatial import cKDTree  # imported only where it is used

    surface = model.wetted.surface
    side = np.flatnonzero(surface.kind != END)
    place = nodes.place.reshape(-1, 3)[nodes.active]
    nearest = side[cKDTree(surface.place[side]).query(place)[1]]
    volume = spread(
        model.particles.volume,
        model.first_in_motion(slice(None)),
        model.nodes_in_motion,
        model.splines()[0],
    )[nodes.active]
    share = fluid.density * volume / model.mass_in_motion[nodes.active]
    each = np.column_stack(fluid.carried(surface))[nearest]
    return np.argsort(order)[nearest], share[:, None] * each
