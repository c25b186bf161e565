"""Regions of bodies of every kind, with one material each; and the axis of straight bodies."""

from __future__ import annotations

from dataclasses import dataclass

from magmpm.inputs.settings import Key
from magmpm.inputs.vectors import Vector


@dataclass(frozen=True)
class Region:
    """A stretch of a body with one material and magnetization: a segment of a catheter or strip, a part of an assembly.

    magnetization: unit vector in the undeformed body, or zeros; held: it can't move.
    """

    name: str
    at: Key  # where the scene's data describe it, below `body`
    material_name: str
    magnetization: Vector
    held: bool = False


@dataclass(frozen=True)
class Line:
    """A straight body along +x: base (3,) m, the center of its base face; length m."""

    base: Vector
    length: float
