"""Scenes of the hard cases, in SI, and bodies set in motion by hand, for cases that look closer than frames allow."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from magmpm.bodies.surface_mesh import Mesh
from magmpm.compiled.arrays import Array, Named
from magmpm.dynamics import energies
from magmpm.dynamics.step_control import LIMIT
from magmpm.dynamics.time_loop import begin
from magmpm.dynamics.total_lagrangian import TotalMotion, take
from magmpm.effects import acting as effects
from magmpm.errors import SolveError
from magmpm.fields.dipole import MU0
from magmpm.inputs.vectors import Vector
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
CATHETER_LENGTH = 40e-3
DIAMETER = 4e-3
X = (1.0, 0.0, 0.0)
EULER = np.pi**2 / 4  # critical load of theta'' + load sin(theta) = 0, theta(0) = theta'(1) = 0
FIRST_ROOT = 1.8751040687  # first root of cos(z) cosh(z) = -1: bending of a cantilever


def at_rest(scene: Scene) -> tuple[TotalMotion, float, float]:
    """Make the motion of the undeformed body.

    No step ends early because the body has grown stiffer than the step was chosen for: a run would
    find a new one, a case keeps its own.

    Parameters
    ----------
    scene : Scene
        The scene.

    Returns
    -------
    motion : TotalMotion
        The body.
    step : float, s
        The time step that a run chooses.
    largest : float, s
        The largest stable one.
    """
    moved = begin(build(scene))
    moved.motion.watch[LIMIT] = np.inf
    return moved.motion, FACTOR * moved.control.step, FACTOR * moved.stable.largest


def throw(motion: TotalMotion, velocity: Affine) -> None:
    """Give the undeformed body a velocity.

    Parameters
    ----------
    motion : TotalMotion
        The body.
    velocity : Affine
        From points (m, 3) m to velocities (m, 3) m/s.
    """
    free = motion.packed.nodes.inverse_mass > 0
    motion.v[:] = np.where(free, velocity(motion.packed.node_place).ravel(), 0.0)


def stretch(motion: TotalMotion, by: float) -> None:
    """Put the body, at rest, into another size.

    Parameters
    ----------
    motion : TotalMotion
        The body.
    by : float, no unit
        How many times as large.
    """
    free = motion.packed.nodes.inverse_mass > 0
    motion.u[:] = np.where(free, (by - 1.0) * motion.packed.node_place.ravel(), 0.0)


def advance(motion: TotalMotion, steps: int, dt: float, start: float = 0.0) -> None:
    """Take time steps.

    Parameters
    ----------
    motion : TotalMotion
        The body.
    steps : int
        How many.
    dt : float, s
        Each of them.
    start : float, s, default 0.0
        Time of the first.

    Raises
    ------
    SolveError
        Where the motion breaks.
    """
    named = effects.collect(motion.model.scene, times=start + dt * np.arange(steps, dtype=float))
    taken, broken = take(motion, named, steps, dt)
    if broken or taken < steps:  # a step in which the body moves too far is the last one
        raise SolveError(
            f"the motion {'broke' if broken else 'was stopped'} at step {taken} of {steps}"
        )


def energy(motion: TotalMotion, time: float = 0.0) -> float:
    """Find the kinetic, elastic and the effects' potential energies together, of one moment.

    Parameters
    ----------
    motion : TotalMotion
        The body.
    time : float, s, default 0.0
        The moment, of the field's schedule.

    Returns
    -------
    float, J
        Their sum.

    Raises
    ------
    SolveError
        Where they are not finite.
    """
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
    """Find the angular momentum about the origin.

    Parameters
    ----------
    motion : TotalMotion
        The body.

    Returns
    -------
    array (3,), N m s
        The angular momentum.
    """
    place = motion.packed.node_place + motion.u.reshape(-1, 3)
    return np.asarray(
        np.cross(place, motion.packed.mass.momentum(motion.velocity().reshape(-1, 3))).sum(axis=0)
    )


def last_cells(model: Model) -> Array:
    """Find weights by which particles of the last cells along x stand for the tip.

    Parameters
    ----------
    model : Model
        The body.

    Returns
    -------
    array (n,), no unit
        Weights of the particles; they sum to 1.
    """
    last = model.particles.cell[:, 0] == model.particles.cell[:, 0].max()
    share = model.particles.volume * last
    return np.asarray(share / share.sum())


def made(
    body: Named,
    materials: Named,
    *,
    field: Named,
    effects: Named,
    solver: Named | None = None,
    cells: int | None = 2,
) -> Scene:
    """Make a scene of its parts: an equilibrium unless the solver says otherwise.

    Parameters
    ----------
    body : Mapping[str, Any]
        As in a scene file, in SI.
    materials : Mapping[str, Any]
        As in a scene file, in SI.
    field : Mapping[str, Any]
        As in a scene file, in SI.
    effects : Mapping[str, Any]
        As in a scene file, in SI.
    solver : Mapping[str, Any], optional
        As in a scene file, in SI.
    cells : int or None, default 2
        Cells across; None: the usual number.

    Returns
    -------
    Scene
        The scene.
    """
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
    """Put other parts into a scene's data.

    Parameters
    ----------
    scene : Scene
        The scene.
    **parts : object
        Data by key, in SI.

    Returns
    -------
    Scene
        The other scene.
    """
    return Scene.from_si({**scene.to_si(), **parts})


def rod(
    *,
    length: float = CATHETER_LENGTH,
    directions: Sequence[Sequence[float]] = (X,),
    ratio: float = RATIO,
    field: Sequence[float] | None = None,
    cells: int = 2,
    clamp: str = "base",
    effects: Named | None = None,
    dynamic: Named | None = None,
) -> Scene:
    """Make the scene of a catheter 4 mm thick of equal segments.

    Parameters
    ----------
    length : float, m
        Of the catheter.
    directions : sequence of sequence of float, default (X,)
        Magnetization of each segment.
    ratio : float, no unit
        Bulk over shear modulus.
    field : sequence (3,) of float, T, optional
        The uniform field.
    cells : int, default 2
        Cells across.
    clamp : str, default 'base'
        The face that is held: "base" or "none".
    effects : Mapping[str, Any], optional
        As in a scene file, in SI; besides magnetic_torque, which acts where there is a field.
    dynamic : Mapping[str, Any], optional
        As in a scene file, in SI: a motion in place of an equilibrium.

    Returns
    -------
    Scene
        The scene.
    """
    catheter = {
        "length": length,
        "diameter": DIAMETER,
        "material": "silicone",
        "clamp": clamp,
        "segments": [{"magnetization": list(direction)} for direction in directions],
    }
    return made(
        {"catheter": catheter},
        {"silicone": {**SILICONE, "bulk_to_shear": ratio}},
        field={"uniform": [0.0, 0.0, 0.0] if field is None else [float(b) for b in field]},
        cells=cells,
        effects={**({} if field is None else {"magnetic_torque": {}}), **(effects or {})},
        solver=None if dynamic is None else {"dynamic": {"duration": 1.0, **dynamic}},
    )


def with_modulus(scene: Scene, segments: Sequence[int], shear: float) -> Scene:
    """Make the scene of a rod in which some segments are softer or stiffer.

    Parameters
    ----------
    scene : Scene
        As `rod` makes it.
    segments : sequence of int
        Their numbers, from 0 at the base.
    shear : float, Pa
        Their shear modulus.

    Returns
    -------
    Scene
        The other scene.
    """
    data = scene.to_si()
    data["materials"]["other"] = {**data["materials"]["silicone"], "shear_modulus": shear}
    for number in segments:
        data["body"]["catheter"]["segments"][number]["material"] = "other"
    return Scene.from_si(data)


def bending_field(
    load: float, angle: float = np.pi / 2, length: float = CATHETER_LENGTH
) -> list[float]:
    """Find the field in the x-z plane for a load M B A L^2/(E I) on a rod magnetized along its axis; A/I = 16/D^2.

    Parameters
    ----------
    load : float, no unit
        The load.
    angle : float, rad, optional
        From +x; a right angle unless given.
    length : float, m, optional
        Of the rod.

    Returns
    -------
    list of float, T
        The field's components.

    References
    ----------
    Wang et al., JMPS 142 (2020) 104045.
    """
    E = young_modulus(G, RATIO * G)
    size = load * E * MU0 * DIAMETER**2 / (16 * REMANENCE * length**2)
    return [float(size * np.cos(angle)), 0.0, float(size * np.sin(angle))]


def twisting_field(load: float) -> list[float]:
    """Find the field along z for a load M B A L^2/(G J) on a rod magnetized along y; A/J = 8/D^2.

    Parameters
    ----------
    load : float, no unit
        The load.

    Returns
    -------
    list of float, T
        The field's components.
    """
    return [0.0, 0.0, load * G * MU0 * DIAMETER**2 / (8 * REMANENCE * CATHETER_LENGTH**2)]


def block(lower: Vector, upper: Vector) -> Mesh:
    """Make the surface of a block, its triangles facing outward.

    Parameters
    ----------
    lower : Vector
        A corner.
    upper : Vector
        The opposite corner, of larger coordinates.

    Returns
    -------
    Mesh
        The surface.
    """
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
