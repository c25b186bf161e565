"""Estimates of a straight body that is held at its base alone, from its rod at rest: kinks of a tube, its first frequency, its weight."""

import numpy as np

from magmpm.bodies.segments import StraightBody
from magmpm.effects.acting import NO_LOADS
from magmpm.effects.gravity import Gravity
from magmpm.errors import SolveError
from magmpm.materials import poisson_ratio
from magmpm.rod.cosserat import rod_model, solve_rod
from magmpm.scene import Scene


def is_cantilever(scene: Scene) -> bool:
    """True if the scene's body is straight and held at its base alone: its rest can be taken as a rod's."""
    shape = scene.body.shape
    return isinstance(shape, StraightBody) and shape.clamp == "base"


def kink_warning(scene: Scene) -> str | None:
    """A warning, in milliseconds and before any equilibrium is solved, that a tube at rest will kink; None where it will not.

    A tube bears at most M = (2 sqrt(2)/9) pi E r t^2 / sqrt(1 - nu^2) (Brazier 1927), two thirds of the moment that its round section would
    have at Catheter.kink_radius. Its rod has the moments of the round section. Near the clamp it stays round: moments beyond count.
    """
    # (2 sqrt(2)/9) / (sqrt(2)/3): the largest moment of a tube that flattens, over that of a round one at the same curvature
    borne = 2 / 3
    tube = scene.body.catheter
    if tube is None or not tube.hollow or not scene.static or not is_cantilever(scene):
        return None
    try:
        rod = solve_rod(scene)
    except SolveError:
        return None
    used = [scene.materials[region.material_name] for region in scene.regions()]
    limit = tube.kink_radius(
        max(poisson_ratio(m.shear_modulus, m.shear_modulus * m.bulk_to_shear) for m in used)
    )
    bent = np.linalg.norm(rod.curvature[rod.s >= tube.held_round, 1:], axis=1).max(initial=0.0)
    if bent * limit <= borne:
        return None
    return (
        f"the tube will kink: the load bends it with {bent * limit / borne:.2g} times the moment "
        "at which its section flattens (Brazier); the solve may be slow and fail; thicken the "
        "wall, or bend it less"
    )


def without_motion(scene: Scene) -> Scene:
    """The scene at rest, without the effects that act only in motion. A field that never ends stays: only rods can be solved in it."""
    named = dict.fromkeys(NO_LOADS)
    solver = scene.solver.model_copy(update={"dynamic": None, "quasi_static": None})
    kept = scene.effects.model_copy(update=named)
    return scene.model_copy(update={"solver": solver, "effects": kept, "reference": None})


def first_frequency(scene: Scene) -> float:
    """First angular frequency of a clamped rod with the mean compliance and mass of this one: 3.516 sqrt(E I / (m L^4)), rad/s."""
    dry = without_motion(scene)
    dry = dry.model_copy(update={"effects": dry.effects.model_copy(update={"fluid": None})})
    rod = rod_model(_heavy(dry, Gravity(acceleration=(0.0, 0.0, -1.0))), time=0.0)
    length = float(rod.length.sum())
    bending = length / float(np.sum(rod.length / rod.twist_bend[:, 1]))
    mass = float(np.linalg.norm(rod.weight[0])) / length
    return float(3.516 * np.sqrt(bending / (mass * length**4)))


def weight_in_motion(scene: Scene) -> float:
    """Estimate how far (m) gravity moves a body in motion: its deflection at rest, in the fields of some moments, times the share of it
    that the body reaches in time. Raises SolveError where its rod finds no equilibrium."""
    moments = 5  # of the motion, at equal distances
    still = without_motion(scene)
    moved = 0.0
    for time in np.linspace(0.0, scene.duration, moments).tolist():
        heavy, light = (
            solve_rod(one, time=time).position for one in (_heavy(still, Gravity()), still)
        )
        moved = max(moved, float(np.linalg.norm(heavy - light, axis=1).max()))
    return moved * _reached(scene)


def _heavy(scene: Scene, gravity: Gravity) -> Scene:
    """The scene under this weight, without the rules that fields without end break at rest."""
    return scene.model_copy(
        update={"effects": scene.effects.model_copy(update={"gravity": gravity})}
    )


def _reached(scene: Scene) -> float:
    """Largest share of the deflection at rest that the first bending mode reaches in the scene's time under a sudden load, by
    x'' + c x' + w^2 (x - 1) = 0."""
    w = first_frequency(scene)
    named = scene.effects
    softest = min(scene.materials[region.material_name].shear_modulus for region in scene.regions())
    lost = 0.0 if named.viscosity is None else named.viscosity.viscosity / softest  # s
    factor = 0.0 if named.viscosity is None else named.viscosity.loss_factor or 0.0
    c = (0.0 if named.damping is None else named.damping.rate) + w**2 * lost + w * factor
    root = np.sqrt(complex(c**2 / 4 - w**2) + 1e-9 * w**2)
    slow = root - c / 2
    fast = -root - c / 2
    t = np.linspace(0.0, scene.duration, 200)
    return float(
        (1.0 - (slow * np.exp(fast * t) - fast * np.exp(slow * t)) / (slow - fast)).real.max()
    )
