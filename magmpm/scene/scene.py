"""Scenes: what is simulated, how, and how finely, as immutable values in SI.

`load_scene(path)` reads a file, where quantities carry units. In Python the same classes take SI floats (or
text with units), `Material(shear_modulus=120e3, bulk_to_shear=20)`, and raise pydantic's ValidationError.
`scene.to_si()` is plain SI data, as results save it, and `Scene.from_si` makes the same scene of it.
"""

from __future__ import annotations

import difflib
import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    ValidationInfo,
    WithJsonSchema,
    field_validator,
    model_validator,
)

from magmpm.bodies.regions import Region
from magmpm.bodies.slender import CATHETER, REGIONS_A_PERIOD, Body, Catheter, Segment, Strip
from magmpm.errors import InputError
from magmpm.fields.outside_field import Field as OutsideField
from magmpm.fields.outside_field import outside_field
from magmpm.fields.sources import FieldSource
from magmpm.inputs.csv_tables import TableError, read_centreline
from magmpm.inputs.folder_names import folder_fault
from magmpm.inputs.settings import Key, Settings, fault, folder_of, from_file, read_yaml, validate
from magmpm.inputs.vectors import Angles
from magmpm.scene.options import (
    Effects,
    Gravity,
    MagneticTorque,
    Material,
    Resolution,
    Solver,
    StaticOptions,
)
from magmpm.scene.surroundings import IN_MOTION

__all__ = [
    "Angles",
    "Body",
    "Catheter",
    "Effects",
    "FieldSource",
    "Gravity",
    "MagneticTorque",
    "Material",
    "Reference",
    "Region",
    "Resolution",
    "Scene",
    "Segment",
    "Solver",
    "StaticOptions",
    "Strip",
    "load_scene",
]

K = TypeVar("K")
V = TypeVar("V")

NO_ENERGY = (  # rule and remedy, where a static scene names one of them (Scene.without_energy)
    "in a field that varies in space, equilibrium needs magnetic_torque and magnetic_force: either alone has no energy",
    "add `magnetic_force: {}` or `magnetic_torque: {}`, or ask for motion with solver.dynamic, where either may act alone",
)


class FrozenDict(dict[K, V]):
    """A dict that refuses changes, so that scenes can be shared and hashed."""

    def _refuse(self, *args: Any, **kwargs: Any) -> Any:
        raise TypeError("a scene is immutable; build another with its with_... methods")

    __setitem__ = __delitem__ = __ior__ = update = setdefault = pop = popitem = clear = _refuse

    def __hash__(self) -> int:  # type: ignore[override]
        return hash(frozenset(self.items()))

    def __reduce__(self) -> Any:
        return FrozenDict, (dict(self),)  # else pickle would fill it item by item


def load_scene(path: Path | str) -> Scene:
    """The scene that the file at this path describes, with all quantities in SI.

    Raises InputError (NotThereYet for keys of a later version) that lists everything wrong with the file, by
    line, key, value received, rule and remedy.
    """
    return validate(Scene, read_yaml(path))


def _read_points(value: Any, info: ValidationInfo) -> Any:
    """The rows of the table a path names, in SI; in Python, rows in SI are taken as they are."""
    if not isinstance(value, (str, Path)):
        if from_file(info):
            raise fault(
                "must be the path of a CSV table", "write, say, `centreline: ../references/shape.csv`"
            )
        return value
    try:
        return read_centreline(folder_of(info) / value).tolist()
    except TableError as error:
        raise fault(f"{error.rule} ({error.place})", error.remedy) from None


class Reference(Settings):
    """A known answer to compare with."""

    centreline: Annotated[
        tuple[tuple[float, float, float, float], ...],
        BeforeValidator(_read_points),
        WithJsonSchema({"type": "string"}),
    ] = Field(
        description="Path, relative to this file, of a CSV table with columns s_mm,x_mm,y_mm,z_mm.",
        examples=["../references/shape.csv"],
    )


