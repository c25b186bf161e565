"""A catheter: a straight round rod or tube."""

import math
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from magmpm.bodies.body_shape import Discretization
from magmpm.bodies.contact_solid import Solids, rod_solid
from magmpm.bodies.contact_surface import SurfacePoints, rod_surface
from magmpm.bodies.grid import EVEN, Grid, Knots
from magmpm.bodies.polar_grid import PolarGrid, tube_grid, tube_particles
from magmpm.bodies.section_quadrature import (
    Particles,
    rod_grid,
    rod_particles,
    rod_section,
    section_errors,
)
from magmpm.bodies.segments import MAX_SEGMENTS, Section, Segment, StraightBody, ring
from magmpm.bodies.wetted_surface import WettedSurface, wetted_rod
from magmpm.compiled.arrays import Array, Named, NamedNumbers
from magmpm.inputs.messages import Instead
from magmpm.inputs.quantities import KINDS, BadQuantity, parse_quantity
from magmpm.inputs.settings import Length, Quantity, Width, fault
from magmpm.inputs.vectors import Vector

THIN_WALL = "resolution: the tube's wall"  # how the warning of a wall of less than a cell begins


class Catheter(StraightBody):
    """A straight rod, base at the origin, axis +x.

    Parameters
    ----------
    length : float or str, m
        Length of the undeformed catheter.
    diameter : float or str, m
        Outer diameter.
    inner_diameter : float or str, m, optional
        Diameter of the bore; 0 mm, a solid rod, unless given.
    material : str
        A name from `materials`; segments may name others.
    clamp : {'base', 'none'}, optional
        The face that is held: base, or none (a free body).
    segments : sequence of Segment
        From base to tip.

    Examples
    --------
    >>> from magmpm import Catheter, Segment
    >>> rod = Catheter(
    ...     length="40 mm",
    ...     diameter="4 mm",
    ...     material="silicone",
    ...     segments=[Segment(magnetization=[1, 0, 0]), Segment(magnetization=[0, 0, 1])],
    ... )
    >>> rod.segment_lengths()  # m
    [0.02, 0.02]
    """

    kind: ClassVar[str] = "catheter"
    across: ClassVar[str] = "diameter"

    length: Length = Field(description="Length of the undeformed catheter.", examples=["40 mm"])
    diameter: Width = Field(description="Outer diameter.", examples=["4 mm"])
    inner_diameter: Annotated[float, Quantity("length", at_least="0 mm", at_most="1 m")] = Field(
        default=0.0,
        description="Diameter of the bore; 0 mm, a solid rod, unless given.",
        examples=["2 mm"],
    )
    material: str = Field(
        description="A name from `materials`; segments may name others.", examples=["silicone"]
    )
    clamp: Literal["base", "none"] = Field(
        default="base",
        description="The face that is held: base, or none (a free body).",
        examples=["base"],
    )
    segments: tuple[Segment, ...] = Field(
        min_length=1,
        max_length=MAX_SEGMENTS,
        description="From base to tip.",
        examples=[[{"magnetization": [1, 0, 0]}]],
    )

    @field_validator("diameter")
    @classmethod
    def _slender(cls, diameter: float, info: ValidationInfo) -> float:
        cls._check_slender(info.data.get("length"), diameter)
        return diameter

    @field_validator("inner_diameter")
    @classmethod
    def _hollow(cls, inner: float, info: ValidationInfo) -> float:
        # of the diameter: a hundredth of a cell at 16 cells across; `warnings` reports walls thinner than a
        # cell
        thinnest_wall = 1e-3
        outer = info.data.get("diameter")
        if outer is not None and not inner < outer:
            raise fault(
                "the inner diameter must be less than the diameter",
                f"give less than {1e3 * outer:g} mm, or remove it",
            )
        if outer is not None and not (outer - inner) / 2 >= thinnest_wall * outer * (1 - 1e-9):
            raise fault(
                f"a tube's wall must be at least {thinnest_wall:g} times its diameter thick,"
                f" {1e3 * thinnest_wall * outer:.3g} mm here",
                f"give at most {1e3 * (1 - 2 * thinnest_wall) * outer:g} mm",
            )
        return inner

    @staticmethod
    def by_other_keys(key: str, values: Named) -> Instead | None:
        """Return what to write for a key that people write and that is said by another one here, with its number: a tube's wall."""
        if key not in ("wall", "wall_thickness"):
            return None
        try:
            wall, outer = (
                parse_quantity(str(values.get(name)), KINDS["length"]) for name in (key, "diameter")
            )
        except BadQuantity:
            wall = outer = 0.0
        if not 0.0 < 2 * wall < outer:
            return Instead("write inner_diameter in its place: the diameter less twice the wall")
        return Instead(
            f"write `inner_diameter: {1e3 * (outer - 2 * wall):g} mm` in its place: the diameter"
            " less twice the wall"
        )

    @property
    def thickness(self) -> float:
        """Its diameter, m."""
        return self.diameter

    @property
    def hollow(self) -> bool:
        """True if the catheter has a bore."""
        return self.inner_diameter > 0.0

    @property
    def round_cells(self) -> bool:
        """True if the cells at rest lie around the axis, in layers that fit the wall: from 0.1 of the radius on, the thinnest wall held
        against finite elements; at 0.05 and 0.02 no equilibrium was found."""
        return self.hollow and self.diameter - self.inner_diameter >= (0.1 - 1e-9) * self.diameter

    def kink_radius(self, poisson: float) -> float:
        """Radius (m) of its axis below which a tube has no equilibrium: its section flattens, and it kinks. 0 for a solid rod.

        The bending moment of a long thin tube is largest at the curvature (sqrt(2)/3) t/(r^2 sqrt(1 - nu^2)); t: wall, r: middle radius.
        Source: Brazier, Proc. R. Soc. A 116 (1927) 104-114; Calladine, Theory of Shell Structures, section 16.2.
        """
        wall = (self.diameter - self.inner_diameter) / 2
        middle = (self.diameter + self.inner_diameter) / 4
        return (
            3 / math.sqrt(2) * middle**2 * math.sqrt(1 - poisson**2) / wall if self.hollow else 0.0
        )

    @property
    def held_round(self) -> float:
        """Length (m) from the clamp within which it keeps a tube's section round: r sqrt(r/t), in which flattening dies away."""
        wall = (self.diameter - self.inner_diameter) / 2
        middle = (self.diameter + self.inner_diameter) / 4
        return middle * math.sqrt(middle / wall)

    @property
    def radii(self) -> NamedNumbers:
        """Outer and inner radius, m."""
        return {"outer": self.diameter / 2, "inner": self.inner_diameter / 2}

    def box(self) -> tuple[Vector, Vector]:
        return (0.0, -self.diameter / 2, -self.diameter / 2), (
            self.length,
            self.diameter / 2,
            self.diameter / 2,
        )

    def grid(
        self, cells_across: int, knots: Knots = EVEN, shift: tuple[float, float] = (0.0, 0.0)
    ) -> Grid:
        """The grid in the undeformed body, lower along y and z by `shift` of a cell; cells around the axis are turned by its first part."""
        if knots.at_rest and self.round_cells:
            return tube_grid(
                self.segment_ends(),
                **self.radii,
                cells_across=cells_across,
                knots=knots,
                turn=shift[0],
            )
        return rod_grid(self.segment_ends(), self.diameter, cells_across, shift, knots)

    def discretize(
        self,
        cells_across: int,
        particles_per_cell: int,
        knots: Knots = EVEN,
        shift: tuple[float, float] = (0.0, 0.0),
    ) -> Discretization:
        """Its grid, moved by `shift` of a cell, and particles."""
        grid = self.grid(cells_across, knots, shift)
        ends = self.segment_ends()
        if isinstance(grid, PolarGrid):
            particles = tube_particles(
                grid,
                outer=self.diameter / 2,
                segment_ends=ends,
                cells_across=cells_across,
                particles_per_cell=particles_per_cell,
            )
        else:
            particles = rod_particles(
                grid, **self.radii, segment_ends=ends, particles_per_cell=particles_per_cell
            )
        return Discretization(
            grid, particles, section_errors(particles, **self.radii, length=self.length)
        )

    def fewest_particles(
        self, cells_across: int, particles_per_cell: int, *, around: bool = False
    ) -> float:
        """The number of its particles, but for cells that two segments share, which have more."""
        grid = self.grid(cells_across, Knots(at_rest=around))
        if isinstance(grid, PolarGrid):
            return float(np.prod(grid.cells)) * particles_per_cell**3
        section = rod_section(grid, **self.radii, particles_per_cell=particles_per_cell)[1][0]
        return float(len(section) * grid.cells[0] * particles_per_cell)

    def surface(self, grid: Grid, *, base: bool) -> SurfacePoints:
        width = grid.spacing[1] * (self.diameter / 2 if isinstance(grid, PolarGrid) else 1.0)
        return rod_surface(grid.origin[0] + grid.faces, **self.radii, cell=float(width), base=base)

    def wetted(self, grid: Grid, *, base: bool) -> WettedSurface:
        return wetted_rod(grid.origin[0] + grid.faces, **self.radii, base=base)

    def solids(self, cell: float, particles: Particles) -> Solids:
        (start, _, _), (end, _, _) = self.box()
        return rod_solid(start, end, self.diameter / 2)

    def section(self, shear: Array, young: Array, poisson: Array) -> Section:
        return ring(**self.radii, G=shear, E=young, nu=poisson)

    def warnings(self, cells_across: int, *, one_grid: bool) -> list[str]:
        """Warn of a wall that is thinner than a cell."""
        wall = (self.diameter - self.inner_diameter) / 2 * cells_across / self.diameter
        if wall >= 1:
            return []
        return [
            f"{THIN_WALL} is only {wall:.2f} cells thick; use cells_across: "
            f"{int(np.ceil(cells_across / wall - 1e-9))} or more, or request an error: "
            "`resolution: {error: 1 %}`"
        ]


class Tube(Catheter):
    """A catheter with a bore: the same settings, of which `inner_diameter` must be given. In files it is a catheter.

    Parameters
    ----------
    length : float or str, m
        Length of the undeformed catheter.
    diameter : float or str, m
        Outer diameter.
    inner_diameter : float or str, m
        Diameter of the bore.
    material : str
        A name from `materials`; segments may name others.
    clamp : {'base', 'none'}, optional
        The face that is held: base, or none (a free body).
    segments : sequence of Segment
        From base to tip.

    Examples
    --------
    >>> from magmpm import Segment, Tube
    >>> tube = Tube(
    ...     length="40 mm",
    ...     diameter="4 mm",
    ...     inner_diameter="2 mm",
    ...     material="silicone",
    ...     segments=[Segment(magnetization=[1, 0, 0])],
    ... )
    >>> tube.hollow
    True
    """

    inner_diameter: Annotated[float, Quantity("length", above="0 mm", at_most="1 m")] = Field(
        description="Diameter of the bore.", examples=["2 mm"]
    )
