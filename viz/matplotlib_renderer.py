"""The renderer where no OpenGL library is found: the same picture drawn by matplotlib alone.

matplotlib's own three dimensions sort whole groups of points, not points, so a body that bends in front of itself comes out wrong. The
projection is parallel and known (viz.camera), so everything is projected here and drawn flat, the farthest first.
"""

from __future__ import annotations

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch

from magmpm.bodies.curves import face_normals
from magmpm.viz import style
from magmpm.viz.camera import View
from magmpm.viz.drawing import BODY, Layer, outward
from magmpm.viz.layout import Panel
from magmpm.viz.meshes import TriangleSurface
from magmpm.viz.snapshot import Balls, DrawnSolid, Snapshot

_DPI = 100.0


class MatplotlibCanvas:
    """A figure whose panels each have their own view."""

    def clear(self, size: tuple[int, int], thin: float) -> None:
        """Start a picture of that width and height in pixels; layers are drawn in order, without steps between them."""
        self._figure = Figure(figsize=(size[0] / _DPI, size[1] / _DPI), dpi=_DPI, facecolor="white")

    def panel(self, place: Panel, view: View, reach: float) -> MatplotlibPanel:
        """A panel seen in that view."""
        return MatplotlibPanel(self._figure, place, view)

    def image(self, *, fine: bool) -> np.ndarray:
        """Image of what was drawn, (height, width, 3) uint8; edges are always smooth."""
        canvas = FigureCanvasAgg(self._figure)
        canvas.draw()
        return np.asarray(canvas.buffer_rgba())[:, :, :3].copy()


class MatplotlibPanel:
    """A panel of the figure; what its methods do, viz.drawing.PanelCanvas says."""

    def __init__(self, figure: Figure, place: Panel, view: View) -> None:
        points_per_inch = 72.0
        self.view = view
        width, height = figure.get_size_inches()
        self._axes = figure.add_axes(
            (place.left, place.bottom, place.right - place.left, place.top - place.bottom)
        )
        self._axes.set_xlim(-place.aspect(width / height), place.aspect(width / height))
        self._axes.set_ylim(-1.0, 1.0)
        self._axes.set_axis_off()
        # Points (1/72 inch) to a meter: widths of balls and lines are given to matplotlib in points.
        self._scale = 0.5 * height * (place.top - place.bottom) * points_per_inch / view.half_height
        self._line_unit = height * points_per_inch / 900

    def balls(
        self,
        points: np.ndarray,
        width: float,
        colors: str | np.ndarray,
        layer: Layer,
        *,
        lit: bool = True,
        rim: bool = False,
    ) -> None:
        flat = self.view.project(points)
        order = np.argsort(flat[:, 2], kind="stable")
        edge = 0.2 * width * self._scale if rim else 0.0
        self._axes.scatter(
            flat[order, 0],
            flat[order, 1],
            s=(width * self._scale + edge) ** 2,
            c=colors if isinstance(colors, str) else colors[order],
            edgecolors="white" if rim else "none",
            linewidths=edge,
            zorder=layer.order,
        )

    def flat(self, points: np.ndarray, triangles: np.ndarray, color: str, layer: Layer) -> None:
        self._polygons(self.view.project(points)[:, :2][triangles], color, layer.order)

    def solids(self, obstacles: tuple[DrawnSolid, ...], snapshot: Snapshot) -> None:
        body = snapshot.body
        colors = snapshot.colors
        solids = [
            (
                TriangleSurface(o.points, o.triangles, np.full(len(o.triangles), o.hollow)),
                style.rgb(o.color),
            )
            for o in obstacles
        ]
        if isinstance(body, Balls):
            middle = float((body.points @ self.view.toward).mean())
            for solid, color in solids:
                near = float((solid.points @ self.view.toward).mean()) > middle
                self._shaded(
                    solid,
                    np.tile(color, (len(solid.triangles), 1)),
                    BODY.order + (1.0 if near else -0.5),
                )
            colors = (
                colors * self.view.brightness(outward(body, snapshot.axis), contrast=0.25)[:, None]
            )
            self.balls(body.points, style.BALL_WIDTH * body.size, colors, BODY)
            return
        shape = TriangleSurface(
            body.points.astype(float), body.triangles, np.zeros(len(body.triangles), dtype=bool)
        )
        colors = np.vstack(
            [colors, *(np.tile(color, (len(solid.triangles), 1)) for solid, color in solids)]
        )
        self._shaded(
            TriangleSurface.joined([shape, *(solid for solid, _ in solids)]), colors, BODY.order
        )

    def lines(self, segments: np.ndarray, color: str, width: float, layer: Layer) -> None:
        flat = self.view.project(segments.reshape(-1, 3))[:, :2].reshape(-1, 2, 2)
        lines = LineCollection(
            list(flat), colors=color, linewidths=width * self._line_unit, zorder=layer.order
        )
        self._axes.add_collection(lines, autolim=False)

    def arrow(
        self,
        start: np.ndarray,
        vector: np.ndarray,
        width: float,
        color: str,
        layer: Layer,
        *,
        halo: bool = False,
    ) -> None:
        """An arrow as it is seen: one that points at the viewer comes out short."""
        ends = self.view.project(np.stack([start, start + vector]))[:, :2]
        thick = width * self._scale
        seen = float(np.linalg.norm(ends[1] - ends[0])) * self.view.half_height * self._scale
        head = min(2.6 * thick, max(0.6 * seen, 0.1))
        for each, grow, order in (
            ("white", 0.7 * thick, layer.order),
            (color, 0.0, layer.order + 0.1),
        ):
            if halo or grow == 0.0:
                arrow = FancyArrowPatch(
                    tuple(ends[0]),
                    tuple(ends[1]),
                    arrowstyle=(
                        f"simple,head_length={head},head_width={2.5 * thick},tail_width={thick}"
                    ),
                    shrinkA=0.0,
                    shrinkB=0.0,
                    mutation_scale=1.0,
                    facecolor=each,
                    edgecolor=each,
                    linewidth=grow,
                    joinstyle="miter",
                    zorder=order,
                    clip_on=False,
                )
                self._axes.add_patch(arrow)

    def _shaded(self, surface: TriangleSurface, colors: np.ndarray, order: float) -> None:
        """Triangles in colors (m, 3), the farthest first. The surface's part (m,) says what is hollow: of that only the far side."""
        corners = surface.points[surface.triangles]
        hollow = surface.part
        face = face_normals(corners)
        face /= np.maximum(np.linalg.norm(face, axis=1, keepdims=True), 1e-300)
        seen = (face @ self.view.toward > 0) != hollow
        light = self.view.brightness(
            np.where(hollow[seen, None], -face[seen], face[seen]), contrast=0.3
        )
        flat = self.view.project(corners[seen].reshape(-1, 3)).reshape(-1, 3, 3)
        far_first = np.argsort(flat[:, :, 2].mean(axis=1))
        color = np.clip(colors[seen] * light[:, None], 0.0, 1.0)
        self._polygons(flat[far_first, :, :2], color[far_first], order)

    def _polygons(self, flat: np.ndarray, colors: str | np.ndarray, order: float) -> None:
        """Polygons (m, 3, 2). Edges of the faces' own color close the hairlines between them."""
        faces = PolyCollection(
            list(flat), facecolors=colors, edgecolors=colors, linewidths=0.3, zorder=order
        )
        self._axes.add_collection(faces, autolim=False)
