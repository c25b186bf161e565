"""A scene in a window of the desktop, by PyVista: the same shapes, sliders and frames as the page in the browser shows."""

from __future__ import annotations

import json
import struct
import time
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
import pyvista as pv

from magmpm.viz import style

PAUSE = 40  # ms between two looks at what is to be done
MOST_SLIDERS = 9  # that have room
SECONDS = 6.0  # that a motion lasts


class View(Protocol):
    """What a window asks: see magmpm.cli.view_shape and view_motion."""

    def routes(self) -> Mapping[str, Any]: ...


def unpacked(message: bytes) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Header and arrays of a message (viz.page.wire)."""
    (length,) = struct.unpack("<I", message[:4])
    header, at, arrays = json.loads(message[4 : 4 + length]), 4 + length, {}
    for one in header["arrays"]:
        arrays[one["name"]] = np.frombuffer(message, "<u4" if one["kind"] == "u" else "<f4", one["count"], at)
        at += 4 * one["count"]
    return header, arrays


class Window:
    """A plotter with a body in it."""

    def __init__(self, view: View, *, off_screen: bool = False) -> None:
        self.routes = view.routes()
        self.about = self.routes["about"](None)
        self.plotter = _plotter(f"{self.about['name']} - magmpm view", off_screen)
        self.plotter.set_background("white")
        self.plotter.enable_parallel_projection()
        self.surface = ""
        self._mesh: Any = pv.PolyData()
        self._words("starting")
        if self.about.get("target"):
            dots = pv.PolyData(np.array(self.about["target"]))
            self.plotter.add_mesh(dots, color=style.TARGET, point_size=11, render_points_as_spheres=True, name="target")
        self.plotter.add_axes()

    def _words(self, text: str, alarm: bool = False) -> None:
        """The lines in the upper left corner."""
        color = style.ALARM if alarm else style.INK
        self.plotter.add_text(f"{self.about['name']}\n{text}", position="upper_left", font_size=10, color=color, name="words")

    def draw(self, header: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> None:
        """A message's surface, arrows and what stands around."""
        points = arrays["points"].reshape(-1, 3)
        if "triangles" in arrays:
            self.surface = header["surface"]
            self._mesh = _surface(points, arrays["triangles"])
            self._mesh["color"] = (255 * arrays["colors"].reshape(-1, 3)).astype(np.uint8)
            self.plotter.add_mesh(self._mesh, scalars="color", rgb=True, smooth_shading=True, opacity=0.7, name="body")
        self._mesh.points = points
        self._mesh.compute_normals(inplace=True, auto_orient_normals=False, split_vertices=False, consistent_normals=False)
        arrows = arrays["arrows"].reshape(-1, 2, 3)
        if len(arrows):
            self.plotter.add_mesh(pv.merge([_arrow(*arrow) for arrow in arrows]), color=style.MAGNETIZATION, name="arrows")
        for one in header.get("obstacles", ()):
            around = _surface(arrays[one["id"] + ".points"].reshape(-1, 3), arrays[one["id"] + ".triangles"])
            self.plotter.add_mesh(around, color=one["color"], opacity=0.35 if one["hollow"] else 1.0, name=one["id"])
        self._field(np.array(header.get("field") or [0.0, 0.0, 0.0], dtype=float))

    def _field(self, field: np.ndarray) -> None:
        """The field's arrow, above the base."""
        size = float(np.linalg.norm(field))
        self.plotter.remove_actor("field", render=False)
        if size > 0:
            length = 0.3 * self.about["length"]
            start = np.array([-0.1 * length, 0.0, 1.5 * length])
            self.plotter.add_mesh(_arrow(start, field / size * length), color=style.FIELD, name="field")

    def begin(self) -> None:
        """Aim the camera at the body from the front, a little above."""
        self.plotter.camera_position = [(0.4, -1.0, 0.35), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)]
        self.plotter.reset_camera()

    def show(self) -> None:
        """Stay open until closed."""
        self.begin()
        self.plotter.add_timer_event(max_steps=10**9, duration=PAUSE, callback=lambda _: self.step())
        self.plotter.show()

    def step(self) -> None:
        """What is to be done now."""
        raise NotImplementedError


