"""Contact law common to all obstacles: the penalty force with Coulomb friction, its stiffness, checks and reports.

A particle of mass m at a depth inside the obstacle is pushed back along the normal by the force m w^2 depth, with the energy
m w^2 depth^2 / 2. Friction holds it by a spring of the same stiffness, up to friction times that force (effects.contact_force).

The frequency w of the penalty is that of a pressure wave through a cell of the stiffest material, w = sqrt((K + 4/3 G) / rho) / h, about
a quarter of the body's highest frequency. So contact does not require a smaller step. A body at rest sinks in by g / w^2 times the number
of particles above each one in contact; a body that lands, by speed / w times the root of that number: micrometers. Source of the lumped
bound used by `stable_step`: Hughes, The Finite Element Method, section 9.1.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
from pydantic import Field

from magmpm.compiled.arrays import Array
from magmpm.compiled.jit import compiled
from magmpm.effects.base import Contact, Effect, Records, SceneLike
from magmpm.effects.contact_force import PARTS, hold
from magmpm.effects.hooks import add_contact, near_of
from magmpm.errors import SceneError, dotted

THROWN = 0.1  # m/s
SHARE = 0.7  # of the explicit limit 2 / w: 0.8 of the smaller of the body's and the contact's bounds is then stable for both together


Friction = Annotated[
    float,
    Field(
        strict=True,
        ge=0,
        le=10,
        allow_inf_nan=False,
        description="Coulomb's coefficient of friction; 0, slippery, unless given.",
        examples=[0.3],
    ),
]
Stiffness = Annotated[
    float,
    Field(
        strict=True,
        gt=0,
        le=100,
        allow_inf_nan=False,
        description="Times the usual stiffness of the contact, which lets the body in by micrometers; 1 unless given. "
        "Above about 8 the contact asks for a smaller time step than the body.",
        examples=[1.0],
    ),
]


def reach(scene: SceneLike, toward: Array | None = None) -> float:
    """Distance of the outermost particles from the body's surface, m: the body touches when a particle is that near.

    toward: unit vector (3,) from the undeformed body to the obstacle, to get the depth in that direction. None: in all directions, so
    that an obstacle that just touches the body contains no particle yet (see bodies.body_shape).
    """
    return scene.body.shape.depth(scene.resolution.cells_across, scene.resolution.particles_per_cell, toward)


def penalty(scene: SceneLike, factor: float) -> float:
    """w^2 in 1/s^2, times `factor`, for the stiffest material of the body's free regions."""
    used = [scene.materials[region.material_name] for region in scene.regions() if not region.held]
    squares = [m.shear_modulus * (m.bulk_to_shear + 4 / 3) / m.density for m in used if m.density is not None]
    return factor * max(squares, default=0.0) / scene.cell ** 2


def stable_step(stiffness: float, friction: float) -> float:
    """Largest stable step (s) of a penalty of this stiffness w^2 (1/s^2), together with a body at its own limit; with friction, times
    sqrt(1 + z^2) - z for a dashpot of z = 1 times the critical damping (Belytschko, section 6.6)."""
    damped = math.sqrt(2.0) - 1.0 if friction > 0 else 1.0
    return damped * SHARE * 2.0 / math.sqrt(stiffness) if stiffness > 0 else math.inf


def place(model: Any, particle: int) -> str:
    """Region and position of a particle, in words: "segment 2 (body.catheter.segments[1]), at (12, 0, -2) mm"."""
    region = model.scene.regions()[model.particles.segment[particle]]
    at = ", ".join(f"{c:.3g}" for c in 1e3 * model.particles.position[particle] + 0.0)
    return f"{region.name} ({dotted(('body', *region.at))}), at ({at}) mm"


@compiled
def _touching(named, x, v, mass, dt, anchor, force):
    """Number in contact, the deepest one (-1: none) and how deep it is (m), sum of mass depth^2 (kg m^2); adds to force (3,) N and moves
    anchors (n, 3) m."""
    count, worst, deepest, squares, f = 0, -1, 0.0, 0.0, np.empty(PARTS)
    for p in range(len(mass)):
        depth = near_of(named, x[p])
        if depth > 0.0:
            f[:] = 0.0
            add_contact(named, 0, x[p], v[p], mass[p], dt, f)
            hold(x[p], anchor[p], f)
            force += f[:3]
            count += 1
            if depth > deepest:
                worst, deepest = p, depth
            squares += mass[p] * depth**2
    return count, worst, deepest, squares


def contact_of(named: Records, x: Array, v: Array, mass: Array, dt: float, anchor: Array | None = None) -> Contact:
    """Contact of particles at x (n, 3) m with velocities v (n, 3) m/s and mass (n,) kg, in steps of dt (s); named: of one effect.

    anchor (n, 3) m: where friction holds them; None: where they are, without friction.
    """
    force = np.zeros(3)
    count, _, deepest, _ = _touching(named, x, v, mass, dt, np.array(x if anchor is None else anchor), force)
    return Contact(force=force, count=count, depth=deepest)


class Obstacle(Effect):
    """Obstacle that a body presses on and slides over. Its hook `near` is the depth of a particle in it, and `contact` pushes by `push`."""

    PHASE = "contact"
    ONLY_IN_MOTION = True
    WORDS: ClassVar[str]  # what it is, in messages
    CLEAR: ClassVar[str]  # how to get the body out of it

    if TYPE_CHECKING:  # each obstacle has them as its last keys
        friction: Friction
        stiffness: Stiffness

    def stable_step(self, model: Any) -> float:
        """Largest stable step, s."""
        return stable_step(penalty(model.scene, self.stiffness), self.friction)

    def report(self, model: Any, x: Array, v: Array, dt: float, anchor: Array) -> Contact:
        """Contact of the model's particles at x (n, 3) m with velocities v (n, 3) m/s, in steps of dt (s), held at anchor (n, 3) m."""
        return contact_of(self.records(model.scene), x, v, model.density * model.particles.volume, dt, anchor)

    def check(self, model: Any) -> None:
        """Raises SceneError where the body begins so deep in the obstacle that it would be thrown out faster than THROWN."""
        x, masses = model.particles.position, model.density * model.particles.volume
        _, particle, depth, squares = _touching(self.records(model.scene), x, 0 * x, masses, 1.0, x.copy(), np.zeros(3))
        energy, mass = 0.5 * penalty(model.scene, self.stiffness) * squares, float(model.density @ model.particles.volume)
        speed = math.sqrt(2.0 * energy / mass) if mass > 0 else 0.0
        if speed > THROWN:
            raise SceneError(
                f"effects.{self.key()}",
                found=f"the body begins {1e3 * depth:.3g} mm inside {self.WORDS}, deepest with {place(model, particle)}, and would be "
                f"thrown out at {speed:.2g} m/s",
                rule="a body must begin clear of it, or just touching",
                remedy=f"{self.CLEAR}, by {1e3 * depth:.3g} mm or more",
            )
