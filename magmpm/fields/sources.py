"""The sources of the external field, which add up: settings and their rules.

The descriptions and examples are what editors show (scene.schema.json) and what error messages quote.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field, GetJsonSchemaHandler, model_validator
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from magmpm.compiled.arrays import Plain
from magmpm.errors import count, in_mm
from magmpm.fields.measured_map import Map
from magmpm.fields.over_time import OverTime
from magmpm.inputs.settings import Length, Quantity, Settings, fault
from magmpm.inputs.vectors import Axis, FluxVector, Point, Vector, three

MAX_SOURCES = 100

_Moment = Annotated[float, Quantity("magnetic moment", at_least="-1e6 A*m^2", at_most="1e6 A*m^2")]
if TYPE_CHECKING:
    Moment = Vector
    Sizes = Vector
else:
    Moment = Annotated[tuple[_Moment, _Moment, _Moment], three("[0 A*m^2, 0 A*m^2, 0.5 A*m^2]")]
    Sizes = Annotated[tuple[Length, Length, Length], three("[20 mm, 20 mm, 10 mm]")]


class _OneOrMore(BeforeValidator):
    """A single mapping counts as a list of one."""

    def __init__(self) -> None:
        super().__init__(lambda value: [value] if isinstance(value, (Mapping, Settings)) else value)

    def __get_pydantic_json_schema__(
        self, core: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        schema = handler(core)
        return {"anyOf": [schema["items"], schema]}


class Dipole(Settings):
    """A magnet far away, or a magnetized sphere: the field of a point dipole.

    Parameters
    ----------
    position : sequence (3,) of float or str, m
        Where it is: [x, y, z].
    moment : sequence (3,) of float or str, A m^2
        Magnetic moment, Br V/mu0 of a magnet: [x, y, z].
    diameter : float or str, m, optional
        Diameter of the sphere it represents, which the body must stay out of; a point
        unless given.

    Examples
    --------
    >>> from magmpm import Dipole
    >>> magnet = Dipole(position=["60 mm", "0 mm", "0 mm"], moment=[0, 0, 0.5])
    >>> magnet.moment  # A m^2
    (0.0, 0.0, 0.5)
    """

    position: Point = Field(
        description="Where it is: [x, y, z].", examples=[["60 mm", "0 mm", "0 mm"]]
    )
    moment: Moment = Field(
        description="Magnetic moment, Br V/mu0 of a magnet: [x, y, z].",
        examples=[["0 A*m^2", "0 A*m^2", "0.5 A*m^2"]],
    )
    diameter: Length | None = Field(
        default=None,
        description=(
            "Diameter of the sphere it represents, which the body must stay out of; a point "
            "unless given."
        ),
        examples=["10 mm"],
    )


class Cuboid(Settings):
    """A block.

    Parameters
    ----------
    size : sequence (3,) of float or str, m
        Edges along x, y and the magnet's axis (z unless `axis` is given).

    Examples
    --------
    >>> from magmpm import Cuboid
    >>> Cuboid(size=["20 mm", "20 mm", "10 mm"]).size  # m
    (0.02, 0.02, 0.01)
    """

    size: Sizes = Field(
        description="Edges along x, y and the magnet's axis (z unless `axis` is given).",
        examples=[["20 mm", "20 mm", "10 mm"]],
    )


class Cylinder(Settings):
    """A round bar or disk.

    Parameters
    ----------
    diameter : float or str, m
        Diameter.
    length : float or str, m
        Length along its axis.

    Examples
    --------
    >>> from magmpm import Cylinder, Magnet
    >>> shape = Cylinder(diameter="20 mm", length="10 mm")
    >>> Magnet(cylinder=shape, position=["75 mm", "0 mm", "20 mm"], remanence="1.3 T").remanence  # T
    1.3
    """

    diameter: Length = Field(description="Diameter.", examples=["20 mm"])
    length: Length = Field(description="Length along its axis.", examples=["20 mm"])


class Magnet(Settings):
    """A permanent magnet of finite size, magnetized evenly.

    Parameters
    ----------
    cuboid : Cuboid, optional
        Its shape: a block.
    cylinder : Cylinder, optional
        Its shape: a cylinder.
    position : sequence (3,) of float or str, m
        Its center: [x, y, z].
    axis : Angles, dict or sequence (3,), no unit, optional
        Where its axis points (a block's third edge): [x, y, z] or angles; [0, 0, 1] unless
        given.
    remanence : float or str, T
        Remanent flux density Br; 1.2 to 1.45 T for neodymium.
    magnetization : Angles, dict or sequence (3,), no unit, optional
        Direction of its magnetization in space; along its axis unless given.

    Examples
    --------
    >>> from magmpm import Cylinder, Magnet
    >>> magnet = Magnet(
    ...     cylinder=Cylinder(diameter="20 mm", length="20 mm"),
    ...     position=["60 mm", "0 mm", "0 mm"],
    ...     remanence="1.3 T",
    ... )
    >>> magnet.axis
    (0.0, 0.0, 1.0)
    """

    cuboid: Cuboid | None = Field(
        default=None,
        description="Its shape: a block.",
        examples=[{"size": ["20 mm", "20 mm", "10 mm"]}],
    )
    cylinder: Cylinder | None = Field(
        default=None,
        description="Its shape: a cylinder.",
        examples=[{"diameter": "20 mm", "length": "20 mm"}],
    )
    position: Point = Field(
        description="Its center: [x, y, z].", examples=[["60 mm", "0 mm", "0 mm"]]
    )
    axis: Axis = Field(
        default=(0.0, 0.0, 1.0),
        description=(
            "Where its axis points (a block's third edge): [x, y, z] or angles; [0, 0, 1] unless"
            " given."
        ),
        examples=[[0, 0, 1]],
    )
    remanence: Annotated[float, Quantity("flux density", above="0 mT", at_most="3 T")] = Field(
        description="Remanent flux density Br; 1.2 to 1.45 T for neodymium.", examples=["1.3 T"]
    )
    magnetization: Axis | None = Field(
        default=None,
        description="Direction of its magnetization in space; along its axis unless given.",
        examples=[[1, 0, 0]],
    )

    one_of = ("cuboid", "cylinder")
    written = "cylinder: {diameter: 20 mm, length: 20 mm}"


class Coil(Settings):
    """A thin round coil.

    Parameters
    ----------
    position : sequence (3,) of float or str, m
        Its center: [x, y, z].
    axis : Angles, dict or sequence (3,), no unit, optional
        Its axis; a positive current makes a field along it. [0, 0, 1] unless given.
    diameter : float or str, m
        Mean diameter of the winding.
    current : float or str, A
        Current in each turn.
    turns : int, optional
        Number of turns; 1 unless given.

    Examples
    --------
    >>> from magmpm import Coil
    >>> coil = Coil(
    ...     position=["0 mm", "0 mm", "-60 mm"], diameter="80 mm", current="5 A", turns=200
    ... )
    >>> coil.current  # A
    5.0
    """

    position: Point = Field(
        description="Its center: [x, y, z].", examples=[["0 mm", "0 mm", "-60 mm"]]
    )
    axis: Axis = Field(
        default=(0.0, 0.0, 1.0),
        description="Its axis; a positive current makes a field along it. [0, 0, 1] unless given.",
        examples=[[0, 0, 1]],
    )
    diameter: Length = Field(description="Mean diameter of the winding.", examples=["80 mm"])
    current: Annotated[float, Quantity("current", at_least="-1e6 A", at_most="1e6 A")] = Field(
        description="Current in each turn.", examples=["5 A"]
    )
    turns: int = Field(
        default=1,
        strict=True,
        ge=1,
        le=1_000_000,
        description="Number of turns; 1 unless given.",
        examples=[200],
    )


class Tabulation(Settings):
    """Table of the field of magnets and coils, from which the solver takes field and gradients."""

    tolerance: float = Field(
        default=2e-3,
        strict=True,
        ge=1e-6,
        le=0.1,
        allow_inf_nan=False,
        description=(
            "Largest error of the table, of the field's size at that place; 0.002 unless given."
        ),
        examples=[0.002],
    )
    lower: Point | None = Field(
        default=None,
        description=(
            "Lower corner of the box it covers, [x, y, z]; what the body may reach unless given."
        ),
        examples=[["-50 mm", "-50 mm", "-50 mm"]],
    )
    upper: Point | None = Field(
        default=None,
        description="Upper corner of that box.",
        examples=[["50 mm", "50 mm", "50 mm"]],
    )

    @model_validator(mode="after")
    def _a_box(self) -> Tabulation:
        if (self.lower is None) != (self.upper is None):
            raise fault("a box has both corners, lower and upper", "give both, or neither")
        if (
            self.lower is not None
            and self.upper is not None
            and not np.all(np.less(self.lower, self.upper))
        ):
            raise fault("each coordinate of `upper` must exceed that of `lower`", "swap them")
        return self


class UniformField(Settings):
    """The same flux density everywhere, for fields made in Python: `UniformField(uniform=["0 mT", "6 mT", "8 mT"])`.

    Parameters
    ----------
    uniform : sequence (3,) of float or str, T
        Flux density: [x, y, z].

    Examples
    --------
    >>> from magmpm import UniformField
    >>> UniformField(uniform=["0 mT", "6 mT", 0.008]).uniform  # T
    (0.0, 0.006, 0.008)
    """

    uniform: FluxVector = Field(
        description="Flux density: [x, y, z].", examples=[["0 mT", "6 mT", "8 mT"]]
    )


class FieldSource(Settings):
    """The external magnetic field: the sum of its sources, and how it changes in time.

    Parameters
    ----------
    uniform : sequence (3,) of float or str, T, optional
        Flux density, the same everywhere: [x, y, z].
    dipole : Dipole or sequence of Dipole, optional
        A point dipole, or a list of them.
    magnet : Magnet or sequence of Magnet, optional
        A permanent magnet of finite size, or a list of them (needs magpylib).
    coils : Coil or sequence of Coil, optional
        A round coil, or a list of them (needs magpylib).
    map : dict, optional
        A measured field on a regular grid.
    tabulation : dict, optional
        Accuracy and extent of the field tables of magnets and coils; chosen unless
        given.
    over_time : dict, optional
        How the field changes in time; it does not unless given.

    Examples
    --------
    >>> from magmpm import FieldSource
    >>> turning = {"rotation": {"axis": [0, 1, 0], "frequency": "2 Hz"}}
    >>> FieldSource(uniform=["5 mT", 0, 0], over_time=turning).over_time.rotation.frequency  # Hz
    2.0
    """

    uniform: FluxVector = Field(
        default=(0.0, 0.0, 0.0),
        description="Flux density, the same everywhere: [x, y, z].",
        examples=[["0 mT", "6 mT", "8 mT"]],
    )
    dipole: Annotated[tuple[Dipole, ...] | None, _OneOrMore()] = Field(
        default=None,
        min_length=1,
        max_length=MAX_SOURCES,
        description="A point dipole, or a list of them.",
        examples=[
            {"position": ["60 mm", "0 mm", "0 mm"], "moment": ["0 A*m^2", "0 A*m^2", "0.5 A*m^2"]}
        ],
    )
    magnet: Annotated[tuple[Magnet, ...] | None, _OneOrMore()] = Field(
        default=None,
        min_length=1,
        max_length=MAX_SOURCES,
        description="A permanent magnet of finite size, or a list of them (needs magpylib).",
        examples=[
            {
                "cylinder": {"diameter": "20 mm", "length": "20 mm"},
                "position": ["60 mm", "0 mm", "0 mm"],
                "remanence": "1.3 T",
            }
        ],
    )
    coils: Annotated[tuple[Coil, ...] | None, _OneOrMore()] = Field(
        default=None,
        min_length=1,
        max_length=MAX_SOURCES,
        description="A round coil, or a list of them (needs magpylib).",
        examples=[
            {
                "position": ["0 mm", "0 mm", "-60 mm"],
                "diameter": "80 mm",
                "current": "5 A",
                "turns": 200,
            }
        ],
    )
    map: Map | None = Field(
        default=None,
        description="A measured field on a regular grid.",
        examples=[{"table": "../measured/magnet.csv"}],
    )
    tabulation: Tabulation | None = Field(
        default=None,
        description=(
            "Accuracy and extent of the field tables of magnets and coils; chosen unless given."
        ),
        examples=[{"tolerance": 0.002}],
    )
    over_time: OverTime | None = Field(
        default=None,
        description="How the field changes in time; it does not unless given.",
        examples=[{"ramp": {"duration": "50 ms"}}],
    )

    @model_validator(mode="before")
    @classmethod
    def _of_sources(cls, data: Any) -> Any:
        """A source made in Python, or a list of them, stands for the field that they make."""
        sources = [data] if isinstance(data, Settings) else data
        keys: dict[type, str] = {Dipole: "dipole", Magnet: "magnet", Coil: "coils"}
        if isinstance(sources, Mapping) or not isinstance(sources, Sequence):
            return data
        made: Plain = {}
        for one in sources:
            if isinstance(one, UniformField):
                made["uniform"] = np.add(made.get("uniform", np.zeros(3)), one.uniform).tolist()
            elif type(one) in keys:
                made.setdefault(keys[type(one)], []).append(one)
            else:
                return data
        return made

    def text(self) -> str:
        """The field in a few words: "(0, 6, 8) mT + magnet of 1.3 T at (60, 0, 0) mm, changing in time"; "none" without any."""
        parts = []
        if any(self.uniform) or (not self.varies and self.acts):
            parts.append(f"({', '.join(f'{1e3 * part:.4g}' for part in self.uniform)}) mT")
        each = {
            "dipole": [
                f"of {np.linalg.norm(one.moment):.4g} A m^2 at {in_mm(one.position)}"
                for one in self.dipole or ()
            ],
            "magnet": [
                f"of {one.remanence:.4g} T at {in_mm(one.position)}" for one in self.magnet or ()
            ],
            "coil": [
                f"of {one.turns} x {one.current:.4g} A at {in_mm(one.position)}"
                for one in self.coils or ()
            ],
        }
        for name, found in each.items():
            if found:
                parts.append(f"{name} {found[0]}" if len(found) == 1 else count(len(found), name))
        if self.map is not None:
            parts.append("measured map")
        changing = ", changing in time" if self.over_time is not None else ""
        return f"{' + '.join(parts)}{changing}" if parts else "none"

    @property
    def varies(self) -> bool:
        """True if the field varies in space."""
        return any((self.dipole, self.magnet, self.coils, self.map))

    @property
    def acts(self) -> bool:
        """True if there is any field."""
        frames = self.over_time.frames if self.over_time is not None else ()
        return self.varies or any(self.uniform) or any(any(frame.uniform or ()) for frame in frames)
