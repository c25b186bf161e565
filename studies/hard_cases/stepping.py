"""Hard cases of the time step: sudden loads, steps at the edge, stiff materials."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.dynamics.time_loop import begin, integrate, move
from magmpm.dynamics.total_lagrangian import TotalMotion
from magmpm.errors import SolveError
from magmpm.model import build
from magmpm.scene import Scene
from magmpm.simulate import run
from magmpm.studies.hard_cases.case import Case
from magmpm.studies.hard_cases.motions import advance, at_rest, energy, last_cells, spin, throw
from magmpm.studies.hard_cases.scenes import G, bending_field, rod

STEPS = 100_000
SHORT = 4 * 4e-3  # m
SHAKE = 0.2  # m/s


def _energy_kept(motion: TotalMotion, dt: float, steps: int, looks: int) -> float:
    """Largest change of the energy since the first check, over the largest kinetic energy."""
    begun, change, most = energy(motion), 0.0, 0.0
    for _ in range(looks):
        advance(motion, steps // looks, dt)
        change, most = max(change, abs(energy(motion) - begun)), max(most, motion.kinetic_energy())
    return change / most


def _switched_on(scene: Scene) -> float:
    motion, dt, _ = at_rest(scene)
    return _energy_kept(motion, dt, int(0.1 / dt), 100)


def _shaken(scene: Scene) -> tuple[TotalMotion, float]:
    """A free body that rotates and vibrates in all its modes, and its largest stable step."""
    motion, _, largest = at_rest(scene)
    noise = np.random.default_rng(0)

    def velocity(x: Array) -> Array:
        return np.cross([0.0, 30.0, 0.0], x) + SHAKE * noise.standard_normal(x.shape)

    throw(motion, velocity)
    return motion, largest


def _stays(part: float) -> Callable[[Scene], float]:
    def measure(scene: Scene) -> float:
        """Change of the energy over 10^5 steps of a part of the bound, over the energy at first; at least that of the spin."""
        motion, bound = _shaken(scene)
        advance(motion, 64, part * bound)
        begun, turning, most = energy(motion), spin(motion), 0.0
        for _ in range(50):
            advance(motion, STEPS // 50, part * bound)
            most = max(most, abs(energy(motion) / begun - 1))
        return max(most, float(np.linalg.norm(spin(motion) - turning) / np.linalg.norm(turning)))

    return measure


def _detected(part: float) -> Callable[[Scene], float]:
    def measure(scene: Scene) -> float:
        """Steps until a motion is stopped; infinite if it never is, or if the message does not name the key to change."""
        moved = begin(build(scene))
        bound = moved.stable.largest
        moved.control.step = part * bound  # what a scene may not ask for
        try:
            integrate(moved)
        except SolveError as error:
            state = error.state
            named = all(word in error.reason for word in ("step", "t =", "time_step", f"{bound:.3g}"))
            kept = state is not None and bool(np.isfinite(state.x).all())
            return float(error.reason.split()[1].rstrip(",")) if named and kept else math.inf
        return math.inf

    return measure


def _settled(scene: Scene) -> float:
    """Distance of the tip from that of statics, over L."""
    still = run(Scene.from_si({**scene.to_si(), "solver": {"static": {}}, "effects": _static(scene)}))
    model = build(scene)
    moved = move(model)
    return float(np.linalg.norm(last_cells(model) @ (moved.x - still.particle_position))) / scene.length


def _static(scene: Scene) -> dict[str, object]:
    return {**scene.to_si()["effects"], "damping": None, "viscosity": None}


def _settling(load: float, **body: object) -> Scene:
    return rod(
        field=bending_field(load), effects={"damping": {"rate": 60.0}}, dynamic={"duration": 0.35}, **body  # type: ignore[arg-type]
    )


def _too_long() -> Scene:
    moving = {"duration": 2.0, "output_every": 0.01, "time_step": 1e-6}
    return rod(length=SHORT, field=bending_field(2.0, length=SHORT), dynamic=moving)


CASES = (
    Case(
        "field switched on at once",
        lambda: rod(field=bending_field(10.0), dynamic={}),
        "blows up on the first swing, or loses it",
        "change of all energies over 0.1 s, over the largest kinetic",
        _switched_on,
        0.01,
        "nothing does work: a constant field has a potential",
    ),
    Case(
        "time step 0.9 of the bound",
        lambda: rod(length=SHORT, clamp="none", dynamic={}),
        "gains energy slowly, or loses it, or its spin",
        "change in 10^5 steps of energy or of spin, over those at first",
        _stays(0.9),
        0.1,
        "symplectic Euler below 2/omega: the energy of a mode swings, and does not grow",
    ),
    Case(
        "time step 1.2 of the bound",
        _too_long,
        "ends with values that are not finite, or with wrong ones",
        "steps until it is stopped, with its reason and last good state",
        _detected(1.2),
        40.0,
        "the fastest mode grows 3.5-fold a step, by x + sqrt(x^2 - 1), x = 2 1.2^2 - 1: from rounding to 1 in 30",
    ),
    Case(
        "K/G = 500 in motion",
        lambda: _settling(2.0, ratio=500.0),
        "locks, or needs a step for which it was not asked",
        "settled tip from statics, over L",
        _settled,
        0.002,
        "statics by Newton's method on the same particles",
    ),
    Case(
        "stiffness contrast 1:100",
        lambda: rod(
            directions=[(1.0, 0.0, 0.0), (0.0, 0.0, 1.0)] * 2,
            shear=[G, G / 100, G, G / 100],
            field=[0.0, 0.0, 0.1e-3],
            effects={"damping": {"rate": 12.0}},
            dynamic={"duration": 2.0, "output_every": 0.1},
        ),
        "takes the soft neighbor's step, or tears at the joint",
        "settled tip from statics, over L",
        _settled,
        0.002,
        "statics by Newton's method on the same particles",
        slow=True,
    ),
)
