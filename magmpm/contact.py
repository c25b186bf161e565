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
from dataclasses import dataclass

from magmpm.basis import Array
from magmpm.bodies import gauss
from magmpm.jit import compiled
from magmpm.scene import Scene

SHARE = 0.7  # of the explicit limit 2 / w: with it, 0.8 of the smaller of body's and contact's steps is stable for both at once


@dataclass(frozen=True)
class Contact:
    """What an effect reports: force (3,) N on the body, number of particles that touch, deepest penetration m (0 where none)."""

    force: Array
    count: int
    deepest: float


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


def cell_size(scene: Scene) -> float:
    """Side of a grid cell across the body, m."""
    return scene.thickness / scene.resolution.cells_across


def reach(scene: Scene) -> float:
    """How far the outermost particles are from the body's surface, m: a body touches when a particle is that near."""
    outermost = gauss(scene.resolution.particles_per_cell)[0].max() / math.sqrt(12.0)
    return cell_size(scene) * (0.5 - float(outermost))


def penalty(scene: Scene, factor: float) -> float:
    """w^2 in 1/s^2, times `factor`: of the stiffest of the scene's materials."""
    squares = [
        m.shear_modulus * (m.bulk_to_shear + 4 / 3) / m.density
        for m in scene.materials.values()
        if m.density is not None
    ]
    return factor * max(squares, default=0.0) / cell_size(scene) ** 2


def stable_step(stiffness: float) -> float:
    """Largest stable step (s) of a penalty of this stiffness w^2 (1/s^2), beside a body at its own limit."""
    return SHARE * 2.0 / math.sqrt(stiffness) if stiffness > 0 else math.inf
