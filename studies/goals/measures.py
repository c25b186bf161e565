"""Measures of an answer: one number each, in SI, that a goal makes larger or smaller, or a constraint bounds."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Discriminator, Field, Tag, model_validator

from magmpm.bodies.segments import StraightBody
from magmpm.compiled.arrays import Array, Index, NamedNumbers
from magmpm.errors import PAIR, InputError, MagmpmError, in_mm, length, quantity
from magmpm.inputs.csv_tables import named_table, read_centreline
from magmpm.inputs.messages import Instead
from magmpm.inputs.settings import Quantity, Settings, fault
from magmpm.inputs.vectors import Axis, Point
from magmpm.scene import Scene
from magmpm.statics.surface_pairs import pair_name
from magmpm.studies.goals.answer import Answer, check_region, inserted_at, pushed, time_of
from magmpm.studies.goals.own_function import called, function_of
from magmpm.studies.problem.shape_distance import gaps, root_mean_square
from magmpm.studies.search.study_checks import check_shape

_Spot = Annotated[
    Annotated[str, Tag("name")] | Annotated[Point, Tag("point")],
    Discriminator(lambda value: "name" if isinstance(value, str) else "point"),
]
_Length = Annotated[float, Quantity("length", at_least="0 mm", at_most="10 m")]
_Time = Annotated[float, Quantity("time", at_least="0 s", at_most="1e6 s")]
OF: Any = Field(
    default="body",
    min_length=1,
    description="tip, body (unless given), or the name of a part or segment.",
    examples=["tip"],
)
ALONG: Any = Field(
    default=(1.0, 0.0, 0.0), description="Along this; +x unless given.", examples=[[1, 0, 0]]
)


@dataclass(frozen=True)
class Slopes:
    """Derivatives by p parameters of equilibrium number k, SI, per unit of each parameter.

    Of a place (3, p) m and of a moment (3, 3, p) m^2 by the name of a region and k, of an obstacle's force (3, p) N by its name and k, and
    of the gaps (m, 3, p) m to a target (m, 4) m at k.
    """

    place: Callable[[str, float], Array]
    moment: Callable[[str, float], Array]
    force: Callable[[str, int], Array]
    gaps: Callable[[Array, float], Array]


class OneMeasure(Settings):
    """A kind of measure. kind: of its quantity (inputs.quantities.KINDS) in bounds, None for a plain number."""

    kind: ClassVar[str | None] = None
    unit: ClassVar[str] = ""  # SI

    def before(self, scene: Scene) -> bool:
        """True if it is known before a scene's run."""
        return False

    @abstractmethod
    def of_answer(self, answer: Answer, at: str) -> float:
        """The number, in SI; at: its place in the file, for messages. Raises InputError."""


class Smooth(OneMeasure):
    """A kind of measure that has derivatives at rest."""

    @abstractmethod
    def slopes(self, answer: Answer, at: str, of: Slopes) -> Array:
        """Derivatives (k,) at rest, from those of what it is made of."""

    def parts(self, answer: Answer, at: str, of: Slopes) -> tuple[Array, Array] | None:
        """Components (m,) of a measure that is the length of a vector, with their derivatives (m, k); None for other measures."""
        return None


class AtMoment(Smooth):
    """A kind of measure that is taken at one moment of what runs along time."""

    at: _Time | None = Field(default=None, description="When; at the end unless given.")
    inserted: _Length | None = Field(
        default=None,
        description="Of a fed catheter, in place of `at`: when this length is out of its guide.",
        examples=["20 mm"],
    )

    @model_validator(mode="after")
    def _once(self) -> AtMoment:
        if self.at is not None and self.inserted is not None:
            raise fault("at and inserted both say when", "remove one of them", ("inserted",))
        return self

    def moment(self, answer: Answer) -> float:
        """Number of the moment."""
        return answer.moment(self.at, -1, self.inserted)


class Position(AtMoment):
    """Place along a direction, m."""

    kind: ClassVar[str | None] = "length"
    unit: ClassVar[str] = "m"
    of: str = OF
    along: Axis = ALONG

    def of_answer(self, answer: Answer, at: str) -> float:
        return float(answer.place(self.of, self.moment(answer), at) @ np.array(self.along))

    def slopes(self, answer: Answer, at: str, of: Slopes) -> Array:
        return np.array(self.along) @ of.place(self.of, self.moment(answer))


