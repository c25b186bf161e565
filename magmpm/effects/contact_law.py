"""Contact law common to all obstacles: the penalty force with Coulomb friction, its stiffness, checks and reports.

A point of mass m at a depth inside the obstacle is pushed back along the normal by the force m w^2 depth, with the energy
m w^2 depth^2 / 2. Friction is Coulomb's law on velocities (effects.contact_force): it has no stiffness, and shortens no step.

The frequency w of the penalty is that of a pressure wave through a cell of the stiffest material, sqrt((K + 4/3 G) / rho) / h, times
sqrt(FREE). So contact does not require a smaller step. A body at rest sinks in by half a thousandth of a cell.
Source of the lumped bound used by `stable_step`: Hughes, The Finite Element Method, section 9.1.
"""

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from magmpm.compiled.arrays import Array, NamedNumbers
from magmpm.effects.base import Contact, Effect, Records, SceneLike, Touching, one_record
from magmpm.effects.calls import pushes_on, rows
from magmpm.effects.contact_force import GRIP, LEAST_FRICTION, RIGIDITY
from magmpm.effects.hooks import NO_DATA
from magmpm.errors import PAIR, SceneError, dotted

THROWN = 0.1  # m/s
# of the explicit limit 2 / w: 0.8 of the smaller of the body's and the contact's bounds is then
# stable for both together
SHARE_OF_STABLE_STEP = 0.7
# of the squared frequency of the wave: the body's is 2.1 times as much or more, in steps (SHARE_OF_STABLE_STEP counted)
FREE = 2.0


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
            "Factor on the usual contact stiffness, at which the body sinks in by micrometers; 1 "
            "unless given. Above 1 the contact may require a smaller time step than the body."
        ),
    ),
]


def stiffness_of(scene: SceneLike, factor: float) -> float:
    """Stiffness w^2 of contact (1/s^2), `factor` times the usual one."""
    used = [scene.materials[region.material_name] for region in scene.regions() if not region.held]
    squares = [
        m.shear_modulus * (m.bulk_to_shear + 4 / 3) / m.density
        for m in used
        if m.density is not None
    ]
    rate = math.sqrt(max(squares, default=0.0)) / scene.cell  # of the fastest pressure wave
    return factor * FREE * rate**2


def obstacle_dtype(key: str, *own: tuple[Any, ...]) -> np.dtype[Any]:
    """The dtype of an obstacle's records: its own fields, and those of `push`. Names begin with its key: they distinguish effects."""
    pushing = [(name, np.float64) for name in ("friction", "stiffness")]
    return np.dtype([(f"{key}_{name}", *kind) for name, *kind in (*own, *pushing)])


def obstacle_record(dtype: np.dtype[Any], data: Array = NO_DATA, /, **values: Any) -> Records:
    """A record of an obstacle_dtype, by names of fields without the key, and its table; what is not given is 0."""
    key = (dtype.names or ("",))[0].partition("_")[0]
    return one_record(dtype, data, **{f"{key}_{name}": value for name, value in values.items()})


def own_friction(scene: SceneLike) -> Array:
    """Coefficient of friction of each region (regions,): its material's own, nan where it names none."""
    named = [scene.materials[region.material_name].friction for region in scene.regions()]
    return np.array([np.nan if friction is None else friction for friction in named])


def most_friction(scene: SceneLike, friction: float) -> float:
    """Largest coefficient of any region where a contact names this one."""
    own = own_friction(scene)
    return float(np.where(np.isnan(own), friction, own).max())


def stable_step(stiffness: float) -> float:
    """Largest stable step (s) of a spring of this stiffness w^2 (1/s^2), together with a body at its own limit."""
    return SHARE_OF_STABLE_STEP * 2.0 / math.sqrt(stiffness) if stiffness > 0 else math.inf


def place(model: Any, point: Array) -> str:
    """Region and position of a point (3,) m in words: "segment 2 (body.catheter.segments[1]), at (12, 0, -2) mm"."""
    nearest = ((model.particles.position - point) ** 2).sum(axis=1).argmin()
    region = model.scene.regions()[model.particles.segment[nearest]]
    at = ", ".join(f"{c:.3g}" for c in 1e3 * point + 0.0)
    return f"{region.name} ({dotted(('body', *region.at))}), at ({at}) mm"


