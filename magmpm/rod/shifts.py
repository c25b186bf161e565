"""Shift of a scene's answer by an effect, by the rod: with the effect and without it, at rest, along equilibria in time, or in motion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from magmpm.bodies.segments import StraightBody
from magmpm.compiled.arrays import Array
from magmpm.effects.acting import NO_LOADS
from magmpm.errors import SolveError
from magmpm.materials import poisson_ratio
from magmpm.rod.cosserat import FOLLOWED, RodModel, RodShape, rod_model, segment_counts, solve_rod
from magmpm.rod.kernels import derivatives, factor, solve
from magmpm.rod.motion import move_rod
from magmpm.rod.mutual import MutualField
from magmpm.scene import Scene

ELEMENTS = 60  # of a rod at rest: 1e-3 of the deflection
STATIONS = 81  # along the axis, at which shapes are compared
MOMENTS = 9  # along equilibria in time, at equal parts; and where the load is strongest
QUICK_CLOSE = 1e-3  # of the length, to which quick rods follow a field that varies in space
QUICK = 0.2  # of a shift that was found by few elements
EDGEWISE = 0.01  # of the length: a wide strip that goes farther along its width topples, in a rod, before its clamp lets it
BORNE = 2 / 3  # (2 sqrt(2)/9) / (sqrt(2)/3): the largest moment of a tube that flattens, over that of a round one at the same curvature
TORQUE_ELEMENTS, ALIKE = 20, 1.0 - 1e-9  # of the rod that tells when the load is strongest: its torques are sums over segments
MODEL = 0.05  # of a shift: what rod and body differ by, from tests/benchmarks/advice.py


@dataclass(frozen=True)
class Shift:
    """value: m, the farthest that any point of the axis moves at any moment; uncertainty: m."""

    value: float
    uncertainty: float


def is_rod(scene: Scene) -> bool:
    """True if the scene's body can be taken as a rod."""
    return isinstance(scene.body.shape, StraightBody) and (scene.solver.dynamic is not None or is_cantilever(scene))


def is_cantilever(scene: Scene) -> bool:
    """True if the scene's body is straight and held at its base alone: its rest can be taken as a rod's."""
    shape = scene.body.shape
    return isinstance(shape, StraightBody) and shape.clamp == "base"


def kink_warning(scene: Scene) -> str | None:
    """A warning, in milliseconds and before any equilibrium is solved, that a tube at rest will kink; None where it will not.

    A tube bears at most M = (2 sqrt(2)/9) pi E r t^2 / sqrt(1 - nu^2) (Brazier 1927), BORNE of the moment that its round section would
    have at Catheter.kink_radius. Its rod has the moments of the round section. The clamp keeps the section round nearby: the largest
    moment beyond that length counts.
    """
    tube = scene.body.catheter
    if tube is None or not tube.hollow or not scene.static or not is_cantilever(scene):
        return None
    try:
        rod = solve_rod(scene)
    except SolveError:
        return None
    used = [scene.materials[region.material_name] for region in scene.regions()]
    limit = tube.kink_radius(max(poisson_ratio(m.shear_modulus, m.shear_modulus * m.bulk_to_shear) for m in used))
    bent = np.linalg.norm(rod.curvature[rod.s >= tube.held_round, 1:], axis=1).max(initial=0.0)
    if bent * limit <= BORNE:
        return None
    return (
        f"the tube will kink: the load bends it with {bent * limit / BORNE:.2g} times the moment that its wall bears before the section "
        "flattens (Brazier); the solve may take long and fail; thicken the wall, or bend it less"
    )


def flat_stiffening(scene: Scene) -> float:
    """Fraction by which a strip that is much wider than thick is stiffer than its rod, about. 0 for other bodies.

    Near the clamp, which keeps its width, it bends like a plate, with E / (1 - nu^2): over w / (w + L) of the whole, for widths w of a
    tenth to twice the length L (measured: docs/effects.md, "How sure").
    """
    strip = scene.body.strip
    if strip is None or not strip.bends_as_plate or strip.plane_strain:
        return 0.0
    used = [scene.materials[region.material_name] for region in scene.regions()]
    nu = float(np.mean([poisson_ratio(m.shear_modulus, m.shear_modulus * m.bulk_to_shear) for m in used]))
    return nu**2 / (1 - nu**2) * strip.width / (strip.width + strip.length)