class Displacement(Position):
    """Displacement from the undeformed body along a direction, m."""

    def of_answer(self, answer: Answer, at: str) -> float:
        begin = answer.place(self.of, None, at) @ np.array(self.along)
        return super().of_answer(answer, at) - float(begin)


class Travel(Smooth):
    """Displacement between two times along a direction, m."""

    kind: ClassVar[str | None] = "length"
    unit: ClassVar[str] = "m"
    of: str = OF
    along: Axis = ALONG
    begin: _Time | None = Field(
        default=None, alias="from", description="From when; the start unless given."
    )
    end: _Time | None = Field(
        default=None, alias="to", description="Until when; to the end unless given."
    )

    def of_answer(self, answer: Answer, at: str) -> float:
        first, last = answer.moment(self.begin, 0), answer.moment(self.end, -1)
        way = answer.place(self.of, last, at) - answer.place(self.of, first, at)
        return float(way @ np.array(self.along))

    def slopes(self, answer: Answer, at: str, of: Slopes) -> Array:
        first, last = answer.moment(self.begin, 0), answer.moment(self.end, -1)
        return np.array(self.along) @ (of.place(self.of, last) - of.place(self.of, first))


class Turn(AtMoment):
    """Rotation about an axis since the start, by the rotation that fits the particles best, rad."""

    kind: ClassVar[str | None] = "angle"
    unit: ClassVar[str] = "rad"
    of: str = OF
    about: Axis = Field(
        default=(0.0, 1.0, 0.0), description="The axis; +y unless given.", examples=[[0, 1, 0]]
    )

    @staticmethod
    def by_other_keys(key: str, values: Any) -> Instead | None:
        return Instead("a turn has an axis: write `about: [0, 1, 0]`") if key == "along" else None

    def of_answer(self, answer: Answer, at: str) -> float:
        return float(self._turned(answer, self.moment(answer), at) @ np.array(self.about))

    def slopes(self, answer: Answer, at: str, of: Slopes) -> Array:
        """Change of the rotation R of the polar decomposition R P of the moment M, and of its vector r.

        dR = R W, with the skew part of R^T dM = (W P + P W) / 2: w = (tr P - P)^-1 a, a the axial vector of R^T dM - (R^T dM)^T. Then dr is
        w by the inverse of the right Jacobian of SO(3) (Chirikjian, Stochastic Models, Information Theory, and Lie Groups 2, sec. 10.8.2).
        """
        from scipy.spatial.transform import Rotation  # as in `_turned`

        k = self.moment(answer)
        begin, now, share = self._arms(answer, k, at)
        r = self._turned(answer, k, at)
        R = Rotation.from_rotvec(r).as_matrix()
        P = R.T @ ((share[:, None] * now).T @ begin)
        A = np.einsum("ji,jmk->imk", R, of.moment(self.of, k))
        a = np.stack([A[2, 1] - A[1, 2], A[0, 2] - A[2, 0], A[1, 0] - A[0, 1]])
        w = np.linalg.solve(np.trace(P) * np.eye(3) - P, a)
        angle = max(float(np.linalg.norm(r)), 1e-6)  # below, the last share is 1 / 12 to 1e-13
        across = np.cross(r, w, axis=0)
        twice = np.cross(r, across, axis=0)
        share_twice = (1.0 - 0.5 * angle / math.tan(0.5 * angle)) / angle**2
        return np.array(self.about) @ (w + 0.5 * across + share_twice * twice)

    def _turned(self, answer: Answer, k: float, at: str) -> Array:
        """Rotation vector (3,) rad at moment k; along time the one nearest to that of the frame before, so that full turns count.

        After full turns the axis of a small rotation says nothing: they are about the axis of the frame before.
        """
        from scipy.spatial.transform import Rotation  # 0.1 s to import, and few measures turn

        vector = np.zeros(3)
        before = [] if answer.motion is None else range(math.ceil(k))
        for moment in [*before, k]:
            begin, now, share = self._arms(answer, moment, at)
            found = Rotation.align_vectors(now, begin, weights=share)[0].as_rotvec()
            angle = float(np.linalg.norm(found))
            axis = found / max(angle, 1e-9)
            if angle < 0.5:
                axis = vector / max(float(np.linalg.norm(vector)), 1e-9)
            turns = round(float((vector - found) @ axis) / math.tau)
            vector = found + turns * math.tau * axis
        return vector

    def _arms(self, answer: Answer, k: float, at: str) -> tuple[Array, Array, Array]:
        """Particles from their mean, undeformed and at moment k, (n, 3) m, and their shares (n,) of the volume."""
        on = answer.region(self.of, at)
        volume = answer.model.particles.volume[on]
        share = volume / volume.sum()
        begin = answer.particles(None)[on]
        now = answer.particles(k)[on]
        return begin - share @ begin, now - share @ now, share


