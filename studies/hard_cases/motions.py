"""Scenes of the hard cases, in SI, and bodies set in motion by hand, for cases that look closer than frames allow."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from magmpm.bodies.surface_mesh import Mesh
from magmpm.compiled.arrays import Array
from magmpm.dynamics import energies
from magmpm.dynamics.step_control import LIMIT
from magmpm.dynamics.time_loop import begin
from magmpm.dynamics.total_lagrangian import TotalMotion, take
from magmpm.effects import acting as effects
from magmpm.errors import SolveError
from magmpm.fields.dipole import MU0
from magmpm.materials import young_modulus
from magmpm.model import Model, build
from magmpm.scene import Scene

Affine = Callable[[Array], Array]
FACTOR = 1.0  # of the chosen step and of the stable one: controls raise it
# Pa, K/G, kg/m^3, T
G = 120e3
RATIO = 20.0
DENSITY = 1882.0
REMANENCE = 0.1
SILICONE = {"shear_modulus": G, "bulk_to_shear": RATIO, "density": DENSITY, "remanence": REMANENCE}
# m
LENGTH = 40e-3
DIAMETER = 4e-3
X = (1.0, 0.0, 0.0)
EULER = np.pi**2 / 4  # critical load of theta'' + load sin(theta) = 0, theta(0) = theta'(1) = 0
FIRST = 1.8751040687  # first root of cos(z) cosh(z) = -1: bending of a cantilever


def at_rest(scene: Scene) -> tuple[TotalMotion, float, float]:
    """The undeformed body, its chosen time step and the largest stable one, s. No step ends early because the body has grown stiffer than
    the step was chosen for: a run would find a new one, a case keeps its own.
    """
    moved = begin(build(scene))
    moved.motion.watch[LIMIT] = np.inf
    return moved.motion, FACTOR * moved.control.step, FACTOR * moved.stable.largest


def throw(motion: TotalMotion, velocity: Affine) -> None:
    """Give the undeformed body velocity(x) (m, 3) m/s at points x (m, 3) m."""
    free = motion.packed.nodes.inverse_mass > 0
    motion.v[:] = np.where(free, velocity(motion.packed.node_place).ravel(), 0.0)


def stretch(motion: TotalMotion, by: float) -> None:
    """Put the body, at rest, `by` times as large as it is."""
    free = motion.packed.nodes.inverse_mass > 0
    motion.u[:] = np.where(free, (by - 1.0) * motion.packed.node_place.ravel(), 0.0)


def advance(motion: TotalMotion, steps: int, dt: float, start: float = 0.0) -> None:
    """Take so many steps of dt (s) from time `start` (s). Raises SolveError where the motion breaks."""
    named = effects.collect(motion.model.scene, times=start + dt * np.arange(steps, dtype=float))
    taken, broken = take(motion, named, steps, dt)
    if broken or taken < steps:  # a step in which the body moves too far is the last one
        raise SolveError(
            f"the motion {'broke' if broken else 'was stopped'} at step {taken} of {steps}"
        )


def energy(motion: TotalMotion, time: float = 0.0) -> float:
    """Kinetic, elastic and the effects' potential energies together, J, of one moment. Raises SolveError where they are not finite."""
    now = motion.kinematics()
    model = motion.model
    elastic = energies.elastic_energy(model, now.F)
    found = (
        now.kinetic + elastic + sum(energies.effect_energies(model, now.x, now.F, time).values())
    )
    if not np.isfinite(found):
        raise SolveError("the energy of the motion is not finite")
    return found


def spin(motion: TotalMotion) -> Array:
    """Angular momentum (3,) about the origin, N m s."""
    place = motion.packed.node_place + motion.u.reshape(-1, 3)
    return np.asarray(
        np.cross(place, motion.packed.mass.momentum(motion.velocity().reshape(-1, 3))).sum(axis=0)
    )


