"""Variables of a scene that a design may change, one number each: directions of magnetization, field, materials, lengths, diameter.

`variables(scene, of)` lists them by kind, or by address (scene.addresses): any other number that leaves the body's shape as it is, such as
a magnet's place or a coil's current. Each knows its name and unit, and makes the scene in which it is changed by an amount: what a central
difference uses, and what `sensitivities` gives the derivative with respect to.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from magmpm.bodies.segments import StraightBody
from magmpm.effects.contact_law import Obstacle, most_friction
from magmpm.effects.self_contact import SelfContact
from magmpm.errors import InputError
from magmpm.inputs.quantities import KINDS as KINDS_OF_QUANTITIES
from magmpm.inputs.quantities import divided, kind_of
from magmpm.inputs.vectors import Vector
from magmpm.scene.addresses import Place, changed, places, value_at, written
from magmpm.scene.scene import Scene

ADDRESS = "address"  # kind of what has no other


@dataclass(frozen=True)
class Variable:
    """One number that a design may change.

    Attributes
    ----------
    kind : str
        The word that requests it.
    name : str
        Of its own.
    unit : str
        Its SI unit.
    place : Place
        Where the scene has it; of a turn its direction.
    region : int or None
        Index of the segment or part that is turned or made longer.
    direction : tuple of float (3,), no unit, or None
        Unit tangent toward which the magnetization turns.
    """

    kind: str
    name: str
    unit: str
    place: Place
    region: int | None = None
    direction: Vector | None = None

    @property
    def address(self) -> str:
        """Its address; of a turn that of its angle."""
        angle = "azimuth", "elevation"
        turned = [f".{one}" for one in angle if self.unit == "rad" and self.name.endswith(one)]
        return written(self.place) + "".join(turned)

    @property
    def material(self) -> str | None:
        """Name of the material that it belongs to."""
        return str(self.place[1]) if self.place[:1] == ("materials",) else None

    @property
    def component(self) -> int | None:
        """Number of the field's component, 0 to 2."""
        return int(self.place[-1]) if self.kind == "field" else None

    def changed(self, scene: Scene, amount: float) -> Scene:
        """Make the scene in which this variable is larger.

        A direction d turns along the great circle toward `direction` t: cos(amount) d + sin(amount)
        t. The bulk modulus stays in proportion to the shear modulus. A segment that gets longer
        makes its body longer; the other segments keep their lengths, and a tube its bore.

        Parameters
        ----------
        scene : Scene
            One that has the variable.
        amount : float, the variable's unit
            By how much.

        Returns
        -------
        Scene
            The other scene.

        Raises
        ------
        InputError
            Where it breaks a rule.
        """
        if self.kind == "length" and self.region is not None:
            lengths = segment_lengths(scene)
            lengths[self.region] += float(amount)
            return changed(scene, of_lengths(scene, lengths))
        now = value_at(scene, self.place)
        if isinstance(now, list):
            turned = math.cos(amount) * np.array(now) + math.sin(amount) * np.array(self.direction)
            return changed(scene, {self.place: turned.tolist()})
        return changed(scene, {self.place: now + float(amount)})


def segment_lengths(scene: Scene) -> list[float]:
    """Find the lengths of a straight body's segments.

    Parameters
    ----------
    scene : Scene
        The scene.

    Returns
    -------
    list of float, m
        Base to tip.
    """
    shape = scene.body.shape
    assert isinstance(shape, StraightBody)
    return shape.segment_lengths()


def of_lengths(scene: Scene, lengths: Sequence[float]) -> dict[Place, float]:
    """Put lengths at their places.

    Parameters
    ----------
    scene : Scene
        The scene.
    lengths : sequence of float, m
        Of the segments, base to tip.

    Returns
    -------
    dict of place to float, m
        Each segment's, and their sum at the body's.
    """
    body = ("body", scene.body.kind)
    found: dict[Place, float] = {(*body, "length"): math.fsum(lengths)}
    for k, length in enumerate(lengths):
        found[*body, "segments", k, "length"] = length
    return found


def tangents(direction: Sequence[float]) -> tuple[Vector, Vector]:
    """Find the unit vectors along which a direction turns: toward growing azimuth about +z, and toward growing elevation.

    With a its azimuth (0 at the poles) and e its elevation: (-sin a, cos a, 0) and (-sin e cos a,
    -sin e sin a, cos e).

    Parameters
    ----------
    direction : sequence of float (3,)
        Of any length.

    Returns
    -------
    tuple of (float, float, float), no unit
        The two.
    """
    x, y, z = direction
    across = math.hypot(x, y)
    cos_a, sin_a = (x / across, y / across) if across > 0.0 else (1.0, 0.0)
    size = math.hypot(across, z)
    cos_e = across / size
    sin_e = z / size
    return (-sin_a, cos_a, 0.0), (-sin_e * cos_a, -sin_e * sin_a, cos_e)


