"""Deformed axis and tip of an equilibrium, from the spline coefficients of its displacement.

A displacement is carried from one grid of a body to another by least squares, along the axis and across the section apart: splines are
products of one along the axis and one across, so two small fits do, u_fine = A u_coarse S^T.
"""

from collections.abc import Iterator

import numpy as np

from magmpm.bodies.body_shape import Line
from magmpm.bodies.segments import StraightBody
from magmpm.compiled.arrays import Array, Index
from magmpm.model import Model
from magmpm.statics.layout import StaticModel


def section_weights(model: StaticModel) -> Array:
    """Weights (nodes_per_plane,) that give the axis from a plane's coefficients: at y = z = 0, or a tube's mean over its section."""
    shape = model.scene.body.shape
    if isinstance(shape, StraightBody) and shape.hollow:
        return end_face_weights(model)
    return _plane_weights(model, np.array([_line(model).base[1:]]), np.ones(1))


def _line(model: Model) -> Line:
    if model.line is None:
        raise ValueError("only a straight body (catheter, strip) has an axis to measure")
    return model.line


def end_face_weights(model: StaticModel) -> Array:
    """Weights (nodes_per_plane,) of the mean over a section."""
    position = model.particles.position
    slice_ = position[:, 0] == position[:, 0].min()
    share = model.particles.volume[slice_]
    return _plane_weights(model, position[slice_, 1:], share / share.sum())


def _plane_weights(model: StaticModel, points: Array, share: Array) -> Array:
    """Sum over points (q, 2) of share times the splines of y and z, for each node of a plane."""
    dense = np.zeros(model.grid.nodes[1:])
    node_yz = model.layout.node_yz
    for y, z, first, second in _each_across(model, points):
        np.add.at(dense, (y, z), share * first * second)
    return dense[node_yz[:, 0], node_yz[:, 1]]


def _each_across(model: StaticModel, points: Array) -> Iterator[tuple[Index, Index, Array, Array]]:
    """The nine nodes of a section that points (q, 2) m see: index of each along both axes, and the values of its two splines, (q,) each."""
    node, weights = model.grid.section_splines(points)
    if model.plane_strain:  # the middle row of nodes represents all three
        weights[:, 0] = np.array([0.0, 1.0, 0.0])
    for a, b in np.ndindex(3, 3):
        yield (
            (node[:, 0] + a) % model.grid.nodes[1],
            node[:, 1] + b,
            weights[:, 0, a],
            weights[:, 1, b],
        )


def along_axis(model: StaticModel, grid: Array, weights: Array, s: Array) -> Array:
    """Deformed positions (m, 3) m at arc lengths s (m,) m; weights: of the functions above; grid (planes, m): of the displacement."""
    planes = grid.reshape(model.layout.planes, -1, 3).transpose(0, 2, 1) @ weights
    if model.clamped_face:
        planes = np.concatenate([-planes[:1], planes])  # node 0, eliminated by the clamp
    elif model.driven:  # the first coefficient is the displacement of the base, which moves
        planes[0] = 2.0 * planes[0] - planes[1]
    if (
        model.scene.body.shape.clamp == "both"
    ):  # as at the lower face; the last coefficient is 0 where that face does not move
        planes[-1] = 2.0 * planes[-1] - planes[-2]
    node, N, _ = model.grid.splines_along(s)
    u = sum(N[:, a, None] * planes[node + a] for a in range(3))
    return u + np.outer(s, [1.0, 0.0, 0.0]) + np.array(_line(model).base)


def splines_along(model: StaticModel, s: Array) -> Array:
    """Splines (m, planes) along the axis at arc lengths s (m,) m, clamps built in: times a plane's weighted coefficients they give u."""
    out = model.grid.matrix_along(s)
    if model.scene.body.shape.clamp == "both":  # as along_axis has it
        out[:, -2] -= out[:, -1]
        out[:, -1] *= 2.0 * ("tip" in dict(model.driven))
    if model.clamped_face or model.driven:
        out[:, 1] -= out[:, 0]
        out[:, 0] *= 2.0
    if model.clamped_face:
        out = out[:, 1:]
    return np.ascontiguousarray(out)


