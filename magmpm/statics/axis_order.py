"""Axis order for the static solver: planes of unknowns lie across the longest side of the body.

The work of a factorization grows as the cube of the unknowns in a plane. In straight bodies, planes already lie across x. For other bodies
the reference axes are renumbered cyclically, (x, y, z) -> (y, z, x) or (z, x, y). The columns of F and the reference remanence follow;
deformed positions stay in x, y, z. Energies depend on F only through F^T F, det F and F Br, so they do not change.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magmpm.bodies.grid import Grid
from magmpm.bodies.section_quadrature import Particles
from magmpm.bodies.volume_modes import volume_modes
from magmpm.compiled.arrays import Index
from magmpm.errors import SceneError
from magmpm.statics.contact import resting
from magmpm.statics.layout import StaticModel, make_layout

MOST_MEMORY = 4e9  # bytes of the factored tangent


def arranged(model: StaticModel) -> tuple[StaticModel, Index]:
    """The model with renumbered axes, and the index (n,) of each of its particles in the given model.

    Raises SceneError if a region is not connected to anything held, or the tangent would not fit in memory.
    """
    of = np.arange(len(model.shear))
    if model.line is None:
        _all_hang_on_something(model)
        model, of = _renumbered(model)
    layout = model.layout
    needed = 24.0 * layout.planes * layout.m**2
    if needed > MOST_MEMORY:
        raise SceneError(
            "resolution",
            found=f"statics of this body would take {needed / 1e9:.3g} GB for its tangent, {layout.planes} planes of {layout.m} unknowns",
            rule=f"at most {MOST_MEMORY / 1e9:g} GB are used",
            remedy="make the cells larger, or let the body settle: `solver: {dynamic: {duration: 0.5 s}}` with damping",
        )
    return model, of


def _renumbered(model: StaticModel) -> tuple[StaticModel, Index]:
    """The model with its longest side as the first axis of the grid, and the new order of its particles."""
    nodes, p = model.grid.nodes, model.particles
    order = max([(0, 1, 2), (1, 2, 0), (2, 0, 1)], key=lambda cycle: nodes[cycle[0]])
    axes = list(order)
    cell = p.cell[:, axes]
    cells = (model.grid.cells[axes[0]], model.grid.cells[axes[1]], model.grid.cells[axes[2]])
    of = np.lexsort((np.arange(len(cell)), p.segment, np.ravel_multi_index(cell.T, cells)))
    grid = Grid(model.grid.origin[axes], model.grid.spacing[axes], cells)
    particles = Particles(p.position[of], p.volume[of], p.segment[of], cell[of])
    ratio = (model.bulk / model.shear)[of]
    turned = replace(
        model,
        grid=grid,
        particles=particles,
        weights=np.ascontiguousarray(model.weights[of][:, axes]),
        slopes=np.ascontiguousarray(model.slopes[of][:, axes]),
        shear=model.shear[of],
        bulk=model.bulk[of],
        remanence=np.ascontiguousarray(model.remanence[of][:, [*axes, *range(3, model.remanence.shape[1])]]),  # a mark stays last
        density=model.density[of],
        modes=volume_modes(grid, particles, ratio) if model.modes.shape[1] else model.modes,
        held=model.held[of],
        driven=tuple((name, np.ascontiguousarray(nodes.transpose(axes))) for name, nodes in model.driven),
        axes=np.ascontiguousarray(np.eye(3)[:, axes]),
        order=order,
    )
    layout, touching = make_layout(turned, turned.weights), model.touching
    if touching is not None:
        touching = replace(touching, first=touching.first[:, axes], weights=touching.weights[:, axes])
        touching = resting(touching, layout.planes, layout.node_yz, turned)
    return replace(turned, layout=layout, touching=touching), of


def _all_hang_on_something(model: StaticModel) -> None:
    """Raise SceneError unless every region is held, or is connected through grid nodes to one that is."""
    from scipy.sparse import coo_matrix  # 0.1 s to import, and straight bodies do not need it
    from scipy.sparse.csgraph import connected_components

    regions, particles, nodes = model.scene.regions(), model.particles, model.grid.nodes
    clamped = np.zeros(len(regions), bool)
    # Where a clamp plane changed a cell's splines they no longer sum to one.
    changed = np.any(np.abs(model.weights.sum(axis=2) - 1) > 1e-6, axis=1)
    for _, follows in model.driven:
        changed |= np.any([follows[tuple((particles.cell + shift).T)] for shift in np.ndindex(3, 3, 3)], axis=0)
    clamped[particles.segment[changed | model.held]] = True
    links = []
    for shift in np.ndindex(3, 3, 3):
        at = np.ravel_multi_index((particles.cell + shift).T, nodes)
        links.append(np.unique(at * len(regions) + particles.segment))
    key = np.concatenate(links)
    node = np.unique(key // len(regions), return_inverse=True)[1]
    count = len(regions) + int(node.max()) + 1
    graph = coo_matrix((np.ones(len(key)), (key % len(regions), node + len(regions))), shape=(count, count))
    _, group = connected_components(graph, directed=False)
    held_groups = set(group[: len(regions)][clamped].tolist())
    for k, region in enumerate(regions):
        if group[k] not in held_groups:
            raise SceneError(
                f"body.{model.scene.body.kind}",
                found=f"{region.name} touches no part that is held",
                rule="equilibrium needs every part to hang on something",
                remedy="clamp it or what it touches, or move it: `solver: {dynamic: {duration: 0.5 s}}`",
            )
