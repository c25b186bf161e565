"""Dynamic scenes for tests, and motions recorded at given times."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from reference.scenes import BR, G

from magmpm.bodies.signed_distance import DistanceTable
from magmpm.dynamics.time_loop import begin
from magmpm.dynamics.total_lagrangian import TotalMotion
from magmpm.effects import damping, feed, gravity, ground, viscosity, walls
from magmpm.effects.base import one_record
from magmpm.model import Model, build
from magmpm.scene import Scene

DENSITY = 1882.0


def moving_scene(
    body: dict[str, Any],
    effects: dict[str, Any],
    *,
    cells: int = 2,
    shear: float = G,
    duration: float = 1.0,
    **more: Any,
) -> Scene:
    """A scene with a body of the material `m`, or `stiff`, ten times as stiff, in SI. more: other keys of the scene."""
    material = {"shear_modulus": shear, "bulk_to_shear": 20.0, "density": DENSITY, "remanence": BR}
    materials = {
        "m": material,
        **({"stiff": {**material, "shear_modulus": 10 * shear}} if "stiff" in str(body) else {}),
    }
    about = {
        "name": "test",
        "solver": {"dynamic": {"duration": duration}},
        "resolution": {"cells_across": cells},
    }
    return Scene.from_si(
        {**about, "materials": materials, "body": body, "effects": effects, **more}
    )


def resting_scene(body: dict[str, Any], effects: dict[str, Any], **more: Any) -> Scene:
    """The same at equilibrium."""
    return moving_scene(body, effects, **{"solver": {"static": {}}, **more})


def block(size: Sequence[float], **strip: Any) -> dict[str, Any]:
    """A free block of this size (m); by default it stands on z = 0."""
    usual = {
        **dict(zip(("length", "width", "thickness"), size)),
        "material": "m",
        "clamp": "none",
        "position": [0.0, 0.0, size[2] / 2],
    }
    return {"strip": {**usual, "segments": [{"magnetization": [0.0, 0.0, 0.0]}], **strip}}


FAR = DistanceTable(np.full(3, 1.0), 1e-3, np.zeros((3, 3, 3)))  # m
NEUTRAL = (
    one_record(gravity.DTYPE, gravity=np.zeros(3)),
    one_record(viscosity.DTYPE, viscosity=0.0),
    one_record(damping.DTYPE, damping_rate=0.0),
    ground.parameters(point=[0, 0, -1], normal=[0, 0, 1], friction=0.0, stiffness=0.0),
    walls.parameters(FAR, friction=0.0, stiffness=0.0),
    one_record(feed.DTYPE, feed_speed=0.0, feed_exit=-1.0, feed_radius=0.0),
)


def filled(model: Model) -> Model:
    """The model plus the missing effects of motion at zero strength, so that one compiled kernel serves many tests."""
    having = {
        model.effects[k].dtype.names: model.effects[k : k + 2]
        for k in range(0, len(model.effects), 2)
    }
    named = [having.pop(neutral[0].dtype.names, neutral) for neutral in NEUTRAL]
    assert not having, "NEUTRAL knows them all"
    return replace(model, effects=tuple(part for pair in named for part in pair))


@dataclass
class Moment:
    """time s, x, v (n, 3), contacts: what each contact effect reports."""

    time: float
    x: np.ndarray
    v: np.ndarray
    contacts: dict[str, Any]


def follow(
    scene: Scene | Model, times: Sequence[float], motion: TotalMotion | None = None
) -> Iterator[Moment]:
    """The moments at the given times (s), from rest or from the state of `motion`."""
    model = filled(scene if isinstance(scene, Model) else build(scene))
    begun = begin(model)
    motion = begun.motion if motion is None else motion
    now = 0.0
    for time in times:
        steps = max(1, int(np.ceil((time - now) / begun.dt)))
        dt = (time - now) / steps
        left = steps
        while left:
            taken, broken = motion.advance(left, dt, model.effects)
            assert not broken, f"the motion broke before t = {time:g} s"
            left -= taken
        now = time
        x, v, _ = motion.particles()
        contacts = {}
        for key in ("ground", "walls"):
            if getattr(model.scene.effects, key) is not None:
                contacts[key] = model.scene.effects.named()[key].report(
                    model, motion.touching_points()
                )
        yield Moment(time, x, v, contacts)
