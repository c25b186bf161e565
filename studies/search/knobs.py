"""Knobs that trials turn: numbers, choices and directions of a scene, as Optuna suggests them, and the scene that they make."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import NoneType
from typing import TYPE_CHECKING, Any

import numpy as np

from magmpm.compiled.arrays import Named, Plain
from magmpm.errors import InputError, in_one_line
from magmpm.inputs.quantities import divided, in_si, kind_of
from magmpm.inputs.vectors import Vector, angles_of, from_angles
from magmpm.scene import Scene
from magmpm.scene.addresses import Place, Placed, changed, check_apart, places, value_at, written
from magmpm.scene.variables import tangents, variables
from magmpm.studies.problem.study_file import Robust
from magmpm.studies.problem.variables import Addressed, FreeDirection, VaryNumber
from magmpm.studies.search.samplers.blocks import Ball, Block, Direction, Number

if TYPE_CHECKING:
    from magmpm.studies.search.samplers.blocks import Distributions


@dataclass(frozen=True)
class Knob(ABC):
    """One thing that trials turn.

    Attributes
    ----------
    name : str
        Of its parameter.
    places : tuple of Place
        In the scene, which share the value.
    """

    name: str
    places: tuple[Place, ...]

    @property
    def smooth(self) -> bool:
        """True if it turns without steps."""
        return True

    @property
    def tied(self) -> int:
        """Count of the scene's numbers that share a parameter."""
        return len(self.places)

    @abstractmethod
    def distributions(self) -> Distributions:
        """Describe its parameters for Optuna.

        Returns
        -------
        dict[str, BaseDistribution]
            Distributions by name.
        """

    def blocks(self) -> list[Block]:
        """Describe its parameters for Gauss-Newton's steps.

        Returns
        -------
        list of Block
            Blocks; none where it turns in steps.
        """
        return []

    @abstractmethod
    def at(self, params: Named) -> Placed:
        """Find the values that parameters, which may be a step beyond their bounds, write into the scene.

        Parameters
        ----------
        params : Named
            Parameters by name.

        Returns
        -------
        dict[Place, Any]
            Values by place.
        """

    def arranged(self, scene: Scene, params: Named) -> Scene:
        """Put the parts of a scene, with all its values, in their order.

        Parameters
        ----------
        scene : Scene
            The scene.
        params : Named
            Parameters by name.

        Returns
        -------
        Scene
            The scene; the same unless an order is turned.
        """
        return scene

    def own(self, scene: Scene) -> Plain:
        """Find the parameters that give the scene's own value.

        Parameters
        ----------
        scene : Scene
            The scene.

        Returns
        -------
        dict[str, Any]
            Parameters by name; none where none can.
        """
        return {}

    def begun(self, scene: Scene) -> Plain:
        """Find the parameters within the bounds that are nearest to the scene's own value.

        Parameters
        ----------
        scene : Scene
            The scene.

        Returns
        -------
        dict[str, Any]
            Parameters by name; none where none can.
        """
        return self.own(scene)


@dataclass(frozen=True)
class Bounded(Knob):
    """A number within bounds.

    Attributes
    ----------
    name : str
        Of its parameter.
    places : tuple of Place
        In the scene, which share the value.
    low : float, `unit`
        Least value.
    high : float, `unit`
        Greatest value.
    unit : str
        In which the parameter is.
    scale : float
        How many SI units that is.
    log : bool
        Whether its logarithm is drawn evenly.
    whole : bool
        Whether it is an integer.
    """

    low: float
    high: float
    unit: str
    scale: float
    log: bool
    whole: bool

    @property
    def smooth(self) -> bool:
        return not self.whole

    @property
    def block(self) -> Number:
        """The parameter."""
        return Number(self.name, self.low, self.high, self.log, self.whole)

    def distributions(self) -> Distributions:
        return self.block.distributions()

    def blocks(self) -> list[Block]:
        return [] if self.whole else [self.block]

    def at(self, params: Named) -> Placed:
        value = int(params[self.name]) if self.whole else float(params[self.name])
        return dict.fromkeys(self.places, f"{value!r} {self.unit}" if self.unit else value)

    def own(self, scene: Scene) -> Plain:
        now = value_at(scene, self.places[0])
        if not isinstance(now, (int, float)) or isinstance(now, bool):
            return {}
        value = now / self.scale
        near = round(value, 12) if value else 0.0
        return {self.name: int(near) if self.whole else near}

    def begun(self, scene: Scene) -> Plain:
        kind = int if self.whole else float
        return {
            name: kind(min(max(value, self.low), self.high))
            for name, value in self.own(scene).items()
        }