class Apart(AtMoment):
    """A kind of measure that is the length of a vector, m."""

    kind: ClassVar[str | None] = "length"
    unit: ClassVar[str] = "m"

    def slopes(self, answer: Answer, at: str, of: Slopes) -> Array:
        found = self.parts(answer, at, of)
        assert found is not None  # its components are what it is the length of
        apart, way = found
        return np.asarray(apart / max(float(np.linalg.norm(apart)), 1e-12) @ way)


class Distance(Apart):
    """Distance of two places, m."""

    between: tuple[_Spot, _Spot] = Field(
        description="Two of tip, body, names of parts and segments, and points [x, y, z].",
        examples=[["tip", ["30 mm", "0 mm", "5 mm"]]],
    )

    def of_answer(self, answer: Answer, at: str) -> float:
        one, other = self._spots(answer, self.moment(answer), at)
        return float(np.linalg.norm(one - other))

    def parts(self, answer: Answer, at: str, of: Slopes) -> tuple[Array, Array]:
        k = self.moment(answer)
        one, other = self._spots(answer, k, at)
        way = sum(
            sign * of.place(spot, k)
            for sign, spot in zip((1.0, -1.0), self.between, strict=True)
            if isinstance(spot, str)
        )
        return one - other, np.asarray(way)

    def _spots(self, answer: Answer, k: float, at: str) -> list[Array]:
        return [
            answer.place(of, k, at) if isinstance(of, str) else np.array(of) for of in self.between
        ]

    @model_validator(mode="after")
    def _moves(self) -> Distance:
        if not any(isinstance(of, str) for of in self.between):
            raise fault("one of the two must be of the body", "name the tip, a part or a segment")
        return self


class Shape(Apart):
    """Root mean square distance of a straight body's axis from a target shape, at equal arc lengths, m."""

    centreline: Annotated[
        tuple[tuple[float, float, float, float], ...],
        named_table(lambda path: read_centreline(path).tolist(), None),
    ] = Field(
        description="Path, relative to this file, of a CSV table with columns s_mm,x_mm,y_mm,z_mm.",
        examples=["../targets/s_shape.csv"],
    )

    def of_answer(self, answer: Answer, at: str) -> float:
        return root_mean_square(self._gaps(answer))

    def parts(self, answer: Answer, at: str, of: Slopes) -> tuple[Array, Array]:
        way = of.gaps(np.array(self.centreline), self.moment(answer))
        share = 1.0 / math.sqrt(len(self.centreline))
        return share * self._gaps(answer).ravel(), share * way.reshape(-1, way.shape[-1])

    def _gaps(self, answer: Answer) -> Array:
        """Vectors (m, 3) m from the target's points to the axis."""
        return gaps(answer.axis_and_tip(self.moment(answer))[0], np.array(self.centreline))

    def check(self, scene: Scene, at: str) -> None:
        """Raises InputError for a body without an axis, and for a target that is not of a body of this length."""
        if not isinstance(scene.body.shape, StraightBody):
            raise InputError(
                at,
                received="a body of parts",
                rule="only straight bodies have an axis, whose shape is compared",
                remedy="write `target: {distance: {between: [PART, [x, y, z]]}, value: 0 mm}` for each part",
            )
        check_shape(np.array(self.centreline), scene.length, f"{at}.centreline")


