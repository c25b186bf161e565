"""The constants that a fit looks for: what each is in the scene, and the number by which it changes.

A fit works in numbers x without unit: what must be positive (moduli, remanence, density, damping) is its start times exp(x), so that x is
a relative change, and intervals stay positive; a direction turns by x rad; a stray field is x times 1 mT.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array, NamedNumbers
from magmpm.errors import InputError
from magmpm.inputs.quantities import divided
from magmpm.scene import Scene
from magmpm.scene.addresses import Place, Placed, changed, places, value_at, written
from magmpm.scene.variables import Variable, of_lengths, segment_lengths, tangents, variables

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
    """One number of a scene that a fit may change. It works in numbers x without unit (see the module).

    Attributes
    ----------
    variable : Variable
        Which number it is.
    start : float, SI
        Its value in the scene; of a direction and of a stray field the change, so 0.
    shown : tuple[float, str]
        How many of the unit in which people read it are an SI one, and that unit.
    known : float or None
        Standard deviation, in x, of what is known beforehand; None: nothing.
    shared : tuple of Place
        Other places that have the same value.
    """

    variable: Variable
    start: float
    shown: tuple[float, str] = (1.0, "")
    known: float | None = None
    shared: tuple[Place, ...] = ()

    @property
    def name(self) -> str:
        """Its name."""
        return self.variable.name

    @property
    def kind(self) -> str:
        """The word that requests it."""
        return self.variable.kind

    @property
    def unit(self) -> str:
        """Unit of its value, SI."""
        return self.variable.unit

    @property
    def places(self) -> tuple[Place, ...]:
        """All of its places."""
        return (self.variable.place, *self.shared)

    @property
    def address(self) -> str:
        """Its address, or all of them with `=` between them."""
        return "=".join([self.variable.address, *map(written, self.shared)])

    @property
    def words(self) -> list[str]:
        """Words by which `variables` has it, among others of its kind."""
        own = self.name if self.name == written(self.variable.place) else self.kind
        return [own, *map(written, self.shared)]

    @property
    def relative(self) -> bool:
        """True if x is the logarithm of its ratio to the start."""
        return self.kind not in ("magnetization", "field")

    def value(self, x: float) -> float:
        """Find the value of a number x.

        Parameters
        ----------
        x : float, no unit
            The number.

        Returns
        -------
        float, SI
            The value.
        """
        if self.relative:
            return self.start * math.exp(x)
        return x if self.kind == "magnetization" else x * _MILLITESLA

    def slope(self, x: float) -> float:
        """Find the derivative of the value.

        Parameters
        ----------
        x : float, no unit
            Where it is taken.

        Returns
        -------
        float, SI
            d(value)/dx.
        """
        return (
            self.value(x)
            if self.relative
            else (1.0 if self.kind == "magnetization" else _MILLITESLA)
        )

    def number(self, value: float) -> float:
        """Find the number x of a value.

        Parameters
        ----------
        value : float, SI
            The value.

        Returns
        -------
        float, no unit
            The number.
        """
        if self.relative:
            return math.log(value / self.start)
        return value if self.kind == "magnetization" else value / _MILLITESLA


def constants_of(scene: Scene, of: Sequence[str] | None = None) -> tuple[Constant, ...]:
    """Find the constants that a scene has.

    Parameters
    ----------
    scene : Scene
        The scene.
    of : sequence of str, optional
        Their kinds, names or addresses, with `=` between those that share one value; shear moduli,
        remanences, and in motion the losses that it names unless given.

    Returns
    -------
    tuple of Constant
        The constants.

    Raises
    ------
    InputError
        For a name that is not known, or of which the scene has none.
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
        each = [constant for one in word.split("=") for constant in _named(scene, one.strip())]
        for constant in _tied(word, each) if "=" in word else each:
            found[constant.name] = constant
    if not found:
        raise InputError(
            "--vary",
            received="nothing",
            rule="a fit needs a constant to find",
            remedy="say, --vary shear_modulus",
        )
    places = [place for c in found.values() if c.kind != "magnetization" for place in c.places]
    if len(set(places)) < len(places):
        raise InputError(
            "--vary",
            received=", ".join(found),
            rule="one number has two names",
            remedy="leave one of them out",
        )
    return tuple(found.values())


def _tied(word: str, each: Sequence[Constant]) -> list[Constant]:
    """Constants that share one value as one that begins at the first one's. Raises InputError."""
    first, *others = each
    if any(not c.relative or c.kind == "length" or c.unit != first.unit for c in each):
        raise InputError(
            "--vary",
            received=word,
            rule="what shares a value changes by factors, and has one unit: no fields, turns or"
            " lengths of segments",
            remedy="say, --vary materials.a.shear_modulus=materials.b.shear_modulus",
        )
    return [replace(first, shared=tuple(c.variable.place for c in others))]


