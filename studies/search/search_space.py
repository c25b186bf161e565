"""Search space of a study, and the scene that each design stands for.

A design is made of blocks (parameters.py), in this order: directions of the magnetized segments, base to tip; the field, or one at each
depth or time; numbers within bounds: lengths, diameter, remanence, stiffness, and those of addresses; directions and vectors of addresses.
Besides there are choices, which have no neighbors: the order of the segments, and values of addresses. Each magnetized segment has two
angles, relative to the catheter and not to the room:

    around: turn about the catheter's axis, from +y toward +z, -180 to 180 deg
    along:  lift from the cross-section toward the tip, -90 to 90 deg
    d = (sin along, cos along cos around, cos along sin around)

A varied field has its strength and the two angles of scene files: azimuth from +x toward +y, elevation to +z.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from magmpm.bodies.segments import StraightBody
from magmpm.compiled.arrays import Array, NamedNumbers, Plain
from magmpm.scene import Scene
from magmpm.scene.addresses import Place, Placed, put, say, written
from magmpm.scene.variables import of_lengths, segment_lengths
from magmpm.studies.problem.variables import Vary
from magmpm.studies.search.knobs import Choice, Knob, Turning
from magmpm.studies.search.parameters import (
    FIELD,
    FieldVector,
    Makeable,
    Parameters,
    SegmentDirection,
    VariedNumber,
)
from magmpm.studies.search.samplers.blocks import Ball, Block, Direction
from magmpm.studies.search.samplers.gauss_newton_steps import Coordinates
from magmpm.studies.search.scene_edits import (
    addressed,
    arrangement,
    kept_total,
    numbers_of,
    orders,
    segment_names,
    with_own_materials,
)

if TYPE_CHECKING:
    from magmpm.scene.variables import Variable
    from magmpm.studies.problem.study import Study
    from magmpm.studies.search.samplers.blocks import Distributions

_Kind = TypeVar("_Kind", bound=Block)
__all__ = ["FIELD", "SearchSpace"]


@dataclass(frozen=True)
class SearchSpace:
    """Space of what is varied in a scene.

    A design is a set of named parameters. Its embedded coordinates are numbers in which the search
    measures distances: unit vectors of directions, vectors of fields (T), and places between bounds
    from 0 to 1.

    Attributes
    ----------
    scene : Scene
        With all that is not varied.
    segments : tuple of int
        The magnetized segments whose directions vary, by numbers from 0, base first.
    field_max : float, T, or None
        Greatest strength of a varied field; None for a fixed field.
    fields : int
        How many fields there are, one at each depth or time.
    numbers_within : tuple of VariedNumber
        Quantities within bounds.
    keeps_length : bool
        Whether segments that vary their lengths sum to the body's.
    order : bool
        Whether the order of magnetized and plain segments varies.
    limits : Makeable or None
        Of the directions that can be made.
    others : tuple of Knob
        Choices, directions and vectors by their addresses.
    """

    scene: Scene
    segments: tuple[int, ...]
    field_max: float | None
    fields: int = 1
    numbers_within: tuple[VariedNumber, ...] = ()
    keeps_length: bool = True
    order: bool = False
    limits: Makeable | None = None
    others: tuple[Knob, ...] = ()

    @classmethod
    def of(cls, study: Study) -> SearchSpace:
        """Make the space that a study requests.

        Parameters
        ----------
        study : Study
            The study.

        Returns
        -------
        SearchSpace
            Its space.
        """
        vary = study.vary
        scene = study.scene
        limits = study.limits
        return replace(
            numbers_space(scene, vary),
            segments=tuple(study.turned),
            field_max=study.field_max,
            fields=study.fields,
            limits=(
                None
                if limits is None
                else Makeable(
                    None if limits.directions is None else np.array(limits.directions),
                    limits.at_most,
                )
            ),
        )

    # the blocks, and where their embedded coordinates stand

    @cached_property
    def blocks(self) -> tuple[Block, ...]:
        """The parts of a design, in the order of its parameters and embedded coordinates."""
        found: list[Block] = [
            SegmentDirection(f"{name}_around_deg", f"{name}_along_deg", i)
            for name, i in zip(self.segment_names(), self.segments, strict=True)
        ]
        if self.field_max is not None:
            found += [
                FieldVector(*names, 1e3 * self.field_max, 1e-3, k)
                for k, names in enumerate(self._field_names())
            ]
        found += self.numbers_within
        return (*found, *(block for knob in self.others for block in knob.blocks()))

    @cached_property
    def coordinates(self) -> Coordinates:
        """The embedded coordinates of all blocks together, and steps in them."""
        return Coordinates(self.blocks)

    @cached_property
    def parts(self) -> tuple[tuple[Block, slice], ...]:
        """The blocks, each with the slice of its embedded coordinates."""
        return tuple(zip(self.blocks, self.coordinates.places, strict=True))

    def those(self, kind: type[_Kind]) -> list[tuple[_Kind, slice]]:
        """Find the blocks of a kind.

        Parameters
        ----------
        kind : type[_Kind]
            Their class.

        Returns
        -------
        list of tuple[_Kind, slice]
            Each with the slice of its embedded coordinates.
        """
        return [(block, at) for block, at in self.parts if isinstance(block, kind)]

    @property
    def size(self) -> int:
        """Number of embedded coordinates of a design."""
        return self.coordinates.size

    @property
    def freedom(self) -> int:
        """Count of numbers that can change independently: two a direction, three a field, one a number (one less for a kept length).

        Limits aside.
        """
        lengths = sum(number.what == "length" for number in self.numbers_within)
        return self.coordinates.freedom - int(lengths > 0 and self.keeps_length)

    @cached_property
    def bounds(self) -> dict[str, tuple[float, float]]:
        """Least and greatest value of each numeric parameter, by name, in the order of the blocks."""
        return self.coordinates.bounds()

    @property
    def choices(self) -> dict[str, tuple[Any, ...]]:
        """Values of the parameters that are choices, orders of magnetized (M) and plain (P) segments, base to tip, among them."""
        orders_of = {"order": orders(self.scene)} if self.order else {}
        made = [knob for knob in self.others if isinstance(knob, Choice)]
        return orders_of | {knob.name: tuple(knob.shown) for knob in made}

    def segment_names(self) -> list[str]:
        """Name the segments whose directions vary.

        Returns
        -------
        list of str
            Names, base to tip.
        """
        return [segment_names(self.scene)[i] for i in self.segments]

    def _field_names(self) -> list[tuple[str, str, str]]:
        """Parameters of each field; of several, field_01 is the first."""
        if self.fields == 1:
            return [FIELD]
        stems = [f"field_{k:0{len(str(self.fields))}d}" for k in range(1, self.fields + 1)]
        strength, azimuth, elevation = (name.removeprefix("field") for name in FIELD)
        return [(stem + strength, stem + azimuth, stem + elevation) for stem in stems]

    def distributions(self) -> Distributions:
        """Describe the parameters as Optuna requests them.

        Returns
        -------
        dict[str, BaseDistribution]
            Distributions by name.
        """
        from optuna.distributions import CategoricalDistribution

        chosen = {name: CategoricalDistribution(known) for name, known in self.choices.items()}
        return self.coordinates.distributions() | chosen

    # parameters <-> embedded coordinates

    def embedded(self, parameters: Parameters) -> Array:
        """Find the embedded coordinates of a design.

        Parameters
        ----------
        parameters : Parameters
            The design.

        Returns
        -------
        array (size,)
            Its coordinates.
        """
        return self.coordinates.read(parameters)

    def parameters_at(self, x: Array, chosen: Parameters | None = None) -> Plain:
        """Find the parameters of embedded coordinates, each block brought to its nearest design: the inverse of `embedded`.

        Parameters
        ----------
        x : array (size,)
            Embedded coordinates.
        chosen : Parameters, optional
            With the choices; where one is missing it is as in the scene.

        Returns
        -------
        dict[str, Any]
            The design.
        """
        own = {**self.own, **(chosen or {})}
        choices = {name: own.get(name, known[0]) for name, known in self.choices.items()}
        return self.coordinates.write(self.nearest(x)) | choices

    def chosen(self, parameters: Parameters) -> Plain:
        """Find the choices among the parameters of a design.

        Parameters
        ----------
        parameters : Parameters
            The design.

        Returns
        -------
        dict[str, Any]
            Values by name.
        """
        return {name: parameters[name] for name in self.choices}

    @cached_property
    def own(self) -> Plain:
        """Parameters of what the scene has itself: of choices, directions and vectors."""
        order = {"order": orders(self.scene, own=True)[0]} if self.order else {}
        return order | {
            name: value for knob in self.others for name, value in knob.begun(self.scene).items()
        }

    @property
    def middle(self) -> Array:
        """Embedded coordinates of a design: numbers within bounds are in the middle, directions and vectors of addresses the scene's."""
        x = self.nearest(np.full(self.size, 0.5))
        for block, at in self.parts:
            if block.bounds().keys() <= self.own.keys():
                x[at] = block.read(self.own)
        return x

    def nearest(self, x: Array) -> Array:
        """Find the embedded coordinates of the nearest design, block by block.

        Parameters
        ----------
        x : array (size,)
            Any numbers.

        Returns
        -------
        array (size,)
            Embedded coordinates of a design.
        """
        return self.coordinates.nearest(np.asarray(x, dtype=float))

    def drawn(self, rng: np.random.Generator) -> Array:
        """Draw a random design: directions uniform on the sphere, numbers between their bounds.

        Parameters
        ----------
        rng : np.random.Generator
            The generator.

        Returns
        -------
        array (size,)
            Its embedded coordinates.
        """
        return self.coordinates.drawn(rng)

    # designs as directions and plain numbers, for samplers with kernels on the sphere (tpe.py)

    @property
    def count(self) -> int:
        """Directions in a design: one a magnetized segment, those of addresses, and of the fields and other vectors."""
        return sum(isinstance(block, Direction | Ball) for block in self.blocks)

    @property
    def numbers(self) -> int:
        """Plain numbers in a design: the vectors' strengths and the numbers within bounds."""
        return sum(not isinstance(block, Direction) for block in self.blocks)

    def design(self, parameters: Parameters) -> tuple[Array, Array]:
        """Write a design as directions and plain numbers.

        Parameters
        ----------
        parameters : Parameters
            The design.

        Returns
        -------
        directions : array (count, 3), no unit
            Of the blocks, so of the segments base to tip, then of the fields.
        numbers : array (numbers,), no unit
            From 0 to 1, of their range.
        """
        directions = []
        numbers = []
        for block in self.blocks:
            if isinstance(block, Direction):
                directions.append(block.read(parameters))
            elif isinstance(block, Ball):
                directions.append(block.direction(parameters))
                numbers.append(parameters[block.strength] / block.most)
            else:
                numbers.append(float(block.read(parameters)[0]))
        return np.array(directions).reshape(-1, 3), np.array(numbers)

    def parameters(self, directions: Array, numbers: Array) -> NamedNumbers:
        """Find the parameters of directions and plain numbers: the inverse of `design`.

        Parameters
        ----------
        directions : array (count, 3), no unit
            As of `design`.
        numbers : array (numbers,), no unit
            As of `design`.

        Returns
        -------
        dict[str, float]
            The design.
        """
        found: NamedNumbers = {}
        vectors = iter(directions)
        values = iter(numbers)
        for block in self.blocks:
            if isinstance(block, Direction):
                found |= block.write(next(vectors))
            elif isinstance(block, Ball):
                strength = float(next(values)) * block.most
                found |= block.write(next(vectors)) | {block.strength: strength}
            else:
                found |= block.write(np.array([next(values)]))
        return found

    # designs -> scenes

    def made(self, x: Array) -> Array:
        """Find the embedded coordinates of what is made: directions within the limits.

        Parameters
        ----------
        x : array (size,)
            Embedded coordinates of what is requested.

        Returns
        -------
        array (size,)
            Those of what is made.
        """
        if self.limits is None or not self.segments:
            return x
        count = 3 * len(self.segments)  # directions come first
        return np.concatenate(
            [
                self.limits.made(np.asarray(x[:count], dtype=float).reshape(-1, 3)).reshape(-1),
                x[count:],
            ]
        )

    def scene_of(self, parameters: Parameters, field: int = -1) -> Scene:
        """Make the scene of a trial.

        Parameters
        ----------
        parameters : Parameters
            The design.
        field : int, default -1
            Number of the field, of one at each depth or time; the last unless given.

        Returns
        -------
        Scene
            The scene.

        Raises
        ------
        InputError
            For values that no scene has.
        """
        return self.scene_at(self.embedded(parameters), parameters, field)

    def scene_at(self, x: Array, chosen: Parameters | None = None, field: int = -1) -> Scene:
        """Make the scene of embedded coordinates.

        Parameters
        ----------
        x : array (size,)
            Embedded coordinates.
        chosen : Parameters, optional
            With the choices, as of `parameters_at`.
        field : int, default -1
            As of `scene_of`.

        Returns
        -------
        Scene
            The scene.

        Raises
        ------
        InputError
            For values that no scene has.
        """
        data = self._data(self.values(x, chosen, field))
        self.put_in_order(data, chosen)
        return Scene.from_si(data)

    def _data(self, values: Mapping[Place, Any]) -> Plain:
        """The scene's data with these values."""
        data = self.scene.to_si()
        with_own_materials(data, self.scene, self.numbers_within)
        put(data, values, self.scene)
        return data

    def write(self, content: Plain, parameters: Parameters) -> None:
        """Write a design into the content of the scene's file, in place, with units.

        Parameters
        ----------
        content : dict[str, Any]
            Of the file.
        parameters : Parameters
            The design.
        """
        with_own_materials(content, self.scene, self.numbers_within)
        values = self.values(self.embedded(parameters), parameters)
        say(content, Scene.from_si(self._data(values)), values)
        self.put_in_order(content, parameters)

    def values(self, x: Array, chosen: Parameters | None = None, field: int = -1) -> Placed:
        """Find the values that embedded coordinates write into the scene; the order of segments apart.

        Parameters
        ----------
        x : array (size,)
            Embedded coordinates.
        chosen : Parameters, optional
            With the choices, as of `parameters_at`.
        field : int, default -1
            As of `scene_of`.

        Returns
        -------
        dict of place to value, SI or text with its unit
            Each where the scene has it.
        """
        x = self.made(x)
        params = {**self.coordinates.write(x), **(chosen or {})} if self.others else {}
        found: Placed = {}
        regions = self.scene.regions()
        for turned, at in self.those(SegmentDirection):
            found["body", *regions[turned.segment].at, "magnetization"] = x[at].tolist()
        for number, at in self.those(VariedNumber):
            found |= dict.fromkeys((number.place, *number.shared), number.value(x[at]))
        fields = self.those(FieldVector)
        if fields:
            found["field", "uniform"] = x[fields[field][1]].tolist()
        for knob in self.others:
            if knob.distributions().keys() <= params.keys():  # else as the scene has it
                found |= knob.at(params)
        requested = [found[n.place] for n in self.numbers_within if n.what == "length"]
        if requested:
            lengths = self._lengths(np.array(requested))[0]
            found |= of_lengths(self.scene, lengths.tolist())
            if self.keeps_length:
                body = ("body", self.scene.body.kind)
                found[*body, "length"] = self.scene.length
                longest = int(np.argmax(lengths))
                found[*body, "segments", longest, "length"] = None  # the rest, to the last bit
        return found

    def put_in_order(self, data: Plain, chosen: Parameters | None) -> None:
        """Put the segments of the scene's data, or of its file's content, in an order.

        Parameters
        ----------
        data : dict[str, Any]
            The data, or the content, changed in place.
        chosen : Parameters or None
            With the `order`, letters from base to tip; without: as they are.
        """
        order = (chosen or {}).get("order")
        if order is not None:
            body = data["body"][self.scene.body.kind]
            body["segments"] = [body["segments"][k] for k in arrangement(self.scene, order)]

    def _lengths(self, requested: Array) -> tuple[Array, Array]:
        """Lengths (k,) m of the segments for those requested, and their derivatives (k, k); of the body's length in all if that is kept."""
        if not self.keeps_length:
            return requested, np.eye(len(requested))
        number = next(number for number in self.numbers_within if number.what == "length")
        return kept_total(requested, *number.ends, self.scene.length)

    def directions(self, parameters: Parameters) -> Array:
        """Find the magnetization of every segment of the trial's scene, in the undeformed body.

        Parameters
        ----------
        parameters : Parameters
            The design.

        Returns
        -------
        array (k, 3), no unit
            Unit vectors, or zeros.
        """
        regions = self.scene_of(parameters).regions()
        return np.array([region.magnetization for region in regions], dtype=float)

    def quantities(self, parameters: Parameters) -> Plain:
        """Find the values of the numbers that vary: lengths base to tip, the diameter, and remanence and shear modulus of each segment.

        Parameters
        ----------
        parameters : Parameters
            The design.

        Returns
        -------
        dict[str, Any]
            Values in SI; names end with the unit.
        """
        varied = {number.what for number in self.numbers_within}
        if not varied:
            return {}
        scene = self.scene_of(parameters)
        shape = scene.body.shape
        materials = [scene.region_material(i) for i in range(len(scene.regions()))]
        assert isinstance(shape, StraightBody)
        found = {
            "length": ("segment_lengths_m", shape.segment_lengths()),
            "diameter": ("diameter_m", shape.thickness),
            "remanence": ("remanence_T", [material.remanence for material in materials]),
            "shear_modulus": (
                "shear_modulus_Pa",
                [material.shear_modulus for material in materials],
            ),
        }
        return dict(found[what] for what in found if what in varied)

    def field(self, parameters: Parameters, number: int = -1) -> Array:
        """Find the uniform part of the field of a design.

        Parameters
        ----------
        parameters : Parameters
            The design.
        number : int, default -1
            Which field; the last unless given.

        Returns
        -------
        array (3,), T
            The field.
        """
        return np.array(self.scene_of(parameters, number).field.uniform, dtype=float)

    # sensitivities -> embedded coordinates

    @property
    def sensitivities(self) -> list[str]:
        """Kinds of variables to request of `magmpm.sensitivities`: its `of`."""
        found = ["magnetization"] if self.segments else []
        if self.field_max is not None:
            found.append("field")
        found += [kind for number in self.numbers_within for kind in number.kinds]
        found += [
            written((*place, i))
            for knob in self.others
            for place in knob.places
            for i in range(3)
            if isinstance(knob, Turning)
        ]
        return list(dict.fromkeys(found))

    def chain(self, variables: Sequence[Variable], x: Array, field: int = -1) -> Array:
        """Find the derivatives of a solve's variables by embedded coordinates, so that columns (..., k) @ chain are (..., size).

        A direction's three columns are the gradient on the sphere: they have no part along the
        direction.

        Parameters
        ----------
        variables : sequence of Variable
            The k of `Sensitivities.variables`, of the scene of these coordinates and field.
        x : array (size,)
            Embedded coordinates.
        field : int, default -1
            As of `scene_of`.

        Returns
        -------
        array (k, size)
            SI of each variable per unit of each coordinate.
        """
        found = np.zeros((len(variables), self.size))
        rows: dict[Place, list[int]] = {}  # of the Jacobian
        known = set()  # a number may be there by its word and its address
        for row, variable in enumerate(variables):
            if (key := (variable.place, variable.direction)) not in known:
                rows.setdefault(variable.place, []).append(row)
            known.add(key)
        regions = self.scene.regions()
        for turned, at in self.those(SegmentDirection):
            # none where the remanence is zero
            for row in rows.get(("body", *regions[turned.segment].at, "magnetization"), ()):
                found[row, at] = variables[row].direction
        numbers = self.those(VariedNumber)
        for number, at in numbers:
            if number.what != "length":
                for place in (number.place, *number.shared):
                    found[rows.get(place, []), at] = number.slope(x[at])
        lengths = [(number, at) for number, at in numbers if number.what == "length"]
        fields = self.those(FieldVector)
        for i in range(3 if fields else 0):
            found[rows["field", "uniform", i], fields[field][1].start + i] = 1.0
        moved = (
            self._lengths(np.array([number.value(x[at]) for number, at in lengths]))[1]
            if lengths
            else np.zeros((0, 0))
        )
        for i in range(len(lengths)):
            for row in rows[lengths[i][0].place]:
                for j, (other, at) in enumerate(lengths):
                    found[row, at] = other.slope(x[at]) * moved[i, j]
        places = dict(self.parts)
        for knob in (one for one in self.others if isinstance(one, Turning)):
            for block in knob.blocks():
                at = places[block]
                for place, slopes in self._turned(knob, block, x, at).items():
                    for i, slope in enumerate(slopes):
                        found[rows[*place, i], at] = slope
        if self.limits is not None:
            count = 3 * len(self.segments)
            found[:, :count] = found[:, :count] @ self.limits.derivative(
                x[:count].reshape(-1, 3)
            ).reshape(count, count)
        return found

    def _turned(self, knob: Turning, block: Block, x: Array, at: slice) -> dict[Place, Array]:
        """Derivatives (3, k), SI, of the vectors of a knob by the coordinates of one of its blocks: differences that stay within bounds."""
        basis, _, high = block.tangent(x[at])
        here = knob.vectors(self.coordinates.write(x))
        found = {place: np.zeros((3, block.size)) for place in here}
        size = 1e-7  # of a whole step: the derivatives are right to as much
        steps = np.diag(np.where(high > size, size, -size))
        for step, along in zip(steps, np.linalg.pinv(basis), strict=True):
            moved = x.copy()
            moved[at] = block.moved(x[at], step)
            for place, there in knob.vectors(self.coordinates.write(moved)).items():
                slope = knob.scale * np.subtract(there, here[place]) / step.sum()
                found[place] += np.outer(slope, along)
        return found


