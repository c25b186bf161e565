"""What contact with anything has in common: the penalty force with Coulomb friction, its stiffness, and what is reported of it.

A particle of mass m that is `depth` inside the forbidden side is pushed back by m w^2 depth along the normal, from the energy
m w^2 depth^2 / 2. Friction opposes its sliding with at most friction times that, and at most what stops the particle's sliding within
the step (m speed / dt): it never turns a motion back, and takes energy out, never in. Sticking is this limit: what holds a body of mass M
against a force M a by particles of mass m in contact lets them creep at (M / m) a dt, 0.1 mm/s for a catheter on a slope at usual steps.

The penalty's frequency w is that of a pressure wave through a cell, w = sqrt((K + 4/3 G) / rho) / h, in the stiffest material: about a
quarter of what the body's own stiffest motion has. So contact never asks for a smaller step, and a body that lands with a speed far
below the wave's gives way by speed / w, a body at rest by g / w^2, times the number of particles above each that touches (its root
for the landing): micrometres. Source of the lumped bound used by `stable_step`: Hughes, The Finite Element Method, section 9.1.
"""

from __future__ import annotations

import math
from typing import Any, TypedDict

from magmpm.compiled.arrays import Array
from magmpm.compiled.jit import compiled
from magmpm.errors import SceneError, dotted
from magmpm.scene import Scene

THROWN = 0.1  # m/s
SHARE = 0.7  # of the explicit limit 2 / w: with it, 0.8 of the smaller of body's and contact's steps is stable for both at once


class Contact(TypedDict):
    """What an effect reports: force (3,) N on the body, number of particles that touch, deepest penetration m (0 where none)."""

    force: Array
    count: int
    depth: float


@compiled
def push(depth, n0, n1, n2, v, mass, dt, stiffness, friction, f):  # type: ignore[no-untyped-def]
    """f += mass stiffness depth n, and friction against what of v (m/s) is across n.

    n: unit normal out of the obstacle; stiffness 1/s^2; depth > 0 m.
    """
    normal = mass * stiffness * depth
    along = v[0] * n0 + v[1] * n1 + v[2] * n2
    t0, t1, t2 = v[0] - along * n0, v[1] - along * n1, v[2] - along * n2
    speed = math.sqrt(t0 * t0 + t1 * t1 + t2 * t2)
    drag = 0.0
    if speed > 0.0:
        drag = min(friction * normal / speed, mass / dt)
    f[0] += normal * n0 - drag * t0
    f[1] += normal * n1 - drag * t1
    f[2] += normal * n2 - drag * t2


def reach(scene: Scene, towards: Array | None = None) -> float:
    """How far the outermost particles are taken to be from the body's surface, m: a body touches when a particle is that near.

    towards: unit vector (3,) from the body to the obstacle, as the body lies at the start: the particles' depth that way. None: all
    ways, so that no obstacle the body just touches holds a particle already (see bodies.body_shape).
    """
    return scene.body.shape.depth(scene.resolution.cells_across, scene.resolution.particles_per_cell, towards)


def penalty(scene: Scene, factor: float) -> float:
    """w^2 in 1/s^2, times `factor`: of the stiffest material of the body's free regions."""
    used = [scene.materials[region.material_name] for region in scene.regions() if not region.held]
    squares = [m.shear_modulus * (m.bulk_to_shear + 4 / 3) / m.density for m in used if m.density is not None]
    return factor * max(squares, default=0.0) / scene.cell ** 2


def stable_step(stiffness: float) -> float:
    """Largest stable step (s) of a penalty of this stiffness w^2 (1/s^2), beside a body at its own limit."""
    return SHARE * 2.0 / math.sqrt(stiffness) if stiffness > 0 else math.inf


def place(model: Any, particle: int) -> str:
    """Which region of the body a particle is in, and where, in words: "segment 2 (body.catheter.segments[1]), at (12, 0, -2) mm"."""
    region = model.scene.regions()[model.particles.segment[particle]]
    at = ", ".join(f"{c:.3g}" for c in 1e3 * model.particles.position[particle] + 0.0)
    return f"{region.name} ({dotted(('body', *region.at))}), at ({at}) mm"


def refuse_overlap(key: str, obstacle: str, model: Any, particle: int, depth: float, energy: float, remedy: str) -> None:
    """A body that begins within an obstacle would be thrown out of it: SceneError where that is faster than THROWN.

    key: of the effect; obstacle: in words; particle: the deepest, depth m; energy J: of the contact.
    """
    mass = float(model.density @ model.particles.volume)
    speed = math.sqrt(2.0 * energy / mass) if mass > 0 else 0.0
    if speed > THROWN:
        raise SceneError(
            f"effects.{key}",
            found=f"the body begins {1e3 * depth:.3g} mm inside {obstacle}, deepest with {place(model, particle)}, and would be thrown "
            f"out at {speed:.2g} m/s",
            rule="a body must begin clear of it, or just touching",
            remedy=f"{remedy}, by {1e3 * depth:.3g} mm or more",
        )