def _named(scene: Scene, word: str) -> list[Constant]:
    """The constants that a word names: all of a kind, one by its own name, or numbers by their address."""
    if word in KINDS:
        made = _made(scene, word)
        if isinstance(made, str):
            rule, _, remedy = made.partition("; ")
            raise InputError("--vary", received=word, rule=rule, remedy=remedy or "leave it out")
        return made
    every = [c for kind in KINDS if not isinstance(made := _made(scene, kind), str) for c in made]
    chosen = [constant for constant in every if constant.name == word]
    if not chosen and ("." in word or "[" in word):
        return _at_address(scene, word)
    if not chosen:
        names = [*KINDS, *(constant.name for constant in every)]
        near = difflib.get_close_matches(word, names, n=1)
        remedy = f'did you mean "{near[0]}"?' if near else "choose among them"
        raise InputError(
            "--vary",
            received=repr(word),
            rule=f"must be of {', '.join(dict.fromkeys(names))}, or an address",
            remedy=remedy,
        )
    return chosen


def _made(scene: Scene, kind: str) -> list[Constant] | str:
    """The constants of a kind; where the scene has none: the rule it breaks and the remedy."""
    if kind in LOSSES:
        key, unit = LOSSES[kind]
        if scene.solver.dynamic is None:
            return (
                f"{kind} acts in motion only, and the scene is none; give it `solver: {{dynamic:"
                " ...}`, and a table with t_ms"
            )
        effect = getattr(scene.effects, kind, None)
        if getattr(effect, "loss_factor", None) is not None:
            return _at_address(scene, "effects.viscosity.loss_factor")
        if effect is None or getattr(effect, key) <= 0:
            return f"the scene names no {kind}; name it with a first guess"
        return _started(scene, [Variable(kind, kind, unit, ("effects", kind, key))])
    try:
        found = _started(scene, variables(scene, [kind]))
    except InputError as error:
        lines = str(error).splitlines()
        return f"{lines[1].partition(': ')[2]}; {lines[2].partition(': ')[2]}"
    if kind == "remanence" and min(constant.start for constant in found) <= 0:
        return "a material has no remanence to start from; give it a first guess"
    return found


def _at_address(scene: Scene, address: str) -> list[Constant]:
    """The numbers at an address, of a direction its angles. Raises InputError for one that a fit can't change by factors."""
    try:
        named = places(scene, address)
        turned = _made(scene, "magnetization")
        if isinstance(turned, list) and (
            angles := [c for c in turned if c.variable.place in named]
        ):
            return angles
        found = _started(scene, variables(scene, [address]))
    except InputError as error:
        raise InputError(f"--vary: {error}") from None
    for constant in found:
        rule = None
        if constant.kind == "magnetization":
            rule = "a direction turns by two angles, not by a component"
            remedy = "leave the index out for both, or --vary segment_1_azimuth"
        elif constant.relative and constant.start == 0.0:
            rule = "a fit changes a number by factors, and it is 0 in the scene"
            remedy = "give it a first guess"
        if rule is not None:
            raise InputError("--vary", received=constant.name, rule=rule, remedy=remedy)
    return found


def _started(scene: Scene, found: Sequence[Variable]) -> list[Constant]:
    """Variables as constants that start at the scene's values; turns and stray fields at zero."""
    out = []
    for variable in found:
        start = 0.0
        if variable.kind == "length" and variable.region is not None:
            start = segment_lengths(scene)[variable.region]
        elif variable.kind not in ("magnetization", "field"):
            start = value_at(scene, variable.place)
        shown = SHOWN.get(variable.kind)
        if shown is None:
            number, unit = divided(value_at(scene, variable.place, units=True)) or (start, "")
            shown = (number / start if start else 1.0, unit)
        out.append(Constant(variable, float(start), shown))
    return out


def diameter_of(scene: Scene) -> list[Constant]:
    """Find a catheter's diameter as a constant.

    Parameters
    ----------
    scene : Scene
        The scene.

    Returns
    -------
    list of Constant
        The constant; none of other bodies.
    """
    return [] if scene.body.catheter is None else _started(scene, variables(scene, [GEOMETRY]))