def numbers_space(scene: Scene, vary: Vary) -> SearchSpace:
    """Make the space of numbers and orders that are varied, without directions and fields.

    Parameters
    ----------
    scene : Scene
        The study's scene.
    vary : Vary
        What its file says of them.

    Returns
    -------
    SearchSpace
        The space.
    """
    keeps = vary.length is None or vary.length.total == "keep"
    quantities = numbers_of(vary, scene)
    more, others = addressed(vary, scene, quantities)
    numbers = (*quantities, *more)
    order = vary.order is not None
    return SearchSpace(scene, (), None, 1, numbers, keeps, order, others=tuple(others))


@dataclass(frozen=True)
class Segments(Knob):
    """Lengths of segments, which may keep their sum, and their order, as studies of shapes have them.

    Attributes
    ----------
    name : str
        For messages.
    places : tuple of Place
        Of the lengths, and of the body's.
    space : SearchSpace
        Of the lengths and the order alone.
    """

    space: SearchSpace
    smooth = False
    tied = 1

    def distributions(self) -> Distributions:
        return self.space.distributions()

    def at(self, params: Parameters) -> Placed:
        return self.space.values(self.space.embedded(params))

    def arranged(self, scene: Scene, params: Parameters) -> Scene:
        data = scene.to_si()
        self.space.put_in_order(data, params)
        return Scene.from_si(data)

    def own(self, scene: Scene) -> Plain:
        named = zip(self.space.numbers_within, segment_lengths(scene), strict=False)
        lengths = {number.name: round(number.unit * length, 12) for number, length in named}
        return lengths | dict.fromkeys(self.space.choices, orders(scene, own=True)[0])

    def begun(self, scene: Scene) -> Plain:
        return self.space.parameters_at(self.space.embedded(self.own(scene)))


def segments(scene: Scene, vary: Vary) -> Segments:
    """Make a knob of lengths and orders of segments.

    Parameters
    ----------
    scene : Scene
        The study's scene.
    vary : Vary
        What its file says of them.

    Returns
    -------
    Segments
        The knob.
    """
    space = numbers_space(scene, vary)
    places = tuple(number.place for number in space.numbers_within)
    body = (("body", scene.body.kind, "length"),) if places else ()
    return Segments("length", (*places, *body), space)