class RodAnswers:
    """Shapes (k, STATIONS, 3) m of a scene's axis and of its variants, at the same k moments: one for an equilibrium."""

    def __init__(self, scene: Scene, *, quick: bool = False) -> None:
        """quick: by half as many elements (of a motion a quarter), once, in varying fields to QUICK_CLOSE: sure to QUICK of a shift."""
        self.scene, self.quick = scene, quick
        self._found: dict[tuple[Any, int], Array] = {}

    def shift(self, scene: Scene, other: Scene) -> Shift:
        """Distance between two variants of the scene. Raises SolveError where a rod is not found, InputError where one can't be."""
        if self.quick:
            apart = self._apart(scene, other, self.coarser)
            followed = 2 * QUICK_CLOSE * scene.length if scene.field.varies else 0.0
            return self._of_body(scene, other, apart, QUICK * apart + followed)
        apart = self._apart(scene, other, 0)
        coarse = self._apart(scene, other, 1)
        return self._of_body(scene, other, apart, abs(apart - coarse) + MODEL * apart)

    def _of_body(self, scene: Scene, other: Scene, apart: float, uncertainty: float) -> Shift:
        """A rod's shift, and what the body's width makes of it. One that a wide strip goes along its width, or twisted, is hardly known."""
        stiffer = flat_stiffening(self.scene)
        if stiffer > 0.0:
            aside = max(float(np.ptp(self.shapes(one, self.coarser)[..., 1], axis=1).max()) for one in (scene, other))
            if aside > EDGEWISE * self.scene.length:
                uncertainty += apart
        return Shift(apart / (1.0 + stiffer), uncertainty + stiffer * apart)

    @property
    def coarser(self) -> int:
        """Number of times that the elements of a quick answer are halved."""
        return 2 if self.quick and self.scene.solver.dynamic is not None else int(self.quick)

    def _apart(self, scene: Scene, other: Scene, coarser: int) -> float:
        between = self.shapes(scene, coarser) - self.shapes(other, coarser)
        return float(np.sqrt((between**2).sum(axis=2)).max())

    def shapes(self, scene: Scene, coarser: int = 0) -> Array:
        """Shapes of one variant; coarser: how many times its elements are halved."""
        key = tuple(scene.effects.named().items()), coarser  # nothing else differs
        if key not in self._found:
            self._found[key] = self._shapes(scene, coarser, QUICK_CLOSE if self.quick else FOLLOWED)
        return self._found[key]

    def _shapes(self, scene: Scene, coarser: int, close: float) -> Array:
        if scene.solver.dynamic is not None:
            path = move_rod(scene, coarser=coarser)
            return _at_stations(path.s, path.position)
        count = ELEMENTS // 2**coarser
        if scene.solver.quasi_static is None:
            shape = rest(scene, count, close=close)
            return _at_stations(shape.s, shape.position[None])
        return np.concatenate([_along(scene, time, count, close) for time in self._moments])

    @cached_property
    def _moments(self) -> list[float]:
        """Times (s) at which equilibria along time are compared, the same for all variants: equal parts, and the strongest load."""
        times = self.scene.path_times()
        chosen = {times[i] for i in np.linspace(0, len(times) - 1, MOMENTS).round().astype(int)}
        return sorted(chosen | ({strongest(self.scene)} if self.scene.effects.feed is None and len(chosen) < len(times) else set()))


def _along(scene: Scene, time: float, count: int, close: float) -> Array:
    """The shape (1, STATIONS, 3) of an equilibrium at a time; of a fed catheter, of its part outside the guide."""
    feed, whole = scene.effects.feed, scene
    if feed is None:
        shape = rest(scene, count, time, close)
        return _at_stations(shape.s, shape.position[None])
    if scene.field.varies and scene.effects.in_a_field:
        raise SolveError("a fed catheter in a field that varies in space is not estimated")
    outside = float(np.clip(scene.length + feed.speed * time - feed.exit, 0.0, scene.length))
    if outside <= scene.thickness:
        ahead = np.linspace(0.0, scene.length, STATIONS)
        return np.asarray(ahead[None, :, None] * [1.0, 0.0, 0.0])
    data = whole.to_si()
    data["solver"]["quasi_static"], data["effects"]["feed"] = None, None
    shape = rest(Scene.from_si(data).inserted(outside), count, time, close)
    return _at_stations(shape.s, shape.position[None])


def _at_stations(s: Array, position: Array) -> Array:
    """Positions (k, n, 3) at STATIONS equal parts of the length."""
    at = np.linspace(0.0, s[-1], STATIONS)
    right = np.clip(np.searchsorted(s, at), 1, len(s) - 1)
    share = ((at - s[right - 1]) / (s[right] - s[right - 1]))[:, None]
    return np.asarray((1 - share) * position[:, right - 1] + share * position[:, right])


def rest(scene: Scene, elements: int = ELEMENTS, time: float | None = None, close: float = FOLLOWED) -> RodShape:
    """The rod of a scene at rest; where it names magnetic_interaction, moved on by what that does to first order.

    time: s, of the field's schedule; its end unless given; close: as of solve_rod. Raises SolveError.
    """
    shape = solve_rod(scene, elements, time=time, close=close)
    if scene.effects.magnetic_interaction is None or len(scene.magnetized_regions()) < 2:
        return shape
    return replace(shape, position=shape.position + mutual_shift(scene, shape, elements))


