"""Bodies that are straight along x and made of segments, base to tip: what a catheter and a strip have in common.

Their cross-sections are given as a rod feels them; axis 1 runs along the body, 2 and 3 (y, z undeformed) lie in the section.
"""

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from magmpm.bodies.body_shape import BodyShape, Line, Region
from magmpm.compiled.arrays import Array
from magmpm.inputs.settings import Length, Settings, fault
from magmpm.inputs.vectors import Direction, Vector


@dataclass(frozen=True)
class Section:
    """A cross-section as a rod feels it, for k materials.

    Attributes
    ----------
    area : float, m^2
        Of the section.
    twist_bend : array (k, 3), N m^2
        Stiffness against torsion, and bending about axes 2 and 3.
    compliance : array (k, 3), 1/N
        Against stretch and the two shears.
    """

    area: float
    twist_bend: Array
    compliance: Array


def ring(outer: float, inner: float, G: Array, E: Array, nu: Array) -> Section:
    """Make the section of a round tube.

    Parameters
    ----------
    outer : float, m
        Outer radius.
    inner : float, m
        Inner radius; 0 of a solid rod.
    G : array (k,), Pa
        Shear moduli.
    E : array (k,), Pa
        Young's moduli.
    nu : array (k,), no unit
        Poisson's ratios.

    Returns
    -------
    Section
        The section.

    References
    ----------
    Shear: Cowper, J. Appl. Mech. 33 (1966) 335-340.
    """
    r1 = outer
    r0 = inner
    m = inner / outer
    area = np.pi * (r1**2 - r0**2)
    inertia = np.pi / 4 * (r1**4 - r0**4)
    shear = (
        6 * (1 + nu) * (1 + m**2) ** 2 / ((7 + 6 * nu) * (1 + m**2) ** 2 + (20 + 12 * nu) * m**2)
    )
    twist_bend = np.stack([2 * G * inertia, E * inertia, E * inertia], axis=1)
    return Section(float(area), twist_bend, _compliance(area, E, shear * G))


def _compliance(area: float, E: Array, G: Array) -> Array:
    """Strains (k, 3) per N: along the axis and, with the moduli G that shear feels, across it."""
    return np.stack([1 / (E * area), 1 / (G * area), 1 / (G * area)], axis=1)


def rectangle(
    width: float, thickness: float, G: Array, E: Array, nu: Array, plane_strain: bool
) -> Section:
    """Make the section of a strip. In plane strain E/(1 - nu^2) takes E's place, and twist and bending in the plane of the sheet are next
    to impossible.

    Parameters
    ----------
    width : float, m
        Along axis 2.
    thickness : float, m
        Along axis 3.
    G : array (k,), Pa
        Shear moduli.
    E : array (k,), Pa
        Young's moduli.
    nu : array (k,), no unit
        Poisson's ratios.
    plane_strain : bool
        Whether nothing varies along axis 2.

    Returns
    -------
    Section
        The section.

    References
    ----------
    Torsion: Timoshenko and Goodier, Theory of Elasticity, section 109; shear: Cowper, J. Appl.
    Mech. 33 (1966) 335-340.
    """
    area = width * thickness
    shear = 10 * (1 + nu) / (12 + 11 * nu)
    if plane_strain:
        E = E / (1 - nu**2)
        bend = E * area * thickness**2 / 12
        twist_bend = np.stack(
            [1e3 * bend, bend, 1e3 * bend], axis=1
        )  # what can't happen is as stiff as that
    else:
        second_moments = area * thickness**2 / 12, area * width**2 / 12
        twist_bend = np.stack(
            [G * torsion_constant(width, thickness), E * second_moments[0], E * second_moments[1]],
            axis=1,
        )
    return Section(area, twist_bend, _compliance(area, E, shear * G))


def torsion_constant(width: float, thickness: float) -> float:
    """Find the torsion constant J of a rectangle: twist rate = torque / (G J).

    Parameters
    ----------
    width : float, m
        One side.
    thickness : float, m
        The other side.

    Returns
    -------
    float, m^4
        J.
    """
    b = max(width, thickness)
    t = min(width, thickness)
    odd = 2 * np.arange(8) + 1.0
    series = np.sum(np.tanh(odd * np.pi * b / (2 * t)) / odd**5)
    return float(b * t**3 / 3 * (1 - 192 * t / (np.pi**5 * b) * series))


MAX_SEGMENTS = 1000
MAX_SLENDERNESS = 500.0  # length over diameter, or over thickness
SHORTEST_SEGMENT = (
    0.01  # of the diameter or thickness: a segment; 0.02 of a cell at 2 cells across, 0.16 at 16
)


class Segment(Settings):
    """A length of a catheter or strip with one magnetization and one material.

    Parameters
    ----------
    magnetization : Angles, dict or sequence (3,), no unit, optional
        Direction in the undeformed body: [x, y, z], normalized, or {azimuth: ..., elevation:
        ...}; [0, 0, 0], unmagnetized, unless given.
    material : str, optional
        A name from `materials`; the body's unless given.
    length : float or str, m, optional
        Length of this segment; segments without one share the rest of the length equally.

    Examples
    --------
    >>> from magmpm import Segment
    >>> Segment(magnetization={"azimuth": "90 deg", "elevation": "0 deg"}).magnetization
    (0.0, 1.0, 0.0)
    """

    magnetization: Direction = Field(
        default=(0.0, 0.0, 0.0),
        description=(
            "Direction in the undeformed body: [x, y, z], normalized, or {azimuth: ..., elevation:"
            " ...}; [0, 0, 0], unmagnetized, unless given."
        ),
        examples=[[1, 0, 0]],
    )
    material: str | None = Field(
        default=None,
        description="A name from `materials`; the body's unless given.",
        examples=["plain silicone"],
    )
    length: Length | None = Field(
        default=None,
        description=(
            "Length of this segment; segments without one share the rest of the length equally."
        ),
        examples=["8 mm"],
    )


