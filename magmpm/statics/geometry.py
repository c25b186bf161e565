"""Derivatives with respect to a body's lengths and diameter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from magmpm.compiled.arrays import Array
from magmpm.scene.variables import Variable
from magmpm.statics.energy import Energy, Point


@dataclass(frozen=True)
class GeometryChange:
    """Changes at fixed coefficients: of the residual (planes, m) N, of the axis's rows (rows, 3) m and of the tip (3,) m, per unit."""

    residual: Array
    rows: Array
    tip: Array


def geometry_changes(energy: Energy, point: Point, variables: Sequence[Variable]) -> dict[int, GeometryChange]:
    """By number, the change with each variable that is a length or diameter."""
    return {}
