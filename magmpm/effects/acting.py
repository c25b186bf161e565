"""The effects that a scene may name, and what the program requests of those it does name. What is not named costs nothing.

To add an effect: one file (docs/adding_an_effect.md has a worked example), and one line, its key in `Effects`.
"""

from __future__ import annotations

from functools import cache
from typing import Any, ClassVar, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator
from pydantic.json_schema import SkipJsonSchema

from magmpm.compiled.arrays import Array, Named, NamedNumbers, Plain
from magmpm.effects.base import (
    PHASES,
    BodyChange,
    BodyEffect,
    Effect,
    MarkedParticles,
    Records,
    SceneLike,
)
from magmpm.effects.contact_law import Obstacle, most_friction
from magmpm.effects.damping import Damping
from magmpm.effects.feed import Feed
from magmpm.effects.fluid import Fluid
from magmpm.effects.gravity import Gravity
from magmpm.effects.ground import Ground
from magmpm.effects.hooks import pairs
from magmpm.effects.magnetic_force import MagneticForce
from magmpm.effects.magnetic_interaction import MagneticInteraction
from magmpm.effects.magnetic_torque import MagneticTorque
from magmpm.effects.magnetization import rotating
from magmpm.effects.self_contact import SelfContact
from magmpm.effects.viscosity import AT_REST, Viscosity
from magmpm.effects.walls import Walls
from magmpm.fields.dipole import MU0
from magmpm.inputs.messages import Instead, plain_word
from magmpm.inputs.settings import Settings, fault

# the square of a tip's speed over the mean of the body's: 3 for a body that turns about its base,
# and a free end whips
WHIP = 4.0
_PLANE = {"point": ["0 mm", "0 mm", "-2 mm"], "friction": 0.3}
_LUMEN = {
    "tube": {"radius": "5 mm", "path": [["-10 mm", "0 mm", "0 mm"], ["60 mm", "0 mm", "0 mm"]]}
}
_PULL = (
    "A field that varies in space pulls the magnetized segments: {}. A uniform field does not pull."
)


_FLUID = (
    "a fluid around the body is `fluid: {density: 1000 kg/m^3, viscosity: 1 mPa s}`: buoyancy, drag,"
    " and what of it the body carries along"
)
_FLOW = (
    "a stream is that of a `fluid: {density: 1060 kg/m^3, viscosity: 3.5 mPa s, velocity: [10 cm/s, 0"
    " m/s, 0 m/s]}`, or `mean_speed: 10 cm/s` through the tube of `walls`"
)
_OBSTACLE = (
    "an obstacle is a plane, `ground: {point: [0 mm, 0 mm, -2 mm]}`, or a lumen that the body is"
    " in, `walls: {tube: ...}` or `walls: {surface: {mesh: vessel.stl, unit: mm}}`; parts of"
    " `body.parts` touch each other by `self_contact: {}`"
)
_FRICTION = (
    "friction belongs to what is touched: `ground: {..., friction: 0.3}`, `walls`, `self_contact`,"
    " or a material"
)
_FIELD = (
    "the field acts by `magnetic_torque: {}`, and one that varies in space also by "
    "`magnetic_force: {}`; what makes it stands in `field`"
)
_FORCE = (
    "the loads are the field's, weight (`gravity`), contact, and ends that are moved (`move`, "
    "beside `effects`); there is no other force"
)
_SEGMENTS = "magnetized segments act on each other by `magnetic_interaction: {}`"
_LOSSES = (
    "in motion the material loses energy by `viscosity: {loss_factor: 0.1}`, a viscosity or `branches`,"
    " the surroundings by `damping`"
)
_INSERTED = "the base is pushed through a guide by `feed: {speed: 20 mm/s, exit: 10 mm}`"
_INERTIA = (
    "inertia acts in every motion, `solver: {dynamic: {duration: 0.5 s}}`, and in no "
    "equilibrium; it is not an effect to name"
)
_INSTEAD = {  # words by which people ask for an effect: what there is
    **dict.fromkeys(
        (
            "drag",
            "stokes_drag",
            "viscous_drag",
            "fluid_drag",
            "air",
            "air_drag",
            "air_resistance",
            "liquid",
            "water",
            "blood",
            "buoyancy",
            "added_mass",
            "hydrodynamics",
            "fluid_structure_interaction",
            "fsi",
        ),
        _FLUID,
    ),
    **dict.fromkeys(("flow", "blood_flow", "stream", "lift"), _FLOW),
    **dict.fromkeys(
        (
            "obstacle",
            "obstacles",
            "contact",
            "contacts",
            "collision",
            "collisions",
            "plane",
            "floor",
            "table",
            "surface",
            "substrate",
            "box",
            "sphere",
            "cylinder",
            "rigid_body",
            "vessel",
            "lumen",
            "tube",
            "channel",
        ),
        _OBSTACLE,
    ),
    **dict.fromkeys(("friction", "coulomb", "coulomb_friction"), _FRICTION),
    **dict.fromkeys(
        (
            "magnetic",
            "magnetism",
            "magnetics",
            "magnetic_field",
            "field",
            "torque",
            "actuation",
            "external_field",
        ),
        _FIELD,
    ),
    **dict.fromkeys(
        (
            "force",
            "forces",
            "load",
            "loads",
            "point_load",
            "external_force",
            "body_force",
            "pressure",
            "traction",
            "tension",
            "displacement",
        ),
        _FORCE,
    ),
    **dict.fromkeys(
        (
            "interaction",
            "interactions",
            "dipole",
            "dipoles",
            "dipole_interaction",
            "dipole_dipole",
            "self_interaction",
            "demagnetization",
            "demagnetisation",
            "magnetostatics",
        ),
        _SEGMENTS,
    ),
    **dict.fromkeys(
        (
            "loss",
            "losses",
            "loss_factor",
            "viscoelasticity",
            "viscoelastic",
            "rayleigh_damping",
            "material_damping",
            "hysteresis",
        ),
        _LOSSES,
    ),
    **dict.fromkeys(("insertion", "push", "advance", "advancement", "feeding"), _INSERTED),
    **dict.fromkeys(("inertia", "dynamics", "mass"), _INERTIA),
    **dict.fromkeys(("weight", "self_weight", "g"), "weight is `gravity: {}`"),
    **dict.fromkeys(
        ("self_collision", "self_intersection"), "the body touches itself by `self_contact: {}`"
    ),
}


