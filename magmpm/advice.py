"""What an effect's `advice` gets and gives: how much the effect would matter to a scene, in numbers, before anything is run.

An effect's file may have `advice(scene, body) -> Advice`. `body` estimates equilibria of the scene and of others like it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from magmpm.basis import Array
from magmpm.scene import Scene


@dataclass(frozen=True)
class Advice:
    """shift: farthest (m) that any point of the body's axis comes to rest from where it would without the effect; None: not known."""

    shift: float | None
    says: str


class Body(Protocol):
    """Estimates of a scene's body."""

    def rest(self, scene: Scene) -> Array:
        """Points (m, 3) m of the body at equilibrium in a scene of the same body: along its axis, or all over it.

        Raises SolveError where none is found.
        """

    @property
    def frequency(self) -> float | None:
        """First angular frequency of bending, rad/s; None where it is not known."""

    @property
    def half(self) -> float:
        """How far the surface is from the points of `rest`, m."""


def shift(scene: Scene, body: Body, key: str, settings: Any = None) -> float:
    """How far (m) an effect moves the body's rest: with it (as the scene names it, else with the settings, {}) and without it."""
    named = getattr(scene.effects, key)
    having = scene.with_effects(**{key: named if named is not None else settings or {}})
    apart = body.rest(having) - body.rest(scene.with_effects(**{key: None}))
    return float(np.linalg.norm(apart, axis=1).max())
