"""Content of one picture, as plain arrays: it travels to the drawing process, and nothing else has to.

A Snapshot knows neither scene nor solver; viz.from_motion and viz.from_result make them. It is small (single precision, at most
about 1 MB), because one is pickled for every trial of a study.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from magmpm.bodies.curves import arc_lengths, linear
from magmpm.errors import length as readable_length
from magmpm.viz import style
from magmpm.viz.meshes import TriangleSurface


def _no_points() -> np.ndarray:
    return np.zeros((0, 3))


def _no_arrows() -> np.ndarray:
    return np.zeros((0, 2, 3))


@dataclass(frozen=True)
class DrawnSolid:
    """A solid near the body: points (n, 3) m, triangles (m, 3) counter-clockwise from outside.

    name: what the legend calls it, or "" for nothing. hollow: only its far side is drawn, so that one sees inside. framed: it must be
    in view.
    """

    name: str
    points: np.ndarray
    triangles: np.ndarray
    color: str
    hollow: bool = False
    framed: bool = True


@dataclass(frozen=True)
class Plane:
    """A plane: a point (3,) m and the unit normal (3,) into the free side."""

    point: np.ndarray
    normal: np.ndarray

    def dropped(self, points: np.ndarray) -> np.ndarray:
        """Points (n, 3) m projected onto the plane."""
        return points - ((points - self.point) @ self.normal)[:, None] * self.normal

    def height(self, points: np.ndarray) -> np.ndarray:
        """(n,) m above the plane."""
        return np.asarray((points - self.point) @ self.normal)


@dataclass(frozen=True)
class Balls:
    """A body drawn as balls: positions (n, 3) float32 m, part (n,) of each, size (m) of the cube that a whole particle fills."""

    points: np.ndarray
    part: np.ndarray
    size: float


@dataclass(frozen=True)
class History:
    """The field at the body over a whole motion: times (k,) s, values (k, 3) T. jumps: times, s, at which a branch of equilibria ended."""

    times: np.ndarray
    values: np.ndarray
    jumps: tuple[float, ...] = ()


@dataclass(frozen=True)
class Snapshot:
    """One body, deformed, with its surroundings. SI units.

    body              its surface, or its particles
    magnetized        (k,) bool of each part; held (k,) bool: parts that cannot move, or None
    length, thickness m, of the undeformed body: they size the marks
    axis              (m, 3) m, deformed center line from base to tip, drawn as a line, or shape (0, 3)
    target            (q, 3) m, the dots of the target shape, or None; target_name is what the legend calls them
    arrows            (a, 2, 3) m, start and vector of magnetization arrows; arrow_width in m
    obstacles         what is around it; ground: the plane, or None
    contact           (c, 3) m, where the body touches; forces (f, 2, 3) m: starts and vectors of the forces on it
    touches           whether it touches anything at some time of the motion
    trace             (t, 3) m, the path of its tip or middle so far
    field             (3,) T now, or None if unknown; history over the motion, or None
    fields            (f, 2, 3) m, start and vector of arrows of several fields, each next to what it acts on; notes: texts and their
                      places (3,) m
    gravity           (3,) m/s^2, or None
    time              s, or None for a body at rest; duration: s, of the motion; pace: how many times slower than life, or None
    title, trial, rms caption; rms in m
    mark              replaces the caption, in red, where this is no answer or none to trust; or ""
    event             what has just happened, after the time in the caption, in red: "snapped through"; or ""
    insets            whether it is seen from above and from the side too
    """

    body: TriangleSurface | Balls
    magnetized: np.ndarray
    length: float
    thickness: float
    held: np.ndarray | None = None
    axis: np.ndarray = field(default_factory=_no_points)
    target: np.ndarray | None = None
    target_name: str = "target"
    arrows: np.ndarray = field(default_factory=_no_arrows)
    arrow_width: float = 0.0
    obstacles: tuple[DrawnSolid, ...] = ()
    ground: Plane | None = None
    contact: np.ndarray = field(default_factory=_no_points)
    forces: np.ndarray = field(default_factory=_no_arrows)
    touches: bool = False
    trace: np.ndarray = field(default_factory=_no_points)
    fields: np.ndarray = field(default_factory=_no_arrows)
    notes: tuple[tuple[str, np.ndarray], ...] = ()
    field: np.ndarray | None = None
    history: History | None = None
    gravity: np.ndarray | None = None
    time: float | None = None
    duration: float = 1.0
    pace: float | None = None
    title: str = ""
    trial: int | None = None
    rms: float | None = None
    mark: str = ""
    event: str = ""
    insets: bool = False

    def __post_init__(self) -> None:
        for name, array in (
            ("body.points", self.body.points),
            ("axis", self.axis),
            ("target", self.target),
            ("trace", self.trace),
        ):
            if array is not None and (array.ndim != 2 or array.shape[1] != 3):
                raise ValueError(f"Snapshot.{name} has shape {array.shape}; it must be (any, 3)")
        if len(self.body.points) == 0:
            raise ValueError("Snapshot.body has no points: there is nothing to draw")
        if isinstance(self.body, Balls) and self.body.part.shape != (len(self.body.points),):
            raise ValueError(
                f"Balls.part has shape {self.body.part.shape}; it must be"
                f" ({len(self.body.points)},), one a particle"
            )

    @property
    def colors(self) -> np.ndarray:
        """Color (m, 3) in 0..1 of each triangle or particle."""
        colors = style.segment_colors(self.magnetized)
        if self.held is not None:
            colors[self.held] = style.rgb(style.HELD)
        return np.asarray(colors[self.body.part])

    @property
    def pushes(self) -> np.ndarray:
        """The forces (f, 2, 3) m that are long enough to be drawn."""
        return np.asarray(
            self.forces[np.linalg.norm(self.forces[:, 1], axis=1) > 0.02 * self.length]
        )

    @property
    def unit(self) -> float:
        """Length (m) of the scale bar and of the floor's squares: a round number, about a quarter of the body."""
        return style.nice_length(0.3 * self.length)

    def caption(self) -> str:
        """The mark; else trial and rms, "trial 12   rms 1.93 mm"; else the time and the movie's pace; empty if none is known."""
        if self.mark:
            return self.mark
        words = []
        if self.trial is not None:
            words.append(f"trial {self.trial}")
        if self.rms is not None:
            words.append(
                f"rms {self.rms * 1e3:.2f} mm"
                if self.rms >= 1e-4
                else f"rms {readable_length(self.rms)}"
            )
        if self.time is not None:
            words.append(f"t = {seconds(self.time, self.duration)}")
            words += [self.event] if self.event else [slower(self.pace)] if self.pace else []
        return "   ".join(words)


def spread(points: np.ndarray, most: int = style.TARGET_DOTS) -> np.ndarray:
    """Dots (q, 3) along a line through points (n, 3), as many but at most so many, at equal distances, the first and last among them."""
    s = arc_lengths(points)
    return linear(np.linspace(0.0, s[-1], min(len(points), most)), s, np.asarray(points))


def seconds(time: float, duration: float = 1.0) -> str:
    """A time in s as text with its unit and the digits that a motion of that duration (s) calls for: "12.5 ms", "0.250 s"."""
    unit, name = next(
        (u for u in ((1.0, "s"), (1e-3, "ms")) if duration >= 0.05 * u[0]), (1e-6, "µs")
    )
    digits = 3 if duration < unit else 2 if duration < 20 * unit else 1
    return f"{time / unit:.{digits}f} {name}"


def slower(pace: float) -> str:
    """Pace of a movie's time: "10x slower", "real time"."""
    if 0.95 < pace < 1.05:
        return "real time"
    return f"{pace:.2g}× slower" if pace > 1 else f"{1 / pace:.2g}× faster"