class ContactForce(Smooth):
    """Size of the force of an obstacle or a part on the body or one of its parts, N."""

    kind: ClassVar[str | None] = "force"
    unit: ClassVar[str] = "N"
    of: str = Field(
        default="body",
        min_length=1,
        description="body (unless given), or the name of a part or segment: what is pushed.",
        examples=["finger_2"],
    )
    by: str = Field(
        alias="with",
        min_length=1,
        description=(
            "What pushes: ground, walls, a part that self_contact lets touch `of`, or self_contact"
            " for all of them."
        ),
        examples=["walls"],
    )
    over: Literal["largest", "mean", "last"] = Field(
        default="largest",
        description="Over time: largest (unless given), mean, or last; of a motion, of its frames.",
        examples=["mean"],
    )

    def slopes(self, answer: Answer, at: str, of: Slopes) -> Array:
        names = self.named(answer.scene, at)
        forces = self._forces(answer, at)
        sizes = np.linalg.norm(forces, axis=1)
        out = []
        for k, share in zip(*self._counted(answer, sizes), strict=True):
            slope = sum(sign * of.force(name, int(k)) for name, sign in names.items())
            out.append(share * forces[k] / max(float(sizes[k]), 1e-300) @ slope)
        return np.sum(out, axis=0)

    def _forces(self, answer: Answer, at: str) -> Array:
        """Force (k, 3) N at each moment."""
        names = self.named(answer.scene, at)
        return np.sum([sign * answer.pushes(name) for name, sign in names.items()], axis=0)

    def _counted(self, answer: Answer, sizes: Array) -> tuple[Index, Array]:
        """Numbers (k,) of the moments that count, and by how much (k,): in a mean by their share of the time."""
        if self.over != "mean" or len(sizes) == 1:
            return np.array(
                [sizes.argmax() if self.over == "largest" else len(sizes) - 1]
            ), np.ones(1)
        share = np.gradient(answer.times) / np.ptp(answer.times)
        share[[0, -1]] *= 0.5
        return np.arange(len(sizes)), share

    def of_answer(self, answer: Answer, at: str) -> float:
        sizes = np.linalg.norm(self._forces(answer, at), axis=1)
        moments, share = self._counted(answer, sizes)
        return float(share @ sizes[moments])

    def named(self, scene: Scene, at: str) -> NamedNumbers:
        """Contacts, as contacts.csv names them, whose forces with these signs add up to this one. Raises InputError."""
        effects = scene.effects.named()
        parts = [region.name for region in scene.regions()]
        obstacles = [key for key in ("ground", "walls") if key in effects]
        of = self.of
        by = self.by
        key, _, pair = by.partition(PAIR)
        if of == "body" and key == "self_contact" and pair:  # as contacts.csv names it
            of, _, by = pair.partition(", ")
        if of not in ("body", *parts):
            raise self._unknown(f"{at}.of", of, "of a part or segment", ["body", *parts])
        if by in obstacles:
            return {by if of == "body" else f"{by}{PAIR}{of}": 1.0}
        touching = parts if "self_contact" in effects else []
        others = [part for part in touching if part != of]
        if of == "body" and by in ("self_contact", *touching):
            raise InputError(
                f"{at}.of",
                received="'body'",
                rule="the forces of the body on itself add up to zero",
                remedy=f"name the part that is pushed, one of {', '.join(parts[:8])}",
            )
        if by not in ("self_contact", *others):
            raise self._unknown(f"{at}.with", by, f"that may touch {of}", [*obstacles, *others])
        found = {}
        for other in others if by == "self_contact" else [by]:
            two = sorted((of, other), key=parts.index)
            found[pair_name(*two)] = 1.0 if two[0] == of else -1.0
        return found

    @staticmethod
    def _unknown(at: str, name: str, what: str, known: list[str]) -> InputError:
        listed = f"name one of {', '.join(known[:8])}"
        none = "name ground, walls or self_contact in the scene's effects"
        rule = f"must be a name {what}"
        return InputError(at, received=repr(name), rule=rule, remedy=listed if known else none)


class LargestStrain(OneMeasure):
    """Largest stretch of any particle, less one."""

    def of_answer(self, answer: Answer, at: str) -> float:
        return _result(answer, at).largest_stretch - 1.0


class LargestField(OneMeasure):
    """Strongest field at any particle of the body at any time, T."""

    kind: ClassVar[str | None] = "flux density"
    unit: ClassVar[str] = "T"

    def before(self, scene: Scene) -> bool:
        return not scene.field.varies

    def of_answer(self, answer: Answer, at: str) -> float:
        return float(answer.field[1].max())


