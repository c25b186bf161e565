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

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.kernels.equilibrium import (
    StaticCells,
    StaticParticles,
    add_stresses,
    gradient_products,
    grid_to_particles,
)
from magmpm.statics.layout import StaticModel
from magmpm.statics.tangent_matrix import SparseOfEachAxis


class TurningParticles:
    """Arcs of a body of any form. The matrix of the least squares is made and factored once."""

    def __init__(self, model: StaticModel, cells: StaticCells, particles: StaticParticles) -> None:
        self._layout = model.layout
        self._shear = model.shear
        self._cells = cells
        self._particles = particles
        self._matrix = SparseOfEachAxis(model.layout)
        self._matrix.clear()
        gradient_products(
            cells, particles, model.particles.volume * model.shear, self._matrix.target(cells)
        )
        self._matrix.finish()
        if not self._matrix.factor():
            raise ArithmeticError(
                "the gradients of the grid's splines do not tell its coefficients: some node has no"
                " material"
            )

    def moved(self, grid: Array, F: Array, direction: Array, fraction: float) -> Array:
        """Coefficients (planes, m) m after a fraction of a step `direction` (planes, m) m from `grid`, where particles have F (n, 3, 3)."""
        n = len(F)
        change = np.empty((n, 3, 3))
        nothing = np.zeros((3, 3))
        grid_to_particles(
            self._cells, self._particles, fraction * direction, nothing, np.empty((n, 3)), change
        )
        rate = change @ np.linalg.inv(F)
        turned = _exponential((rate - rate.transpose(0, 2, 1)) / 2)
        stretched = F + (rate + rate.transpose(0, 2, 1)) @ F / 2
        wanted = self._shear[:, None, None] * (turned @ stretched - F)
        right = np.zeros_like(grid)
        add_stresses(self._cells, self._particles, wanted, right)
        if (
            self._layout.springs is not None
        ):  # they are in the matrix as well, and stretch as along the straight step
            right += self._layout.springs.gradient(fraction * direction)
        right[self._layout.fixed] = 0.0
        return np.asarray(grid + self._matrix.solve(right))


def _exponential(skew: Array) -> Array:
    """Rotations (n, 3, 3) of skew matrices (n, 3, 3), by Rodrigues' formula."""
    angle = np.sqrt(0.5 * np.einsum("nij,nij->n", skew, skew))[:, None, None]
    return np.asarray(
        np.eye(3)
        + np.sinc(angle / np.pi) * skew
        + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * (skew @ skew)
    )


def rest_nodes(model: StaticModel) -> Array:
    """Positions (planes, nodes, 3) m of the nodes of the undeformed grid, in x, y, z."""
    grid = model.grid
    layout = model.layout
    X = np.empty((layout.planes, layout.nodes_per_plane, 3))
    X[..., 0] = grid.node_coordinates(0)[int(model.clamped_face) :, None]
    X[..., 1:] = grid.section_nodes(layout.node_yz)
    return X @ model.frame.T


def along_arc(model: StaticModel, grid: Array, direction: Array, fraction: float) -> Array:
    """Coefficients (planes, m) m after a fraction of a step `direction` (planes, m) m from `grid` (planes, m) m, along an arc."""
    X = rest_nodes(model)
    x = X + grid.reshape(X.shape)
    d = direction.reshape(X.shape)
    center = x.mean(axis=1)
    shift = d.mean(axis=1)
    arm = x - center[:, None]
    turn = d - shift[:, None]
    # The rotation that is nearest to each plane's motion, by least squares: of the sum of |w x arm - turn|^2.
    inertia = np.einsum("pni,pni->p", arm, arm)[:, None, None] * np.eye(3) - np.einsum(
        "pni,pnj->pij", arm, arm
    )
    w = np.einsum(
        "pij,pj->pi",
        np.linalg.pinv(inertia, rcond=1e-9, hermitian=True),
        np.cross(arm, turn).sum(axis=1),
    )
    section = _turned(fraction * w, arm + fraction * (turn - np.cross(w[:, None], arm)))
    between = np.diff(center, axis=0)
    change = np.diff(shift, axis=0)
    mean = (w[1:] + w[:-1]) / 2
    gaps = _turned(
        fraction * mean, (between + fraction * (change - np.cross(mean, between)))[:, None]
    )[:, 0]
    start = center[:1] + fraction * shift[:1]
    moved = np.concatenate([start, start + np.cumsum(gaps, axis=0)])
    out = (moved[:, None] + section - X).reshape(grid.shape)
    out[model.layout.fixed] = grid[model.layout.fixed]
    return np.ascontiguousarray(out)


def _turned(angles: Array, vectors: Array) -> Array:
    """Vectors (p, n, 3) turned by rotation vectors (p, 3) rad."""
    turned = _exponential(np.cross(np.eye(3), angles[:, None]))
    return vectors @ turned.transpose(0, 2, 1)
