"""Contact law common to all obstacles: the penalty force with Coulomb friction, its stiffness, checks and reports.

A point of mass m at a depth inside the obstacle is pushed back along the normal by the force m w^2 depth, with the energy
m w^2 depth^2 / 2. Friction holds it by a spring of the same stiffness, up to friction times that force (effects.contact_force).

The frequency w of the penalty is that of a pressure wave through a cell of the stiffest material, w = sqrt((K + 4/3 G) / rho) / h, about
a quarter of the body's highest frequency. So contact does not require a smaller step. A body at rest sinks in by a thousandth
of a cell, with friction by some. Source of the lumped bound used by `stable_step`: Hughes, The Finite Element Method, section 9.1.

With friction, an elastic body on a hard plane flutters: shear and bounce of the whole body feed on each other while it slides, and it
slides where it should stick (Martins, Oden, Simoes, Int. J. Eng. Sci. 28 (1990) 29). A dashpot beside a spring as stiff as a cell does not
feel these slow modes. So friction's spring begins softer, to give as much as SOFT thicknesses of the body, beside a dashpot near the
impedance of the pressure wave, which acts only where the body slides: what rolls loses nothing. From the depth KNEE on the spring is as
stiff as without friction, so that bodies that land do not sink in. And friction follows the push with a delay (effects.contact_force).
"""

import math
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
from pydantic import Field

from magmpm.compiled.arrays import Array
from magmpm.compiled.by_address import address
from magmpm.compiled.jit import compiled, compiled_elsewhere
from magmpm.effects.base import Contact, Effect, Records, SceneLike, Touching, one_record
from magmpm.effects.calls import call_each, depths, given_for, of_points, point_from
from magmpm.effects.contact_force import HELD, PARTS, hold, own_grip, stored
from magmpm.effects.hooks import NO_DATA
from magmpm.errors import SceneError, dotted

THROWN = 0.1  # m/s
# thicknesses of the body: the layer of it that gives as much as contact with friction. From 2 to 4
# blocks stick and balls roll
SOFT = 3.0
# cells: deeper than bodies at rest sink in; beyond it friction's spring is as stiff as that of
# slippery contact
KNEE = 0.02
# of the explicit limit 2 / w: 0.8 of the smaller of the body's and the contact's bounds is then
# stable for both together
SHARE = 0.7


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
        examples=[1.0],
        description=(
            "Times the usual stiffness of the contact, which lets the body in by micrometers; 1"
            " unless given. Above 1 the contact may ask for a smaller time step than the body."
        ),
    ),
]


def law(scene: SceneLike, factor: float, friction: float) -> dict[str, float]:
    """The arguments of `push`: `stiffness` w^2 in 1/s^2, times `factor`, and with friction `layer` (m), `knee` (m) and `damping` (1/s)."""
    used = [scene.materials[region.material_name] for region in scene.regions() if not region.held]
    squares = [
        m.shear_modulus * (m.bulk_to_shear + 4 / 3) / m.density
        for m in used
        if m.density is not None
    ]
    rate = math.sqrt(max(squares, default=0.0)) / scene.cell  # of the fastest pressure wave
    if not friction > 0:
        return {"stiffness": factor * rate**2}
    return {
        "stiffness": factor * rate**2,
        "layer": scene.cell / SOFT / factor,
        "knee": KNEE * scene.cell,
        "damping": rate,
    }


def obstacle_dtype(key: str, *own: tuple[Any, ...]) -> np.dtype[Any]:
    """The dtype of an obstacle's records: its own fields, and those of `push`. Names begin with its key: they distinguish effects."""
    pushing = [(name, np.float64) for name in ("friction", "stiffness", "layer", "knee", "damping")]
    return np.dtype([(f"{key}_{name}", *kind) for name, *kind in (*own, *pushing)])


def obstacle_record(dtype: np.dtype[Any], data: Array = NO_DATA, /, **values: Any) -> Records:
    """A record of an obstacle_dtype, by names of fields without the key, and its table; layer, knee 1 m unless given, others 0."""
    names = dtype.names or ()
    usual = {"layer": 1.0, "knee": 1.0, **values}
    return one_record(
        dtype,
        data,
        **{f"{names[0].partition('_')[0]}_{name}": value for name, value in usual.items()},
    )


def grips(scene: SceneLike) -> Array:
    """Numbers of each region (regions, 3) that friction depends on: its material's own coefficient, nan where it names none; its
    thickness, m; the time that a shear wave takes through it, s. A region that is held is as rigid as an obstacle: 0 and 0.
    """
    found = []
    for region in scene.regions():
        material = scene.materials[region.material_name]
        thickness = region.thickness
        through = thickness * math.sqrt((material.density or 0.0) / material.shear_modulus)
        found.append(
            [np.nan if material.friction is None else material.friction, thickness, through]
        )
    return np.array(found)


def most_friction(scene: SceneLike, friction: float) -> float:
    """Largest coefficient of any region where a contact names this one."""
    own = grips(scene)[:, 0]
    return float(np.where(np.isnan(own), friction, own).max())


def stable_step(stiffness: float, damping: float = 0.0) -> float:
    """Largest stable step (s) of a spring of this stiffness w^2 (1/s^2), together with a body at its own limit; with a dashpot of this
    rate (1/s), z = rate / 2 w times the critical one, shorter by sqrt(1 + z^2) - z (Belytschko, section 6.6).
    """
    if not stiffness > 0:
        return math.inf
    z = damping / (2.0 * math.sqrt(stiffness))
    return (math.sqrt(1.0 + z * z) - z) * SHARE * 2.0 / math.sqrt(stiffness)