class FieldEnergy(OneMeasure):
    """Integral of B^2 over time, where it is strongest at the body, T^2 s; of an equilibrium over one second."""

    kind: ClassVar[str | None] = "field energy"
    unit: ClassVar[str] = "T^2 s"

    def before(self, scene: Scene) -> bool:
        return not scene.field.varies

    def of_answer(self, answer: Answer, at: str) -> float:
        times, strength = answer.field
        return float(np.trapezoid(strength**2, times) if len(times) > 1 else strength[0] ** 2)


class MagnetizedVolume(OneMeasure):
    """Volume of what is magnetized, m^3."""

    kind: ClassVar[str | None] = "volume"
    unit: ClassVar[str] = "m^3"

    def before(self, scene: Scene) -> bool:
        return True

    def of_answer(self, answer: Answer, at: str) -> float:
        magnetized = np.linalg.norm(answer.model.remanence[:, :3], axis=1) > 0.0
        return float(answer.model.particles.volume[magnetized].sum())


class Stable(OneMeasure):
    """Smallest eigenvalue of the tangent over that of the unloaded body: 1 at rest, 0 at a critical load."""

    def of_answer(self, answer: Answer, at: str) -> float:
        found = _result(answer, at).stability
        if found is None:
            raise InputError(
                at,
                received="a motion",
                rule="only equilibria have a stability",
                remedy="leave it out, or write `solver: {static: {}}` in the scene",
            )
        return found


KINDS: dict[str, type[OneMeasure]] = {
    "position": Position,
    "displacement": Displacement,
    "travel": Travel,
    "turn": Turn,
    "distance": Distance,
    "shape": Shape,
    "contact_force": ContactForce,
    "strain": LargestStrain,
    "largest_field": LargestField,
    "field_energy": FieldEnergy,
    "magnetized_volume": MagnetizedVolume,
    "stability": Stable,
}


def _result(answer: Answer, at: str) -> Any:
    if answer.result is None:
        raise InputError(
            at,
            received="a motion that runs",
            rule="it is known at the end alone",
            remedy="leave out `prune`",
        )
    return answer.result


def of_kind(of: type[OneMeasure], example: str = "{}") -> Any:
    """A key for a measure of this kind."""
    about = (of.__doc__ or "").splitlines()[0]
    return Field(default=None, description=about, examples=[example])