def grips(f: Array, friction: Array) -> Array:
    """Friction (n,) N that pushes f (n, PARTS) allow; friction (n,): of the points' own material, nan where the obstacle's counts."""
    return np.where(friction >= 0.0, friction * np.linalg.norm(f[:, :3], axis=1), f[:, GRIP])


def contact_of(named: Records, touching: Touching) -> Contact:
    """Contact of points; named: of one effect.

    Where several points or obstacles share a friction, each has the part of it that its push has of the largest friction. A point that
    slides has the friction of its present push; what holds one that sticks does not grow.
    """
    x, mass, friction, pull, most = touching
    depth, f = pushes_on(rows(named, "contact"), x, mass)
    on = depth > 0.0
    share = np.divide(grips(f, friction), most, out=np.zeros_like(most), where=most > 0.0)
    sticks = np.linalg.norm(pull, axis=1) < (1.0 - LEAST_FRICTION) * most
    share = np.where(sticks, np.minimum(share, 1.0), share)
    return Contact(
        force=(f[:, :3] + share[:, None] * pull)[on].sum(axis=0),
        count=int(on.sum()),
        depth=float(depth.max(initial=0.0)),
        energy=0.5 * float(f[on, RIGIDITY] @ depth[on] ** 2),
    )


def obstacle_contacts(
    model: Any, touching: Touching, part: NDArray[np.integer]
) -> dict[str, Contact]:
    """Contact with each obstacle that a model's scene names, and of each part or segment that touches it ("ground: foot"); part (n,): of
    each point."""
    names = [region.name for region in model.scene.regions()]
    found = {}
    for key, effect in model.scene.effects.named().items():
        whole = effect.report(model, touching)
        if whole is None:
            continue
        found[key] = whole
        for number in np.unique(part) if whole["count"] else ():
            one = effect.report(model, Touching(*(each[part == number] for each in touching)))
            if one["count"]:
                found[f"{key}{PAIR}{names[number]}"] = one
    return found


def springs(contacts: Mapping[str, Contact]) -> NamedNumbers:
    """Energy (J) of the springs of each contact of the whole body, of which those of its parts are shares."""
    return {key: contact["energy"] for key, contact in contacts.items() if PAIR not in key}


def at_rest(x: Array, mass: Array | None = None) -> Touching:
    """Points at rest at x (n, 3) m without friction; of mass (n,) kg, or 1 kg each."""
    n = len(x)
    masses = np.ones(n) if mass is None else mass
    return Touching(x, masses, np.full(n, np.nan), np.zeros((n, 3)), np.zeros(n))


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

    def stiffness_in(self, scene: SceneLike) -> float:
        """Stiffness w^2 (1/s^2) of the contact of a scene's body."""
        return stiffness_of(scene, self.stiffness)

    def stable_step(self, model: Any) -> float:
        """Largest stable step, s."""
        return stable_step(self.stiffness_in(model.scene))

    def report(self, model: Any, touching: Touching) -> Contact:
        """Contact of a model."""
        return contact_of(self.records(model.scene), touching)

    def passed(self, scene: SceneLike, x: Array) -> str | None:
        """Reason why points of a surface can't rest at x (n, 3) m: one is more than a cell inside, where the spring is no contact."""
        depth = contact_of(self.records(scene), at_rest(x))["depth"]
        found = (
            f"the body is {1e3 * depth:.3g} mm inside {self.WORDS}, more than a cell: it was "
            "pressed in or passed through"
        )
        return found if depth > scene.cell else None

    def check(self, model: Any) -> None:
        """Raises SceneError where the body begins so deep in the obstacle that it would be thrown out faster than THROWN."""
        still = at_rest(model.surface.place, model.surface.mass)
        named = self.records(model.scene)
        found = contact_of(named, still)
        mass = float(model.density @ model.particles.volume)
        speed = math.sqrt(2.0 * found["energy"] / mass) if mass > 0 else 0.0
        if speed > THROWN:
            depth, _ = pushes_on(rows(named, "contact"), still.x, still.mass)
            raise SceneError(
                f"effects.{self.key()}",
                found=(
                    f"initial overlap of {1e3 * depth.max():.3g} mm with {self.WORDS} in "
                    f"{place(model, still.x[depth.argmax()])}: contact would eject the body at {speed:.2g} "
                    "m/s"
                ),
                rule="a body must start clear of it, or just touching",
                remedy=f"{self.CLEAR}, by {1e3 * depth.max():.3g} mm or more",
            )
