"""Rods that follow one another: each begins from the one before, as a body does that is pushed out of a guide, or whose field changes.

A design has several equilibria at most of its depths. Which one a body takes is decided by where it comes from, so designs are evaluated
on the way: from each depth to the next the length grows and the field passes evenly, in small steps. A design of
rods that only hold their shapes (RodTrajectory.grown) may not be reached on it. Where a rod leaves the design's shape, that depth's
field is fitted anew in every step of the way, and then the whole design from there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from magmpm.bodies.curves import linear
from magmpm.compiled.arrays import Array
from magmpm.errors import SolveError
from magmpm.rod.cosserat import RodShape
from magmpm.scene import Scene
from magmpm.studies.problem import STABILITY_AT_BRINK
from magmpm.studies.problem.path import Path
from magmpm.studies.rods.rod_trajectory import (
    Depth,
    RodStates,
    RodTrajectory,
    RodTrajectoryDesign,
    depth_of,
)
from magmpm.studies.search.samplers.blocks import unit

LEAST_STEPS_PER_DEPTH = 4  # steps from one depth to the next
RISKY = 3.0  # times as much a design counts whose stability on the way is below STABILITY_AT_BRINK


@dataclass(frozen=True)
class RodStop:
    """A rod on the way.

    Attributes
    ----------
    depth : Depth
        Where it is.
    field : array (3,), T
        In which it is.
    q : array (n + 1, 4), no unit
        Its frames as quaternions.
    position : array (n + 1, 3), m
        Its axis.
    squares : float, m^2
        Weighted mean of its squared distances from the path.
    """

    depth: Depth
    field: Array
    q: Array
    position: Array
    squares: float

    def shape(self, directions: Array) -> RodShape:
        """Make the rod shape from which the body's solve begins.

        Parameters
        ----------
        directions : array (k, 3), no unit
            Unit vectors of all segments, or zeros.

        Returns
        -------
        RodShape
            The shape.
        """
        return self.depth.rod.shape(self.q, directions[self.depth.segments], self.field)


@dataclass(frozen=True)
class RodPath:
    """The places where a design is evaluated, and for each of them the rods on the way to it, itself the last.

    Attributes
    ----------
    rods : RodTrajectory
        The rods at these places.
    ways : tuple of tuple of Depth
        For each place the depths on the way to it.
    """

    rods: RodTrajectory
    ways: tuple[tuple[Depth, ...], ...]

    @classmethod
    def of(
        cls,
        scene: Scene,
        path: Path,
        lengths: Sequence[float],
        *,
        max_field: float,
        exit_weight: float,
    ) -> RodPath:
        """Make the way of a scene's catheter through inserted lengths.

        Parameters
        ----------
        scene : Scene
            The scene.
        path : Path
            The path of the insertion.
        lengths : sequence of float, m
            Inserted lengths, rising.
        max_field : float, T
            Greatest strength of the field.
        exit_weight : float
            How much the exit counts (evaluate.trajectory.InsertionTrajectory).

        Returns
        -------
        RodPath
            The way.
        """
        rods = RodTrajectory.of(scene, path, lengths, max_field=max_field, exit_weight=exit_weight)
        before = min(scene.thickness, lengths[0])
        ways = []
        for length, depth in zip(lengths, rods.depths, strict=True):
            steps = max(LEAST_STEPS_PER_DEPTH, math.ceil(48 * (length - before) / scene.length))
            between = (
                np.linspace(before, length, steps + 1)[1:-1] if length > before else np.zeros(0)
            )
            ways.append(
                (*(depth_of(scene, path, float(each), len(lengths)) for each in between), depth)
            )
            before = length
        return cls(rods, tuple(ways))

    def stops(self, directions: Array, fields: Array) -> list[list[RodStop]]:
        """Find all rods on the way to each place.

        Parameters
        ----------
        directions : array (k, 3), no unit
            Unit vectors of all segments, or zeros.
        fields : array (D, 3), T
            The field at each place.

        Returns
        -------
        list of list of RodStop
            For each place the rods, itself the last.

        Raises
        ------
        SolveError
            Where one finds no equilibrium.
        """
        last = None
        found = []
        for k, way in enumerate(self.ways):
            went = self._go(way, directions, last, fields[k])
            if went is None:
                raise SolveError(
                    "the rod that is pushed on from the depth before finds no equilibrium"
                )
            found.append(went)
            last = went[-1]
        return found

    def least_stability(self, design: RodTrajectoryDesign) -> float:
        """Find the smallest stability of a design's rods on the way (RodFamily.stability).

        Parameters
        ----------
        design : RodTrajectoryDesign
            The design.

        Returns
        -------
        float, no unit
            The stability; 0 where one finds no equilibrium.
        """
        try:
            ways = self.stops(design.directions, design.fields)
        except SolveError:
            return 0.0
        stops = [stop for stops in ways for stop in stops]
        return min(
            stop.depth.rod.stability(stop.q, design.directions[stop.depth.segments], stop.field)
            for stop in stops
        )

    def mended(
        self, design: RodTrajectoryDesign, *, turning: bool = True
    ) -> RodTrajectoryDesign | None:
        """Change a design where its rods have left it on the way.

        Parameters
        ----------
        design : RodTrajectoryDesign
            The design.
        turning : bool, default True
            Whether directions may change, not fields alone.

        Returns
        -------
        RodTrajectoryDesign or None
            The design as its rods find it on the way; None where they find no equilibrium.
        """
        for _ in range(4):
            went = self._followed(design)
            if went is None:
                return None
            fields, state, strayed = went
            if not strayed:
                return replace(design, value=float(np.sqrt(state.squares)), state=state)
            begin = RodTrajectoryDesign(design.directions, fields, np.inf, state)
            design = self.rods.least_squares(begin, 30, turning=turning)
        try:
            ends = [way[-1] for way in self.stops(design.directions, design.fields)]
        except SolveError:
            return None
        return replace(design, value=float(np.sqrt(sum(stop.squares for stop in ends))), state=None)

    def _followed(self, design: RodTrajectoryDesign) -> tuple[Array, RodStates, bool] | None:
        """Fields, rods on the way, and whether a depth had to be fitted anew since its rod left the design's."""
        assert design.state is not None
        last: RodStop | None = None
        ends = []
        strayed = False
        length = float(self.rods.depths[-1].place[-1])
        for k, way in enumerate(self.ways):
            went = self._go(way, design.directions, last, design.fields[k])
            away = (
                np.inf
                if went is None
                else float(np.abs(went[-1].position - design.state.positions[k]).max())
            )
            if away > 0.01 * length:  # it has left its branch
                strayed = True
                fitted = self._go(way, design.directions, last, None)
                if went is None or (fitted is not None and fitted[-1].squares < went[-1].squares):
                    went = fitted
            if went is None:
                return None
            last = went[-1]
            ends.append(last)
        fields = np.array([stop.field for stop in ends])
        state = self.rods.settled(design.directions, fields, tuple(stop.q for stop in ends))
        return None if state is None else (fields, state, strayed)

    def _go(
        self, way: Sequence[Depth], directions: Array, last: RodStop | None, field: Array | None
    ) -> list[RodStop] | None:
        """Stops from the last one along a way to a field (3,) T; without one the field is fitted in each step. None: no equilibrium."""
        begin = np.zeros(3) if last is None else last.field
        found: list[RodStop] = []
        for j, depth in enumerate(way):
            q = depth.rod.straight(1)[0] if last is None else _longer(last, depth)
            one = replace(self.rods, depths=(depth,))
            now = (
                (found[-1].field if found else begin)
                if field is None
                else begin + (j + 1) / len(way) * (field - begin)
            )
            state = one.settled(directions, now[None], (q,))
            if state is None:
                return None
            if field is None:
                fitted = one.least_squares(
                    RodTrajectoryDesign(directions, now[None], np.inf, state), 20, turning=False
                )
                assert fitted.state is not None  # least_squares begins from one
                now = fitted.fields[0]
                state = fitted.state
            last = RodStop(depth, now, state.shapes[0], state.positions[0], state.squares)
            found.append(last)
        return found


