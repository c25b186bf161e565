"""Estimates for `Effect.advice`: how much an effect would matter to a scene, in numbers, before anything is run.

`body`, a RestEstimate, gives equilibria of the scene and of others with the same body.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.effects.base import Advice, RestEstimate, SceneLike

MEASURE = "to measure, compare `magmpm run` with and without it"
STILL = 1e-6  # of the length: a smaller shift counts as none


def shift(scene: SceneLike, body: RestEstimate, key: str, settings: Any = None) -> float:
    """Distance (m) by which an effect moves the body's rest: with it (as the scene names it, else with the settings, {}) and without it."""
    named = getattr(scene.effects, key)
    having = scene.with_effects(**{key: named if named is not None else settings or {}})
    apart = body.rest(having) - body.rest(scene.with_effects(**{key: None}))
    return float(np.linalg.norm(apart, axis=1).max())


def shift_by_field(scene: SceneLike, body: RestEstimate, key: str, what: str) -> Advice:
    """Estimate how far an effect of the outside field moves the body's rest; what: `the field`, say."""
    moved = shift(scene, body, key)
    if scene.field.over_time is not None and moved < STILL * scene.length:
        return Advice(None, f"moves nothing once the field's schedule has ended; what it does on the way is not estimated: {MEASURE}")
    return Advice(moved, f"{what} moves it by {in_lengths(moved, scene)}")


def in_lengths(way: float, scene: SceneLike) -> str:
    """A distance (m) as a fraction of the body's length: "42 % of its length"."""
    percent = 100 * way / scene.length
    return f"{percent:.0f} % of its length" if percent >= 99.5 else f"{percent:.2g} % of its length"


def no_rest(scene: SceneLike) -> str | None:
    """Reason why the equilibrium of a scene's body can't be estimated, as text; None where it can."""
    if scene.effects.feed is not None:
        return "the body is fed"
    if scene.body.shape.clamp == "none":
        return "nothing holds the body"
    return None


def obstacle(scene: SceneLike, body: RestEstimate, room: Callable[[Array], Array], where: str) -> Advice:
    """The influence of an obstacle, from the equilibrium without it.

    room: distance (k,) m of points (k, 3) m from it, negative beyond it; where: "above it", say, of what is clear of it.
    """
    if (why := no_rest(scene)) is not None:
        return Advice(None, f"not estimated: {why}; {MEASURE}")
    clear = float(room(body.rest(scene)).min()) - body.half
    if clear < 0:
        return Advice(-clear, f"without it the body would come to rest {-1e3 * clear:.3g} mm beyond it")
    says = f"the body comes to rest {1e3 * clear:.3g} mm {where}"
    if scene.solver.dynamic is None or scene.field.over_time is None:
        return Advice(0.0 if scene.solver.dynamic is None else None, says)
    return Advice(None, f"{says} when the field has ended; how near it comes on its way is not estimated: {MEASURE}")