def _key(description: str, example: Plain) -> Any:
    """A key of `Effects`: what editors show of it, and settings with which it can be tried."""
    return Field(default=None, description=description, examples=[example])


class Effects(Settings):
    """Simulated effects: one that is not named costs nothing."""

    unknown_key: ClassVar[str] = (
        "there is no such effect; docs/effects.md says what each of these does, and where it acts"
    )

    magnetic_torque: MagneticTorque | None = _key(
        "The external field turns the magnetized segments: {}.", {}
    )
    magnetic_force: MagneticForce | None = _key(_PULL, {})
    magnetic_interaction: MagneticInteraction | None = _key(
        "The magnetized segments turn and pull each other: {}.", {}
    )
    gravity: Gravity | None = _key("Weight: {} for 9.81 m/s^2 along -z.", {})
    viscosity: Viscosity | None = _key(
        "In motion: losses in the material (Kelvin-Voigt).", {"viscosity": "5 Pa s"}
    )
    fluid: Fluid | None = _key(
        "A fluid around the body: buoyancy, drag, and what of it the body carries along.",
        {"density": "1000 kg/m^3", "viscosity": "1 mPa s"},
    )
    damping: Damping | None = _key(
        "In motion: resistance of the surroundings, in proportion to mass.", {"rate": "60 1/s"}
    )
    ground: Ground | None = _key("Contact with a plane.", _PLANE)
    walls: Walls | None = _key("Contact with the wall of a lumen.", _LUMEN)
    self_contact: SelfContact | None = _key("The body touches itself and separates again: {}.", {})
    feed: Feed | None = _key(
        "In motion: the base is pushed through a guide.", {"speed": "20 mm/s", "exit": "10 mm"}
    )
    # `effects: auto` in a file: the program is to choose (solving.effects_choice); nothing is named with it.
    auto: SkipJsonSchema[Literal[True] | None] = Field(
        default=None, description="The program chooses.", examples=[True]
    )

    @model_validator(mode="before")
    @classmethod
    def _of_a_list(cls, data: Any) -> Any:
        """Effects made in Python may be given as one, or as a list: each knows its key."""
        if isinstance(data, Effect):
            return {data.key(): data}
        if not isinstance(data, (list, tuple)) or not any(isinstance(one, Effect) for one in data):
            return data
        for k, one in enumerate(data):
            if not isinstance(one, Effect):
                raise fault("must be an effect", "write, say, Gravity()", (k,))
        return {one.key(): one for one in data}

    @model_validator(mode="after")
    def _auto_stands_alone(self) -> Effects:
        if self.auto and self.named():
            raise fault(
                "`auto` leaves the choice to the program, and this names"
                f" {' and '.join(self.named())} as well",
                "write `effects: auto`, or name the effects without it",
                ("auto",),
            )
        return self

    @staticmethod
    def by_other_keys(key: str, values: Named) -> Instead | None:
        """Return what there is for an effect that people ask for by another name, or that is not simulated."""
        remedy = _INSTEAD.get(plain_word(key))
        return None if remedy is None else Instead(remedy)

    @classmethod
    @cache
    def every(cls) -> dict[str, type[Effect]]:
        """All effects there are, by key, in the order of their phases; within a phase in the order of their keys."""
        kinds = {
            key: get_args(field.annotation)[0]
            for key, field in cls.model_fields.items()
            if key != "auto"
        }
        return dict(sorted(kinds.items(), key=lambda item: PHASES.index(item[1].PHASE)))

    def named(self) -> dict[str, Effect]:
        """The effects that are named, by key, in the same order."""
        return {key: effect for key in self.every() if (effect := getattr(self, key)) is not None}

    @property
    def in_a_field(self) -> bool:
        """True if an effect of the external field is named."""
        return any(effect.IN_FIELD for effect in self.named().values())


