"""Prediction of what was measured: residuals (simulated minus measured) and how they change with the constants."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from magmpm.bodies.curves import on_rows
from magmpm.compiled.arrays import Array
from magmpm.errors import InputError
from magmpm.inputs.vectors import Vector
from magmpm.model import build
from magmpm.results.measures import of_particles, tip_of
from magmpm.scene import Scene
from magmpm.scene.addresses import value_at, written
from magmpm.scene.apparatus import Apparatus
from magmpm.simulate import run, sensitivities, simulated
from magmpm.solving.solve import RunOptions
from magmpm.statics.equilibrium import Following
from magmpm.studies.fitting.constants import Constant, applied, chain
from magmpm.studies.fitting.table import Measurements, Readings
from magmpm.studies.search.samplers.blocks import across


@dataclass(frozen=True)
class Label:
    """Origin of a residual.

    Attributes
    ----------
    line : int
        Of the table.
    what : str
        It measures, in words.
    angle : bool
        Whether it is an angle (rad), or else a length (m).
    measured : tuple of float, SI
        The number, or of a curve the point.
    simulated : tuple of float, SI
        The number, or of a curve the foot on it.
    table : int
        Which of several it is in.
    """

    line: int
    what: str
    angle: bool = False
    measured: tuple[float, ...] = ()
    simulated: tuple[float, ...] = ()
    table: int = 0

    @property
    def unit(self) -> str:
        return "rad" if self.angle else "m"


@dataclass(frozen=True)
class Axis:
    """Shape of a body, and its derivatives by k numbers.

    Attributes
    ----------
    rows : array (n, 4), m
        Rows [s, x, y, z]; none for parts.
    tip : array (3,), m
        The tip.
    rows_change : array (n, 3, k), m per unit
        Derivatives of the rows' x, y and z.
    tip_change : array (3, k), m per unit
        Derivatives of the tip.
    """

    rows: Array
    tip: Array
    rows_change: Array
    tip_change: Array

    @classmethod
    def alone(cls, rows: Array, tip: Array) -> Axis:
        """Make a shape without derivatives.

        Parameters
        ----------
        rows : array (n, 4), m
            Rows [s, x, y, z].
        tip : array (3,), m
            The tip.

        Returns
        -------
        Axis
            The shape.
        """
        return cls(rows, tip, np.zeros((len(rows), 3, 0)), np.zeros((3, 0)))

    def at(self, s: Array) -> tuple[Array, Array, Array, Array]:
        """Find the body at arc lengths.

        Parameters
        ----------
        s : array (m,), m
            Arc lengths.

        Returns
        -------
        places : array (m, 3), m
            Points of the axis.
        moved : array (m, 3, k), m per unit
            Their derivatives.
        slopes : array (m, 3), no unit
            Derivatives of the points by arc length.
        turned : array (m, 3, k), 1 per unit
            Derivatives of these.
        """
        n, _, k = self.rows_change.shape
        places, slopes = on_rows(self.rows[:, 0], self.rows[:, 1:], s)
        moved, turned = on_rows(self.rows[:, 0], self.rows_change.reshape(n, 3 * k), s)
        return places, moved.reshape(len(places), 3, k), slopes, turned.reshape(len(places), 3, k)


def compare(shape: Axis, readings: Readings) -> tuple[Array, Array, list[Label]]:
    """Compare a shape with the readings of one state.

    Parameters
    ----------
    shape : Axis
        The simulated shape.
    readings : Readings
        The measured one.

    Returns
    -------
    residuals : array (r,), m or rad
        Simulated minus measured.
    slopes : array (r, k), per unit
        Their derivatives.
    labels : list of Label
        What each is of.
    """
    found = list((_along_curve if readings.kind == "curve" else _at_points)(shape, readings))
    residuals = np.array([each for each, _, _ in found])
    slopes = np.array([each for _, each, _ in found])
    return (
        residuals,
        slopes.reshape(len(found), shape.tip_change.shape[1]),
        [label for _, _, label in found],
    )


def _at_points(shape: Axis, readings: Readings) -> Iterator[tuple[float, Array, Label]]:
    kind = readings.kind
    if kind == "places":
        places, moved, _, _ = shape.at(np.minimum(readings.s, shape.rows[-1, 0]))
    for m, line in enumerate(readings.lines):
        place, change = (shape.tip, shape.tip_change) if kind == "tips" else (places[m], moved[m])
        for i in np.flatnonzero(np.isfinite(readings.points[m])):
            prefix = "tip_" if kind == "tips" else ""
            both = (float(readings.points[m, i]),), (float(place[i]),)
            label = Label(int(line), f"{prefix}{'xyz'[i]}", False, *both, readings.table)
            yield float(place[i] - readings.points[m, i]), change[i], label
        if np.isfinite(readings.angles[m]):
            angle, turned = tip_angle(shape, readings.plane)
            both = (float(readings.angles[m]),), (angle,)
            difference = math.remainder(angle - readings.angles[m], math.tau)
            yield difference, turned, Label(int(line), "tip_angle", True, *both, readings.table)


def tip_angle(shape: Axis, plane: int | None) -> tuple[float, Array]:
    """Find the angle between the tip's tangent and +x, and its derivatives.

    Parameters
    ----------
    shape : Axis
        The shape.
    plane : int or None
        The axis, 1 or 2, that has the plane with x in which the angle has a sign; None: without
        a sign.

    Returns
    -------
    angle : float, rad
        The angle.
    slopes : array (k,), rad per unit
        Its derivatives.
    """
    _, _, slopes, turned = shape.at(shape.rows[-1:, 0])
    t = slopes[0]
    dt = turned[0]
    if plane is not None:
        size = max(float(t[0] ** 2 + t[plane] ** 2), 1e-24)
        return float(np.arctan2(t[plane], t[0])), (t[0] * dt[plane] - t[plane] * dt[0]) / size
    across = float(np.hypot(t[1], t[2]))
    if across < 1e-12:
        return 0.0 if t[0] > 0 else np.pi, np.zeros(dt.shape[1])
    dacross = (t[1] * dt[1] + t[2] * dt[2]) / across
    return float(np.arctan2(across, t[0])), (t[0] * dacross - across * dt[0]) / (
        across**2 + t[0] ** 2
    )


def _along_curve(shape: Axis, readings: Readings) -> Iterator[tuple[float, Array, Label]]:
    """Distances of points from the curve, across it: its projection where a coordinate is missing; beyond its ends, from its tangents.

    The distance is a least one, so a shift of its foot along the curve does not change it to first order.
    """
    length = shape.rows[-1, 0]
    axes = list(readings.axes)
    fine = np.linspace(0.0, length, 20 * (len(shape.rows) - 1) + 1)
    curve = shape.at(fine)[0][:, axes]
    for m, line in enumerate(readings.lines):
        point = readings.points[m, axes]
        s = _foot(shape, axes, point, fine, curve)
        places, moved, slopes, turned = shape.at(np.array([s]))
        size = max(float(np.linalg.norm(slopes[0, axes])), 1e-300)
        tangent = slopes[0, axes] / size
        away = places[0, axes] - point
        for k, normal in enumerate(_normals(tangent)):
            # ahead: not 0 beyond an end alone, where the tangent turns
            gap = float(normal @ away)
            ahead = float(tangent @ away) / size
            what = f"across the curve{f' ({k + 1})' if len(axes) == 3 else ''}"
            both = tuple(point.tolist()), tuple(places[0, axes].tolist())
            yield (
                gap,
                normal @ (moved[0, axes] - ahead * turned[0, axes]),
                Label(int(line), what, False, *both, readings.table),
            )


def _foot(shape: Axis, axes: list[int], point: Array, fine: Array, curve: Array) -> float:
    """Arc length of the place on a curve that is nearest to a point: the nearest sample, then Gauss-Newton steps along the tangent."""
    s = float(fine[np.argmin(np.sum((curve - point) ** 2, axis=1))])
    for _ in range(8):
        places, _, slopes, _ = shape.at(np.array([s]))
        t = slopes[0, axes]
        new = float(
            np.clip(s - (places[0, axes] - point) @ t / max(float(t @ t), 1e-12), 0.0, fine[-1])
        )
        if abs(new - s) < 1e-9 * fine[-1]:
            return new
        s = new
    return s


def _normals(tangent: Array) -> list[Array]:
    """Unit vectors across a tangent: one in a plane, two in space."""
    if len(tangent) == 2:
        return [np.array([-tangent[1], tangent[0]])]
    return list(across(tangent).T)


@dataclass
class Prediction:
    """Residuals of all measurements for a scene with its constants at x.

    It keeps what it found, and what the last shapes add to their rods (corrections), from which the
    next solves begin.

    Attributes
    ----------
    scene : Scene
        With the constants where the fit begins.
    measured : Measurements
        The measurements.
    constants : tuple of Constant
        The k constants.
    solves : int
        Number of simulations so far.
    labels : list of Label
        What each residual is of; known after `at`.
    """

    scene: Scene
    measured: Measurements
    constants: tuple[Constant, ...]
    solves: int = 0
    labels: list[Label] = field(default_factory=list)
    _found: dict[tuple[bytes, bool], tuple[Array, Array, list[Label]]] = field(default_factory=dict)
    _motions: dict[bytes, tuple[Array, list[Label]]] = field(default_factory=dict)
    _last: dict[int, Array] = field(default_factory=dict)
    _following: Following = field(
        default_factory=lambda: Following(lambda rod: None, with_stability=False)
    )

    def __post_init__(self) -> None:
        """Raises InputError where the rows give what is to be found."""
        lengths = [constant.name for constant in self.constants if constant.kind == "length"]
        if lengths and any(
            readings.apparatus.inserted is not None for readings in self.measured.states
        ):
            rule = (
                "the column inserted_mm says how long the free body is in each row, so its length"
                " is no constant to find"
            )
            remedy = (
                "leave length out of --vary; or remove the column, and fit the rows of one inserted"
                " length"
            )
            raise InputError(
                self.measured.named,
                received=f"inserted_mm, and --vary {','.join(lengths)}",
                rule=rule,
                remedy=remedy,
            )
        places = [p for c in self.constants if c.kind not in ("field", "length") for p in c.places]
        for readings in self.measured.states if places else ():
            there = readings.apparatus.applied(self.scene)
            for place in places:
                if value_at(there, place) != value_at(self.scene, place):
                    raise InputError(
                        self.measured.named,
                        received=f"a column that sets {written(place)}",
                        rule="what each row gives is no constant to find",
                        remedy="leave it out of --vary, or remove the column",
                    )

    def at(self, x: Array, *, slopes: bool = True) -> tuple[Array, Array]:
        """Find the residuals and their derivatives.

        Parameters
        ----------
        x : array (k,), no unit
            Numbers of the constants.
        slopes : bool, default True
            Whether the derivatives are needed; without, they may be missing.

        Returns
        -------
        residuals : array (n,), m or rad
            Simulated minus measured.
        jacobian : array (n, k), m or rad per unit of x
            Their derivatives.

        Raises
        ------
        SolveError
            Where a shape is not found.
        InputError
            Where x leaves what a scene allows.
        """
        found = self._found.get((x.tobytes(), True)) or self._found.get((x.tobytes(), slopes))
        if found is None:
            residuals, jacobian = (
                self._in_motion(x, slopes) if self.scene.in_time else self._at_rest(x, slopes)
            )
            found = self._found[x.tobytes(), slopes] = residuals, jacobian, self.labels
        self.labels = found[2]
        return found[0], found[1]

    def _at_rest(self, x: Array, slopes: bool) -> tuple[Array, Array]:
        loads = [(readings.field, readings.apparatus) for readings in self.measured.states]
        shapes = {
            load: self._shape_in(*load, loads.index(load), x, slopes)
            for load in dict.fromkeys(loads)
        }
        parts = [
            compare(shapes[load], readings)
            for load, readings in zip(loads, self.measured.states, strict=True)
        ]
        self.labels = [label for _, _, labels in parts for label in labels]
        return np.concatenate([r for r, _, _ in parts]), np.concatenate([j for _, j, _ in parts])

    def _shape_in(
        self,
        field: Vector | None,
        apparatus: Apparatus,
        index: int,
        x: Array,
        slopes: bool,
    ) -> Axis:
        """The shape in a field of an apparatus; tables may share one."""
        base = apparatus.applied(self.scene if field is None else self.scene.with_field(field))
        scene = applied(base, self.constants, x)
        words = list(dict.fromkeys(word for c in self.constants for word in c.words))
        self._following.expected = lambda rod: self._last.get(index)
        self.solves += 1
        near = sensitivities(scene, of=words, start=self._following) if slopes else None
        result = (
            simulated(scene, RunOptions(start=self._following)) if near is None else near.result
        )
        self._last[index] = result.grid_correction
        if near is None:
            return Axis.alone(result.centreline, tip_of(result))
        per_x = chain(base, self.constants, x, near.variables)
        assert near.tip is not None  # tip_of
        return Axis(result.centreline, tip_of(result), near.centreline @ per_x, near.tip @ per_x)

    def _in_motion(self, x: Array, slopes: bool) -> tuple[Array, Array]:
        half = 0.01  # of x, of the central differences: 1 % of a modulus
        if x.tobytes() not in self._motions:
            self._motions[x.tobytes()] = self._moved(x)
        residuals, self.labels = self._motions[x.tobytes()]
        if not slopes:
            return residuals, np.zeros((len(residuals), 0))
        columns = [
            (self._moved(x + step)[0] - self._moved(x - step)[0]) / (2 * half)
            for step in half * np.eye(len(x))
        ]
        return residuals, np.stack(columns, axis=1)

    def _moved(self, x: Array) -> tuple[Array, list[Label]]:
        """Residuals (n,) of the markers along a motion, and what each is of: a cubic spline in time through its frames."""
        from scipy.interpolate import CubicSpline  # for motions alone

        self.solves += 1
        times, shapes, tips = _frames(applied(self.scene, self.constants, x))
        if len(times) < 4:
            raise InputError(
                "solver",
                received=f"{len(times)} frames",
                rule="measurements over time are compared with at least four frames",
                remedy="write a smaller output_every",
            )
        rows = CubicSpline(times, shapes[:, :, 1:])
        tip = CubicSpline(times, tips)
        parts = []
        for readings, t in ((each, each.time) for each in self.measured.states):
            shape = Axis.alone(
                np.column_stack([shapes[0, :, 0], rows(t)]) if len(shapes[0]) else shapes[0], tip(t)
            )
            parts.append(compare(shape, readings))
        labels = [label for _, _, some in parts for label in some]
        return np.concatenate([residuals for residuals, _, _ in parts]), labels


def _frames(scene: Scene) -> tuple[Array, Array, Array]:
    """Times (f,) s, axes (f, n, 4) m and tips (f, 3) m of a scene along time."""
    from magmpm.results.trajectory import Motion  # and HDF5

    with tempfile.TemporaryDirectory(prefix="magmpm-fit-") as folder:
        run(scene, folder=folder)
        motion: Any = Motion.load(folder)
        model = build(scene)
        positions = [np.asarray(motion.position(k), dtype=float) for k in range(len(motion))]
        found = [of_particles(model, position) for position in positions]
        return (
            np.array(motion.times),
            np.array([axis for axis, _, _ in found]),
            np.array([tip for _, tip, _ in found]),
        )