def place(model: Any, point: Array) -> str:
    """Region and position of a point (3,) m in words: "segment 2 (body.catheter.segments[1]), at (12, 0, -2) mm"."""
    nearest = ((model.particles.position - point) ** 2).sum(axis=1).argmin()
    region = model.scene.regions()[model.particles.segment[nearest]]
    at = ", ".join(f"{c:.3g}" for c in 1e3 * point + 0.0)
    return f"{region.name} ({dotted(('body', *region.at))}), at ({at}) mm"


_stored = compiled(stored)


@compiled_elsewhere
def _touching(calls, x, v, mass, dt, held, grip, layer, knee, force):
    """Number in contact, the deepest (-1: none), its depth (m), energy (J); adds to force (3,) N and changes what is held (n, HELD)."""
    count = 0
    worst = -1
    most = 0.0
    energy = 0.0
    f = np.empty(PARTS)
    found = np.empty(len(mass))
    given = given_for()
    depths(calls.near, 0, given, x, found)
    for p in range(len(mass)):
        depth = found[p]
        if depth > 0.0:
            f[:] = 0.0
            f[7], f[8] = grip[p, 1], grip[p, 2]
            point_from(given, x[p:], v[p:], mass[p:], f)
            call_each(calls.contact, 0, 0, 1, dt, address(given, 0))
            own_grip(grip[p, 0], f)
            hold(x[p], v[p], depth, held[p], f, dt)
            force += f[:3]
            s = x[p] - held[p, :3]
            count += 1
            if depth > most:
                worst = p
                most = depth
            energy += _stored(depth, f[6], layer, f[7], knee) + 0.5 * f[6] * (
                s[0] ** 2 + s[1] ** 2 + s[2] ** 2
            )
    return count, worst, most, energy


def contact_of(
    named: Records, touching: Touching, dt: float, layer: float = 1.0, knee: float = 1.0
) -> Contact:
    """Contact of points in steps of dt (s); named: of one effect; layer, knee (m): of its `law`."""
    force = np.zeros(3)
    x, v, mass, held, grip = touching
    count, _, depth, energy = _touching(
        of_points(named), x, v, mass, dt, held.copy(), grip, layer, knee, force
    )
    return Contact(force=force, count=count, depth=depth, energy=energy)


def at_rest(x: Array, mass: Array | None = None) -> Touching:
    """Points at rest at x (n, 3) m that nothing holds; of mass (n,) kg, or 1 kg each."""
    slippery = np.tile([np.nan, 0.0, 0.0], (len(x), 1))
    return Touching(
        x,
        np.zeros_like(x),
        np.ones(len(x)) if mass is None else mass,
        np.zeros((len(x), HELD)),
        slippery,
    )


class Obstacle(Effect):
    """Obstacle that a body presses on and slides over. Its hook `near` is the depth of a point in it, and `contact` pushes by `push`.

    At equilibrium the surface's points have the energy m w^2 depth^2 / 2 of the push without friction (hook `touch`).
    """

    PHASE = "contact"
    WORDS: ClassVar[str]  # what it is, in messages
    CLEAR: ClassVar[str]  # how to get the body out of it

    if TYPE_CHECKING:  # each obstacle has them as its last keys
        friction: Friction
        stiffness: Stiffness

    def law(self, scene: SceneLike) -> dict[str, float]:
        """The `law` of a scene's body; at equilibrium there is no friction."""
        return law(
            scene,
            self.stiffness,
            0.0 if scene.solver.dynamic is None else most_friction(scene, self.friction),
        )

    def stable_step(self, model: Any) -> float:
        """Largest stable step, s."""
        found = self.law(model.scene)
        return stable_step(found["stiffness"], found.get("damping", 0.0))

    def report(self, model: Any, touching: Touching, dt: float) -> Contact:
        """Contact of a model, in steps of dt (s)."""
        found = self.law(model.scene)
        return contact_of(
            self.records(model.scene), touching, dt, found.get("layer", 1.0), found.get("knee", 1.0)
        )

    def passed(self, scene: SceneLike, x: Array) -> str | None:
        """Reason why points of a surface can't rest at x (n, 3) m: one is more than a cell inside, where the spring is no contact."""
        depth = contact_of(self.records(scene), at_rest(x), 0.0)["depth"]
        found = (
            f"the body is {1e3 * depth:.3g} mm inside {self.WORDS}, more than a cell: it is pressed"
            " or went through"
        )
        return found if depth > scene.cell else None

    def check(self, model: Any) -> None:
        """Raises SceneError where the body begins so deep in the obstacle that it would be thrown out faster than THROWN."""
        x, v, masses, held, grip = at_rest(model.surface.place, model.surface.mass)
        named = self.records(model.scene)
        _, point, depth, energy = _touching(
            of_points(named), x, v, masses, 1.0, held, grip, 1.0, 1.0, np.zeros(3)
        )
        mass = float(model.density @ model.particles.volume)
        speed = math.sqrt(2.0 * energy / mass) if mass > 0 else 0.0
        if speed > THROWN:
            raise SceneError(
                f"effects.{self.key()}",
                found=(
                    f"the body begins {1e3 * depth:.3g} mm inside {self.WORDS}, deepest with"
                    f" {place(model, x[point])}, and would be thrown out at {speed:.2g} m/s"
                ),
                rule="a body must begin clear of it, or just touching",
                remedy=f"{self.CLEAR}, by {1e3 * depth:.3g} mm or more",
            )