def directions_of(scene: Scene) -> Array:
    """Find the directions of all segments of a scene.

    Parameters
    ----------
    scene : Scene
        The scene.

    Returns
    -------
    array (k, 3), no unit
        Unit vectors; zeros where a segment has no magnetization.
    """
    return unit(np.array([region.magnetization for region in scene.regions()], dtype=float))


def _longer(last: RodStop, depth: Depth) -> Array:
    """The quaternions (n + 1, 4) of a stop's rod with what has left the guide since, straight, at its base."""
    old = last.depth.place
    new = depth.place
    at = new - (new[-1] - old[-1])
    return unit(linear(at, old, last.q))


def search(
    way: RodPath,
    path: Any,
    *,
    seed: int,
    starts: int,
    wanted: int = 1,
    enough: float = 0.0,
    note: Callable[[str], object] = lambda text: None,
) -> list[RodTrajectoryDesign]:
    """Search designs that grow from random starts, evaluated on the way.

    It ends once enough designs are near enough. A design whose way comes near the end of a branch
    counts RISKY times as much: the body, or a slightly other design, may fall there; it ends the
    search only with one more of its kind.

    Parameters
    ----------
    way : RodPath
        The rods on the way.
    path : Path or Shapes
        What they follow.
    seed : int
        Of the starts.
    starts : int
        Number of starts, at most.
    wanted : int, default 1
        How many designs are enough.
    enough : float, m, default 0.0
        How near is near enough.
    note : callable, default lambda text: None
        Told in words of each start.

    Returns
    -------
    list of RodTrajectoryDesign
        Designs, best first; there may be none.
    """
    rng = np.random.default_rng(seed)
    found: list[tuple[float, RodTrajectoryDesign]] = []
    for start in range(starts):
        best = f"; best {1e3 * min(design.value for _, design in found):.2f} mm" if found else ""
        note(f"designs of rods, start {start + 1} of at most {starts}{best}")
        grown = way.rods.grown(path, rng)
        design = None if grown is None else way.mended(grown)
        if design is None:
            continue
        found.append(
            (
                design.value * (1.0 if way.least_stability(design) > STABILITY_AT_BRINK else RISKY),
                design,
            )
        )
        if (
            sum(counts <= enough for counts, _ in found) >= wanted
            or sum(each.value <= enough for _, each in found) > wanted
        ):
            break
    return [design for _, design in sorted(found, key=lambda each: each[0])]
