"""Scenes: what is simulated, how, and how finely, as immutable values in SI.

`load_scene(path)` reads a file, where quantities carry units. In Python the same classes take SI floats (or
text with units), `Material(shear_modulus=120e3, bulk_to_shear=20)`, and raise InputError.
`scene.to_si()` is plain SI data, as results save it, and `Scene.from_si` makes the same scene of it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    PrivateAttr,
    ValidationInfo,
    WithJsonSchema,
    field_validator,
    model_validator,
)

from magmpm.bodies.body import CATHETER, Body
from magmpm.bodies.body_shape import Region
from magmpm.compiled.arrays import Array, Named, Plain
from magmpm.effects.acting import Effects
from magmpm.errors import InputError, show
from magmpm.fields.external_field import Field as ExternalField
from magmpm.fields.external_field import Nodes, external_field
from magmpm.fields.schedule import end_time
from magmpm.fields.sources import FieldSource
from magmpm.inputs.csv_tables import named_table, read_centreline
from magmpm.inputs.messages import Instead, plain_word
from magmpm.inputs.quantities import in_si
from magmpm.inputs.settings import Settings, fault, from_file, validate
from magmpm.inputs.user_files import folder_fault
from magmpm.inputs.vectors import Vector
from magmpm.inputs.yaml_document import Document, read_yaml
from magmpm.scene import moves, rules
from magmpm.scene.derived import inserted_data
from magmpm.scene.options import Material, Resolution, Solver

K = TypeVar("K")
V = TypeVar("V")


class FrozenDict(dict[K, V]):
    """A dict that refuses changes, so that scenes can be shared and hashed."""

    def _refuse(self, *args: Any, **kwargs: Any) -> Any:
        raise TypeError("a scene is immutable; build another with its with_... methods")

    __setitem__ = __delitem__ = __ior__ = update = setdefault = pop = popitem = clear = _refuse

    def __hash__(self) -> int:  # type: ignore[override]
        return hash(frozenset(self.items()))

    def __reduce__(self) -> Any:
        return FrozenDict, (dict(self),)  # else pickle would fill it item by item


def load_scene(path: Path | str | Named) -> Scene:
    """Read a scene from its file, with all quantities in SI; or make it of a dict with the keys of such a file.

    Parameters
    ----------
    path : Path, str or Mapping[str, Any]
        Path of the file. Of a dict quantities are text with units or numbers in SI, and its
        paths are relative to the working folder.

    Returns
    -------
    Scene
        The scene.

    Raises
    ------
    InputError
        Lists everything wrong with the file, by line, key, value received, rule and remedy.

    Examples
    --------
    >>> import magmpm
    >>> scene = magmpm.load_scene("data/scenes/axial_transverse.yaml")
    >>> scene.length  # m
    0.04
    """
    data = path if isinstance(path, Mapping) else read_yaml(path)
    _refuse_other_files(data)
    return validate(Scene, data)


def _refuse_other_files(data: Named) -> None:
    """Raises InputError for a study or a robot, whose every key would be unknown here."""
    if "body" in data or "materials" in data:
        return
    place = str(data.path) if isinstance(data, Document) else "input"
    rule = "a scene says what is simulated: `materials`, `body`, `field`, `effects`"
    if "scene" in data:
        raise InputError(
            place,
            received="a study",
            rule=rule,
            remedy=f"`magmpm design {place}` runs the study; the scene that it names is"
            f" {show(data['scene'])}",
        )
    if "n_segments" in data:
        raise InputError(
            place,
            received="a robot of the magneticMPM format",
            rule=rule,
            remedy=f"`magmpm import {place} -o SCENE.yaml` makes a scene of it",
        )


class Reference(Settings):
    """A known answer to compare with."""

    centreline: Annotated[
        tuple[tuple[float, float, float, float], ...],
        named_table(
            lambda path: read_centreline(path).tolist(), "centreline: ../references/shape.csv"
        ),
        WithJsonSchema({"type": "string"}),
    ] = Field(
        description="Path, relative to this file, of a CSV table with columns s_mm,x_mm,y_mm,z_mm.",
        examples=["../references/shape.csv"],
    )


_AUTO = "auto"  # effects that the program is to choose


class _OrAuto:
    """Annotation: the JSON schema of a type, or the word auto."""

    def __get_pydantic_json_schema__(self, core: Any, handler: Any) -> Plain:
        return {"anyOf": [handler(core), {"const": _AUTO}]}


def _read_effects(value: Any) -> Any:
    """`auto` as Effects; a mapping as it is."""
    if isinstance(value, Mapping) and _AUTO in value and value[_AUTO] not in (None, True):
        value = {
            **value,
            _AUTO: True,
        }  # written among others, which Effects refuses, or alone, which means the same
    return {_AUTO: True} if value == _AUTO else value


OF_STUDIES = {
    "vary",
    "match",
    "trials",
    "sampler",
    "seed",
    "stop",
    "minimize",
    "insertion",
    "schedule",
    "robust",
    "stability",
    "limits",
}


class Scene(Settings):
    """Scene to simulate, the method, and the resolution. SI floats inside; immutable.

    Parameters
    ----------
    name : str
        Names the folder of results.
    materials : dict of str to Material
        Materials by name.
    body : Catheter, Tube, Strip, Parts or dict
        What moves: a catheter, a strip, or parts given as STL meshes.
    field : FieldSource, optional
        The external magnetic field; none unless given.
    move : dict of str to dict, optional
        What holds the body is moved: base, tip (of a strip that both ends hold), or held parts
        by their names.
    effects : sequence of effects, dict or 'auto', optional
        The effects to simulate; one that is not named costs nothing. auto: the program
        chooses them, and reports which and why.
    solver : Static, QuasiStatic, Dynamic or dict, optional
        Static unless given.
    resolution : Resolution, optional
        How fine the grid is: {cells_across: 4} unless given.
    advice : {'on', 'off'}, optional
        Whether `magmpm run` warns of effects that are not named and would move the answer: on,
        unless given, or off.
    reference : dict, optional
        A known answer.

    Examples
    --------
    >>> from magmpm import Catheter, Gravity, MagneticTorque, Material, Scene, Segment, UniformField
    >>> silicone = Material(
    ...     shear_modulus="120 kPa", bulk_to_shear=20, density="1882 kg/m^3", remanence="138 mT"
    ... )
    >>> rod = Catheter(
    ...     length="40 mm",
    ...     diameter="4 mm",
    ...     material="silicone",
    ...     segments=[Segment(magnetization=[1, 0, 0])],
    ... )
    >>> scene = Scene(
    ...     name="rod",
    ...     materials={"silicone": silicone},
    ...     body=rod,
    ...     field=UniformField(uniform=["0 mT", "0 mT", "8 mT"]),
    ...     effects=[MagneticTorque(), Gravity()],
    ... )
    >>> scene.save("rod.yaml").name
    'rod.yaml'
    """

    _field_on_nodes: ExternalField | None = PrivateAttr(None)

    @staticmethod
    def by_other_keys(key: str, values: Named) -> Instead | None:
        """Say where a key that belongs in a study should stand.

        Parameters
        ----------
        key : str
            A key that a scene does not have.
        values : Mapping[str, Any]
            What stands beside it.

        Returns
        -------
        Instead or None
            What to write in its place; None of a key of which nothing is known.
        """
        if plain_word(key) not in OF_STUDIES:
            return None
        return Instead(
            "it belongs in a study, a file of its own that names this one, `scene: FILE`; `magmpm"
            " design STUDY` runs it"
        )

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
    body: Body = Field(
        description="What moves: a catheter, a strip, or parts given as STL meshes.",
        examples=[{"catheter": CATHETER}],
    )
    field: FieldSource = Field(
        default=FieldSource(),
        description="The external magnetic field; none unless given.",
        examples=[{"uniform": ["0 mT", "6 mT", "8 mT"]}],
    )
    move: Annotated[dict[str, moves.Move], AfterValidator(FrozenDict)] | None = Field(
        default=None,
        description=(
            "What holds the body is moved: base, tip (of a strip that both ends hold), or held"
            " parts by their names."
        ),
        examples=[{"tip": {"along": [-1, 0, 0], "distance": "0.47 mm"}}],
    )
    effects: Annotated[Effects, BeforeValidator(_read_effects), _OrAuto()] = Field(
        default=Effects(),
        description=(
            "The effects to simulate; one that is not named costs nothing. auto: the program "
            "chooses them, and reports which and why."
        ),
        examples=[{"magnetic_torque": {}}],
    )
    solver: Solver = Field(
        default=Solver(), description="Static unless given.", examples=[{"static": {}}]
    )
    resolution: Resolution = Field(
        default=Resolution(),
        description="How fine the grid is: {cells_across: 4} unless given.",
        examples=[{"cells_across": 4}],
    )
    advice: Literal["on", "off"] = Field(
        default="on",
        description=(
            "Whether `magmpm run` warns of effects that are not named and would move the answer:"
            " on, unless given, or off."
        ),
        examples=["off"],
    )
    reference: Reference | None = Field(
        default=None,
        description="A known answer.",
        examples=[{"centreline": "../references/shape.csv"}],
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
        rules.check(self, written=from_file(info))
        return self

    def check_energy(self) -> None:
        """Refuse a scene whose equilibrium has no energy: with torque or force alone, in a field that varies in space.

        Raises
        ------
        InputError
            Names the effect that is missing.
        """
        if (missing := rules.without_energy(self)) is not None:
            rule, remedy = rules.NO_ENERGY
            raise InputError(f"effects.{missing}", received="nothing", rule=rule, remedy=remedy)

    @property
    def static(self) -> bool:
        """True if equilibrium is sought, one or several along time, rather than motion."""
        return self.solver.dynamic is None

    @property
    def in_time(self) -> bool:
        """True if the scene is solved for several moments, which are written as frames: a motion, or equilibria along time."""
        return self.solver.dynamic is not None or self.solver.quasi_static is not None

    @property
    def duration(self) -> float:
        """Time of the last moment, s; 0 of a single equilibrium."""
        dynamic = self.solver.dynamic
        return dynamic.duration if dynamic is not None else (self.path_times() or [0.0])[-1]

    def path_times(self) -> list[float]:
        """List the times of the equilibria along time.

        Returns
        -------
        list of float, s
            Times, rising; none where the scene requests no such equilibria.
        """
        quasi_static = self.solver.quasi_static
        ends = [end_time(self.field), *(move.end for move in (self.move or {}).values())]
        return [] if quasi_static is None else quasi_static.times(max(ends))

    # what the scene says, put together

    def regions(self) -> tuple[Region, ...]:
        """List the regions of the body, each with one material.

        Returns
        -------
        tuple of Region
            Segments from base to tip, or parts.
        """
        return self.body.shape.regions()

    @property
    def length(self) -> float:
        """Length of the undeformed body, m: what errors and distances are measured by."""
        return self.body.shape.length

    @property
    def allowed_error(self) -> float:
        """The error that the scene requests, m; 1 % of its length where it requests none."""
        return self.resolution.allowed(self.length) or 0.01 * self.length

    @property
    def thickness(self) -> float:
        """Length through which `cells_across` counts cells, m: a catheter's diameter, a strip's thickness."""
        return self.body.shape.thickness

    @property
    def cell(self) -> float:
        """Width of the grid's cells, m, as requested; the grid's own fit the body and may be a little smaller."""
        return self.body.shape.cell_size(self.resolution.cells_across)

    @property
    def anchored(self) -> bool:
        """True if the body is held at its base alone, and so stays within its length of it."""
        return self.body.shape.clamp == "base"

    def box(self) -> tuple[Vector, Vector]:
        """Find the box around the undeformed body.

        Returns
        -------
        tuple of (float, float, float), m
            Its lower and its upper corner.
        """
        return self.body.shape.box()

    def external_field(self) -> ExternalField:
        """Make the external field around the body, with its tables.

        Returns
        -------
        Field
            The field, which can be evaluated wherever the body may come.

        Raises
        ------
        SceneError
            Where it can't be made around this body (fields.external_field).
        """
        return self._field_on_nodes or self._field_around()

    def on_field_nodes_of(self, other: Scene) -> Scene:
        """Make this scene with the magnets' field on the nodes of another scene's table: from one to the other it changes smoothly.

        Parameters
        ----------
        other : Scene
            The scene whose table has the nodes.

        Returns
        -------
        Scene
            This scene with such a table; the scene itself where the other's field has no table.
        """
        nodes = other.external_field().nodes
        if nodes is None:
            return self
        found = self.model_copy()
        found._field_on_nodes = self._field_around(nodes)
        return found

    def _field_around(self, nodes: Nodes | None = None) -> ExternalField:
        low, high = self.box()
        far = moves.farthest(self.move or {})
        box = (
            (low[0] - far, low[1] - far, low[2] - far),
            (high[0] + far, high[1] + far, high[2] + far),
        )
        return external_field(self.field, box, anchored=self.anchored, cell=self.cell, nodes=nodes)

    def region_material(self, index: int) -> Material:
        """Find the material of a region.

        Parameters
        ----------
        index : int
            Index of the region, a segment or part.

        Returns
        -------
        Material
            Its material.

        Raises
        ------
        IndexError
            Where the body has no such region.
        """
        return self.materials[self.regions()[index].material_name]

    def region_remanence(self) -> Array:
        """Find the remanent flux density of each region in the undeformed body.

        Returns
        -------
        array (k, 3), T
            A row for each of the k regions; zeros where it is not magnetized.
        """
        return np.array(
            [
                [self.materials[p.material_name].remanence * x for x in p.magnetization]
                for p in self.regions()
            ]
        )

    def magnetized_regions(self) -> list[int]:
        """Find the regions that have a direction of magnetization and a remanence.

        Returns
        -------
        list of int
            Their indices.
        """
        return [int(i) for i in np.flatnonzero(self.region_remanence().any(axis=1))]

    def reference_centreline(self) -> Array | None:
        """Find the known answer that the scene names.

        Returns
        -------
        array (m, 4), m, or None
            Rows [s, x, y, z]; None where the scene names none.
        """
        return None if self.reference is None else np.array(self.reference.centreline)

    def warnings(self) -> list[str]:
        """Warn of settings that the author may not have meant.

        Returns
        -------
        list of str
            One sentence each.
        """
        return rules.warnings(self)

    def __repr__(self) -> str:
        """One line: the body, its effects, how it is solved, and the field."""
        named = (
            " + ".join(name for name, effect in self.effects if effect is not None) or "no effects"
        )
        dynamic = self.solver.dynamic
        several = (
            f"{len(self.path_times())} equilibria over {self.duration:g} s"
            if self.in_time
            else "equilibrium"
        )
        solved = several if dynamic is None else f"motion of {dynamic.duration:g} s"
        size = (
            f"{1e3 * self.length:g} mm long, {1e3 * self.thickness:g} mm thick,"
            f" {len(self.regions())} regions"
        )
        cells = f"cells of {1e3 * self.cell:.3g} mm"
        return (
            f"Scene({self.name!r}: {self.body.kind}, {size}; {named}; {solved} in {cells}; field"
            f" {self.field.text()})"
        )

    __str__ = __repr__

    def _repr_html_(self) -> str:
        """Its body and what acts on it, as notebooks show it."""
        from magmpm.scene.notebook import of_scene

        return of_scene(self)

    # scenes to and from data, and scenes made of scenes

    def to_si(self) -> Plain:
        """Write the scene as plain data in SI, as `from_si` reads it.

        Returns
        -------
        dict[str, Any]
            Numbers, text, lists and dicts.
        """
        return self.model_dump(mode="json")

    def save(self, path: Path | str) -> Path:
        """Write the scene as a file with units, from which load_scene makes an equal one; its reference as a table next to it.

        Parameters
        ----------
        path : Path or str
            The file to write.

        Returns
        -------
        Path
            The path.

        Raises
        ------
        InputError
            For scenes with a measured map or another table that a file names by its path;
            nothing is written then.
        """
        from magmpm.scene.derived import save

        return save(self, Path(path))

    @classmethod
    def from_si(cls, data: Named) -> Scene:
        """Make the scene that plain SI data describe.

        Parameters
        ----------
        data : Mapping[str, Any]
            As `to_si` returns them.

        Returns
        -------
        Scene
            The scene.

        Raises
        ------
        InputError
            For whatever breaks a rule of scenes.
        """
        return validate(cls, data)

    def hash(self) -> str:
        """Find the SHA-256 of all that decides the answer: everything but `name`, `reference` and `advice`.

        It is the same for any layout of the file, order of keys and choice of units; numbers count
        to 12 digits.

        Returns
        -------
        str
            64 hexadecimal digits.
        """
        content = self.model_dump(
            mode="json", exclude={"name", "reference", "advice"}, exclude_none=True
        )
        return hashlib.sha256(json.dumps(_rounded(content), sort_keys=True).encode()).hexdigest()

    def with_magnetizations(self, directions: ArrayLike) -> Scene:
        """Make the scene with other directions of magnetization.

        Parameters
        ----------
        directions : array (k, 3), no unit
            A direction for each of the k segments or parts, of any length; zeros remove the
            magnetization.

        Returns
        -------
        Scene
            The new scene.

        Raises
        ------
        InputError
            If the shape is another, a number is not finite, or the body has a magnetization
            profile in place of segments.

        Examples
        --------
        >>> import magmpm
        >>> scene = magmpm.load_scene("data/scenes/axial_transverse.yaml")
        >>> scene.with_magnetizations([[0, 0, 2]]).regions()[0].magnetization
        (0.0, 0.0, 1.0)
        """
        given = np.asarray(directions, dtype=float)
        regions = self.regions()
        if given.shape != (len(regions), 3):
            raise InputError(f"directions have shape {given.shape}; must be {(len(regions), 3)}")
        if not self.body.shape.magnetized_by_region:
            raise InputError(
                "body: a magnetization_profile has no segments to change; give the strip `segments`"
            )
        data = self.to_si()
        for region, direction in zip(regions, given.tolist(), strict=True):
            found = data["body"]
            for key in region.at:
                found = found[key]
            found["magnetization"] = direction
        return Scene.from_si(data)

    def with_field(self, uniform: ArrayLike | str | Sequence[float | str]) -> Scene:
        """Make the scene in another uniform field; its other sources and its schedule stay.

        Parameters
        ----------
        uniform : array (3,), T, sequence, float or str
            Components along x, y and z, numbers in T or text with units. One number or text, as
            in `with_field("4 mT")`, is the strength of a field along that of the scene.

        Returns
        -------
        Scene
            The new scene.

        Raises
        ------
        InputError
            For a wrong quantity, or a strength alone where the scene has no uniform field.

        Examples
        --------
        >>> import magmpm
        >>> scene = magmpm.load_scene("data/scenes/axial_transverse.yaml")
        >>> scene.with_field(["0 mT", "3 mT", 0.004]).field.uniform  # T
        (0.0, 0.003, 0.004)
        """
        data = self.to_si()
        given = uniform.tolist() if isinstance(uniform, np.ndarray) else uniform
        if isinstance(given, (str, int, float)):
            given = self._along_its_field(given)
        return Scene.from_si({**data, "field": {**data["field"], "uniform": given}})

    def _along_its_field(self, strength: float | str) -> list[float]:
        """The uniform field with another strength. Raises InputError where there is none whose direction could be kept."""
        before = np.array(self.field.uniform)
        if not before.any():
            rule = "a strength alone needs a field whose direction it keeps, and the scene has none"
            raise InputError(
                "field.uniform",
                received=repr(strength),
                rule=rule,
                remedy='write ["0 mT", "0 mT", "4 mT"]',
            )
        found: list[float] = (
            in_si(strength, "flux density", "field.uniform") * before / np.linalg.norm(before)
        ).tolist()
        return found

    def with_material(self, name: str | None = None, **properties: Any) -> Scene:
        """Make the scene with other properties of a material.

        Parameters
        ----------
        name : str, optional
            The material, which is made if the scene has none of that name; the scene's only one
            unless given.
        **properties : object
            Keys of a material (Material), numbers in SI or text with units.

        Returns
        -------
        Scene
            The new scene.

        Raises
        ------
        InputError
            For a wrong property, a scene of several materials without a name, or a new material
            without a shear modulus.

        Examples
        --------
        >>> import magmpm
        >>> scene = magmpm.load_scene("data/scenes/axial_transverse.yaml")
        >>> softer = scene.with_material(shear_modulus="90 kPa")
        >>> softer.region_material(0).shear_modulus  # Pa
        90000.0
        """
        data = self.to_si()
        if name is None and len(self.materials) > 1:
            raise InputError(
                "materials",
                received="no name",
                rule="the scene has several materials",
                remedy=f"name one of them: {', '.join(self.materials)}",
            )
        key = next(iter(self.materials)) if name is None else name
        if key not in self.materials and "shear_modulus" not in properties:
            raise InputError(
                "materials",
                received=repr(key),
                rule=f"the scene has {', '.join(self.materials)}; a new one needs a shear_modulus",
                remedy="use one of these names",
            )
        return Scene.from_si(
            {
                **data,
                "materials": {
                    **data["materials"],
                    key: {**data["materials"].get(key, {}), **properties},
                },
            }
        )

    def with_cells(self, cells_across: int) -> Scene:
        """Make the scene with a given number of cells, in place of an error, a time or a spacing.

        Parameters
        ----------
        cells_across : int
            Number of grid cells across the body's thickness.

        Returns
        -------
        Scene
            The new scene.

        Raises
        ------
        InputError
            For a number that the body can't have.
        """
        data = self.to_si()
        kept = {
            key: value
            for key, value in data["resolution"].items()
            if key in ("particles_per_cell", "from_tip")
        }
        if data["body"]["parts"] is not None:
            data["body"]["parts"]["spacing"] = None
        return Scene.from_si({**data, "resolution": {"cells_across": cells_across, **kept}})

    def inserted(self, length: float | str) -> Scene:
        """Make the scene of the catheter's last piece, outside a guide: an equilibrium, clamped at the exit, the origin.

        Inside the guide the catheter is straight and held, so nothing but this piece matters. A
        segment that the exit cuts keeps what is outside; region i here is region i + (regions
        there) - (regions here) of the whole; a rest of a segment below a hundredth of the diameter
        counts to the next one. Effects that act in motion only, feed, obstacles and the reference
        stay out. At the whole length the shape is that of the whole catheter. Field and gravity are
        as they are.

        Parameters
        ----------
        length : float, m, or str
            Length outside the guide: from one diameter (a shorter piece is no rod) to the
            whole.

        Returns
        -------
        Scene
            The new scene.

        Raises
        ------
        InputError
            For another length, and for bodies other than a catheter.

        Examples
        --------
        >>> import magmpm
        >>> scene = magmpm.load_scene("data/scenes/five_segments.yaml").inserted("20 mm")
        >>> round(scene.length, 6)  # m
        0.02
        """
        return Scene.from_si(inserted_data(self, self.to_si(), in_si(length, "length", "length")))

    def with_effects(self, **effects: Named | Settings | None) -> Scene:
        """Make the scene with other effects; those not mentioned stay as they are.

        Parameters
        ----------
        **effects : Mapping[str, Any], Settings or None
            By key, the settings of an effect, {} for the usual ones; or None, and the effect is
            not named.

        Returns
        -------
        Scene
            The new scene.

        Raises
        ------
        InputError
            For an unknown effect or a wrong setting.

        Examples
        --------
        >>> import magmpm
        >>> scene = magmpm.load_scene("data/scenes/five_segments.yaml")
        >>> turned = scene.with_effects(gravity={"acceleration": [0, 9.81, 0]})
        >>> turned.effects.gravity.acceleration  # m/s^2
        (0.0, 9.81, 0.0)
        """
        data = self.to_si()
        changed = {
            key: value.model_dump() if isinstance(value, Settings) else value
            for key, value in effects.items()
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
