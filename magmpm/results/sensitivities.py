"""Sensitivities of a result to the numbers of its scene: what `magmpm.sensitivities` returns."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from magmpm.bodies.curves import on_rows
from magmpm.compiled.arrays import Array
from magmpm.results.result import Result
from magmpm.scene.variables import Variable


class Neighborhood(Protocol):
    """Solver of the equilibrium, which knows its tangent (statics.linearized). Shapes and units as of Sensitivities."""

    @property
    def tip(self) -> Array: ...

    @property
    def centreline(self) -> Array: ...

    @property
    def stations(self) -> Array: ...

    def adjoint(self, gradient: Array) -> Array: ...


@dataclass(frozen=True)
class Sensitivities:
    """Derivatives of an equilibrium's shape with respect to k variables of its scene. SI units, per unit of each variable.

    result: the equilibrium; variables: what is changed, in the order of the last axis. Derivatives are computed when first requested
    for: `adjoint` needs none of the others.
    """

    result: Result
    variables: tuple[Variable, ...]
    _near: Neighborhood = field(repr=False)

    @property
    def tip(self) -> Array:
        """Derivatives (3, k), m per unit, of `result.tip`."""
        return self._near.tip

    @property
    def centreline(self) -> Array:
        """Derivatives (stations, 3, k), m per unit, of x, y, z in `result.centreline`, row by row; no rows for a body without an axis.

        A row stays in its place in a cell, so where a segment gets longer the row's arc length grows; `at` is for fixed arc lengths.
        """
        return self._near.centreline

    @property
    def names(self) -> tuple[str, ...]:
        """The variables' names, such as segment_1_azimuth, field_x, remanence_silicone."""
        return tuple(variable.name for variable in self.variables)

    @property
    def units(self) -> tuple[str, ...]:
        """The variables' units: rad, T, Pa, m or kg/m^3."""
        return tuple(variable.unit for variable in self.variables)

    def at(self, arc_lengths: Array) -> Array:
        """Derivatives (m, 3, k), m per unit, of `results.measures.centreline_at(result, arc_lengths)`, arc_lengths (m,) m.

        Exact, as that is: parabolas through three rows. Raises ValueError for an arc length outside the body.
        """
        s = np.asarray(arc_lengths, dtype=float)
        rows = self.result.centreline
        stations, _, k = self.centreline.shape
        values, _ = on_rows(rows[:, 0], self.centreline.reshape(stations, 3 * k), s)
        _, slope = on_rows(rows[:, 0], rows[:, 1:], s)
        moved, _ = on_rows(rows[:, 0], self._near.stations, s)
        return values.reshape(len(s), 3, k) - slope[:, :, None] * moved[:, None, :]

    def adjoint(self, gradient: Array) -> Array:
        """dJ/d(variable) (k,) of an objective J with this gradient dJ/d(centreline) (stations, 3), in J's unit per m.

        One substitution, however many variables. Raises ValueError for a gradient of another shape.
        """
        gradient, rows = np.asarray(gradient, dtype=float), self.result.centreline
        if gradient.shape != (len(rows), 3):
            raise ValueError(f"gradient has shape {gradient.shape}; must be {(len(rows), 3)}, a row for each of the centreline's")
        return self._near.adjoint(gradient)
