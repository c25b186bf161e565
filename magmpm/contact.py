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
from functools import lru_cache
from typing import TypedDict

import numpy as np

from magmpm.basis import Array
from magmpm.bodies import gauss, rod_grid, rod_particles
from magmpm.errors import InputError
from magmpm.jit import compiled
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


def cell_size(scene: Scene) -> float:
    """Side of a grid cell across the body, m."""
    parts = scene.body.parts
    if parts is not None and parts.spacing is not None:
        return parts.spacing
    return scene.thickness / scene.resolution.cells_across


def reach(scene: Scene) -> float:
    """How far the outermost particles are taken to be from the body's surface, m: a body touches when a particle is that near.

    Of a strip's flat face it is the outermost Gauss points' distance. Of a round catheter it is the least around the section, so that it
    may lie on a plane at any angle without an overlap; where the particles lie deeper, it is let in by up to a quarter of a cell. STL
    parts, which are anything, touch at a tenth of a cell.
    """
    catheter, count = scene.body.catheter, scene.resolution.particles_per_cell
    if catheter is not None:
        return _reach_of_ring(
            catheter.diameter, catheter.inner_diameter, scene.resolution.cells_across, count
        )
    if scene.body.parts is not None:
        return 0.1 * cell_size(scene)
    return cell_size(scene) * (0.5 - float(gauss(count)[0].max()) / math.sqrt(12.0))


@lru_cache(maxsize=8)
def _reach_of_ring(diameter: float, inner: float, cells: int, count: int) -> float:
    length = 3 * diameter / cells
    grid = rod_grid(length, diameter, cells, 3)
    particles = rod_particles(
        grid, outer=diameter / 2, inner=inner / 2, segment_ends=np.array([length]), particles_per_cell=count
    )
    _, y, z = particles.position.T
    return diameter / 2 - float(np.hypot(y, z).max())


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


def refuse_overlap(key: str, depth: float, energy: float, mass: float, remedy: str) -> None:
    """A body that begins within an obstacle would be thrown out of it: InputError where that is faster than THROWN.

    depth m: its deepest; energy J: of the contact; mass kg: of the body.
    """
    speed = math.sqrt(2.0 * energy / mass) if mass > 0 else 0.0
    if speed > THROWN:
        raise InputError(
            f"effects.{key}: the body begins {1e3 * depth:.3g} mm inside, and would be thrown out at {speed:.2g} m/s\n"
            f"  rule: a body must begin clear of it, or just touching\n  remedy: {remedy}, by {1e3 * depth:.3g} mm or more"
        )