NO_LOADS = tuple(
    key for key, kind in Effects.every().items() if kind.ONLY_IN_MOTION or kind.PHASE == "contact"
)  # rods at rest lack these


def collect(scene: SceneLike, strength: float = 1.0, times: Array | None = None) -> Records:
    """Parameter records and data, in turn, of the effects the scene names, in the order of their phases, whatever their order in the file.

    strength: factor of every load, 0 to 1, for a solve that increases the load from zero. times (k,) s: of the steps to
    come, where fields change in time; None for statics. An effect at zero strength is left out: kernels without it give the same
    numbers bit for bit, while kernels that add its zeros may not (sums are reassociated).
    """
    return tuple(
        part
        for effect in scene.effects.named().values()
        for part in effect.records(scene, strength, times)
    )


def field_changes(scene: SceneLike, times: Array | None = None) -> tuple[Records, Records, Records]:
    """Records of the derivatives of all named effects with respect to the field's uniform part, x, y, z (Effect.field_changes)."""
    each = [effect.field_changes(scene, times) for effect in scene.effects.named().values()]
    x, y, z = (tuple(part for changes in each for part in changes[i]) for i in range(3))
    return x, y, z


def check(model: Any) -> None:
    """Raises InputError where an effect the model's scene names can't begin: a body that starts inside a wall, say."""
    for effect in model.scene.effects.named().values():
        effect.check(model)


def warnings(scene: SceneLike) -> list[str]:
    """Warnings of the effects that a scene names: ground too far away to be touched, say."""
    named = scene.effects.named()
    found = [text for effect in named.values() for text in effect.warnings(scene)]
    rough = [
        key
        for key, effect in named.items()
        if isinstance(effect, Obstacle | SelfContact)
        and most_friction(scene, effect.friction) > 0.0
    ]
    if scene.solver.dynamic is not None and rough and not loses(scene):
        found.append(
            f"effects.{rough[0]}: friction without material losses: near the friction limit the "
            "sliding distance is not defined (the body flutters, and slides farther on finer "
            "cells); name the losses, for example `viscosity: {loss_factor: 0.1}`"
        )
    return found


def loses(scene: SceneLike) -> bool:
    """True if viscosity or damping takes energy from vibrations in motion."""
    named = scene.effects
    damped = named.damping is not None and named.damping.rate > 0.0
    damped = damped or named.fluid is not None
    return damped or (named.viscosity is not None and bool(named.viscosity.records(scene)))


def passed(scene: SceneLike, x: Array) -> str | None:
    """Reason why the points of a surface can't rest at x (n, 3) m: it has gone through an obstacle (Effect.passed)."""
    return next(
        (
            why
            for effect in scene.effects.named().values()
            if (why := effect.passed(scene, x)) is not None
        ),
        None,
    )


def stable_steps(model: Any) -> NamedNumbers:
    """The largest stable step (s) of each named effect that sets one."""
    named = model.scene.effects.named().items()
    acting = {
        key: effect
        for key, effect in named
        if effect.records(model.scene) or effect.PHASE == "contact"
    }  # self_contact has none
    return {
        key: step
        for key, effect in acting.items()
        if (step := effect.stable_step(model)) is not None
    }


def remembered(scene: SceneLike) -> Array:
    """Memory (6 k,) of an undeformed particle in motion: the viscous strain of each branch of viscosity."""
    named = scene.effects.viscosity
    return np.tile(AT_REST, 0 if named is None else len(named.relaxing(scene)))


def instant_modulus(scene: SceneLike) -> float:
    """Shear modulus (Pa) that branches of viscosity add to quick deformations."""
    named = scene.effects.viscosity
    return 0.0 if named is None else sum(branch.shear_modulus for branch in named.relaxing(scene))