def variables(scene: Scene, of: Sequence[str] | None = None) -> tuple[Variable, ...]:
    """Find the variables that a scene has.

    magnetization: two angles for each magnetized region. field: three components of its uniform
    part. remanence, shear_modulus, density: one for each material that the body uses. length: one
    for each segment. diameter: one. What has a dot or a bracket is an address.

    Parameters
    ----------
    scene : Scene
        The scene.
    of : sequence of str, optional
        Their kinds; all that it has unless given.

    Returns
    -------
    tuple of Variable
        In the order of `of`.

    Raises
    ------
    InputError
        For a kind that is not known, or of which the scene has none.
    """
    if of is None:
        return tuple(
            variable
            for make in _KINDS.values()
            if not isinstance(found := make(scene), str)
            for variable in found
        )
    if isinstance(of, str) or not of or not all(isinstance(kind, str) for kind in of):
        _refuse(
            repr(of),
            "must be a list of names",
            f"write, say, of={[of] if str(of) in _KINDS else ['magnetization', 'field']}",
        )
    found = []
    for kind in dict.fromkeys(of):
        if "." in kind or "[" in kind:
            found += _at_address(scene, kind)
            continue
        if kind not in _KINDS:
            rule = f"must be of {', '.join(_KINDS)}, or an address such as field.uniform[2]"
            _refuse(repr(kind), rule, "correct the name")
        made = _KINDS[kind](scene)
        if isinstance(made, str):
            _refuse(repr(kind), *made.split("; "))
        else:
            found += made
    return tuple(found)


def _at_address(scene: Scene, address: str) -> list[Variable]:
    """The numbers at an address. Raises InputError for one that the scene has not, that is no real number, or that shapes the body."""
    found = []
    for place in places(scene, address):
        name = written(place)
        value = value_at(scene, place)
        if isinstance(value, bool) or not isinstance(value, float):
            _refuse(name, "must be the address of a real number", "add [0], [1] or [2] to a vector")
        if not _differentiable(place):
            shape = "`length`" if scene.body.catheter is None else "`length` or `diameter`"
            _refuse(
                name,
                "it has no derivative: it changes the body's shape or grid, has no effect at rest, "
                "or makes a stream",
                f"name {shape}, or numbers of `field`, `effects`, `materials` or a magnetization",
            )
        _, unit = divided(value_at(scene, place, units=True)) or (value, "")
        kind = kind_of(unit)
        si = KINDS_OF_QUANTITIES[kind].si if unit and kind else "1"
        numbered = Variable(ADDRESS, name, si, place)
        found.append(_with_formula(scene, numbered) or numbered)
    return found


def _with_formula(scene: Scene, variable: Variable) -> Variable | None:
    """Find the kind of a variable, given by its address, whose derivative has a formula; None where none has.

    A component i of a direction d, which a scene normalizes, turns it along e_i - d_i d.
    """
    place = variable.place
    if scene.effects.feed is not None:  # formulas are those of whole bodies
        return None
    if place[:2] == ("field", "uniform") and not isinstance(_field(scene), str):
        return replace(variable, kind="field")
    if place[0] == "materials" and place[2] in ("shear_modulus", "remanence", "density"):
        return replace(variable, kind=str(place[2]))
    if scene.body.shape.magnetized_by_region:
        for k, region in enumerate(scene.regions()):
            if place[:-1] == ("body", *region.at, "magnetization") and any(region.magnetization):
                d = np.array(region.magnetization)
                toward = np.eye(3)[int(place[-1])] - d[int(place[-1])] * d
                x, y, z = toward.tolist()
                return replace(variable, kind="magnetization", region=k, direction=(x, y, z))
    return None


def _differentiable(place: Place) -> bool:
    """True if a number at a place changes the loads and stresses of a body, and nothing of its grid."""
    if place[0] == "body":
        return any(str(key).startswith("magnetization") for key in place)
    if place[:2] == ("effects", "fluid"):  # a still one has no drag, whose derivative is not zero
        return place[2] not in ("velocity", "mean_speed")
    return place[0] in ("field", "effects", "materials")