@dataclass(frozen=True)
class Choice(Knob):
    """One of some values.

    Attributes
    ----------
    name : str
        Of its parameter.
    places : tuple of Place
        In the scene, which share the value.
    values : tuple of object
        The values.
    """

    values: tuple[Any, ...]

    @property
    def smooth(self) -> bool:
        return False

    @property
    def shown(self) -> dict[Any, Any]:
        """The values by what stands for each."""
        plain = (str, int, float, NoneType)
        return {v if isinstance(v, plain) else repr(v): v for v in self.values}

    def distributions(self) -> Distributions:
        from optuna.distributions import CategoricalDistribution

        return {self.name: CategoricalDistribution(tuple(self.shown))}

    def at(self, params: Named) -> Placed:
        return dict.fromkeys(self.places, self.shown[params[self.name]])

    def own(self, scene: Scene) -> Plain:
        now = value_at(scene, self.places[0])
        for shown, value in self.shown.items():
            if value_at(changed(scene, {self.places[0]: value}), self.places[0]) == now:
                return {self.name: shown}
        return {}


@dataclass(frozen=True)
class Turning(Knob):
    """A direction by azimuth and elevation, or by the angle in a plane; a vector, with its length, too.

    Attributes
    ----------
    name : str
        Of its parameter.
    places : tuple of Place
        In the scene, which share the value.
    across : tuple of float (3,), no unit, or None
        Unit vector across the plane; None: two angles.
    around : tuple of float (3,), no unit, or None
        Unit vector about which each place's direction is turned from the one before, by an
        equal share of a full turn.
    longest : float, `unit`, or None
        Greatest length of a vector; None: a direction.
    unit : str
        Of the length.
    scale : float
        How many SI units that is.
    middle : float, degrees
        Middle of the angle in the plane.
    turn : float, degrees
        By how much it may differ from that.
    size : float, SI
        Length of a vector that only turns.
    """

    across: Vector | None = None
    around: Vector | None = None
    longest: float | None = None
    unit: str = ""
    scale: float = 1.0
    middle: float = 0.0
    turn: float = 180.0
    size: float = 1.0

    def _frame(self) -> tuple[np.ndarray, np.ndarray]:
        """Two unit vectors in the plane: the angle is from the first towards the second, right-handed about `across`."""
        n = np.array(self.across)
        x = np.array([1.0, 0.0, 0.0]) if abs(n[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
        first = x - (x @ n) * n
        first /= np.linalg.norm(first)
        return first, np.cross(n, first)

    def angles(self, vector: Sequence[float]) -> list[float]:
        """Find the angles of a vector, or of the part of it that is in the plane.

        Parameters
        ----------
        vector : sequence of float (3,)
            Of any length.

        Returns
        -------
        list of float, degrees
            One or two.
        """
        if self.across is None:
            return list(angles_of(vector))
        first, second = self._frame()
        return [math.degrees(math.atan2(second @ vector, first @ vector))]

    def _names(self) -> list[str]:
        angles = ["angle"] if self.across is not None else ["azimuth", "elevation"]
        return [f"{self.name} {angle} (deg)" for angle in angles]

    @property
    def _length(self) -> str:
        return f"{self.name} length ({self.unit})" if self.unit else f"{self.name} length"

    def distributions(self) -> Distributions:
        from optuna.distributions import FloatDistribution

        bounds = [(self.middle - self.turn, self.middle + self.turn), (-90.0, 90.0)]
        found: Distributions = {
            name: FloatDistribution(*ends)
            for name, ends in zip(self._names(), bounds, strict=False)
        }
        if self.longest is not None:
            found[self._length] = FloatDistribution(0.0, self.longest)
        return found

    def blocks(self) -> list[Block]:
        names = self._names()
        if self.across is None and self.longest is not None:
            azimuth, elevation = names
            return [Ball(self._length, azimuth, elevation, self.longest, 1.0 / self.longest)]
        if self.across is None:
            return [Direction(*names)]
        ranges: Plain = self.distributions()
        return [Number(name, each.low, each.high) for name, each in ranges.items()]

    def vectors(self, params: Named) -> dict[Place, list[float]]:
        """Find the vectors of parameters.

        Parameters
        ----------
        params : Named
            Parameters by name.

        Returns
        -------
        dict[Place, list of float], `unit`
            Three components by place.
        """
        angles = [math.radians(params[name]) for name in self._names()]
        if self.across is not None:
            first, second = self._frame()
            d = (math.cos(angles[0]) * first + math.sin(angles[0]) * second).tolist()
        else:
            d = from_angles(*angles)
        length = self.size if self.longest is None else float(params[self._length])
        share = 2.0 * math.pi / len(self.places)
        found = {}
        for k, place in enumerate(self.places):
            vector: list[float] = [length * x for x in d]
            if self.around is not None:
                from scipy.spatial.transform import Rotation  # 0.1 s to import

                turn = Rotation.from_rotvec(k * share * np.array(self.around))
                vector = turn.apply(vector).tolist()
            found[place] = vector
        return found

    def at(self, params: Named) -> Placed:
        return {
            place: [f"{x!r} {self.unit}" if self.unit else x for x in vector]
            for place, vector in self.vectors(params).items()
        }

    def own(self, scene: Scene) -> Plain:
        vector = value_at(scene, self.places[0])
        length = math.hypot(*vector)
        if self.across is not None and abs(np.dot(self.across, vector)) > 1e-9 * length:
            return {}  # out of the plane
        found = dict(zip(self._names(), self.angles(vector), strict=True))
        if self.longest is None:
            return found if length else {}
        return {**found, self._length: round(length / self.scale, 12)}

    def begun(self, scene: Scene) -> Plain:
        found = self.own(scene)
        if self.longest is not None and found:
            found[self._length] = min(found[self._length], self.longest)
        return found


def knobs(
    numbers: Sequence[VaryNumber], scene: Scene, turned: Sequence[Knob] = ()
) -> tuple[Knob, ...]:
    """Find all that a study turns in a scene.

    Parameters
    ----------
    numbers : sequence of VaryNumber
        What the study's file says of numbers.
    scene : Scene
        The scene.
    turned : sequence of Knob, default ()
        What it turns besides.

    Returns
    -------
    tuple of Knob
        `turned`, and its numbers.

    Raises
    ------
    InputError
        For addresses that are not there, that are varied twice, and bounds that the scene
        refuses.
    """
    found = list(turned)
    for k, number in enumerate(numbers):
        found += _of_number(number, scene, f"vary.numbers[{k}]")
    check_apart([(knob.name, knob.places) for knob in found], "vary")
    return tuple(found)


def groups(number: Addressed, scene: Scene, at: str) -> list[tuple[Place, ...]]:
    """Find the places of numbers.

    Parameters
    ----------
    number : Addressed
        With their addresses.
    scene : Scene
        The scene.
    at : str
        Where that is said, for messages.

    Returns
    -------
    list of tuple of Place
        One for each place, or one for all that are tied.

    Raises
    ------
    InputError
        For an address that the scene has not.
    """
    try:
        each = [place for address in number.addresses for place in places(scene, address)]
    except InputError as error:
        raise InputError(f"{at}.of: {error}") from None
    return [tuple(each)] if isinstance(number.of, tuple) else [(place,) for place in each]


def _of_number(number: VaryNumber, scene: Scene, at: str) -> list[Knob]:
    """The knobs of a number: one for each place, or one for all that are tied. Raises InputError."""
    out: list[Knob] = []
    for group in groups(number, scene, at):
        name = written(group[0])
        if number.direction is not None or number.within is not None:
            out.append(_turning(number, scene, name, group, at))
        elif number.choices is not None:
            for value in number.choices:
                accepted(scene, dict.fromkeys(group, value), f"{at}.choices", value)
            out.append(Choice(name, group, number.choices))
        else:
            out.append(_range(number, scene, name, group, at))
    return out


def _turning(
    number: VaryNumber, scene: Scene, name: str, group: tuple[Place, ...], at: str
) -> Turning:
    """The knob of a direction, or of a vector within a length. Raises InputError."""
    now = value_at(scene, group[0])
    key = "direction" if number.within is None else "within"
    if not (isinstance(now, list) and len(now) == 3):
        raise InputError(
            f"{at}.{key}",
            received=name,
            rule="must be an address of three numbers",
            remedy="give `min` and `max`",
        )
    free = number.direction or FreeDirection()
    knob = Turning(name, group, free.across, number.turned_about, size=math.hypot(*now) or 1.0)
    if free.across is not None:  # the angle's seam is opposite to the scene's own direction
        angles = knob.angles(now)
        turn = 180.0 if free.at_most is None else math.degrees(free.at_most)
        knob = replace(knob, middle=angles[0], turn=turn)
    if number.within is None:
        return knob
    longest, unit = _number(number.within, f"{at}.within")
    if longest <= 0.0:
        raise InputError(
            f"{at}.within",
            received=repr(number.within),
            rule="must be above 0",
            remedy="give the greatest length",
        )
    most = f"{longest!r} {unit}" if unit else longest
    zero = f"0 {unit}" if unit else 0.0
    along_x = {place: [most, zero, zero] for place in group}
    longest_of = accepted(scene, along_x, f"{at}.within", number.within)
    scale = float(value_at(longest_of, group[0])[0]) / longest
    return replace(knob, longest=longest, unit=unit, scale=scale)


def _number(given: Any, at: str) -> tuple[float, str]:
    """A number and its unit. Raises InputError."""
    found = divided(given)
    if found is None:
        raise InputError(
            at,
            received=repr(given),
            rule="must be a number, with its unit where it has one",
            remedy='write, say, "2 mT"',
        )
    return found


def _range(
    number: VaryNumber, scene: Scene, name: str, group: tuple[Place, ...], at: str
) -> Bounded:
    """The knob of a number within bounds. Raises InputError."""
    ends = [_number(getattr(number, key), f"{at}.{key}") for key in ("min", "max")]
    (low, unit), (high, other) = ends
    if unit != other:
        raise InputError(
            f"{at}.max",
            received=repr(number.max),
            rule=f"must have the unit of min, {unit or 'none'}",
            remedy="write both in one unit",
        )
    if not low < high or (number.log and not low > 0):
        raise InputError(
            f"{at}.min",
            received=f"{number.min!r} to {number.max!r}",
            rule="min must be less than max" + (", and above 0 with `log`" if number.log else ""),
            remedy="exchange or correct them",
        )
    whole = all(isinstance(end, int) for end in (number.min, number.max)) and isinstance(
        value_at(scene, group[0]), int
    )
    knob = Bounded(name, group, low, high, unit, 1.0, number.log, whole)
    ends_of = [
        accepted(scene, knob.at({name: end}), f"{at}.{key}", getattr(number, key))
        for key, end in (("min", low), ("max", high))
    ]
    most = max((abs(low), 0), (abs(high), 1))  # the larger end tells the unit best
    largest = value_at(ends_of[most[1]], group[0])
    # a scene brings directions to length 1: a component of one is not the number that was written
    if not isinstance(largest, (int, float)) or (not unit and abs(largest) != most[0]):
        raise InputError(
            f"{at}.of",
            received=name,
            rule="must be an address of a number, and of no component of a direction",
            remedy="give `choices`, or `direction: {}` for the whole direction",
        )
    scale = abs(float(largest)) / most[0]
    return replace(knob, name=f"{name} ({unit})" if unit else name, scale=scale)


def accepted(scene: Scene, values: Mapping[Place, Any], at: str, given: Any) -> Scene:
    """Put values of a file into a scene, where quantities have units.

    Parameters
    ----------
    scene : Scene
        The scene.
    values : Mapping[Place, Any]
        By place.
    at : str
        The key that gives them, for messages.
    given : object
        What stands there.

    Returns
    -------
    Scene
        The scene with the values.

    Raises
    ------
    InputError
        Where the scene refuses them.
    """
    try:
        return changed(scene, values, units=True)
    except InputError as error:
        raise InputError(
            at,
            received=repr(given),
            rule=f"the scene refuses it: {in_one_line(error)}",
            remedy=str(error).partition("remedy: ")[2].partition("\n")[0],
        ) from None


def distributions(turned: Sequence[Knob]) -> Distributions:
    """Describe all parameters for Optuna.

    Parameters
    ----------
    turned : sequence of Knob
        What the study turns.

    Returns
    -------
    dict[str, BaseDistribution]
        Distributions by name.
    """
    return {name: one for knob in turned for name, one in knob.distributions().items()}


def made(scene: Scene, turned: Sequence[Knob], params: Named) -> Scene:
    """Make the scene of a trial.

    Parameters
    ----------
    scene : Scene
        The study's scene.
    turned : sequence of Knob
        What the study turns.
    params : Named
        The trial's parameters by name.

    Returns
    -------
    Scene
        The scene.

    Raises
    ------
    InputError
        Where its values together break a rule of the scene.
    """
    values: Placed = {}
    for knob in turned:
        values |= knob.at(params)
    found = changed(scene, values)
    for knob in turned:
        found = knob.arranged(found, params)
    return found


def errors_of(robust: Robust, scene: Scene) -> list[dict[Place, float]]:
    """Find the errors that a scene is made with: words name numbers by their addresses, too.

    Parameters
    ----------
    robust : Robust
        What a study's file says.
    scene : Scene
        The scene that is made.

    Returns
    -------
    list of dict[Place, float], SI
        What numbers change by one standard deviation of each independent error. A direction has two,
        tilts along both of its `tangents`.

    Raises
    ------
    InputError
        For addresses that are not there, or are named twice, and for deviations that can't be.
    """
    found: list[tuple[tuple[Place, ...], float, bool]] = []  # places, deviation, of each value
    for kind, size in (
        ("magnetization", robust.direction),
        ("remanence", robust.remanence),
        ("shear_modulus", robust.shear_modulus),
    ):
        known = variables(scene, [kind]) if size else ()
        found += [((place,), size, True) for place in dict.fromkeys(v.place for v in known)]
    for k, number in enumerate(robust.numbers or ()):
        at = f"robust.numbers[{k}]"
        for group in groups(number, scene, at):
            found.append((group, *_deviation(number.deviation, scene, group[0], at)))
    check_apart([(written(group[0]), group) for group, _, _ in found], "robust.numbers")
    changes = list[dict[Place, float]]()
    for group, size, relative in found:
        tilts: tuple[dict[Place, float], ...] = ({}, {})
        for place in group:
            now = value_at(scene, place)
            if not isinstance(now, list):
                tilts[0][place] = size * (now if relative else 1.0)
                continue
            length = size * math.hypot(*now)
            across = tangents(now) if length else ()  # what is zero has no direction
            for tilt, tangent in zip(tilts, across, strict=False):
                tilt |= {(*place, i): length * part for i, part in enumerate(tangent)}
        changes += filter(None, tilts)
    return changes


def _deviation(given: Any, scene: Scene, place: Place, at: str) -> tuple[float, bool]:
    """A standard deviation, SI or a share of the value at a place, and whether it is a share. Raises InputError."""
    now = value_at(scene, place)
    vector = isinstance(now, list)
    size, unit = _number(given, f"{at}.deviation")
    said = divided(value_at(scene, place, units=True))
    own = kind_of(said[1]) if said else ""
    kind = "percentage" if unit == "%" else "angle" if vector else own
    if kind:
        size = in_si(given, kind, f"{at}.deviation")
    most = {"percentage": 0.5, "angle": math.pi / 4}.get(kind, math.inf)
    if not 0.0 < size <= most or bool(unit) != bool(kind) or (unit == "%" and (vector or not now)):
        raise InputError(
            f"{at}.deviation",
            received=repr(given),
            rule="must be above 0: at most 45 deg of a direction, at most 50 % of a number that is"
            " not 0",
            remedy="write, say, `deviation: 5 %`, or a quantity in the number's own unit",
        )
    return size, unit == "%"
