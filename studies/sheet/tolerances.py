"""Tolerances of a design's numbers: the error of each that alone moves the tip by a given distance, to first order.

From the derivatives of the equilibrium (magmpm.sensitivities). A direction may be wrong by a turn about any axis across it: what counts is
the turn that moves the tip most, the largest singular value of the tip's derivatives (3, 2) by two perpendicular turns. Materials, field,
lengths and the diameter count by the length of the tip's derivative.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.scene import Scene

SHARE = 0.01  # of the length: how far the tip may move
LARGEST = {"deg": 30.0, "%": 30.0, "mm": float("inf")}  # beyond which the first order says no more than that
USUAL = {"deg": 5.0, "%": 5.0}  # errors of manufacture by which a design is evaluated where its study names none


class Derived(Protocol):
    """The part of magmpm.Sensitivities that is read here."""

    @property
    def variables(self) -> Sequence[Any]: ...

    @property
    def tip(self) -> Array: ...


def tolerances(scene: Scene, found: Derived, hidden: int = 0) -> list[dict[str, Any]]:
    """A row for each number of a design: `what`, `of`, its `unit` (deg, % or mm) and `tip_m_per_unit`, how far the tip moves for one unit.

    scene: that of `found`; hidden: how many segments of the whole body, from its base, it does not have.
    """
    tip, variables = np.asarray(found.tip, dtype=float), list(found.variables)
    columns: dict[tuple[str, Any], list[int]] = {}
    for k, variable in enumerate(variables):
        columns.setdefault((variable.kind, _whose(variable)), []).append(k)
    rows: list[dict[str, Any]] = []
    for (kind, whose), places in columns.items():
        rows += _rows(kind, whose, tip[:, places], scene, variables[places[0]], hidden)
    return [row for row in rows if row["tip_m_per_unit"] > 0.0]  # without weight the density does nothing


def _whose(variable: Any) -> Any:
    """Owner of a variable: a segment's number, a material, or nothing."""
    return variable.region if variable.region is not None else variable.material


def _rows(kind: str, whose: Any, columns: Array, scene: Scene, variable: Any, hidden: int) -> list[dict[str, Any]]:
    def row(what: str, of: str, unit: str, moved: Any) -> dict[str, Any]:
        return {"what": what, "of": of, "unit": unit, "tip_m_per_unit": float(moved), "segment": segment}

    segment = None if variable.region is None else variable.region + hidden + 1
    degree = np.deg2rad(1.0)
    if kind == "magnetization":
        return [row("direction", f"segment {segment}", "deg", degree * np.linalg.norm(columns, ord=2))]
    if kind == "field":
        field = np.array(scene.field.uniform, dtype=float)
        strength = float(np.linalg.norm(field))
        if columns.shape[1] != 3 or strength == 0.0:
            return []
        across = np.eye(3) - np.outer(field, field) / strength**2  # the field as it turns
        return [
            row("strength", "field", "%", 0.01 * np.linalg.norm(columns @ field)),
            row("direction", "field", "deg", degree * strength * np.linalg.norm(columns @ across, ord=2)),
        ]
    moved = float(np.linalg.norm(columns))
    if kind in ("length", "diameter"):
        return [row(kind, "body" if segment is None else f"segment {segment}", "mm", 1e-3 * moved)]
    value = float(getattr(scene.materials[whose], kind))
    return [row(kind.replace("_", " "), str(whose), "%", 0.01 * value * moved)] if value else []


def allowed(row: dict[str, Any], distance: float) -> float | None:
    """The error, in the row's unit, that alone moves the tip by `distance` (m); None where it is beyond LARGEST."""
    if row["tip_m_per_unit"] * LARGEST[row["unit"]] <= distance:
        return None
    return float(distance / row["tip_m_per_unit"])


def together(rows: Sequence[dict[str, Any]], direction: float = USUAL["deg"], materials: float = USUAL["%"]) -> float:
    """Standard deviation (m, in space) of the tip for independent errors of manufacture, to first order: an upper bound.

    direction: standard deviation, deg, of each segment's turn along each of two axes; materials: of remanence and shear modulus, %.
    Each direction counts both axes with the derivative of the worse one.
    """
    parts = [np.sqrt(2.0) * direction * row["tip_m_per_unit"] for row in rows if row["what"] == "direction" and row["segment"] is not None]
    parts += [materials * row["tip_m_per_unit"] for row in rows if row["what"] in ("remanence", "shear modulus")]
    return float(np.linalg.norm(parts)) if parts else 0.0