def centreline(model: StaticModel, grid: Array) -> Array:
    """Rows [s, x, y, z] (2 cells + 1, 4) m: the deformed axis at faces and middles of the cells; no rows for a body without an axis."""
    if model.line is None:
        return np.zeros((0, 4))
    s = model.grid.stations
    return np.column_stack([s, along_axis(model, grid, section_weights(model), s)])


def tip(model: StaticModel, grid: Array) -> Array:
    """Position (3,) m of the far end of a straight body, the mean over its face; grid (planes, m): of the displacement."""
    return along_axis(model, grid, end_face_weights(model), np.array([_line(model).length]))[0]


def carried(coarse: StaticModel, grid: Array, fine: StaticModel) -> Array:
    """Coefficients (planes, m) m on the fine grid of the displacement `grid` (planes, m) m on the coarse one. Straight bodies only."""
    values = grid.reshape(coarse.layout.planes, -1, 3)
    across = np.einsum("kj,pjc->pkc", _section(coarse, fine), values, optimize=True)
    out = along(coarse, fine, across.reshape(coarse.layout.planes, -1))
    moves = fine.scene.move or {}
    given = (
        fine.displaced(**{name: move.displacement(fine.time)[0] for name, move in moves.items()})
        if fine.driven
        else np.zeros_like(out)
    )
    out[fine.layout.fixed] = given[fine.layout.fixed]
    return np.ascontiguousarray(out)


def _section(coarse: StaticModel, fine: StaticModel) -> Array:
    """Nodes of a fine plane from those of a coarse one, (fine nodes, coarse nodes), fitted at the fine section's points."""
    position = fine.particles.position
    slice_ = position[:, 0] == position[:, 0].min()
    points = position[slice_, 1:]
    target, source = (_splines_across(model, points) for model in (fine, coarse))
    normal = target.T @ target
    normal += (
        1e-10 * np.trace(normal) / len(normal) * np.eye(len(normal))
    )  # what the points hardly see is kept small
    return np.asarray(np.linalg.solve(normal, target.T @ source))


def _splines_across(model: StaticModel, points: Array) -> Array:
    """Splines (q, nodes_per_plane) of a section at points (q, 2) m."""
    dense = np.zeros((len(points), *model.grid.nodes[1:]))
    node_yz = model.layout.node_yz
    for y, z, first, second in _each_across(model, points):
        dense[np.arange(len(points)), y, z] += first * second
    return np.asarray(dense[:, node_yz[:, 0], node_yz[:, 1]])


def along(coarse: StaticModel, fine: StaticModel, values: Array, moved: float = 0.0) -> Array:
    """Plane coefficients on the fine grid from those (planes, k) on the coarse one, fitted at Gauss points of the fine cells.

    moved: m, where the fine grid's base lies on the coarse one's axis; nothing is displaced before the coarse one's base.
    """
    from scipy.linalg import solveh_banded  # only where a solve goes on to a finer grid

    unit = np.polynomial.legendre.leggauss(3)[0]  # points a cell
    s = fine.grid.along.at((1 + unit) / 2, np.arange(fine.grid.cells[0])[:, None]).ravel()
    target = splines_along(fine, s)
    used = np.abs(target).max(axis=0) > 0.0  # a far clamp's plane is not
    target = target[:, used]
    normal = target.T @ target
    right = target.T @ (
        splines_along(coarse, np.clip(s + moved, 0.0, coarse.grid.faces[-1])) @ values
    )
    bands = np.array([np.concatenate([np.zeros(k), np.diagonal(normal, k)]) for k in (2, 1, 0)])
    out = np.zeros((len(used), values.shape[1]))
    out[used] = solveh_banded(bands, right)
    return out
