"""How far an effect moves a scene's answer, by the rod: with the effect and without it, at rest, along equilibria in time, or in motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from magmpm.bodies.segments import StraightBody
from magmpm.compiled.arrays import Array
from magmpm.errors import InputError, SolveError
from magmpm.rod.cosserat import RodShape, Surroundings, along_rod, rod_model, solve_rod, solve_rod_model
from magmpm.rod.motion import move_rod
from magmpm.rod.mutual import MutualField
from magmpm.scene import Scene

ELEMENTS = 60  # of a rod at rest: 1e-3 of the deflection
STATIONS = 81  # along the axis, at which shapes are compared
MOMENTS = 9  # along equilibria in time
MODEL = 0.05  # of a shift: what rod and body differ by, from tests/benchmarks/advice.py
TURNS = 30  # of the fixed point of segments that act on each other


@dataclass(frozen=True)
class Shift:
    """value: m, the farthest that any point of the axis moves at any moment; uncertainty: m."""

    value: float
    uncertainty: float


def is_rod(scene: Scene) -> bool:
    """Whether the scene's body can be taken as a rod."""
    shape = scene.body.shape
    return isinstance(shape, StraightBody) and (scene.solver.dynamic is not None or shape.clamp == "base")


class RodAnswers:
    """Shapes (k, STATIONS, 3) m of a scene's axis and of its variants, at the same k moments: one for an equilibrium."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._found: dict[tuple[str, int], Array] = {}

    def shift(self, scene: Scene, other: Scene) -> Shift:
        """How far two variants of the scene are apart. Raises SolveError where a rod is not found, InputError where one can't be."""
        apart = self._apart(scene, other, 0)
        coarse = self._apart(scene, other, 1)
        return Shift(apart, abs(apart - coarse) + MODEL * apart)

    def _apart(self, scene: Scene, other: Scene, coarser: int) -> float:
        between = self.shapes(scene, coarser) - self.shapes(other, coarser)
        return float(np.sqrt((between**2).sum(axis=2)).max())

    def shapes(self, scene: Scene, coarser: int = 0) -> Array:
        """Shapes of one variant; coarser: how many times its elements are halved."""
        key = scene.hash(), coarser
        if key not in self._found:
            self._found[key] = _shapes(scene, coarser)
        return self._found[key]


def _shapes(scene: Scene, coarser: int) -> Array:
    if scene.solver.dynamic is not None:
        path = move_rod(scene, coarser=coarser)
        return _at_stations(path.s, path.position)
    count = ELEMENTS // 2**coarser
    if scene.solver.quasi_static is None:
        shape = rest(scene, count)
        return _at_stations(shape.s, shape.position[None])
    times = scene.path_times()
    chosen = sorted({times[i] for i in np.linspace(0, len(times) - 1, MOMENTS).round().astype(int)})
    return np.concatenate([_along(scene, time, count) for time in chosen])


def _along(scene: Scene, time: float, count: int) -> Array:
    """The shape (1, STATIONS, 3) of an equilibrium at a time; of a fed catheter, of its part outside the guide."""
    feed, whole = scene.effects.feed, scene
    if feed is None:
        shape = rest(scene, count, time)
        return _at_stations(shape.s, shape.position[None])
    if scene.field.varies and scene.effects.in_a_field:
        raise SolveError("a fed catheter in a field that varies in space is not estimated")
    outside = float(np.clip(scene.length + feed.speed * time - feed.exit, 0.0, scene.length))
    if outside <= scene.thickness:
        ahead = np.linspace(0.0, scene.length, STATIONS)
        return np.asarray(ahead[None, :, None] * [1.0, 0.0, 0.0])
    data = whole.to_si()
    data["solver"]["quasi_static"], data["effects"]["feed"] = None, None
    shape = rest(Scene.from_si(data).inserted(outside), count, time)
    return _at_stations(shape.s, shape.position[None])


def _at_stations(s: Array, position: Array) -> Array:
    """Positions (k, n, 3) at STATIONS equal parts of the length."""
    at = np.linspace(0.0, s[-1], STATIONS)
    right = np.clip(np.searchsorted(s, at), 1, len(s) - 1)
    share = ((at - s[right - 1]) / (s[right] - s[right - 1]))[:, None]
    return np.asarray((1 - share) * position[:, right - 1] + share * position[:, right])


def rest(scene: Scene, elements: int = ELEMENTS, time: float | None = None) -> RodShape:
    """The rod of a scene at rest, with the segments' field on each other if the scene names magnetic_interaction.

    time: s, of the field's schedule; its end unless given. Raises SolveError.
    """
    if scene.effects.magnetic_interaction is None or len(scene.magnetized_regions()) < 2:
        return solve_rod(scene, elements, time=time)
    mutual = MutualField(scene)
    alone = scene.effects.magnetic_torque is None
    turned: Any = scene.with_effects(magnetic_torque={}) if alone else scene
    rod = rod_model(turned, elements, time=time)
    uniform = 0.0 * rod.field if alone else rod.field
    outside = along_rod(scene, rod, time) if scene.field.varies and scene.effects.in_a_field else None
    s = np.concatenate([[0.0], np.cumsum(rod.length)])

    def around(position: Array, frames: Array) -> tuple[Array, Array]:
        field, force = (uniform, np.zeros((len(rod.length), 3))) if outside is None else outside(position, frames)
        own, pull = mutual.at(s, position, frames)
        return field + own, force + (pull[1:] + pull[:-1]) / 2 * rod.length[:, None]

    found: Surroundings = around
    return solve_rod_model(rod, surroundings=found)


__all__ = ["InputError", "RodAnswers", "Shift", "SolveError", "is_rod", "rest"]