def check_differentiable(scene: Scene, *, fed: bool = False) -> None:
    """Refuse a scene whose answer is not that of one equilibrium: what came before it counts.

    Along a path of equilibria that is friction alone: all else follows its load at each moment, and
    the past only chooses the branch.

    Parameters
    ----------
    scene : Scene
        The scene.
    fed : bool, default False
        Whether a catheter may be pushed out of its guide, which equilibria let slide.

    Raises
    ------
    InputError
        For a motion, and for paths with friction or feed.
    """
    if scene.solver.dynamic is not None:
        raise InputError(
            "solver.dynamic",
            received="a motion",
            rule="sensitivities are computed at an equilibrium",
            remedy="remove solver.dynamic, or take finite differences of runs",
        )
    fluid = scene.effects.fluid
    if fluid is not None and fluid.flows:
        raise InputError(
            "effects.fluid",
            received="a stream",
            rule="sensitivities need loads that have an energy, and drag has none",
            remedy="take finite differences of runs, or remove the stream",
        )
    if scene.solver.quasi_static is None:
        return
    if scene.effects.feed is not None and fed:
        return
    if scene.effects.feed is not None:
        raise InputError(
            "effects.feed",
            received="a catheter that is pushed out of its guide",
            rule=(
                "sensitivities need a given length outside the guide, and here it grows along the"
                " path"
            ),
            remedy=(
                "differentiate the length outside at the end, `scene.inserted(length)`, in the "
                "field of that time; with obstacles, or sources of a field, take finite "
                "differences of runs"
            ),
        )
    for key, effect in scene.effects.named().items():
        if (
            isinstance(effect, Obstacle | SelfContact)
            and (friction := most_friction(scene, effect.friction)) > 0.0
        ):
            raise InputError(
                f"effects.{key}.friction",
                received=f"{friction:g}, along a path of equilibria",
                rule=(
                    "what friction holds depends on every step before, so the last equilibrium"
                    " alone does not say how the shape answers"
                ),
                remedy=(
                    "take finite differences of runs (friction is settled to 0.1 % of the grip, "
                    "so change a variable by some per cent), or write `friction: 0`, also in "
                    "materials"
                ),
            )


def _refuse(received: str, rule: str, remedy: str) -> None:
    raise InputError("of", received=received, rule=rule, remedy=remedy)


# The variables of each kind; where a scene has none: the rule that it breaks and the remedy, with "; " between them.

_Found = list[Variable] | str


def _word(name: str) -> str:
    """A region's or material's name as a part of a variable's."""
    return "_".join(name.split())


def _magnetization(scene: Scene) -> _Found:
    if not scene.body.shape.magnetized_by_region:
        return "a magnetization_profile has no segments to turn; give the strip `segments`"
    regions = scene.regions()
    on = scene.magnetized_regions()
    if not on:
        return "no region is magnetized; give one a `magnetization`, and its material a `remanence`"
    return [
        Variable(
            "magnetization",
            f"{_word(regions[k].name)}_{angle}",
            "rad",
            ("body", *regions[k].at, "magnetization"),
            k,
            tangent,
        )
        for k in on
        for angle, tangent in zip(
            ("azimuth", "elevation"), tangents(regions[k].magnetization), strict=True
        )
    ]


def _field(scene: Scene) -> _Found:
    if not scene.effects.in_a_field:
        return "no effect of the field is named; name one, `magnetic_torque: {}`"
    over = scene.field.over_time
    if over is not None and any(frame.uniform is not None for frame in over.frames):
        return "the field's keyframes give its uniform part; write `field.uniform` in their place"
    return [
        Variable("field", f"field_{axis}", "T", ("field", "uniform", i))
        for i, axis in enumerate("xyz")
    ]


def _of_materials(
    kind: str, unit: str, has: Callable[[Scene, str], bool], otherwise: str
) -> Callable[[Scene], _Found]:
    def made(scene: Scene) -> _Found:
        used = dict.fromkeys(region.material_name for region in scene.regions())
        names = [name for name in used if has(scene, name)]
        return [
            Variable(kind, f"{kind}_{_word(name)}", unit, ("materials", name, kind))
            for name in names
        ] or otherwise

    return made


def _turned(scene: Scene, material: str) -> bool:
    return any(
        region.material_name == material and any(region.magnetization) for region in scene.regions()
    )


def _length(scene: Scene) -> _Found:
    shape = scene.body.shape
    if not isinstance(shape, StraightBody):
        return f"a body of {scene.body.kind} has no length to change; change its meshes"
    if shape.segments is None:
        return [Variable("length", "length", "m", ("body", scene.body.kind, "length"))]
    return [
        Variable(
            "length", f"{_word(region.name)}_length", "m", ("body", *region.at, "length"), region=k
        )
        for k, region in enumerate(scene.regions())
    ]


def _diameter(scene: Scene) -> _Found:
    if scene.body.catheter is None:
        return f"a {scene.body.kind} has no diameter; ask for it of a catheter"
    return [Variable("diameter", "diameter", "m", ("body", "catheter", "diameter"))]


_KINDS: dict[str, Callable[[Scene], _Found]] = {
    "magnetization": _magnetization,
    "field": _field,
    "remanence": _of_materials(
        "remanence",
        "T",
        _turned,
        "no region has a direction of magnetization; give one, say, `magnetization: [1, 0, 0]`",
    ),
    "shear_modulus": _of_materials("shear_modulus", "Pa", lambda scene, name: True, ""),
    "length": _length,
    "diameter": _diameter,
    "density": _of_materials(
        "density",
        "kg/m^3",
        lambda scene, name: scene.materials[name].density is not None,
        "no material has a density; give it one",
    ),
}
KINDS = tuple(_KINDS)
