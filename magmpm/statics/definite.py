"""Cholesky factors of a tangent that may have none: those of the tangent plus some of the mass matrix.

The mass matrix M is lumped and of density 1. As much of it as NEUTRAL of the smallest eigenvalue of the undeformed body is always added, so
that a neutral direction does no harm. Where the tangent has no factors even then, more is added, STIFFER times as much at each attempt. So
the softest motions are changed by about what they lack, and the stiff ones not at all: as a preconditioner of a tangent that is positive
definite these factors serve well.
"""

from dataclasses import replace

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.scene import time_limit
from magmpm.statics.energy import Energy, Point
from magmpm.statics.layout import StaticModel
from magmpm.statics.newton import factored

STIFFER = 10.0  # times as much of the mass matrix, where a tangent has no factors yet
# of the lowest eigenvalue of the undeformed body: what counts as zero. A buckled round rod turns
# about its axis freely
NEUTRAL = 1e-4


class Definite:
    """Factors tangents of one body after the other. shift: of the mass matrix in the last factors, Pa/m^2."""

    def __init__(self) -> None:
        self.shift = 0.0
        self._free = 0.0
        # the shift that a tangent last needed to have factors: where the next one looks for its own
        self._enough = 0.0
        self._mass_of: object = None
        self._masses = np.zeros((0, 0))

    def forget(self) -> None:
        """Forget what earlier tangents needed."""
        self._enough = 0.0

    def factored(self, energy: Energy, point: Point, more: float = 0.0) -> tuple[Array, bool]:
        """Residual, and whether all eigenvalues of the tangent are positive or count as zero (NEUTRAL).

        If so, the energy's matrix holds the factors of the tangent plus that much, or `more` (Pa/m^2), of the mass matrix. So steps along
        a neutral direction, where rounding decides, stay short; others are Newton's to within NEUTRAL.
        """
        time_limit.check()
        self.shift = max(more, self.neutral(energy))
        residual, matrix = energy.tangent(point)
        matrix.add_diagonal(self.shift * self.mass(energy))
        return residual, matrix.factor()

    def made(self, energy: Energy, point: Point, more: float = 0.0) -> tuple[Array | None, bool]:
        """Factor as `factored`, with as much more of the mass matrix as it takes to have factors. A slender body on its way is compressed
        for a step or two, as it moves along tangents of its arcs: it is not unstable. No residual where values are not finite.
        """
        residual, definite = self.factored(energy, point, more)
        done = definite
        enough = self._enough / STIFFER
        while not done:
            residual, done = self.factored(energy, point, max(STIFFER * self.shift, enough))
            if not self.shift < 1e15 * self.neutral(energy):  # it is not the tangent that matters
                return None, False
            self._enough = self.shift
        return residual, definite

    def mass(self, energy: Energy) -> Array:
        """The lumped mass of the energy's model."""
        if self._mass_of is not energy.model.layout:
            self._mass_of = energy.model.layout
            self._masses = lumped_mass(energy.model)
            self._free = 0.0
        return self._masses

    def free(self, energy: Energy) -> float:
        """Lowest eigenvalue (Pa/m^2) of the undeformed body, which nothing touches or holds."""
        mass = self.mass(energy)
        model = energy.model
        if self._free == 0.0:
            energy.load(replace(model, touching=None, pairs=None))
            factored(energy, energy.at(np.zeros(energy.shape)))
            self._free = lowest_mode(energy, mass)[0]
            energy.load(model)
        return self._free

    def neutral(self, energy: Energy) -> float:
        """Eigenvalue (Pa/m^2) that counts as zero."""
        return NEUTRAL * self.free(energy)


def lumped_mass(model: StaticModel) -> Array:
    """Mass (planes, m) of the unknowns for a density of 1: the volume that each node's spline carries."""
    layout = model.layout
    size = layout.planes * layout.nodes_per_plane
    out = np.zeros(size)
    of = np.repeat(np.arange(len(layout.cell_plane)), np.diff(layout.cell_first))
    for a, b, c in np.ndindex(3, 3, 3):
        share = model.particles.volume * np.abs(
            model.weights[:, 0, a] * model.weights[:, 1, b] * model.weights[:, 2, c]
        )
        plane = np.minimum(layout.cell_plane[of] + a, layout.planes - 1)
        out += np.bincount(
            plane * layout.nodes_per_plane + layout.cell_row[of, b] + c, share, minlength=size
        )
    out = np.repeat(out.reshape(layout.planes, -1), 3, axis=1)
    out[layout.fixed] = float(out.max())
    return out


def lowest_mode(energy: Energy, mass: Array, but: Array | None = None) -> tuple[float, Array]:
    """Smallest eigenvalue (Pa/m^2) and mode (planes, m) of the factored tangent against a lumped mass of density 1: inverse iteration.

    but: a mode of norm 1 in this mass, which does not count: then the next eigenvalue.
    """
    model = energy.model
    layout = energy.model.layout
    x = model.plane_coordinates()
    d = (
        1e-6
        * np.random.default_rng(0).standard_normal((layout.planes, layout.m))
        * float(np.ptp(x)) ** 2
    )
    aside = np.tile(model.frame @ [0.0, 1e-3, 1.0], layout.nodes_per_plane)
    d = energy.free(d + np.outer((x - x[0]) ** 2, aside))
    lowest = np.inf
    for _ in range(40):
        if but is not None:
            d = d - float(np.sum(mass * but * d)) * but
        loaded = mass * d
        new = energy.matrix.solve(energy.free(loaded))
        size = float(np.sum(mass * new * new))
        before = lowest
        lowest = float(np.sum(new * loaded)) / size
        d = new / np.sqrt(size)
        if abs(lowest - before) < 1e-6 * abs(lowest):
            break
    return lowest, d