class Measure(Settings):
    """A measure: one of these keys."""

    position: Position | None = of_kind(Position, "{of: tip, along: [0, 0, 1]}")
    displacement: Displacement | None = of_kind(Displacement, "{of: tip, along: [0, 0, 1]}")
    travel: Travel | None = of_kind(Travel, "{of: body, along: [1, 0, 0], from: 0.1 s}")
    turn: Turn | None = of_kind(Turn, "{of: body, about: [0, 1, 0]}")
    distance: Distance | None = of_kind(Distance, "{between: [finger_1, finger_2]}")
    shape: Shape | None = of_kind(Shape, "{centreline: ../targets/s_shape.csv}")
    contact_force: ContactForce | None = of_kind(ContactForce, "{with: walls}")
    strain: LargestStrain | None = of_kind(LargestStrain)
    largest_field: LargestField | None = of_kind(LargestField)
    field_energy: FieldEnergy | None = of_kind(FieldEnergy)
    magnetized_volume: MagnetizedVolume | None = of_kind(MagnetizedVolume)
    stability: Stable | None = of_kind(Stable)
    python: str | None = Field(
        default=None,
        description=(
            "FILE.py:FUNCTION, relative to this file: a function of a Result, or of the Motion of"
            " what runs along time, that returns a number."
        ),
        examples=["stride.py:stride"],
    )

    one_of = (*KINDS, "python")
    written = "travel: {of: body, along: [1, 0, 0]}"

    @property
    def name(self) -> str:
        """Its kind, or the function's name."""
        if self.python is not None:
            return self.python.rpartition(":")[2]
        return self.given

    @property
    def label(self) -> str:
        """Its name with its SI unit: `travel (m)`."""
        return f"{self.name} ({self.unit})" if self.unit else self.name

    @property
    def full_label(self) -> str:
        """Its label with what it is of: `position of tip along [0, 0, 1] (m)`."""
        said = {} if self.python is not None else getattr(self, self.name).model_dump(by_alias=True)
        words = [f"{key} {said[key]}" for key in ("of", "with") if said.get(key)]
        ends = [of if isinstance(of, str) else in_mm(of) for of in said.get("between", ())]
        words += [f"between {' and '.join(ends)}"] if ends else []
        if "along" in said:
            words.append(f"along [{', '.join(f'{part:.3g}' for part in said['along'])}]")
        return " ".join([self.name, *words, *([f"({self.unit})"] if self.unit else [])])

    @property
    def _class(self) -> type[OneMeasure]:
        return KINDS.get(
            self.given, OneMeasure
        )  # of a user's function it has no unit, and no derivative

    @property
    def unit(self) -> str:
        """Its SI unit, "" where it has none."""
        return self._class.unit

    @property
    def kind(self) -> str | None:
        """Kind of its quantity, None for a plain number."""
        return self._class.kind

    @property
    def regions(self) -> set[str]:
        """Names of the regions whose places it measures."""
        if not issubclass(self._class, AtMoment | Travel):
            return set()
        said = getattr(self, self.name).model_dump()
        between = said.get("between", ())
        places = [said.get("of", "body"), *(of for of in between if isinstance(of, str))]
        return {str(of) for of in places[bool(between) :]}

    def check_moments(self, scene: Scene, at: str) -> None:
        """Raises InputError for a time at which the scene has no answer, a length that nobody pushes out of a guide, and a contact or
        a part that the scene has not."""
        kind = None if self.python is not None else getattr(self, self.name)
        for of in sorted(self.regions):
            check_region(scene, of, at)
        if isinstance(kind, ContactForce):
            kind.named(scene, at)
        if isinstance(kind, Shape):
            kind.check(scene, f"{at}.shape")
        said = {key: getattr(kind, key, None) for key in ("at", "begin", "end", "inserted")}
        for key, value in said.items():
            if value is None:
                continue
            asked = value
            place = f"{at}.{self.name}.{ {'begin': 'from', 'end': 'to'}.get(key, key) }"
            if key == "inserted":
                if not pushed(scene):
                    raise InputError(
                        place,
                        received=length(value),
                        rule="only a catheter that is fed comes out of a guide",
                        remedy="name `effects: {feed: ...}` in the scene, or give `at` a time",
                    )
                value = time_of(scene, value)
            received = quantity(value, "s")
            if not scene.in_time:
                raise InputError(
                    place,
                    received=received,
                    rule="an equilibrium has no times",
                    remedy="leave it out",
                )
            times = scene.path_times() or [0.0, scene.duration]
            near = min(times, key=lambda time: abs(time - value))
            along = scene.solver.quasi_static is not None
            last = max(times)
            if abs(near - value) <= 1e-6 * last or (not along and value <= last):
                continue
            nearest = quantity(near, "s")
            if key == "inserted":
                received = f"{length(asked)}, out of the guide at {received}"
                nearest += f", with {length(inserted_at(scene, near))}"
            raise InputError(
                place,
                received=received,
                rule=f"the scene has no answer then; the nearest is at {nearest}",
                remedy="choose that, or "
                + (
                    "add the time to `solver.quasi_static.at`"
                    if along
                    else "give `solver.dynamic` a longer `duration`"
                ),
            )

    def smooth(self, scene: Scene) -> bool:
        """True if it has derivatives at rest: of the equilibrium, or as it is known without a run."""
        return issubclass(self._class, Smooth) or self.before(scene)

    def before(self, scene: Scene) -> bool:
        """True if it is known before a scene's run."""
        return self.python is None and bool(getattr(self, self.name).before(scene))

    def of_answer(self, answer: Answer, at: str, folder: Path) -> float:
        """The number, in SI. Raises InputError, or MagmpmError where a user's function fails."""
        if self.python is not None:
            return called(function_of(self.python, folder, at), answer.given, f"{at}.python")
        found = getattr(self, self.name).of_answer(answer, at)
        if not math.isfinite(found):
            raise MagmpmError(f"{at}: {self.name} gave {found}, which is no finite number")
        return float(found)