def marked(scene: SceneLike, particles: Any, remanence: Array) -> Array:
    """Array passed to hooks as `magnet`: remanence (n, 3) T, with a fourth column where it rotates or an effect marks particles.

    Kernels pass the row of a particle on unchanged. The column is 1 where the material's magnetization rotates, 0 where it stretches
    (effects.magnetization); or the block of magnetic_interaction, the one effect that marks, which no scene has together with that.
    """
    if (law := rotating(scene)).any():
        return np.column_stack([remanence, law[particles.segment]])
    for effect in scene.effects.named().values():
        if (marks := effect.marks(particles, remanence)) is not None:
            return np.column_stack([remanence, marks])
    return remanence


def refresh(named: Records, body: Any, x: Array, F: Array) -> float:
    """Bring tables that depend on the body's shape up to date, in place, and return their energy (`shared_energy`), J.

    body: a Model; x (n, 3) m, F (n, 3, 3) of its particles.
    """
    return sum(
        float(record["share"][0]) * kind.refresh(data, _particles(body), x, F)
        for kind, record, data in _refreshed(named)
    )


def coordinates(named: Records, body: Any, x: Array, F: Array) -> list[Array]:
    """Return what the tables of `own_tables` act on (BodyEffect.coordinates), times the shares of their loads."""
    return [
        float(record["share"][0]) * kind.coordinates(_particles(body), x, F)
        for kind, record, _ in _refreshed(named)
    ]


def own_tables(named: Records) -> list[Array]:
    """The tables that `refresh` brings up to date."""
    return [data for _, _, data in _refreshed(named)]


def refresh_change(named: Records, body: Any, x: Array, F: Array, by: BodyChange) -> Records:
    """Records of the effects whose tables depend on the body's shape, with the change of their tables in place of these."""
    out: list[Any] = []
    for kind, record, data in _refreshed(named):
        change = np.zeros_like(data)
        kind.refresh_change(change, _particles(body), x, F, by)
        out += [record, change]
    return tuple(out)


def shared_energy(named: Records, body: Any, x: Array, F: Array) -> float:
    """Energy (J) of effects in which every particle feels all others; their energy hooks count loads that do not follow the shape."""
    return sum(
        float(record["share"][0]) * kind.shared_energy(_particles(body), x, F)
        for kind, record, _ in _refreshed(named)
    )


def _refreshed(named: Records) -> list[tuple[type[BodyEffect], NDArray[Any], NDArray[Any]]]:
    """Effects whose table depends on the body's shape, with their record and table."""
    kinds = [kind for kind in Effects.every().values() if issubclass(kind, BodyEffect)]
    return [
        (kind, record, data)
        for record, data in pairs(named)
        for kind in kinds
        if record.dtype == kind.REFRESHED
    ]


def _particles(body: Any) -> MarkedParticles:
    return MarkedParticles(
        body.remanence[:, -1], body.particles.segment, body.particles.volume, body.remanence[:, :3]
    )


def feels_itself(scene: SceneLike) -> bool:
    """True if an effect depends on the shape of the whole body, so that equilibrium takes several solves."""
    return any(
        isinstance(effect, BodyEffect) and effect.records(scene)
        for effect in scene.effects.named().values()
    )


def driven_speed(model: Any, x: Array, time: float, way: float) -> float:
    """The speed (m/s) to which loads can drive a particle of a Model until a time (s): what feed gives, and sqrt(2 WHIP w).

    w: most work on a mass (J/kg): of weight along `way` (m), the farthest; of fields, 4 M B; of neighbors. x (n, 3) m: present positions.
    """
    scene = model.scene
    named = model.scene.effects
    work = 0.0
    if named.gravity is not None:
        buoyed = 0.0 if named.fluid is None else named.fluid.density / float(model.density.min())
        work += max(1.0, buoyed) * float(np.linalg.norm(named.gravity.acceleration)) * way
    remanence = np.linalg.norm(model.remanence[:, :3], axis=1)
    magnetic = float((remanence / model.density).max()) / MU0
    if named.in_a_field and magnetic > 0.0:
        field = scene.external_field()
        # a field that changes in time is looked at in nine moments
        most = max(
            float(np.linalg.norm(field.at(x, moment), axis=1).max())
            for moment in np.linspace(0.0, time, 9)
        )
        work += 4.0 * magnetic * most
    if named.magnetic_interaction is not None:
        work += magnetic * float(remanence.max())
    fed = 0.0 if named.feed is None else abs(named.feed.speed)
    flowing = 0.0 if named.fluid is None else named.fluid.fastest
    return float(np.sqrt(2.0 * WHIP * work)) + fed + flowing
