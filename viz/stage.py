"""One moment of a motion as it is drawn: plain arrays, so that it travels to the drawing process and nothing else has to.

A Stage knows neither scene nor solver; viz.play makes them from a motion, or one from a result.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from viz import style
from viz.camera import View, fitted
from viz.scenery import Plane, Prop, least_turn


@dataclass(frozen=True)
class History:
    """The field at the body over the whole motion: times (k,) s, values (k, 3) T."""

    times: np.ndarray
    values: np.ndarray


@dataclass(frozen=True)
class Stage:
    """A body and what is around it. SI units.

    points (n, 3), triangles (m, 3)   its surface; part (m,) of each triangle; magnetised (k,) bool of each part
    held                              (k,) bool: parts that cannot move
    arrows            (a, 2, 3) m, start and vector of magnetisation arrows
    props             what stands around; ground: the plane, or None
    contact           (c, 3) m, where the body touches; forces (f, 2, 3) m: starts and vectors of the forces on it
    touches           whether it touches anything at some time of the motion
    trace             (t, 3) m, the way its tip or middle has gone
    length, thickness m, of the undeformed body: they size marks; arrow_width: m, of the magnetisation's arrows
    field             (3,) T now, or None if unknown; history over the motion, or None
    time              s, or None for a body at rest; duration: s, of the motion; pace: how many times slower than life the movie is, or None
    mark              what stands in the time's place, in red, where this is no answer; or ""
    """

    points: np.ndarray
    triangles: np.ndarray
    part: np.ndarray
    magnetised: np.ndarray
    length: float
    thickness: float
    arrow_width: float = 0.0
    held: np.ndarray | None = None
    arrows: np.ndarray = field(default_factory=lambda: np.zeros((0, 2, 3)))
    props: tuple[Prop, ...] = ()
    ground: Plane | None = None
    contact: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    forces: np.ndarray = field(default_factory=lambda: np.zeros((0, 2, 3)))
    touches: bool = False
    trace: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    field: np.ndarray | None = None
    history: History | None = None
    gravity: np.ndarray | None = None
    time: float | None = None
    duration: float = 1.0
    pace: float | None = None
    title: str = ""
    mark: str = ""

    @property
    def colours(self) -> np.ndarray:
        """Colour (m, 3) in 0..1 of each triangle."""
        colours = style.segment_colours(self.magnetised)
        if self.held is not None:
            colours[self.held] = style.rgb(style.HELD)
        return np.asarray(colours[self.part])

    @property
    def pushes(self) -> np.ndarray:
        """The forces (f, 2, 3) m that are long enough to be drawn."""
        return np.asarray(self.forces[np.linalg.norm(self.forces[:, 1], axis=1) > 0.02 * self.length])

    @property
    def unit(self) -> float:
        """Length (m) of the scale bar and of the floor's squares."""
        return style.nice_length(0.3 * self.length)

    def caption(self) -> str:
        """The time, and the movie's pace; the mark, where there is one."""
        if self.mark:
            return self.mark
        if self.time is None:
            return ""
        return f"t = {seconds(self.time, self.duration)}" + (f"   {slower(self.pace)}" if self.pace else "")


def seconds(time: float, duration: float = 1.0) -> str:
    """A time in s as text with its unit and the digits that a motion of that duration (s) calls for: "12.5 ms", "0.250 s"."""
    unit, name = next((u for u in ((1.0, "s"), (1e-3, "ms")) if duration >= 0.05 * u[0]), (1e-6, "µs"))
    digits = 3 if duration < unit else 2 if duration < 20 * unit else 1
    return f"{time / unit:.{digits}f} {name}"


def slower(pace: float) -> str:
    """How a movie's time runs: "10x slower", "real time"."""
    if 0.95 < pace < 1.05:
        return "real time"
    return f"{pace:.2g}× slower" if pace > 1 else f"{1 / pace:.2g}× faster"


