"""The same picture drawn by matplotlib alone: what is used where no OpenGL library is found.

matplotlib's own three dimensions sort whole groups of points, not points, so a body that bends before
itself comes out wrong. The projection is parallel and known (viz.camera), so everything is projected here
and drawn flat, the farthest ball first, each shaded by how its place on the body faces the light.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, Rectangle

from viz import layout, style
from viz.camera import Frame, View
from viz.picture import Picture
from viz.shade import brightness, outward

_POINTS_PER_INCH = 72.0
_DPI = 100.0


def draw(
    picture: Picture, frame: Frame | None = None, size: tuple[int, int] = style.TRIAL_SIZE
) -> np.ndarray:
    """The picture as an image (height, width, 3) uint8, laid out and seen as viz.scene3d draws it."""
    frame = Frame.of(picture) if frame is None else frame
    figure = Figure(figsize=(size[0] / _DPI, size[1] / _DPI), dpi=_DPI, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    views = layout.Views.of(frame, size[0] / size[1])
    main = FlatPanel(figure, layout.MAIN, views.main)
    _floor(main, picture, frame)
    _body(main, picture)
    for start, vector in style.magnetisation_arrows(picture):
        main.arrow(start, vector, style.ARROW_WIDTH * picture.thickness, style.MAGNETISATION, halo=True)
    for place, view in ((layout.TOP, views.top), (layout.SIDE, views.side)):
        _body(FlatPanel(figure, place, view, framed=True), picture)
    around = layout.compass_view(views.main)
    compass = FlatPanel(figure, layout.COMPASS, around)
    for _, vector in layout.compass_arrows(picture):
        compass.arrow(np.zeros(3), vector, 0.04, style.FAINT_INK)
    field = layout.field_arrow(picture)
    if field is not None:
        FlatPanel(figure, layout.FIELD, around).arrow(-0.5 * field, field, 0.2, style.FIELD)
    _write(figure, picture, views)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[:, :, :3].copy()


class FlatPanel:
    """One panel of the page; places in metres, projected by its view."""

    def __init__(self, figure: Figure, place: layout.Panel, view: View, framed: bool = False) -> None:
        self.view = view
        width, height = figure.get_size_inches()
        self.axes = figure.add_axes(
            (place.left, place.bottom, place.right - place.left, place.top - place.bottom)
        )
        self.axes.set_xlim(-place.aspect(width / height), place.aspect(width / height))
        self.axes.set_ylim(-1.0, 1.0)
        self.axes.set_xticks([])
        self.axes.set_yticks([])
        self.axes.patch.set_visible(False)
        for spine in self.axes.spines.values():
            spine.set_visible(framed)
            spine.set_color(style.FRAME)
        # Points (1/72 inch) to a metre: widths of balls and lines are given to matplotlib in points.
        self.scale = 0.5 * height * (place.top - place.bottom) * _POINTS_PER_INCH / view.half_height
        self.line_unit = height * _POINTS_PER_INCH / 900

    def balls(self, points: np.ndarray, width: float, colours: Any, zorder: float, rim: float = 0.0) -> None:
        """Discs of that width (m), the farthest first; colours: one or (n, 3); rim: m of white around."""
        flat = self.view.project(points)
        order = np.argsort(flat[:, 2], kind="stable")
        self.axes.scatter(
            flat[order, 0],
            flat[order, 1],
            s=((width + rim) * self.scale) ** 2,
            c=colours if isinstance(colours, str) else colours[order],
            edgecolors="white" if rim else "none",
            linewidths=rim * self.scale,
            zorder=zorder,
        )

    def lines(self, segments: np.ndarray, colour: str, width: float, zorder: float) -> None:
        """Lines between points (n, 2, 3) m; width in pixels of a page 900 pixels high."""
        flat = self.view.project(segments.reshape(-1, 3))[:, :2].reshape(-1, 2, 2)
        self.axes.add_collection(
            LineCollection(list(flat), colors=colour, linewidths=width * self.line_unit, zorder=zorder),
            autolim=False,
        )

    def faces(self, corners: list[np.ndarray], colour: str, zorder: float) -> None:
        """Flat polygons, each (n, 3) m."""
        flat = [self.view.project(points)[:, :2] for points in corners]
        self.axes.add_collection(
            PolyCollection(flat, facecolors=colour, edgecolors="none", zorder=zorder), autolim=False
        )

    def surface(
        self,
        points: np.ndarray,
        triangles: np.ndarray,
        colours: np.ndarray,
        zorder: float,
        hollow: np.ndarray | bool = False,
    ) -> None:
        """Triangles (m, 3) between points (n, 3) m in colours (m, 3), the farthest first; of what is hollow, (m,), the far side only."""
        a, b, c = (points[triangles[:, i]] for i in range(3))
        face = np.cross(b - a, c - a)
        face /= np.maximum(np.linalg.norm(face, axis=1, keepdims=True), 1e-300)
        hollow = np.broadcast_to(hollow, len(triangles))
        seen = (face @ self.view.toward > 0) != hollow
        light = brightness(np.where(hollow, -1.0, 1.0)[seen, None] * face[seen], self.view, contrast=0.3)
        corner = np.stack([a[seen], b[seen], c[seen]], axis=1)
        colour = np.clip(colours[seen] * light[:, None], 0.0, 1.0)
        flat = self.view.project(corner.reshape(-1, 3)).reshape(-1, 3, 3)
        order = np.argsort(flat[:, :, 2].mean(axis=1))
        self.axes.add_collection(
            # Edges of the faces' own colour close the hairlines between them.
            PolyCollection(
                list(flat[order, :, :2]),
                facecolors=colour[order],
                edgecolors=colour[order],
                linewidths=0.3,
                zorder=zorder,
            ),
            autolim=False,
        )

    def arrow(
        self, start: np.ndarray, vector: np.ndarray, width: float, colour: str, halo: bool = False
    ) -> None:
        """An arrow as it is seen; one that points at the viewer comes out short."""
        ends = self.view.project(np.stack([start, start + vector]))[:, :2]
        thick = width * self.scale
        seen = float(np.linalg.norm(ends[1] - ends[0])) * self.view.half_height * self.scale
        head = min(2.6 * thick, max(0.6 * seen, 0.1))
        for colours, grow, order in (("white", 0.7 * thick, 7.0), (colour, 0.0, 7.1)):
            if halo or grow == 0.0:
                self.axes.add_patch(
                    FancyArrowPatch(
                        tuple(ends[0]),
                        tuple(ends[1]),
                        arrowstyle=f"simple,head_length={head},head_width={2.5 * thick},tail_width={thick}",
                        shrinkA=0.0,
                        shrinkB=0.0,
                        mutation_scale=1.0,
                        facecolor=colours,
                        edgecolor=colours,
                        linewidth=grow,
                        joinstyle="miter",
                        zorder=order,
                        clip_on=False,
                    )
                )


def _body(panel: FlatPanel, picture: Picture) -> None:
    """Clamp, magnets, particles or surface, axis and target."""
    if picture.clamp is not None:
        turn = np.linspace(0.0, 2.0 * np.pi, 49)
        circle = np.stack([0 * turn, np.cos(turn), np.sin(turn)], axis=1)
        rim = picture.clamp + style.CLAMP_RADIUS * picture.diameter * circle
        back = rim - np.array([style.CLAMP_THICKNESS * picture.diameter, 0.0, 0.0])
        behind = panel.view.toward[0] >= 0
        edge = [np.stack([rim[k], rim[k + 1], back[k + 1], back[k]]) for k in range(48)]
        panel.faces(edge, style.CLAMP_EDGE, 2.0 if behind else 4.0)
        panel.faces([rim if behind else back], style.CLAMP, 2.1 if behind else 4.1)
    middle = float(picture.axis.mean(axis=0) @ panel.view.toward)
    for prop in picture.props:
        near = float(prop.points.mean(axis=0) @ panel.view.toward) > middle
        panel.surface(prop.points, prop.triangles, np.tile(style.rgb(prop.colour), (len(prop.triangles), 1)), 4.5 if near else 2.5)
    colours = style.segment_colours(picture.magnetised)
    if picture.surface is not None:
        points = picture.surface.points.astype(float)
        panel.surface(points, picture.surface.triangles, colours[picture.surface.part], 3.0)
    else:
        colours = colours[picture.particle_segment]
        colours *= brightness(outward(picture), panel.view, contrast=0.25)[:, None]
        panel.balls(picture.particles, style.BALL_WIDTH * picture.particle_size, colours, 3.0)
    axis = picture.axis
    panel.lines(np.stack([axis[:-1], axis[1:]], axis=1), style.INK, 1.5, 5.0)
    if picture.target is not None:
        width = style.DOT_WIDTH * picture.thickness
        panel.balls(
            style.thinned(picture.target, style.TARGET_DOTS), width, style.TARGET, 6.0, rim=0.2 * width
        )


def _floor(panel: FlatPanel, picture: Picture, frame: Frame) -> None:
    """A grid of squares as wide as the scale bar is long, with the shadows of body and target."""
    low, high = frame.floor
    z = low[2]
    corners = np.array(
        [(low[0], low[1], z), (high[0], low[1], z), (high[0], high[1], z), (low[0], high[1], z)]
    )
    panel.faces([corners], style.FLOOR, 1.0)
    panel.lines(layout.floor_lines(frame, layout.unit(picture)), style.GRID, 1.2, 1.1)
    body, target = layout.shadows(picture, frame)
    if picture.surface is not None:
        panel.faces(list(body[picture.surface.triangles]), style.SHADOW, 1.2)
    else:
        panel.balls(body, style.BALL_WIDTH * picture.particle_size, style.SHADOW, 1.2)
    if target is not None:
        panel.balls(target, 0.7 * style.DOT_WIDTH * picture.thickness, style.TARGET_SHADOW, 1.3)


def _write(figure: Figure, picture: Picture, views: layout.Views) -> None:
    """Title, caption, labels, scale bar and legend."""
    width, height = figure.get_size_inches()
    points = height * _POINTS_PER_INCH

    def text(words: str, x: float, y: float, size: float, colour: str = style.INK, **kind: Any) -> None:
        figure.text(
            x, y, words.replace("$", r"\$"), fontsize=size * points, color=colour, va="center", **kind
        )

    text(layout.title_text(picture), 0.02, layout.TITLE_Y, style.TEXT_LARGE)
    text(picture.caption(), 0.985, layout.TITLE_Y, style.TEXT_LARGE, style.caption(picture.mark), ha="right", weight="bold")
    for panel, name in ((layout.TOP, layout.TOP_NAME), (layout.SIDE, layout.SIDE_NAME)):
        text(name, panel.left + 0.008, panel.top - 0.024, style.TEXT_SMALL, style.FAINT_INK)
    for label in layout.compass_labels(picture, views.main, width / height):
        text(label.text, label.x, label.y, style.TEXT_SMALL, style.FAINT_INK, ha="center")
    text(layout.field_text(picture), layout.FIELD_TEXT_X, layout.FIELD_TEXT_Y, style.TEXT_MEDIUM, style.FIELD)
    bar = layout.scale_bar(views.main, layout.MAIN, layout.MAIN.aspect(width / height), layout.unit(picture))
    page = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    page.set_axis_off()
    page.set_xlim(0.0, 1.0)
    page.set_ylim(0.0, 1.0)
    thick = 0.0025 * points
    page.plot([bar.left, bar.right], [bar.y, bar.y], color=style.INK, linewidth=thick)
    for x in np.linspace(bar.left, bar.right, 6):
        tall = 0.009 if x in (bar.left, bar.right) else 0.0045
        page.plot([x, x], [bar.y - tall, bar.y + tall], color=style.INK, linewidth=thick)
    text(style.in_mm(bar.unit), (bar.left + bar.right) / 2, bar.y - 0.036, style.TEXT_MEDIUM, ha="center")
    for item in layout.legend(picture):
        text(item.text, item.x + layout.LEGEND_GAP, item.y, style.TEXT_SMALL)
        _mark(page, item, width / height, points)


def _mark(page: Any, item: layout.LegendItem, aspect: float, points: float) -> None:
    """The sign before a legend's text."""
    half_height = 0.013
    half = half_height / aspect
    if item.mark == "swatch":
        wide = 2 * half / len(item.colours)
        for k, colour in enumerate(item.colours):
            corner = (item.x - half + k * wide, item.y - 0.8 * half_height)
            page.add_patch(Rectangle(corner, wide, 1.6 * half_height, facecolor=colour, edgecolor="none"))
    elif item.mark == "dot":
        page.scatter(
            [item.x], [item.y], s=(1.4 * half_height * points) ** 2, c=item.colours[0], edgecolors="none"
        )
    else:
        style_of = "-" if item.mark == "line" else "simple,head_length=0.9,head_width=1.2,tail_width=0.35"
        page.add_patch(
            FancyArrowPatch(
                (item.x - half, item.y),
                (item.x + half, item.y),
                arrowstyle=style_of,
                mutation_scale=half_height * points,
                shrinkA=0.0,
                shrinkB=0.0,
                color=item.colours[0],
                linewidth=1.0 if item.mark == "line" else 0.0,
            )
        )