class StraightBody(BodyShape):
    """A body along +x with one cross-section, which a rod describes well."""

    kind: ClassVar[str]  # its key in `body`
    across: ClassVar[str]  # its key for the size that cells are counted through
    # Of the length: equilibria of body and rod differ by 0.2 to 1 % where slender; at a larger distance they may be on two branches.
    branch_distance: ClassVar[float] = 0.1

    if TYPE_CHECKING:  # settings or properties of each kind

        @property
        def material(self) -> str:
            """Material of the segments that name none."""

        @property
        def segments(self) -> tuple[Segment, ...] | None:
            """The segments, base to tip."""

    @field_validator("segments", check_fields=False)
    @classmethod
    def _fill_the_length(
        cls, segments: tuple[Segment, ...] | None, info: ValidationInfo
    ) -> tuple[Segment, ...] | None:
        length = info.data.get("length")
        if length is not None and segments is not None:
            cls._check_lengths(length, info.data.get(cls.across), segments)
        return segments

    @classmethod
    def _check_lengths(
        cls, length: float, thickness: float | None, segments: tuple[Segment, ...]
    ) -> None:
        """Raise `fault` unless segments fill their body's length (m), each at least SHORTEST_SEGMENT of its thickness (m; None: not
        known) long."""
        given = [s.length for s in segments if s.length is not None]
        total = math.fsum(given)
        free = len(segments) - len(given)
        text = f"{1e3 * total:g} mm, the {cls.kind} {1e3 * length:g} mm"
        if free == 0 and not math.isclose(total, length, rel_tol=1e-9):
            raise fault(
                f"segment lengths must sum to the {cls.kind}'s length",
                f"they sum to {text}: change either",
            )
        if free and total >= length * (1 - 1e-9):
            raise fault(
                f"segment lengths must leave some of the {cls.kind}'s length to the segments"
                " without one",
                f"those given sum to {text}: shorten them",
            )
        lengths = segment_lengths(length, segments)
        shortest = min(range(len(lengths)), key=lengths.__getitem__)
        if thickness is not None and lengths[shortest] < SHORTEST_SEGMENT * thickness * (1 - 1e-9):
            raise fault(
                f"a segment must be at least {SHORTEST_SEGMENT:g} times the {cls.kind}'s"
                f" {cls.across} long,"
                f" {1e3 * SHORTEST_SEGMENT * thickness:.3g} mm here, and segment {shortest + 1} is"
                f" {1e3 * lengths[shortest]:.3g} mm",
                "check its unit, make it longer, or leave it out: the grid resolves nothing finer",
                (shortest, "length") if segments[shortest].length is not None else (),
            )

    @classmethod
    def _check_slender(cls, length: float | None, thickness: float) -> None:
        """Raises PydanticCustomError (see `fault`); length None: not known."""
        if length is not None and not thickness <= length <= MAX_SLENDERNESS * thickness:
            raise fault(
                f"the length must be 1 to {MAX_SLENDERNESS:g} times the {cls.across}",
                f"check the units of both: length {1e3 * length:g} mm, {cls.across}"
                f" {1e3 * thickness:g} mm",
            )

    @property
    def base(self) -> Vector:
        """Center of its base face, m."""
        return (0.0, 0.0, 0.0)

    @property
    def line(self) -> Line:
        """Its undeformed axis."""
        return Line(self.base, self.length)

    @property
    def hollow(self) -> bool:
        """True if the axis lies outside the material."""
        return False

    @property
    def bends_as_plate(self) -> bool:
        """True if the section keeps its width as it bends."""
        return False

    def segment_lengths(self) -> list[float]:
        """Find the length of each region; they sum to `length`.

        Returns
        -------
        list of float, m
            Base to tip.
        """
        return segment_lengths(self.length, self.segments or ())

    def segment_ends(self) -> Array:
        """Find the distance of each region's end from the base; the last one is the length.

        Returns
        -------
        array (k,), m
            Base to tip.
        """
        ends = np.cumsum(self.segment_lengths())
        ends[-1] = self.length
        return ends

    def regions(self) -> tuple[Region, ...]:
        """Its segments, base to tip."""
        return tuple(
            Region(
                f"segment {i + 1}",
                (self.kind, "segments", i),
                s.material or self.material,
                s.magnetization,
                self.thickness,
            )
            for i, s in enumerate(self.segments or ())
        )

    @abstractmethod
    def section(self, shear: Array, young: Array, poisson: Array) -> Section:
        """Make its cross-section as a rod feels it, for k materials.

        Parameters
        ----------
        shear : array (k,), Pa
            Shear moduli.
        young : array (k,), Pa
            Young's moduli.
        poisson : array (k,), no unit
            Poisson's ratios.

        Returns
        -------
        Section
            The section.
        """


def segment_lengths(length: float, segments: tuple[Segment, ...]) -> list[float]:
    """Find the length of each segment of a body; segments without one share the rest equally.

    Parameters
    ----------
    length : float, m
        Of the body.
    segments : tuple of Segment
        Base to tip.

    Returns
    -------
    list of float, m
        They sum to the body's length.
    """
    given = [s.length for s in segments if s.length is not None]
    free = len(segments) - len(given)
    share = math.fsum([length, *(-length for length in given)]) / free if free else 0.0
    return [share if s.length is None else s.length for s in segments]