def with_known(constants: Sequence[Constant], known: NamedNumbers) -> tuple[Constant, ...]:
    """Add to constants what is known of them beforehand.

    Parameters
    ----------
    constants : sequence of Constant
        The constants.
    known : dict[str, float], no unit
        Relative standard deviations by name or kind.

    Returns
    -------
    tuple of Constant
        The constants with it.

    Raises
    ------
    InputError
        For a name of none of them, or a number that can't be.
    """
    for name in known:
        chosen = [
            constant
            for constant in constants
            if _is(constant, name) and (constant.name == name or constant.relative)
        ]
        if not chosen:
            names = ", ".join(constant.name for constant in constants if constant.relative)
            raise InputError(
                "--known",
                received=name,
                rule=f"must be one of the varied constants: {names}",
                remedy="correct the name",
            )
    own = sorted(known.items(), key=lambda one: one[0] in KINDS)  # of a kind what has no own one
    return tuple(
        replace(c, known=next((size for name, size in own if _is(c, name) and c.relative), None))
        for c in constants
    )


def _is(constant: Constant, name: str) -> bool:
    """True if a name is a constant's own, that of its kind, or its address, with [*] or not."""
    own = [written(place) for place in constant.places]
    every = [re.sub(r"\[\d+\]", "[*]", one) for one in own]
    return name in (constant.name, constant.kind, *own, *every)


def applied(scene: Scene, constants: Sequence[Constant], x: Array) -> Scene:
    """Make the scene with the constants at x.

    A direction d with tangents t, u (scene.variables) turns by two numbers a, e: cos e (cos a d +
    sin a t) + sin e u.

    Parameters
    ----------
    scene : Scene
        The one that the fit began with.
    constants : sequence of Constant
        The k constants.
    x : array (k,), no unit
        Their numbers.

    Returns
    -------
    Scene
        The other scene.

    Raises
    ------
    InputError
        Where a value leaves what a scene allows.
    """
    values: Placed = {}
    for constant, number in zip(constants, x.tolist(), strict=True):
        value = constant.value(number)
        if constant.kind == "length":
            scene = constant.variable.changed(scene, value - constant.start)
        elif constant.kind == "field":
            values[constant.variable.place] = value_at(scene, constant.variable.place) + value
        elif constant.kind != "magnetization":
            values |= dict.fromkeys(constant.places, value)
    for place, _, a, e, d, t, u in _turned(scene, constants, x):
        turned = np.cos(e) * (np.cos(a) * d + np.sin(a) * t) + np.sin(e) * u
        values[place] = turned.tolist()
    return changed(scene, values)


def places_of(scene: Scene, constants: Sequence[Constant]) -> list[Place]:
    """Find the places of a scene that the constants change.

    Parameters
    ----------
    scene : Scene
        The scene.
    constants : sequence of Constant
        The constants.

    Returns
    -------
    list of Place
        The places.
    """
    found = dict.fromkeys(place for constant in constants for place in constant.places)
    if any(c.kind == "length" and c.variable.region is not None for c in constants):
        found |= dict.fromkeys(of_lengths(scene, segment_lengths(scene)))
    return list(found)


def _turned(scene: Scene, constants: Sequence[Constant], x: Array) -> Iterator[tuple[Any, ...]]:
    """Each place that turns: the numbers of its two turns, the turns a and e (rad), its direction d, the tangents t and u."""
    turns: dict[Place, list[int | None]] = {}
    for k, constant in enumerate(constants):
        if constant.kind == "magnetization":
            pair = turns.setdefault(constant.variable.place, [None, None])
            pair[0 if constant.name.endswith("_azimuth") else 1] = k
    for place, pair in turns.items():
        angles = [0.0 if k is None else float(x[k]) for k in pair]
        d = value_at(scene, place)
        yield place, pair, *angles, np.array(d), *np.array(tangents(d))


def chain(
    scene: Scene, constants: Sequence[Constant], x: Array, there: Sequence[Variable]
) -> Array:
    """Find the derivatives of a scene's variables by x.

    Parameters
    ----------
    scene : Scene
        The one that the fit began with.
    constants : sequence of Constant
        The k constants.
    x : array (k,), no unit
        Their numbers.
    there : sequence of Variable
        The q variables of applied(scene, constants, x), by the same names, as `sensitivities`
        has them.

    Returns
    -------
    array (q, k), SI per unit of x
        The derivatives.
    """
    place = {variable.name: i for i, variable in enumerate(there)}
    out = np.zeros((len(there), len(constants)))
    for k, constant in enumerate(constants):
        if constant.kind != "magnetization":
            for name in (constant.name, *constant.words[1:]):
                out[place[name], k] = constant.slope(float(x[k]))
    for turned, pair, a, e, d, t, u in _turned(scene, constants, x):
        slopes = (
            np.cos(e) * (np.cos(a) * t - np.sin(a) * d),
            np.cos(e) * u - np.sin(e) * (np.cos(a) * d + np.sin(a) * t),
        )
        for variable, i in ((v, place[v.name]) for v in there if v.place == turned):
            for number, slope in zip(pair, slopes, strict=True):
                if number is not None:
                    out[i, number] = float(np.dot(variable.direction or (0.0, 0.0, 0.0), slope))
    return out
