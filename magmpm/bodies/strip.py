"""A strip or sheet: a straight body with a rectangular section, whose magnetization may vary along it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from magmpm.bodies.body_shape import Discretization, Region
from magmpm.bodies.contact_solid import Solids, box_solid
from magmpm.bodies.contact_surface import SurfacePoints, box_surface
from magmpm.bodies.grid import EVEN, ClampPlane, Grid, Knots
from magmpm.bodies.section_quadrature import Particles, strip_errors, strip_grid, strip_particles
from magmpm.bodies.segments import (
    MAX_SEGMENTS,
    MAX_SLENDERNESS,
    Section,
    Segment,
    StraightBody,
    rectangle,
)
from magmpm.bodies.wetted_surface import WettedSurface, wetted_strip
from magmpm.compiled.arrays import Array
from magmpm.inputs.settings import Angle, Key, Length, Quantity, Settings, Width, fault
from magmpm.inputs.vectors import Vector, three

REGIONS_A_PERIOD = (
    8  # regions by which a turn is shown and measured, and the fewest cells that resolve it
)


class Harmonic(Settings):
    """A direction of magnetization that turns steadily along the length."""

    wavelength: Length | None = Field(
        default=None,
        description="Length of one full turn; give this or `periods`.",
        examples=["3.7 mm"],
    )
    periods: float | None = Field(
        default=None,
        strict=True,
        gt=0,
        le=100,
        allow_inf_nan=False,
        description="Full turns along the length; give this or `wavelength`.",
        examples=[1],
    )
    phase: Angle = Field(
        default=0.0,
        description=(
            "Angle at the base, from the plane's first axis toward its second; 0 deg unless given."
        ),
        examples=["45 deg"],
    )
    plane: Literal["xz", "xy", "yz"] = Field(
        default="xz",
        description="Plane in which the direction turns; xz unless given.",
        examples=["xz"],
    )
    turn: Literal["ccw", "cw"] = Field(
        default="ccw",
        description=(
            "Along +x the angle grows (ccw: from the plane's first axis toward its second, unless"
            " given) or shrinks (cw)."
        ),
        examples=["cw"],
    )

    one_of = ("wavelength", "periods")
    written = "harmonic: {periods: 1, phase: 45 deg}"

    def turns(self, length: float) -> float:
        """Full turns along a length (m)."""
        return self.periods if self.periods is not None else length / (self.wavelength or length)


class Profile(Settings):
    """A magnetization that varies along the length."""

    harmonic: Harmonic = Field(
        description="A direction that turns steadily along the length.",
        examples=[{"periods": 1, "phase": "45 deg"}],
    )

    def direction(self, share: float, length: float) -> Vector:
        """Unit vector at a share 0 to 1 of the length (m)."""
        h = self.harmonic
        angle = h.phase + (1.0 if h.turn == "ccw" else -1.0) * 2 * math.pi * h.turns(length) * share
        out = [0.0, 0.0, 0.0]
        out["xyz".index(h.plane[0])], out["xyz".index(h.plane[1])] = (
            math.cos(angle),
            math.sin(angle),
        )
        return (out[0], out[1], out[2])


_Coordinate = Annotated[float, Quantity("length", at_least="-10 m", at_most="10 m")]


class Strip(StraightBody):
    """A straight strip or sheet: length along x, width along y, thickness along z.

    Parameters
    ----------
    length : float or str, m
        Length along x.
    width : float or str, m
        Width along y.
    thickness : float or str, m
        Thickness along z; `cells_across` counts the cells through it.
    material : str
        A name from `materials`; segments may name others.
    clamp : {'base', 'both', 'none'}, optional
        The faces that are held: base (at the lower x), both ends, or none (a free body).
    position : sequence (3,) of float or str, m, optional
        Center of the base face: [x, y, z]; the origin unless given.
    plane_strain : bool, optional
        Nothing moves along y and nothing varies along it, as in a very wide sheet; false unless
        given.
    segments : sequence of Segment, optional
        From base to tip; give these or `magnetization_profile`.
    magnetization_profile : dict, optional
        A magnetization that varies along the length; give this or `segments`.

    Examples
    --------
    >>> from magmpm import Segment, Strip
    >>> strip = Strip(
    ...     length="17.2 mm",
    ...     width="5 mm",
    ...     thickness="0.84 mm",
    ...     material="silicone",
    ...     segments=[Segment(magnetization=[1, 0, 0])],
    ... )
    >>> strip.size.tolist()  # m
    [0.0172, 0.005, 0.00084]
    """

    kind: ClassVar[str] = "strip"
    across: ClassVar[str] = "thickness"
    branch_distance: ClassVar[float] = (
        # strips that free their edges are between beam and plate, and just past buckling that is
        # 0.1
        0.3
    )

    length: Length = Field(description="Length along x.", examples=["17.2 mm"])
    width: Length = Field(description="Width along y.", examples=["5 mm"])
    thickness: Width = Field(
        description="Thickness along z; `cells_across` counts the cells through it.",
        examples=["0.84 mm"],
    )
    material: str = Field(
        description="A name from `materials`; segments may name others.", examples=["silicone"]
    )
    clamp: Literal["base", "both", "none"] = Field(
        default="base",
        description=(
            "The faces that are held: base (at the lower x), both ends, or none (a free body)."
        ),
        examples=["base"],
    )
    position: Annotated[
        tuple[_Coordinate, _Coordinate, _Coordinate], three("[0 mm, 0 mm, 1 mm]")
    ] = Field(
        default=(0.0, 0.0, 0.0),
        description="Center of the base face: [x, y, z]; the origin unless given.",
        examples=[["0 mm", "0 mm", "1 mm"]],
    )
    plane_strain: bool = Field(
        default=False,
        strict=True,
        description=(
            "Nothing moves along y and nothing varies along it, as in a very wide sheet; false"
            " unless given."
        ),
        examples=[True],
    )
    segments: tuple[Segment, ...] | None = Field(
        default=None,
        min_length=1,
        max_length=MAX_SEGMENTS,
        description="From base to tip; give these or `magnetization_profile`.",
        examples=[[{"magnetization": [1, 0, 0]}]],
    )
    magnetization_profile: Profile | None = Field(
        default=None,
        description="A magnetization that varies along the length; give this or `segments`.",
        examples=[{"harmonic": {"periods": 1, "phase": "45 deg"}}],
    )

    @field_validator("thickness")
    @classmethod
    def _thin(cls, thickness: float, info: ValidationInfo) -> float:
        width = info.data.get("width")
        cls._check_slender(info.data.get("length"), thickness)
        if width is not None and not 0.5 * thickness <= width <= MAX_SLENDERNESS * thickness:
            raise fault(
                f"the width must be 0.5 to {MAX_SLENDERNESS:g} times the thickness",
                f"check the units of both: width {1e3 * width:g} mm, thickness"
                f" {1e3 * thickness:g} mm",
            )
        return thickness

    one_of = ("segments", "magnetization_profile")
    written = "segments: [{magnetization: [1, 0, 0]}]"

    @property
    def base(self) -> Vector:
        """Center of its base face, m."""
        return self.position

    @property
    def in_plane_strain(self) -> bool:
        return self.plane_strain

    @property
    def magnetized_by_region(self) -> bool:
        return self.magnetization_profile is None

    @property
    def bends_as_plate(self) -> bool:
        """True if the strip keeps its width as it bends: in plane strain, and nearly so where it is much wider than thick."""
        return self.plane_strain or self.width > 3.0 * self.thickness

    @property
    def size(self) -> Array:
        """Length, width and thickness, (3,) m."""
        return np.array([self.length, self.width, self.thickness])

    def segment_lengths(self) -> list[float]:
        """Length of each region in m, base to tip; they sum to `length`."""
        if self.segments is not None:
            return super().segment_lengths()
        count = len(self.regions())
        return [self.length / count] * count

    def box(self) -> tuple[Vector, Vector]:
        (x, y, z), w, t = self.position, self.width / 2, self.thickness / 2
        return (x, y - w, z - t), (x + self.length, y + w, z + t)

    def regions(self) -> tuple[Region, ...]:
        """Its segments, or equal lengths of its profile, base to tip."""
        profile = self.magnetization_profile
        if profile is None:
            return super().regions()
        count = max(1, math.ceil(REGIONS_A_PERIOD * profile.harmonic.turns(self.length) - 1e-9))
        at: Key = ("strip", "magnetization_profile")
        return tuple(
            Region(
                f"piece {i + 1}",
                at,
                self.material,
                profile.direction((i + 0.5) / count, self.length),
                self.thickness,
            )
            for i in range(count)
        )

    def grid(self, cells_across: int, knots: Knots = EVEN) -> Grid:
        """The grid in the undeformed body: knots on all its faces and joints."""
        ends = self.segment_ends()
        return strip_grid(
            np.array(self.position),
            self.size,
            ends,
            cells_across,
            one_wide=self.plane_strain,
            knots=knots,
        )

    def discretize(
        self, cells_across: int, particles_per_cell: int, knots: Knots = EVEN
    ) -> Discretization:
        """Its grid and particles. The regions of a profile are there to be shown: they cut no cells."""
        ends = self.segment_ends()
        grid = self.grid(cells_across, knots)
        particles = strip_particles(
            grid,
            segment_ends=self.position[0]
            + (ends if self.segments is not None else np.array([self.length])),
            particles_per_cell=particles_per_cell,
            one_wide=self.plane_strain,
        )
        if self.segments is None:
            middle = grid.along.at(np.array(0.5), particles.cell[:, 0])
            particles = replace(particles, segment=np.searchsorted(ends, middle).astype(np.int32))
        planes = (ClampPlane(0, False, grid.cells[0] - 1),) if self.clamp == "both" else ()
        return Discretization(grid, particles, strip_errors(particles, self.size), planes)

    def fewest_particles(
        self, cells_across: int, particles_per_cell: int, *, around: bool = False
    ) -> float:
        """The number of its particles, but for cells that two segments share, which have more."""
        return float(np.prod(self.grid(cells_across).cells)) * particles_per_cell ** (
            2 if self.plane_strain else 3
        )

    def magnetization(self, particles: Particles) -> Array:
        profile = self.magnetization_profile
        if profile is None:
            return super().magnetization(particles)
        x, of = np.unique(particles.position[:, 0], return_inverse=True)
        share = (x - self.position[0]) / self.length
        return np.array([profile.direction(s, self.length) for s in share.tolist()])[of]

    def surface(self, grid: Grid, *, base: bool) -> SurfacePoints:
        across = [grid.origin[k] + grid.spacing[k] * np.arange(grid.cells[k] + 1) for k in (1, 2)]
        return box_surface(
            (grid.origin[0] + grid.faces, across[0], across[1]),
            one_wide=self.plane_strain,
            base=base,
        )

    def wetted(self, grid: Grid, *, base: bool) -> WettedSurface:
        return wetted_strip(
            grid.origin[0] + grid.faces,
            grid.origin[1] + grid.spacing[1] * np.arange(grid.cells[1] + 1),
            self.position[2],
            self.thickness,
            one_wide=self.plane_strain,
            base=base,
        )

    def solids(self, cell: float, particles: Particles) -> Solids:
        low, high = np.array(self.box())
        if self.plane_strain:
            low[1], high[1] = -np.inf, np.inf
        return box_solid(low.tolist(), high.tolist())

    def section(self, shear: Array, young: Array, poisson: Array) -> Section:
        return rectangle(self.width, self.thickness, shear, young, poisson, self.plane_strain)

    def check_resolution(self, cells_across: int) -> None:
        """A profile that turns within a cell or two would be averaged away."""
        if self.magnetization_profile is None:
            return
        turns = self.magnetization_profile.harmonic.turns(self.length)
        a_turn = max(3, round(self.length / self.thickness * cells_across)) / turns
        if a_turn < REGIONS_A_PERIOD:
            raise fault(
                f"a turn of the magnetization must be at least {REGIONS_A_PERIOD} cells long, and"
                f" is {a_turn:.3g}",
                f"raise cells_across to {int(np.ceil(cells_across * REGIONS_A_PERIOD / a_turn))},"
                " or turn less often",
                ("resolution", "cells_across"),
            )
