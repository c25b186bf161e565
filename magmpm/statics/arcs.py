"""Steps along arcs, on which parts of a body turn by finite rotations, as those of a bending or twisting body do.

A straight step moves every node along a line. Where a body turns by an angle a, this stretches it by a^2/2, and stretching is up to a
million times as stiff as bending and twist. So in a soft mode only tiny straight steps lower the energy. To first order in the fraction an
arc is the straight step, so its direction still goes down. Source: retractions, Absil, Mahony, Sepulchre, Optimization Algorithms on
Matrix Manifolds, ch. 4.

Straight bodies turn plane by plane (along_arc): the direction of each plane of nodes is split into a translation, a rotation and a rest.
The rotations are applied as rotations, and the distances between planes are turned with them and added up again from the first plane.

Others turn particle by particle (TurningParticles): the change of each deformation gradient is split into a rotation and a strain, both
are applied in full, and the displacement is the one whose gradient is nearest to these, by least squares weighted by stiffness.
Source: rotation-strain coordinates, Huang, Tong, Zhou, Bao, Desbrun, Interactive shape interpolation through controllable dynamic
deformation, IEEE TVCG 17 (2011) 983.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.kernels.equilibrium import add_stresses, gradient_products, grid_to_particles
from magmpm.statics.layout import StaticModel
from magmpm.statics.tangent_matrix import new_matrix

if TYPE_CHECKING:
    from magmpm.statics.energy import Energy, Point


class TurningParticles:
    """Arcs of a body of any form. The matrix of the least squares is made and factored once."""

    def __init__(self, energy: Energy) -> None:
        self._energy = energy
        self._matrix = new_matrix(energy.model.scene, energy.model.layout)
        self._matrix.clear()
        weight = energy.model.particles.volume * energy.model.shear
        gradient_products(energy.cells, energy.particles, weight, self._matrix.target(energy.cells))
        self._matrix.finish()
        if not self._matrix.factor():
            raise ArithmeticError("the gradients of the grid's splines do not tell its coefficients: some node has no material")

    def moved(self, point: Point, direction: Array, fraction: float) -> Array:
        """Coefficients (planes, m) m after a fraction of a step `direction` (planes, m) m from a point."""
        energy, n = self._energy, len(point.F)
        change = np.empty((n, 3, 3))
        nothing = np.zeros((3, 3))
        grid_to_particles(energy.cells, energy.particles, fraction * direction, nothing, np.empty((n, 3)), change)
        rate = change @ np.linalg.inv(point.F)
        turned = _exponential((rate - rate.transpose(0, 2, 1)) / 2)
        stretched = point.F + (rate + rate.transpose(0, 2, 1)) @ point.F / 2
        wanted = energy.model.shear[:, None, None] * (turned @ stretched - point.F)
        right = np.zeros(energy.shape)
        add_stresses(energy.cells, energy.particles, wanted, right)
        springs = energy.model.layout.springs
        if springs is not None:  # they are in the matrix as well, and stretch as along the straight step
            right += springs.gradient(fraction * direction)
        return np.asarray(point.grid + self._matrix.solve(energy.free(right)))


def _exponential(skew: Array) -> Array:
    """Rotations (n, 3, 3) of skew matrices (n, 3, 3), by Rodrigues' formula."""
    angle = np.sqrt(0.5 * np.einsum("nij,nij->n", skew, skew))[:, None, None]
    return np.asarray(np.eye(3) + np.sinc(angle / np.pi) * skew + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * (skew @ skew))


def rest_nodes(model: StaticModel) -> Array:
    """Positions (planes, nodes, 3) m of the nodes of the undeformed grid, in x, y, z."""
    grid, layout = model.grid, model.layout
    first, second, third = model.order
    X = np.empty((layout.planes, layout.nodes_per_plane, 3))
    X[..., first] = grid.node_coordinates(0)[int(model.clamped_face) :, None]
    X[..., second], X[..., third] = grid.section_nodes(layout.node_yz).T
    return X


def along_arc(model: StaticModel, grid: Array, direction: Array, fraction: float) -> Array:
    """Coefficients (planes, m) m after a fraction of a step `direction` (planes, m) m from `grid` (planes, m) m, along an arc."""
    X = rest_nodes(model)
    x, d = X + grid.reshape(X.shape), direction.reshape(X.shape)
    center, shift = x.mean(axis=1), d.mean(axis=1)
    arm, turn = x - center[:, None], d - shift[:, None]
    # The rotation that is nearest to each plane's motion, by least squares: of the sum of |w x arm - turn|^2.
    inertia = np.einsum("pni,pni->p", arm, arm)[:, None, None] * np.eye(3) - np.einsum("pni,pnj->pij", arm, arm)
    w = np.einsum("pij,pj->pi", np.linalg.pinv(inertia, rcond=1e-9, hermitian=True), np.cross(arm, turn).sum(axis=1))
    section = _turned(fraction * w, arm + fraction * (turn - np.cross(w[:, None], arm)))
    between, change = np.diff(center, axis=0), np.diff(shift, axis=0)
    mean = (w[1:] + w[:-1]) / 2
    gaps = _turned(fraction * mean, (between + fraction * (change - np.cross(mean, between)))[:, None])[:, 0]
    start = center[:1] + fraction * shift[:1]
    moved = np.concatenate([start, start + np.cumsum(gaps, axis=0)])
    out = (moved[:, None] + section - X).reshape(grid.shape)
    out[model.layout.fixed] = grid[model.layout.fixed]
    return np.ascontiguousarray(out)


def _turned(angles: Array, vectors: Array) -> Array:
    """Vectors (p, n, 3) turned by rotation vectors (p, 3) rad."""
    from scipy.spatial.transform import Rotation  # 0.1 s to import, and few solves need it

    return np.einsum("pij,pnj->pni", Rotation.from_rotvec(angles).as_matrix(), vectors)
