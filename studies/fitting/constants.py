"""The constants that a fit looks for: what each is in the scene, and the number by which it changes.

A fit works in numbers x without unit: what must be positive (moduli, remanence, density, damping) is its start times exp(x), so that x is
a relative change, and intervals stay positive; a direction turns by x rad; a stray field is x times 1 mT.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from magmpm.bodies.segments import StraightBody
from magmpm.compiled.arrays import Array
from magmpm.errors import InputError
from magmpm.scene import Scene
from magmpm.scene.variables import Variable, tangents, variables

OF_MATERIALS = ("shear_modulus", "remanence", "density")
KINDS = (*OF_MATERIALS, "length", "magnetization", "field", "damping", "viscosity")
# taken as exact: a fit frees it to say whether it explains residuals, and never to give it
GEOMETRY = "diameter"
LOSSES = {
    "damping": ("rate", "1/s"),
    "viscosity": ("viscosity", "Pa s"),
}  # effects of motions: key and unit
_MILLITESLA = 1e-3
SHOWN = {
    "shear_modulus": (1e-3, "kPa"),
    "remanence": (1e3, "mT"),
    "density": (1.0, "kg/m^3"),
    "length": (1e3, "mm"),
    GEOMETRY: (1e3, "mm"),
    "magnetization": (180 / math.pi, "deg"),
    "field": (1e3, "mT"),
    "damping": (1.0, "1/s"),
    "viscosity": (1.0, "Pa s"),
}


@dataclass(frozen=True)
class Constant:
    """One number of a scene. start: its value there, SI; of a direction and of a stray field the change, so 0."""

    name: str
    kind: str
    start: float
    unit: str
    variable: Variable | None = None
    known: float | None = None  # standard deviation, in x, of what is known beforehand

    @property
    def relative(self) -> bool:
        """True if x is the logarithm of its ratio to the start."""
        return self.kind not in ("magnetization", "field")

    def value(self, x: float) -> float:
        """SI, of the number x."""
        if self.relative:
            return self.start * math.exp(x)
        return x if self.kind == "magnetization" else x * _MILLITESLA

    def slope(self, x: float) -> float:
        """d(value)/dx, SI."""
        return (
            self.value(x)
            if self.relative
            else (1.0 if self.kind == "magnetization" else _MILLITESLA)
        )

    def number(self, value: float) -> float:
        """x of a value, SI."""
        if self.relative:
            return math.log(value / self.start)
        return value if self.kind == "magnetization" else value / _MILLITESLA


def constants_of(scene: Scene, of: Sequence[str] | None = None) -> tuple[Constant, ...]:
    """The constants of these kinds or names that a scene has. None: shear moduli, remanences, and in motion the losses that it names.

    Raises InputError for a name that is not known, or of which the scene has none.
    """
    moving = scene.solver.dynamic is not None
    if of is None:
        has = [
            kind
            for kind in ("shear_modulus", "remanence")
            if not isinstance(_made(scene, kind), str)
        ]
        of = [
            *has,
            *(kind for kind in LOSSES if moving and not isinstance(_made(scene, kind), str)),
        ]
    found: dict[str, Constant] = {}
    for word in of:
        for constant in _named(scene, word):
            found[constant.name] = constant
    if not found:
        raise InputError(
            "--vary",
            received="nothing",
            rule="a fit needs a constant to find",
            remedy="say, --vary shear_modulus",
        )
    return tuple(found.values())


def _named(scene: Scene, word: str) -> list[Constant]:
    """The constants that a word names: all of a kind, or one by its own name."""
    if word in KINDS:
        made = _made(scene, word)
        if isinstance(made, str):
            rule, _, remedy = made.partition("; ")
            raise InputError("--vary", received=word, rule=rule, remedy=remedy or "leave it out")
        return made
    every = [c for kind in KINDS if not isinstance(made := _made(scene, kind), str) for c in made]
    chosen = [constant for constant in every if constant.name == word]
    if not chosen:
        names = [*KINDS, *(constant.name for constant in every)]
        near = difflib.get_close_matches(word, names, n=1)
        remedy = f'did you mean "{near[0]}"?' if near else "choose among them"
        raise InputError(
            "--vary",
            received=repr(word),
            rule=f"must be of {', '.join(dict.fromkeys(names))}",
            remedy=remedy,
        )
    return chosen


def _made(scene: Scene, kind: str) -> list[Constant] | str:
    """The constants of a kind; where the scene has none: the rule it breaks and the remedy."""
    if kind in LOSSES:
        effect = getattr(scene.effects, kind, None)
        key = LOSSES[kind][0]
        if scene.solver.dynamic is None:
            return (
                f"{kind} acts in motion only, and the scene is none; give it `solver: {{dynamic:"
                " ...}`, and a table with t_ms"
            )
        if effect is None or getattr(effect, key) <= 0:
            return f"the scene names no {kind}; name it with a first guess"
        return [Constant(kind, kind, float(getattr(effect, key)), LOSSES[kind][1])]
    try:
        found = variables(scene, [kind])
    except InputError as error:
        lines = str(error).splitlines()
        return f"{lines[1].partition(': ')[2]}; {lines[2].partition(': ')[2]}"
    if kind == "length":
        shape = scene.body.shape
        lengths = (
            shape.segment_lengths()
            if isinstance(shape, StraightBody) and found[0].region is not None
            else [scene.length]
        )
        return [
            Constant(v.name, kind, float(length), v.unit, v)
            for v, length in zip(found, lengths, strict=True)
        ]
    if kind in OF_MATERIALS:
        starts = {v.name: float(getattr(scene.materials[v.material or ""], kind)) for v in found}
        if kind == "remanence" and min(starts.values()) <= 0:
            return "a material has no remanence to start from; give it a first guess"
        return [Constant(v.name, kind, starts[v.name], v.unit, v) for v in found]
    return [Constant(v.name, kind, 0.0, v.unit, v) for v in found]


def diameter_of(scene: Scene) -> list[Constant]:
    """A catheter's diameter as a constant; none of other bodies."""
    found = [] if scene.body.catheter is None else variables(scene, [GEOMETRY])
    return [Constant(v.name, GEOMETRY, float(scene.body.shape.thickness), v.unit, v) for v in found]