class Scene(Settings):
    """What is simulated, how, and how finely. SI floats inside; immutable."""

    name: str = Field(
        min_length=1,
        max_length=100,
        description="Names the folder of results.",
        examples=["five-segment catheter"],
    )
    materials: Annotated[dict[str, Material], AfterValidator(FrozenDict)] = Field(
        min_length=1,
        description="Materials by name.",
        examples=[{"silicone": {"shear_modulus": "120 kPa", "bulk_to_shear": 20}}],
    )
    body: Body = Field(description="What moves: a catheter or a strip.", examples=[{"catheter": CATHETER}])
    field: FieldSource = Field(
        default=FieldSource(),
        description="The outside magnetic field; none unless given.",
        examples=[{"uniform": ["0 mT", "6 mT", "8 mT"]}],
    )
    effects: Effects = Field(
        default=Effects(),
        description="What is simulated; what is not named is not, and costs nothing.",
        examples=[{"magnetic_torque": {}}],
    )
    solver: Solver = Field(default=Solver(), description="Static unless given.", examples=[{"static": {}}])
    resolution: Resolution = Field(
        default=Resolution(),
        description="How fine the grid is: {cells_across: 4} unless given.",
        examples=[{"cells_across": 4}],
    )
    reference: Reference | None = Field(
        default=None, description="A known answer.", examples=[{"centreline": "../references/shape.csv"}]
    )

    @field_validator("name")
    @classmethod
    def _folder_name(cls, name: str) -> str:
        found = folder_fault(name)
        if found is not None:
            raise fault(*found)
        return name

    @model_validator(mode="after")
    def _agree(self, info: ValidationInfo) -> Scene:
        """Rules that join parts of the scene."""
        for at, name in self._materials_named():
            if name not in self.materials:
                near = difflib.get_close_matches(name, self.materials, n=1)
                remedy = f'did you mean "{near[0]}"?' if near else "correct the name, or add the material"
                raise fault(f"must be a name from `materials`: {', '.join(self.materials)}", remedy, at)
        asks = "gravity" if self.effects.gravity is not None else "motion"
        if self.effects.gravity is not None or self.solver.dynamic is not None:
            for name in dict.fromkeys(piece.material_name for piece in self.regions()):
                if self.materials[name].density is None:
                    at = ("materials", name, "density")
                    raise fault(
                        f"{asks} needs the density of each material", "add, say, `density: 1100 kg/m^3`", at
                    )
        if self.reference is not None and self.reference.centreline[-1][0] > self.length * (1 + 1e-6):
            kind = self.body.kind
            raise fault(
                f"s_mm of the reference must not exceed the {kind}'s length, {1e3 * self.length:g} mm",
                f"check that the table belongs to this {kind}",
                ("reference", "centreline"),
            )
        self._profile_is_resolved()
        if from_file(info) and self.solver.dynamic is None and self.body.shape.clamp == "none":
            where = ("meshes",) if self.body.kind == "parts" else ("clamp",)
            raise fault(
                "equilibrium needs a body that is held somewhere",
                "clamp it, or let it move: `solver: {dynamic: {duration: 0.5 s}}`",
                ("body", self.body.kind, *where),
            )
        self._motion_has_its_solver()
        self._contact_has_its_formulation()
        self._feed_can_push()
        self._field_suits_the_solver()
        if from_file(info):
            if (missing := self.without_energy()) is not None:
                raise fault(*NO_ENERGY, ("effects", missing))
            for effect in ("magnetic_torque", "magnetic_force"):
                if getattr(self.effects, effect) is not None:
                    self._field_acts(effect)
        return self

    def _profile_is_resolved(self) -> None:
        """A profile that turns within a cell or two would be averaged away."""
        strip = self.body.strip
        if strip is not None and strip.magnetization_profile is not None:
            across, turns = self.resolution.cells_across, strip.magnetization_profile.harmonic.turns(strip.length)
            a_turn = max(3, round(strip.length / strip.thickness * across)) / turns
            if a_turn < REGIONS_A_PERIOD:
                raise fault(
                    f"a turn of the magnetisation must be at least {REGIONS_A_PERIOD} cells long, and is {a_turn:.3g}",
                    f"raise cells_across to {int(np.ceil(across * REGIONS_A_PERIOD / a_turn))}, or turn less often",
                    ("resolution", "cells_across"),
                )

    def _motion_has_its_solver(self) -> None:
        """Effects that act on a moving body only need the dynamic solver."""
        if getattr(self.solver, "dynamic", None) is not None:
            return
        for name in IN_MOTION:
            if getattr(self.effects, name) is not None:
                raise fault(
                    f"{name} acts in motion only, and this scene is solved for its equilibrium",
                    f"write `solver: {{dynamic: {{duration: 0.5 s}}}}`, or do not name {name}",
                    ("effects", name),
                )

    def _contact_has_its_formulation(self) -> None:
        """Parts of a body meet on a grid in space; a grid in the undeformed body never learns that they are near."""
        dynamic = self.solver.dynamic
        if self.effects.self_contact is not None and dynamic is not None and dynamic.formulation == "total":
            raise fault(
                "self_contact acts in the updated formulation only: in the total one the body would pass through itself",
                "leave formulation out, or write `formulation: updated`; or do not name self_contact",
                ("solver", "dynamic", "formulation"),
            )

    def _feed_can_push(self) -> None:
        """The guide must hold some of a catheter, and go on holding it."""
        feed, catheter = self.effects.feed, self.body.catheter
        if feed is None:
            return
        if catheter is None:
            raise fault(
                f"feed pushes a catheter, and this body is a {self.body.kind}",
                "do not name feed",
                ("effects", "feed"),
            )
        least = catheter.diameter
        if not feed.exit >= least:
            raise fault(
                f"the guide must hold one diameter of the catheter at least, {1e3 * least:g} mm from the base at x = 0",
                f"write an exit of {1e3 * least:g} mm or more",
                ("effects", "feed", "exit"),
            )
        duration = getattr(getattr(self.solver, "dynamic", None), "duration", 0.0)
        left = feed.exit - feed.speed * duration
        if not left >= least:
            raise fault(
                f"the base must stay in the guide by one diameter, {1e3 * least:g} mm; {1e3 * left:g} mm are left after "
                f"{duration:g} s",
                "push more slowly, for a shorter time, or from a guide whose exit is farther",
                ("effects", "feed", "speed"),
            )

    def _field_suits_the_solver(self) -> None:
        """Equilibrium has one field, the one at the end of the schedule, and is a minimum of one energy."""
        if not self.static:
            return
        over = self.field.over_time
        if over is not None and over.endless is not None:
            count = {"rotation": "turns", "oscillation": "cycles"}[over.endless]
            raise fault(
                "a static solve takes the field at the end of its schedule, and this has no end",
                f"add `{count}` to say when it stops, or ask for motion with solver.dynamic",
                ("field", "over_time", over.endless),
            )

    def without_energy(self) -> str | None:
        """In a field that varies in space, which of torque and force is missing from an equilibrium; None where all is well."""
        torque, force = self.effects.magnetic_torque, self.effects.magnetic_force
        if not self.static or not self.field.varies or (torque is None) == (force is None):
            return None
        return "magnetic_torque" if torque is None else "magnetic_force"

    @property
    def static(self) -> bool:
        """Whether equilibrium is sought, rather than motion."""
        return getattr(self.solver, "dynamic", None) is None

    def _field_acts(self, effect: str) -> None:
        """A file that asks for an outside field's torque or force must have something to turn and something to turn it.

        Only asked of files: a study or a test may well set the field or all magnetisations to zero.
        """
        if "field" not in self.model_fields_set:
            raise fault(
                f"{effect} needs a field",
                f"add, say, `field: {{uniform: [0 mT, 6 mT, 8 mT]}}`, or do not name {effect}",
                ("field",),
            )
        if not self.magnetised_segments():
            raise fault(
                f"{effect} needs a segment with a magnetization whose material has a remanence",
                "give a segment, say, `magnetization: [1, 0, 0]`, and its material `remanence: 138 mT`",
                ("effects", effect),
            )

    # what the scene says, put together

    def _materials_named(self) -> list[tuple[Key, str]]:
        """Where the body names materials, and which."""
        named: list[tuple[Key, str]] = []
        if (material := getattr(self.body.shape, "material", None)) is not None:
            named.append((("body", self.body.kind, "material"), material))
        for piece in self.regions():
            if piece.material_name != material:
                named.append((("body", *piece.at, "material"), piece.material_name))
        return named

    def regions(self) -> tuple[Region, ...]:
        """What the body is made of, each with one material: segments from base to tip, or parts."""
        return self.body.shape.regions()

    @property
    def length(self) -> float:
        """Length of the undeformed body, m: what errors and distances are measured by."""
        return self.body.shape.length

    @property
    def thickness(self) -> float:
        """What `cells_across` counts cells through, m: a catheter's diameter, a strip's thickness."""
        shape = self.body.shape
        return shape.diameter if isinstance(shape, Catheter) else shape.thickness

    @property
    def cell(self) -> float:
        """Width of the grid's cells, m, as asked for; the grid's own fit the body and may be a little smaller."""
        parts = self.body.parts
        asked = None if parts is None else parts.spacing
        return asked or self.thickness / self.resolution.cells_across

    @property
    def anchored(self) -> bool:
        """Whether it is held at its base alone, and so stays within its length of it."""
        return getattr(self.body.shape, "clamp", None) == "base"

    def box(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """Lower and upper corner of the box around the undeformed body, m."""
        return self.body.shape.box()

    def outside_field(self) -> OutsideField:
        """The outside field around the body, with its tables. Raises SceneError (fields.outside_field)."""
        return outside_field(self.field, self.box(), anchored=self.anchored, cell=self.cell)

    def segment_material(self, index: int) -> Material:
        """The material of the region (segment or part) with this index. Raises IndexError."""
        return self.materials[self.regions()[index].material_name]

    def segment_remanence(self) -> NDArray[np.float64]:
        """Remanent flux density of each piece in the undeformed body, (k, 3) T."""
        return np.array(
            [[self.materials[p.material_name].remanence * x for x in p.magnetization] for p in self.regions()]
        )

    def magnetised_segments(self) -> list[int]:
        """Indices of the segments that have a direction and a remanence."""
        return [int(i) for i in np.flatnonzero(self.segment_remanence().any(axis=1))]

    def reference_centreline(self) -> NDArray[np.float64] | None:
        """Rows [s, x, y, z] of the known answer, (m, 4) m, or None."""
        return None if self.reference is None else np.array(self.reference.centreline)

    def warnings(self) -> list[str]:
        """What the author may not have meant: one sentence each."""
        found = []
        torque, force = self.effects.magnetic_torque, self.effects.magnetic_force
        if torque is None and force is None and self.field.acts and self.magnetised_segments():
            found.append("effects: magnetic_torque is not named, so the field does nothing")
        elif torque is None and force is not None and self.field.varies:
            found.append("effects: magnetic_torque is not named, so the field pulls the segments but does not turn them")
        elif force is None and self.field.varies and self.magnetised_segments():
            found.append("effects: magnetic_force is not named, so the field turns the segments but does not pull them")
        if force is not None and not self.field.varies:
            found.append("effects: magnetic_force does nothing, for the field is the same everywhere")
        if not any(effect is not None for _, effect in self.effects):
            found.append("effects: none is named, so nothing moves")
        used = {piece.material_name for piece in self.regions()}
        catheter, across = self.body.catheter, self.resolution.cells_across
        if catheter is not None:
            wall = (catheter.diameter - catheter.inner_diameter) / 2 * across / catheter.diameter
            if wall < 1:
                found.append(
                    f"resolution: the tube's wall is {wall:.2f} cells thick; trust needs one cell at least, "
                    f"cells_across {int(np.ceil(across / wall - 1e-9))}"
                )
        if catheter is not None and catheter.clamp == "none" and self.effects.feed is not None:
            found.append("body.catheter.clamp: none frees nothing here: the guide of feed holds the base and pushes it, clamped or not")
        strip = self.body.strip
        if strip is not None and strip.plane_strain and self.field.uniform[1] and self.effects.magnetic_torque is not None:
            found.append("field: its y component does nothing to a strip in plane strain")
        gravity = self.effects.gravity
        if strip is not None and strip.plane_strain and gravity is not None and gravity.acceleration[1]:
            found.append("effects.gravity: the y component of its acceleration does nothing to a strip in plane strain")
        parts, dynamic = self.body.parts, self.solver.dynamic
        apart = self.effects.self_contact is not None or (dynamic is not None and dynamic.formulation == "updated")
        if parts is not None and not apart:
            found += [
                f"body.parts: {one} and {other} are {1e3 * gap:.3g} mm apart, less than two cells of {1e3 * self.cell:.3g} mm: "
                "they move as if joined, unless self_contact is named"
                for one, other, gap in parts.near(2 * self.cell)
            ]
        found += [f"materials: {name} is not used" for name in self.materials if name not in used]
        return found

    def __repr__(self) -> str:
        """One line: the body, its effects, and how it is solved."""
        named = " + ".join(name for name, effect in self.effects if effect is not None) or "no effects"
        dynamic = self.solver.dynamic
        solved = "equilibrium" if dynamic is None else f"motion of {dynamic.duration:g} s"
        size = f"{1e3 * self.length:g} mm long, {1e3 * self.thickness:g} mm thick, {len(self.regions())} regions"
        return f"Scene({self.name!r}: {self.body.kind}, {size}; {named}; {solved} in cells of {1e3 * self.cell:.3g} mm)"

    __str__ = __repr__

    # scenes to and from data, and scenes made of scenes

    def to_si(self) -> dict[str, Any]:
        """Plain data in SI (numbers, text, lists, dicts), as `from_si` reads it."""
        return self.model_dump(mode="json")

    @classmethod
    def from_si(cls, data: Mapping[str, Any]) -> Scene:
        """The scene that plain SI data describe. Raises InputError."""
        return validate(cls, data)

    def hash(self) -> str:
        """SHA-256, in hex, of all that decides the answer: everything but `name` and `reference`.

        The same for any layout of the file, order of keys and choice of units; numbers count to 12 digits.
        """
        content = self.model_dump(mode="json", exclude={"name", "reference"}, exclude_none=True)
        return hashlib.sha256(json.dumps(_rounded(content), sort_keys=True).encode()).hexdigest()

    def with_magnetizations(self, directions: ArrayLike) -> Scene:
        """The scene with these directions, (k, 3), no unit, for its k segments, normalized; zeros remove the magnetization.

        Raises InputError when the shape is another, a number is not finite, or the body has a profile in place of segments.
        """
        given = np.asarray(directions, dtype=float)
        pieces = self.regions()
        if given.shape != (len(pieces), 3):
            raise InputError(f"directions have shape {given.shape}; must be {(len(pieces), 3)}")
        data = self.to_si()
        for piece, direction in zip(pieces, given.tolist(), strict=True):
            found = data["body"]
            for key in piece.at:
                found = found[key]
            if "harmonic" in found:
                raise InputError("body: a magnetization_profile has no segments to change; give the strip `segments`")
            found["magnetization"] = direction
        return Scene.from_si(data)

    def with_field(self, uniform: ArrayLike) -> Scene:
        """The scene in this uniform field, (3,) T; other sources and the schedule stay. Raises InputError."""
        data = self.to_si()
        changed = {**data["field"], "uniform": np.asarray(uniform, dtype=float).tolist()}
        return Scene.from_si({**data, "field": changed})

    def with_cells(self, cells_across: int) -> Scene:
        """The scene with the resolution cells_across: so many cells through the body's thickness. Raises InputError."""
        data = self.to_si()
        return Scene.from_si({**data, "resolution": {**data["resolution"], "cells_across": cells_across}})

    def with_effects(self, **effects: Mapping[str, Any] | Settings | None) -> Scene:
        """The scene with these effects named (by settings, {} for the usual) or, given None, not named.

        Effects not mentioned stay as they are: `scene.with_effects(gravity={}, magnetic_torque=None)`.
        Raises InputError.
        """
        data = self.to_si()
        changed = {
            key: value.model_dump() if isinstance(value, Settings) else value for key, value in effects.items()
        }
        return Scene.from_si({**data, "effects": {**data["effects"], **changed}})


def _rounded(content: Any) -> Any:
    """Numbers as text of 12 digits: the last bits of a cosine differ between machines."""
    if isinstance(content, dict):
        return {key: _rounded(value) for key, value in content.items()}
    if isinstance(content, list):
        return [_rounded(value) for value in content]
    if isinstance(content, (int, float)) and not isinstance(content, bool):
        return f"{content + 0.0:.12g}"  # + 0.0 makes -0.0 into 0.0
    return content