@dataclass(frozen=True)
class Shot:
    """What must be seen during a whole motion, and from where.

    points (m, 3) m; toward (3,) direction to the camera; ground: the plane, or None for a floor below all points; margin m; up (3,)
    unit vector: what is upwards in the picture.
    """

    points: np.ndarray
    toward: np.ndarray
    margin: float
    ground: Plane | None = None
    up: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))

    @classmethod
    def of_all(cls, shots: Sequence[Shot]) -> Shot:
        """What is seen in any of them, from where the first is seen from."""
        first = shots[0]
        return replace(
            first, points=np.vstack([s.points for s in shots]), margin=max(s.margin for s in shots)
        )

    def floor(self) -> np.ndarray:
        """Corners (4, 3) m of the rectangle of ground, or of a floor, under everything, counter-clockwise from its free side."""
        plane = self.plane
        u, v = _across(plane.normal)
        flat = np.stack([(self.points - plane.point) @ u, (self.points - plane.point) @ v], axis=1)
        low, high = flat.min(axis=0) - 1.5 * self.margin, flat.max(axis=0) + 1.5 * self.margin
        corners = [(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])]
        return np.array([plane.point + a * u + b * v for a, b in corners])

    @property
    def plane(self) -> Plane:
        """The ground, or a floor a little below everything."""
        if self.ground is not None:
            return self.ground
        low = float((self.points @ self.up).min()) - self.margin
        return Plane(low * self.up, self.up)

    def floor_lines(self, spacing: float) -> np.ndarray:
        """Lines (n, 2, 3) m on the floor at multiples of the spacing (m)."""
        corners, plane = self.floor(), self.plane
        u, v = _across(plane.normal)
        (a0, b0), (a1, b1) = (
            [float((c - plane.point) @ u), float((c - plane.point) @ v)] for c in corners[[0, 2]]
        )
        shift = float(plane.point @ u), float(plane.point @ v)

        def marks(low: float, high: float, origin: float) -> np.ndarray:
            first = np.ceil((low + origin) / spacing)
            return np.arange(first, np.floor((high + origin) / spacing) + 1) * spacing - origin

        lines = [[a * u + b0 * v, a * u + b1 * v] for a in marks(a0, a1, shift[0])]
        lines += [[a0 * u + b * v, a1 * u + b * v] for b in marks(b0, b1, shift[1])]
        return np.array(lines).reshape(-1, 2, 3) + plane.point

    def view(self, aspect: float) -> View:
        """The view in a panel of that aspect (width over height)."""
        turn = least_turn(self.up)
        seen = np.vstack([self.points, self.floor()]) @ turn
        view = fitted(self.toward @ turn, seen, 0.5 * self.margin, aspect, 1.01)
        right, up, toward, center = (turn @ v for v in (view.right, view.up, view.toward, view.center))
        return View(right, up, toward, center, view.half_height)

    @property
    def aspect(self) -> float:
        """Width over height of what must be seen, as it is seen."""
        flat = self.view(1.0).project(np.vstack([self.points, self.floor()]))[:, :2]
        across, up = np.ptp(flat, axis=0)
        return float(across / max(up, 1e-300))

    def turned(self) -> Shot:
        """The same, seen from a quarter of a turn further about what is upwards."""
        along = float(self.toward @ self.up)
        return replace(self, toward=np.cross(self.up, self.toward) + along * self.up)

    @property
    def reach(self) -> float:
        """m from the middle to the camera."""
        return 10 * float(np.linalg.norm(np.ptp(self.points, axis=0)))


def floor_colours(ground: Plane | None) -> tuple[str, str, str]:
    """Colours of the floor, its lines and its shadows: the ground is warm and darker, a floor that is only an aid to the eye is faint."""
    if ground is None:
        return style.FLOOR, style.GRID, style.SHADOW
    return style.GROUND, style.GROUND_GRID, style.GROUND_SHADOW


def _across(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors in a plane: along x where that is in it, and across."""
    u = np.eye(3)[0] - normal * normal[0]
    if np.linalg.norm(u) < 0.1:
        u = np.eye(3)[1] - normal * normal[1]
    u /= np.linalg.norm(u)
    return u, np.cross(normal, u)
