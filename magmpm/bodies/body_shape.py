"""The interface of every kind of body: all that scenes, models, effects and solvers know about one.

A new kind of body is one file with a class like those in catheter.py, strip.py and assembly.py, and one key of `Body` (body.py).
"""

from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from magmpm.bodies.contact_solid import Solids
from magmpm.bodies.contact_surface import SurfacePoints
from magmpm.bodies.grid import EVEN, ClampPlane, Grid, Knots
from magmpm.bodies.section_quadrature import Particles
from magmpm.bodies.wetted_surface import WettedSurface
from magmpm.compiled.arrays import Array, Index, NamedNumbers
from magmpm.inputs.settings import Key, Settings
from magmpm.inputs.vectors import Vector


@dataclass(frozen=True)
class Region:
    """A stretch of a body with one material and magnetization: a segment of a catheter or strip, a part of an assembly.

    magnetization: unit vector in the undeformed body, or zeros; thickness: m, 0 of one that is held; held: it can't move.
    """

    name: str
    at: Key  # where the scene's data describe it, below `body`
    material_name: str
    magnetization: Vector
    thickness: float
    held: bool = False


@dataclass(frozen=True)
class Line:
    """A straight body along +x: base (3,) m, the center of its base face; length m."""

    base: Vector
    length: float


@dataclass(frozen=True)
class Discretization:
    """A body as a grid and particles.

    errors: relative errors of the particles' volumes or areas, and moments; planes: faces of the grid that hold the body, not x's lower.
    """

    grid: Grid
    particles: Particles
    errors: NamedNumbers
    planes: tuple[ClampPlane, ...] = ()


class BodyShape(Settings):
    """The settings of one kind of body, and what follows from them. Lengths in m.

    `cells_across` and `particles_per_cell` are those of the scene's `resolution`. Methods without a docstring in a kind have these.
    """

    clamp_key: ClassVar[str] = "clamp"  # its key that holds it somewhere

    if TYPE_CHECKING:  # settings or properties of each kind

        @property
        def length(self) -> float:
            """Length of the undeformed body, m: what errors and distances are measured by."""

        @property
        def thickness(self) -> float:
            """Size through which `cells_across` counts cells, m."""

        @property
        def clamp(self) -> str:
            """The held end: base, both, parts or none."""

    @property
    def line(self) -> Line | None:
        """The undeformed axis of a straight body."""
        return None

    @property
    def in_plane_strain(self) -> bool:
        """True if nothing moves along y and nothing varies along it."""
        return False

    @property
    def magnetized_by_region(self) -> bool:
        """True if each region has a direction of magnetization of its own, which may be changed."""
        return True

    @abstractmethod
    def regions(self) -> tuple[Region, ...]:
        """Pieces of one material each: segments from base to tip, or parts."""

    @abstractmethod
    def box(self) -> tuple[Vector, Vector]:
        """Lower and upper corner of the box around it, m."""

    @abstractmethod
    def grid(self, cells_across: int, knots: Knots = EVEN) -> Grid:
        """The grid in the undeformed body; knots: of straight bodies. Raises SceneError where it would have too many cells."""

    @abstractmethod
    def discretize(
        self, cells_across: int, particles_per_cell: int, knots: Knots = EVEN
    ) -> Discretization:
        """Its grid and particles. Raises SceneError where the grid would have too many cells."""

    @abstractmethod
    def fewest_particles(
        self, cells_across: int, particles_per_cell: int, *, around: bool = False
    ) -> float:
        """Lower bound of the number of particles, found without making them; around: as `Knots.at_rest`."""

    def cell_size(self, cells_across: int) -> float:
        """Width of the grid's cells as requested, m; the grid's own fit the body and may be a little smaller."""
        return self.thickness / cells_across

    def magnetization(self, particles: Particles) -> Array:
        """Direction of magnetization at each particle in the undeformed body, unit vectors or zeros (n, 3)."""
        return np.array([region.magnetization for region in self.regions()])[particles.segment]

    @abstractmethod
    def surface(self, grid: Grid, *, base: bool) -> SurfacePoints:
        """Points on its surface, for its cells (bodies.contact_surface); base: whether the lower x face of a straight body counts, too."""

    @abstractmethod
    def wetted(self, grid: Grid, *, base: bool) -> WettedSurface:
        """Pieces of it that a fluid meets; base: as of `surface`."""

    def held_surface(self, grid: Grid) -> SurfacePoints:
        """Points on faces of what can move that lie on held parts; a body that is not made of parts has none."""
        return SurfacePoints(np.zeros((0, 3)), np.zeros(0), np.zeros(0, np.int64))

    @abstractmethod
    def solids(self, cell: float, particles: Particles) -> Solids:
        """The solids of its components, in the order of `components`; cell: width of the grid's cells, m."""

    def part_of(self, particles: Particles) -> NDArray[np.integer]:
        """Part of the body that each particle (n,) is in; a body that is not made of parts is one."""
        return np.zeros(len(particles.volume), np.int64)

    def hollow_parts(self) -> list[str]:
        """Names of parts with a closed cavity in which there is nothing."""
        return []

    def part_names(self) -> tuple[str, ...]:
        """Names of its parts, each another; none of a body that is not made of parts."""
        return ()

    def tip_weights(self, grid: Grid, particles: Particles) -> Array | None:
        """Weights (n,) that give the named tip's position from the particles'; None where no tip is named."""
        return None

    def components(self, particles: Particles) -> Index:
        """Connected component that each particle (n,) is in, from 0: components can move away from each other."""
        return np.zeros(len(particles.volume), np.int64)

    def check_resolution(self, cells_across: int) -> None:
        """Raises PydanticCustomError (see `fault`), for the scene, where so few cells can't resolve the body."""

    def warnings(self, cells_across: int, *, one_grid: bool) -> list[str]:
        """Settings that the author may not have meant, a sentence each. one_grid: whether all parts move on the same grid."""
        return []

    def cell_setting(self, cells_across: int) -> tuple[str, str, str]:
        """The key that decides the size of its cells, its value, and what makes them larger, in words."""
        return "resolution.cells_across", str(cells_across), "fewer cells_across"