def with_known(constants: Sequence[Constant], known: dict[str, float]) -> tuple[Constant, ...]:
    """The constants, with what is known of some: relative standard deviations by name. Raises InputError."""
    for name in known:
        chosen = [
            constant
            for constant in constants
            if constant.name == name or (constant.kind == name and constant.relative)
        ]
        if not chosen:
            names = ", ".join(constant.name for constant in constants if constant.relative)
            raise InputError(
                "--known",
                received=name,
                rule=f"must be among what is varied: {names}",
                remedy="correct the name",
            )
    return tuple(
        replace(c, known=known.get(c.name, known.get(c.kind)) if c.relative else None)
        for c in constants
    )


def applied(scene: Scene, constants: Sequence[Constant], x: Array) -> Scene:
    """The scene with the constants at x. Raises InputError where a value leaves what a scene allows."""
    for constant, number in zip(constants, x, strict=True):
        if constant.kind == "length" and constant.variable is not None:
            scene = constant.variable.changed(scene, constant.value(number) - constant.start)
    found = scene
    if any(constant.kind in (*OF_MATERIALS, *LOSSES, "field") for constant in constants):
        data = scene.to_si()
        write(data, scene, constants, x, lambda kind, value: value)
        found = Scene.from_si(data)
    turned = directions(scene, constants, x)
    return found if turned is None else found.with_magnetizations(turned)


def write(
    data: dict[str, Any],
    scene: Scene,
    constants: Sequence[Constant],
    x: Array,
    written: Callable[[str, float], Any],
) -> None:
    """Put the constants at x of materials, losses and the field into a scene's data; written: a value of a kind as the data have it."""
    uniform = np.array(scene.field.uniform)
    for constant, number in zip(constants, x.tolist(), strict=True):
        value = constant.value(number)
        variable = constant.variable
        if constant.kind in LOSSES:
            data["effects"][constant.kind][LOSSES[constant.kind][0]] = written(constant.kind, value)
        elif variable is not None and constant.kind in OF_MATERIALS:
            data["materials"][variable.material][constant.kind] = written(constant.kind, value)
        elif variable is not None and constant.kind == "field":
            uniform[variable.component or 0] += value
    if any(constant.kind == "field" for constant in constants):
        data["field"] = {
            **data.get("field", {}),
            "uniform": [written("field", part) for part in uniform.tolist()],
        }


def directions(scene: Scene, constants: Sequence[Constant], x: Array) -> Array | None:
    """Directions (k, 3) of the regions turned by x; None where no direction varies.

    With d the scene's direction and t, u its tangents (scene.variables): cos e (cos a d + sin a t) + sin e u for the two numbers a, e.
    """
    turned = list(_turned(scene, constants, x))
    if not turned:
        return None
    found: Array = np.array([region.magnetization for region in scene.regions()])
    for region, _, a, e, d, t, u in turned:
        found[region] = np.cos(e) * (np.cos(a) * d + np.sin(a) * t) + np.sin(e) * u
    return found


def _turned(scene: Scene, constants: Sequence[Constant], x: Array) -> Iterator[tuple[Any, ...]]:
    """Each region that turns: the numbers of its two turns, the turns a and e (rad), its direction d and the tangents t and u."""
    start: Array = np.array([region.magnetization for region in scene.regions()])
    turns: dict[int, list[int | None]] = {}
    for k, constant in enumerate(constants):
        if (
            constant.kind == "magnetization"
            and constant.variable is not None
            and constant.variable.region is not None
        ):
            pair = turns.setdefault(constant.variable.region, [None, None])
            pair[0 if constant.name.endswith("_azimuth") else 1] = k
    for region, pair in turns.items():
        yield (
            region,
            pair,
            *(0.0 if k is None else float(x[k]) for k in pair),
            start[region],
            *np.array(tangents(start[region])),
        )


def chain(
    scene: Scene, constants: Sequence[Constant], x: Array, there: Sequence[Variable]
) -> Array:
    """Derivatives of the variables (q,) of the scene at x, as `sensitivities` has them, by x: (q, k), SI per unit of x.

    scene: the one that the fit began with; there: the variables of applied(scene, constants, x), by the same names.
    """
    place = {variable.name: i for i, variable in enumerate(there)}
    out = np.zeros((len(there), len(constants)))
    for k, constant in enumerate(constants):
        if constant.kind != "magnetization":
            out[place[constant.name], k] = constant.slope(float(x[k]))
    for region, pair, a, e, d, t, u in _turned(scene, constants, x):
        slopes = (
            np.cos(e) * (np.cos(a) * t - np.sin(a) * d),
            np.cos(e) * u - np.sin(e) * (np.cos(a) * d + np.sin(a) * t),
        )
        for variable, i in (
            (v, place[v.name]) for v in there if v.kind == "magnetization" and v.region == region
        ):
            for number, slope in zip(pair, slopes, strict=True):
                if number is not None:
                    out[i, number] = float(np.dot(variable.direction or (0.0, 0.0, 0.0), slope))
    return out
