"""ground: contact with a plane that the body may press on, stick to and slide over, with Coulomb friction.

Force, friction, stiffness and what a body sinks in: see effects.contact_law. The body touches when an outermost particle is as near to the
plane as it is to the body's own surface that way at the start (`ground_reach`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from magmpm.compiled.jit import compiled
from magmpm.effects import contact_law as law
from magmpm.effects.body_reach import body_reach, unreached
from magmpm.effects.contact_law import Contact, push
from magmpm.effects.estimates import Advice, Body, obstacle
from magmpm.effects.hooks import NO_DATA, register
from magmpm.scene import Scene

PHASE = "contact"
DTYPE = np.dtype(
    [
        ("ground_point", np.float64, (3,)),
        ("ground_normal", np.float64, (3,)),
        ("ground_friction", np.float64),
        ("ground_stiffness", np.float64),
        ("ground_reach", np.float64),
    ]
)


def parameters(
    *, point: ArrayLike, normal: ArrayLike, friction: float, stiffness: float, reach: float = 0.0
) -> tuple[NDArray[Any], ...]:
    """What kernels take. point (3,) m on the plane; normal (3,) into the free side, any length; stiffness w^2 1/s^2; reach m."""
    record = np.zeros(1, DTYPE)
    n = np.asarray(normal, dtype=float)
    record["ground_point"], record["ground_normal"] = point, n / np.linalg.norm(n)
    record["ground_friction"], record["ground_stiffness"] = friction, stiffness
    record["ground_reach"] = reach
    return record, NO_DATA


def of_scene(scene: Scene, strength: float, times: NDArray[np.float64] | None) -> tuple[NDArray[Any], ...]:
    """What kernels take."""
    settings = scene.effects.ground
    if settings is None:
        return ()
    return parameters(
        point=settings.point,
        normal=settings.normal,
        friction=settings.friction,
        stiffness=law.penalty(scene, settings.stiffness),
        reach=law.reach(scene, -np.array(settings.normal)),
    )


def stable_step(record: NDArray[Any], data: NDArray[np.float64], model: Any) -> float:
    """Largest stable step, s."""
    return law.stable_step(float(record["ground_stiffness"].max()))


def advice(scene: Scene, body: Body) -> Advice:
    """Whether the body's rest, were the plane not there, would be through it."""
    named = scene.effects.ground
    if named is None:
        return Advice(None, "no plane is given")
    point, normal = np.array(named.point), np.array(named.normal)
    return obstacle(scene, body, lambda points: (points - point) @ normal, "above it")


def warnings(scene: Scene) -> list[str]:
    """Where the plane is too far away to be touched."""
    named, reach = scene.effects.ground, body_reach(scene)
    if named is None:
        return []
    height = (reach.base - np.array(named.point)) @ np.array(named.normal)
    found = unreached("ground", "the ground", reach, height)
    return [] if found is None else [found]


@compiled
def depth(effect, x):  # type: ignore[no-untyped-def]
    """How far (m) the body's surface at a particle at x is below the plane; negative above it."""
    p, n = effect.ground_point, effect.ground_normal
    return effect.ground_reach - ((x[0] - p[0]) * n[0] + (x[1] - p[1]) * n[1] + (x[2] - p[2]) * n[2])


@compiled
def near(effect, data, x):  # type: ignore[no-untyped-def]
    """How far a particle at x is in it, m."""
    return depth(effect, x)


@compiled
def contact(effect, data, x, v, mass, dt, f):  # type: ignore[no-untyped-def]
    """f += the plane's push and friction, N."""
    below = depth(effect, x)
    if below > 0.0:
        n = effect.ground_normal
        push(below, n[0], n[1], n[2], v, mass, dt, effect.ground_stiffness, effect.ground_friction, f)


@compiled
def _touching(effect, data, x, v, mass, dt, force):  # type: ignore[no-untyped-def]
    """Number in contact, the deepest one (-1: none) and how deep it is (m), energy (J); adds to force (3,) N."""
    count, worst, deepest, squares = 0, -1, 0.0, 0.0
    for p in range(len(mass)):
        below = depth(effect, x[p])
        if below > 0.0:
            contact(effect, data, x[p], v[p], mass[p], dt, force)
            count += 1
            if below > deepest:
                worst, deepest = p, below
            squares += mass[p] * below**2
    return count, worst, deepest, 0.5 * effect.ground_stiffness * squares


def report(
    record: NDArray[Any],
    data: NDArray[np.float64],
    x: NDArray[np.float64],
    v: NDArray[np.float64],
    mass: NDArray[np.float64],
    dt: float,
) -> Contact:
    """Contact of particles at x (n, 3) m with velocities v (n, 3) m/s and mass (n,) kg, in steps of dt (s)."""
    force = np.zeros(3)
    count, _, deepest, _ = _touching(record[0], data, x, v, mass, dt, force)
    return Contact(force=force, count=count, depth=deepest)


def check(record: NDArray[Any], data: NDArray[np.float64], model: Any) -> None:
    """Raises SceneError where the body begins below the plane."""
    x, mass = model.particles.position, model.density * model.particles.volume
    _, worst, deepest, energy = _touching(record[0], data, x, 0 * x, mass, 1.0, np.zeros(3))
    remedy = "move the plane's `point` away from the body"
    law.refuse_overlap("ground", "the ground", model, worst, deepest, energy, remedy)


register(DTYPE, wide=("near",), contact=contact, near=near)