def _plotter(title: str, off_screen: bool) -> Any:
    return pv.Plotter(window_size=[1280, 800], title=title, off_screen=off_screen)


def _surface(points: np.ndarray, triangles: np.ndarray) -> Any:
    """A surface of points (n, 3) m and triangles (3 m,)."""
    faces: Any = triangles.reshape(-1, 3).astype(np.int64)
    return pv.PolyData.from_regular_faces(points, faces)


def _arrow(start: np.ndarray, vector: np.ndarray) -> Any:
    """An arrow from a start along a vector, (3,) m."""
    return pv.Arrow(start=start, direction=vector, scale=float(np.linalg.norm(vector)), shaft_radius=0.04, tip_radius=0.11)


class ShapeWindow(Window):
    """A scene at rest: sliders at the right; the preview is drawn at once, the solution when the sliders rest."""

    def __init__(self, view: View, *, off_screen: bool = False) -> None:
        super().__init__(view, off_screen=off_screen)
        self.values = {control["id"]: control["value"] for control in self.about["controls"]}
        self._new, self._solve = True, False
        for k, control in enumerate(self.about["controls"][:MOST_SLIDERS]):
            height = 0.93 - 0.103 * k
            slider = self.plotter.add_slider_widget(
                lambda value, name=control["id"]: self.turn(name, value), [control["low"], control["high"]], value=control["value"],
                title=f"{control['group']} {control['label']}, {control['unit']}", pointa=(0.76, height), pointb=(0.98, height),
                title_height=0.015, fmt="%.4g", interaction_event="always", slider_width=0.02, tube_width=0.004, color=style.INK,
            )  # fmt: skip
            slider.GetRepresentation().SetLabelHeight(0.015)
        self.step()
        self.step()

    def turn(self, name: str, value: float) -> None:
        """A slider has moved."""
        if self.values[name] != value:
            self.values[name] = value
            self._new = True

    def step(self) -> None:
        """Preview what is new, or solve what was previewed."""
        if not (self._new or self._solve):
            return
        route = "preview" if self._new else "solve"
        self._new, self._solve = False, self._new
        header, arrays = unpacked(self.routes[route]({"values": dict(self.values), "surface": self.surface}))
        if "points" in arrays:
            self.draw(header, arrays)
            self._words("preview by the rod; solving" if route == "preview" else "\n".join(
                ["solved", *(f"{row['label']}  {row['text']}" for row in header["numbers"]), *header["warnings"]]))
        elif header.get("words"):
            self._words(header["words"], alarm=True)


class MotionWindow(Window):
    """A motion: it plays; a slider scrubs, and the space bar pauses."""

    def __init__(self, view: View, *, off_screen: bool = False) -> None:
        super().__init__(view, off_screen=off_screen)
        self.playing, self._begun, self._shown = True, time.monotonic(), -1
        self._told = self.routes["progress"](None)
        self._asked = time.monotonic()
        self.plotter.add_key_event("space", self._toggle)
        ends = {"pointa": (0.3, 0.08), "pointb": (0.7, 0.08)}
        self.plotter.add_slider_widget(self._scrub, [0.0, 1.0], value=0.0, title="time", style="modern", **ends)
        self.step()

    def _toggle(self) -> None:
        self.playing = not self.playing

    def _scrub(self, share: float) -> None:
        if len(times := self._told["times"]) and share > 0.0:
            self.playing = False
            self.frame(round(share * (len(times) - 1)))

    def frame(self, number: int) -> None:
        """Show a frame."""
        if number != self._shown:
            header, arrays = unpacked(self.routes["frame"]({"number": number, "surface": self.surface}))
            self.draw(header, arrays)
            self._words(f"t = {header['time']:.4g} s")
            self._shown = number

    def step(self) -> None:
        """The next frame; while the run goes on, also how far it is."""
        if self._told["running"] and time.monotonic() - self._asked > 1.0:
            self._told, self._asked = self.routes["progress"](None), time.monotonic()
        if self._told["failure"]:
            self._words(self._told["failure"], alarm=True)
        if (count := len(self._told["times"])) and self.playing:
            self.frame(int((time.monotonic() - self._begun) / SECONDS * count) % count)