def mutual_shift(scene: Scene, shape: RodShape, elements: int, across: int = 2) -> Array:
    """Shift (n + 1, 3) m of a rod's frames by the segments' field on each other, to first order: by its stiffness under its load.

    The generalized force on the turn of a frame is the torque on its moments, and of the force in the section on its arm.
    """
    body = scene.body.shape
    assert isinstance(body, StraightBody)
    rod = rod_model(scene.with_effects(magnetic_torque={}), elements)  # its moments, whether an outside field turns them or not
    named = rod.moment if scene.effects.magnetic_torque is not None else 0.0 * rod.moment
    n = len(rod.length)
    x, R = shape.position, shape.frames
    middle, turned = (x[1:] + x[:-1]) / 2, (R[1:] + R[:-1]) / 2
    mutual = MutualField(scene, segment_counts(body, elements), rod.length, across)
    field, pull, couple = mutual.at(middle, turned, rod.moment)
    beyond = np.concatenate([np.cumsum((pull * rod.length[:, None])[::-1], axis=0)[::-1], np.zeros((1, 3))])
    g, Hd, Ho = np.empty((n + 1, 3)), np.empty((n + 1, 3, 3)), np.empty((n, 3, 3))
    derivatives(shape.quaternions, rod.length, rod.twist_bend, rod.compliance, named, shape.field, shape.weight, g, Hd, Ho)
    force, half, tangent = np.zeros((n + 1, 3)), rod.length[:, None] / 2, np.array([1.0, 0.0, 0.0])
    for side in (slice(None, -1), slice(1, None)):
        b, w, c = (np.einsum("kji,kj->ki", R[side], load) for load in (field, (beyond[1:] + beyond[:-1]) / 2, couple))
        force[side] += half * (np.cross(rod.moment, b) + np.cross(tangent, w) + c)
    Ld, Lo = np.empty_like(Hd), np.empty_like(Ho)
    if not factor(Hd, Ho, 0.0, Ld, Lo):
        raise SolveError("the rod is at a critical load, where the segments' field on each other may move it anywhere")
    solve(Ld, Lo, force)
    slope = np.einsum("kij,kj->ki", R, np.cross(force, shape.strain))
    moved = np.zeros_like(x)
    np.cumsum(half * (slope[1:] + slope[:-1]), axis=0, out=moved[1:])
    return moved


def without_motion(scene: Scene) -> Scene:
    """The scene as an equilibrium: without the effects that only act in motion. A field without end stays, which no solve takes."""
    named = dict.fromkeys(NO_LOADS)
    solver = scene.solver.model_copy(update={"dynamic": None, "quasi_static": None})
    kept = scene.effects.model_copy(update=named)
    return scene.model_copy(update={"solver": solver, "effects": kept, "reference": None})


def exercise(scene: Scene) -> None:
    """Call every compiled function that estimates of a scene need, so that they are compiled; what it finds is not used."""
    if not isinstance(scene.body.shape, StraightBody):
        return
    if scene.solver.dynamic is not None:
        move_rod(scene)
    elif scene.body.shape.clamp == "base":
        shape = solve_rod(scene, ELEMENTS)
        mutual_shift(scene, shape, ELEMENTS)


def strongest(scene: Scene) -> float:
    """The time (s), of those of a path of equilibria, at which the field would bend the straight body the farthest if its shape followed
    the load in proportion; the first of those that are alike. Only torques count: where the field pulls most, it mostly turns most.

    Raises SolveError for a body that is no rod, SceneError for a field that can't be had.
    """
    rod, line = rod_model(scene.with_effects(magnetic_torque={}), TORQUE_ELEMENTS), scene.body.shape.line
    assert line is not None  # rod_model refuses other bodies
    field, times = scene.outside_field(), scene.path_times()
    x = np.array(line.base) + np.cumsum(rod.length)[:, None] * [1.0, 0.0, 0.0]
    bends = np.array([_deflection(rod, np.cross(rod.moment, field.at(x, time))) for time in times])
    return times[int(np.argmax(bends >= ALIKE * bends.max()))]


def _deflection(rod: RodModel, torque: Array) -> float:
    """Largest deflection (m) of a straight rod along x under torques (n, 3) N, per length, to first order."""
    beyond = np.cumsum((torque * rod.length[:, None])[::-1], axis=0)[::-1, 1:]  # about y and z, in each section
    turn = np.cumsum(beyond / rod.twist_bend[:, 1:] * rod.length[:, None], axis=0)
    return float(np.linalg.norm(np.cumsum(turn * rod.length[:, None], axis=0), axis=1).max())
