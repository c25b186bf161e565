"""Measures of a deformed body: the axis through its particles, the middle of its regions, its distance from a target shape;
and the frames of runs, with the distance between those of two.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from magmpm.bodies.curves import AXIS_STATIONS, on_rows
from magmpm.compiled.arrays import Array
from magmpm.errors import InputError
from magmpm.materials import magnetization
from magmpm.model import Model, build
from magmpm.results.result import Result
from magmpm.scene import Scene

if TYPE_CHECKING:
    from magmpm.results.trajectory import Motion

NO_TIP = "a body of parts has no tip unless the scene names one"
NAME_ONE = "name a part or a point, say `tip: arm` in body.parts"


def region_magnetization(model: Model, F: Array) -> Array:
    """Find the mean magnetization of each region, F Br or R Br.

    Parameters
    ----------
    model : Model
        The body.
    F : array (n, 3, 3), no unit
        Deformation gradients of its particles.

    Returns
    -------
    array (k, 3), T
        A row for each region.
    """
    return region_means(model, magnetization(model.rotating, model.remanence[:, :3], F))


def region_means(model: Model, values: Array) -> Array:
    """Average values at the particles over each region's volume.

    Parameters
    ----------
    model : Model
        The body.
    values : array (n, m)
        Of each particle.

    Returns
    -------
    array (k, m)
        A row for each region, in the values' unit.
    """
    particles = model.particles
    share = np.zeros((len(model.scene.regions()), len(values)))
    share[particles.segment, np.arange(len(values))] = particles.volume
    share /= share.sum(axis=1, keepdims=True)
    return share @ values


def axis_of_particles(model: Model, position: Array) -> Array:
    """Find a straight body's axis from its particles alone.

    The means of the sections are fitted by the splines along the axis, by least squares: for a
    displacement that these splines hold this is the mean of the section exactly, whatever moved the
    particles.

    Parameters
    ----------
    model : Model
        The body.
    position : array (n, 3), m
        Of its deformed particles.

    Returns
    -------
    array (2 cells + 1, 4), m
        Rows [s, x, y, z]; none for a body without an axis.
    """
    if model.line is None:
        return np.zeros((0, 4))
    x, of = np.unique(model.particles.position[:, 0], return_inverse=True)
    volume = np.bincount(of, model.particles.volume)
    mean = np.stack(
        [np.bincount(of, model.particles.volume * p) / volume for p in position.T], axis=1
    )
    root = np.sqrt(volume)[:, None]
    s = model.grid.stations
    splines = model.grid.matrix_along(x - model.line.base[0])
    coefficients = np.linalg.lstsq(root * splines, root * mean, rcond=None)[0]
    return np.column_stack([s, model.grid.matrix_along(s) @ coefficients])


def centreline_at(result: Result, s: Array) -> Array:
    """Find points of the deformed axis. They are exact: between the rows of a cell the axis is a parabola.

    Parameters
    ----------
    result : Result
        The body.
    s : array (m,), m
        Arc lengths, 0 to the length.

    Returns
    -------
    array (m, 3), m
        The points.

    Raises
    ------
    ValueError
        For arc lengths outside the body.

    Examples
    --------
    >>> import magmpm
    >>> from magmpm.results.measures import centreline_at
    >>> import numpy as np
    >>> result = magmpm.run(magmpm.load_scene("data/scenes/axial_transverse.yaml").with_cells(2))
    >>> centreline_at(result, np.array([0.0, 0.02])).shape  # m
    (2, 3)
    """
    return on_rows(result.centreline[:, 0], result.centreline[:, 1:], s)[0]


def largest_distance(result: Result, target: Array) -> float:
    """Find the largest distance between the axis and a target, at the same arc lengths.

    Parameters
    ----------
    result : Result
        The body.
    target : array (m, 4), m
        Rows [s, x, y, z].

    Returns
    -------
    float, m
        The distance.
    """
    return float(np.linalg.norm(centreline_at(result, target[:, 0]) - target[:, 1:], axis=1).max())


def tip_of(result: Result) -> Array:
    """Find the tip of a body that has one.

    Parameters
    ----------
    result : Result
        The body.

    Returns
    -------
    array (3,), m
        The tip.

    Raises
    ------
    InputError
        For parts that name none.
    """
    if result.tip is None:
        raise InputError("tip", received="nothing", rule=NO_TIP, remedy=NAME_ONE)
    return result.tip


def named_tip(model: Model, x: Array) -> Array | None:
    """Find the tip that a body of parts names.

    Parameters
    ----------
    model : Model
        The body.
    x : array (n, 3), m
        Positions of its particles.

    Returns
    -------
    array (3,), m, or None
        The tip; None where it names none.
    """
    return None if model.tip_weights is None else model.tip_weights @ x


def of_particles(model: Model, x: Array) -> tuple[Array, Array | None, Array]:
    """Find what is compared of a body in motion, as Frames.see takes it.

    Parameters
    ----------
    model : Model
        The body.
    x : array (n, 3), m
        Positions of its particles.

    Returns
    -------
    axis : array (2 cells + 1, 4), m
        Rows [s, x, y, z]; none for parts.
    tip : array (3,), m, or None
        The tip.
    centers : array (k, 3), m
        Of the regions.
    """
    axis = axis_of_particles(model, x)
    return axis, axis[-1, 1:] if len(axis) else named_tip(model, x), region_means(model, x)


@dataclass
class Frames:
    """Frames of a run to compare.

    Attributes
    ----------
    times : list of float, s
        Of the frames.
    points : list of array (m, 3), m
        Of the axis; of parts their centers, and the tip if one is named.
    tips : list of array (3,), m, or None
        The tips.
    jumps : list of float, s
        Times at which a path jumps.
    """

    times: list[float] = field(default_factory=list)
    points: list[Array] = field(default_factory=list)
    tips: list[Array | None] = field(default_factory=list)
    jumps: list[float] = field(default_factory=list)

    def see(self, time: float, axis: Array, tip: Array | None, centers: Array) -> None:
        """Add a frame (solving.solve.OnFrame).

        Parameters
        ----------
        time : float, s
            Of the frame.
        axis : array (2 cells + 1, 4), m
            Rows [s, x, y, z]; none for parts.
        tip : array (3,), m, or None
            The tip.
        centers : array (k, 3), m
            Of the regions.
        """
        self.times.append(time)
        self.tips.append(None if tip is None else np.array(tip))
        if len(axis):
            along = np.linspace(0.0, axis[-1, 0], AXIS_STATIONS)
            self.points.append(on_rows(axis[:, 0], axis[:, 1:], along)[0])
        else:
            self.points.append(centers.copy() if tip is None else np.vstack([centers, tip]))

    def ends(self) -> list[Array]:
        """List the tips.

        Returns
        -------
        list of array (3,), m
            One for each frame.

        Raises
        ------
        InputError
            Where the body has none.
        """
        found = [tip for tip in self.tips if tip is not None]
        if len(found) < len(self.tips):
            raise InputError("tip", received="nothing", rule=NO_TIP, remedy=NAME_ONE)
        return found

    def minus(self, other: Frames) -> Frames:
        """Find the way from another run's points and tip to these, in each frame that both have; times agree but for rounding.

        Parameters
        ----------
        other : Frames
            The other run.

        Returns
        -------
        Frames
            The ways as frames, m.
        """
        found = Frames()
        for k, t in enumerate(self.times):
            at = [j for j, u in enumerate(other.times) if math.isclose(t, u, rel_tol=1e-9)]
            if not at:
                continue
            mine = self.tips[k]
            theirs = other.tips[at[0]]
            found.times.append(t)
            found.points.append(self.points[k] - other.points[at[0]])
            found.tips.append(None if mine is None or theirs is None else mine - theirs)
        return found

    def sizes(
        self, of: str = "centreline", skip: Sequence[tuple[float, float]] = ()
    ) -> dict[float, float]:
        """Find how far a point is from the origin at most, in each frame.

        Parameters
        ----------
        of : str, default 'centreline'
            "centreline", of all points; or "tip".
        skip : sequence of (float, float), s, optional
            Spans of time that are left out.

        Returns
        -------
        dict[float, float], s to m
            The farthest by time.

        Raises
        ------
        InputError
            Where it is to be that of tips, and the body has none.
        """
        vectors = self.ends() if of == "tip" else self.points
        return {
            t: float(np.linalg.norm(np.atleast_2d(each), axis=1).max())
            for t, each in zip(self.times, vectors, strict=True)
            if not any(first <= t <= last for first, last in skip)
        }

    def distances(
        self, other: Frames, of: str = "centreline", skip: Sequence[tuple[float, float]] = ()
    ) -> dict[float, float]:
        """Find the largest distance in each frame that two runs have, as `sizes` of `minus`.

        Parameters
        ----------
        other : Frames
            The other run.
        of : str, default 'centreline'
            "centreline", of all points; or "tip".
        skip : sequence of (float, float), s, optional
            Spans of time that are left out.

        Returns
        -------
        dict[float, float], s to m
            Distances by time.
        """
        return self.minus(other).sizes(of, skip)


def frames_of(run: Result | Motion) -> Frames:
    """Read the frames of a run.

    Parameters
    ----------
    run : Result or Motion
        A saved motion or path; of a Result its end is the only frame.

    Returns
    -------
    Frames
        The frames.
    """
    frames = Frames()
    if isinstance(run, Result):
        frames.see(run.time, run.centreline, run.tip, run.segment_center)
        return frames
    scene = Scene.from_si(run.scene or {})
    model = build(scene, time=0.0 if scene.static else None)
    for k, t in enumerate(run.times):
        frames.see(float(t), *of_particles(model, np.asarray(run.position(k), dtype=float)))
    return frames


def near_jumps(one: Frames, other: Frames) -> list[tuple[float, float]]:
    """Find spans of time in which two grids of a path may be on different branches.

    They go from jump to jump, and as long before and after, since the true jump is about as far
    from theirs as they are from each other, or nearer (statics.error_estimate).

    Parameters
    ----------
    one : Frames
        A run.
    other : Frames
        The same on another grid.

    Returns
    -------
    list of (float, float), s
        Begin and end of each span.
    """
    pairs = [(min(a, b), max(a, b)) for a, b in zip(one.jumps, other.jumps)]
    return [(2 * first - last, 2 * last - first) for first, last in pairs]