def last_cells(model: Model) -> Array:
    """Weights (n,), of sum 1, of the particles of the last cells along x: what they average to stands for the tip."""
    last = model.particles.cell[:, 0] == model.particles.cell[:, 0].max()
    share = model.particles.volume * last
    return np.asarray(share / share.sum())


def made(
    body: Mapping[str, Any],
    materials: Mapping[str, Any],
    *,
    field: Mapping[str, Any],
    effects: Mapping[str, Any],
    solver: Mapping[str, Any] | None = None,
    cells: int | None = 2,
) -> Scene:
    """The scene of these data, an equilibrium unless `solver` says otherwise."""
    resolution = {} if cells is None else {"resolution": {"cells_across": cells}}
    parts = {
        "body": body,
        "materials": materials,
        "field": field,
        "effects": effects,
        "solver": solver or {"static": {}},
    }
    return Scene.from_si({"name": "hard case", **parts, **resolution})


def changed(scene: Scene, **parts: Any) -> Scene:
    """The scene with these parts of its data in place of its own."""
    return Scene.from_si({**scene.to_si(), **parts})


def rod(
    *,
    length: float = LENGTH,
    directions: Sequence[Sequence[float]] = (X,),
    shear: Sequence[float] | None = None,
    ratio: float = RATIO,
    field: Sequence[float] | None = None,
    cells: int = 2,
    clamp: str = "base",
    effects: Mapping[str, Any] | None = None,
    dynamic: Mapping[str, Any] | None = None,
) -> Scene:
    """A catheter 4 mm thick of equal segments with these magnetizations. field (3,) T; shear: Pa, one a segment."""
    moduli = [G] * len(directions) if shear is None else list(shear)
    kinds = {
        f"material {k}": {**SILICONE, "shear_modulus": g, "bulk_to_shear": ratio}
        for k, g in enumerate(moduli)
    }
    segments = [
        {"magnetization": list(d), "material": name}
        for d, name in zip(directions, kinds, strict=True)
    ]
    catheter = {
        "length": length,
        "diameter": DIAMETER,
        "material": "material 0",
        "clamp": clamp,
        "segments": segments,
    }
    return made(
        {"catheter": catheter},
        kinds,
        field={"uniform": [0.0, 0.0, 0.0] if field is None else [float(b) for b in field]},
        cells=cells,
        effects={**({} if field is None else {"magnetic_torque": {}}), **(effects or {})},
        solver=None if dynamic is None else {"dynamic": {"duration": 1.0, **dynamic}},
    )


def bending_field(load: float, angle: float = np.pi / 2, length: float = LENGTH) -> list[float]:
    """Field (3,) T at an angle to +x in the x-z plane, for a load M B A L^2/(E I) on a rod magnetized along its axis.

    Source: Wang et al., JMPS 142 (2020) 104045; A/I = 16/D^2.
    """
    E = young_modulus(G, RATIO * G)
    size = load * E * MU0 * DIAMETER**2 / (16 * REMANENCE * length**2)
    return [float(size * np.cos(angle)), 0.0, float(size * np.sin(angle))]


def twisting_field(load: float) -> list[float]:
    """Field (3,) T along z, for a load M B A L^2/(G J) on a rod magnetized along y; A/J = 8/D^2."""
    return [0.0, 0.0, load * G * MU0 * DIAMETER**2 / (8 * REMANENCE * LENGTH**2)]


def block(lower: tuple[float, float, float], upper: tuple[float, float, float]) -> Mesh:
    """The surface of a block between two corners, its triangles facing outward."""
    corners = np.array(
        [
            [(lower, upper)[i][0], (lower, upper)[j][1], (lower, upper)[k][2]]
            for i in (0, 1)
            for j in (0, 1)
            for k in (0, 1)
        ]
    )
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [[a, b, c] for a, b, c, _ in quads] + [[a, c, d] for a, _, c, d in quads]
    return Mesh(corners, np.array(faces))
