"""Drawing of a snapshot: the same for every renderer, which brings the canvas.

A canvas is an image with panels, each seen in its own view. Layers say what is in front: of what lies flat, by thin steps; of signs
that the body must not hide, by a share of the camera's distance. In a parallel projection that changes what hides what, and nothing else.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from magmpm.viz import style
from magmpm.viz.annotations import compass_arrows, field_arrow, written
from magmpm.viz.camera import Framing, View
from magmpm.viz.layout import Layout, Panel, Views
from magmpm.viz.snapshot import Balls, DrawnSolid, Snapshot


@dataclass(frozen=True)
class Layer:
    """order: what is drawn later hides what was drawn before. steps, share: how far toward the camera, in THIN_LINE and in its distance."""

    order: float
    steps: float = 0.0
    share: float = 0.0


FLOOR = Layer(1.0)
GRID = Layer(1.1, 1)
SHADOW = Layer(1.2, 2)
GROUND_MARK = Layer(1.3, 4)
TARGET_SHADOW = Layer(1.3, 40)  # clear of the shadow of balls, which is as thick as they are
TRACE = Layer(2.5)
BODY = Layer(3.0)
BODY_MARK = Layer(3.5, 5)
AXIS = Layer(5.0, 0, 0.1)
TARGET = Layer(6.0, 0, 0.2)
ARROW = Layer(7.0, 0, 0.3)
FORCE = Layer(8.0, 0, 0.36)


class PanelCanvas(Protocol):
    """One panel of a canvas; places in meters. colors: one for all, or (n, 3) in 0..1, one for each."""

    view: View

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
        """Balls of that width (m) at points (n, 3) m; rim: with white around them."""

    def flat(self, points: np.ndarray, triangles: np.ndarray, color: str, layer: Layer) -> None:
        """Triangles (m, 3) between points (n, 3) m, without light or shade."""

    def solids(self, obstacles: tuple[DrawnSolid, ...], snapshot: Snapshot) -> None:
        """Obstacles and body, lit."""

    def lines(self, segments: np.ndarray, color: str, width: float, layer: Layer) -> None:
        """Straight lines between points (n, 2, 3) m; width in pixels of a page 900 pixels high."""

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
        """An arrow from start (3,) along vector (3,), its shaft `width` thick, all in m; halo: with a white rim."""


class Canvas(Protocol):
    """An image to draw on."""

    def clear(self, size: tuple[int, int], thin: float) -> None:
        """Start a picture of that width and height in pixels; thin: m, a step between flat layers."""

    def panel(self, place: Panel, view: View, reach: float) -> PanelCanvas:
        """A panel seen in that view, as near and as far as `reach` (m) from its center. It does not cover what is there already."""

    def image(self, *, fine: bool) -> np.ndarray:
        """Image of what was drawn, (height, width, 3) uint8; fine: with edges as smooth as can be."""


def draw(
    canvas: Canvas, snapshot: Snapshot, framing: Framing, size: tuple[int, int], layout: Layout
) -> np.ndarray:
    """The snapshot as an image (height, width, 3) uint8 of that width and height."""
    # of the body's length: a step between flat layers; closer ones would fight for one depth
    thin_line = 2e-3
    views = Views.of(framing, layout, size[0] / size[1])
    canvas.clear(size, thin_line * snapshot.length)
    for place, view in zip(layout.mains, views.mains):
        main = canvas.panel(place, view, framing.reach)
        _floor(main, snapshot, framing)
        _body(main, snapshot)
        _signs(main, snapshot)
    for inset, view in zip(layout.insets, views.insets):
        _body(canvas.panel(inset.panel, view, framing.reach), snapshot)
    for place, view in zip(layout.compasses, views.mains):
        compass = canvas.panel(place, view.compass(), 10.0)
        for _, vector in compass_arrows(snapshot):
            compass.arrow(np.zeros(3), vector, 0.05, style.FAINT_INK, BODY)
    field = field_arrow(snapshot)
    if field is not None:
        # A weak field's arrow is thin as well as short.
        width = min(0.2, 0.3 * float(np.linalg.norm(field)))
        canvas.panel(layout.field, views.mains[0].compass(), 10.0).arrow(
            -0.5 * field, field, width, style.FIELD, BODY
        )
    image = canvas.image(fine=layout.legend is None or size[0] > style.TRIAL_SIZE[0])
    return image if layout.legend is None else written(image, snapshot, views, layout)


def _floor(panel: PanelCanvas, snapshot: Snapshot, framing: Framing) -> None:
    """The ground, or a faint floor below everything: squares as wide as the scale bar is long, and shadows."""
    fill, grid, shade = style.floor_colors(snapshot.ground is not None)
    panel.flat(framing.floor(), np.array([[0, 1, 2], [0, 2, 3]]), fill, FLOOR)
    panel.lines(framing.floor_lines(snapshot.unit), grid, 1.4, GRID)
    body = snapshot.body
    plane = framing.plane
    dropped = plane.dropped(body.points.astype(float))
    if isinstance(body, Balls):
        panel.balls(dropped, style.BALL_WIDTH * body.size, shade, SHADOW, lit=False)
    else:
        panel.flat(dropped, body.triangles, shade, SHADOW)
    if snapshot.target is not None:
        width = 0.7 * style.DOT_WIDTH * snapshot.thickness
        panel.balls(
            plane.dropped(snapshot.target), width, style.TARGET_SHADOW, TARGET_SHADOW, lit=False
        )


def _body(panel: PanelCanvas, snapshot: Snapshot) -> None:
    """Obstacles, body, axis and target."""
    panel.solids(snapshot.obstacles, snapshot)
    if len(snapshot.axis) > 1:
        panel.lines(pairs(snapshot.axis), style.INK, 1.5, AXIS)
    if snapshot.target is not None:
        panel.balls(
            snapshot.target, style.DOT_WIDTH * snapshot.thickness, style.TARGET, TARGET, rim=True
        )


def _signs(panel: PanelCanvas, snapshot: Snapshot) -> None:
    """Trace, arrows and marks of contact."""
    for start, vector in snapshot.fields:
        panel.arrow(
            start,
            vector,
            min(1.5 * snapshot.arrow_width, 0.15 * float(np.linalg.norm(vector))),
            style.FIELD,
            ARROW,
            halo=True,
        )
    if len(snapshot.trace) > 1:
        panel.lines(pairs(snapshot.trace), style.TRACE, 2.0, TRACE)
    for start, vector in snapshot.arrows:
        if np.linalg.norm(vector) > 2 * snapshot.arrow_width:
            panel.arrow(start, vector, snapshot.arrow_width, style.MAGNETIZATION, ARROW, halo=True)
    if len(snapshot.contact):
        # On the ground just above the shadow, elsewhere on the body.
        layer = GROUND_MARK if snapshot.ground is not None else BODY_MARK
        panel.balls(
            snapshot.contact, style.MARK_WIDTH * snapshot.thickness, style.CONTACT, layer, lit=False
        )
    for start, vector in snapshot.pushes:
        width = min(
            1.3 * style.ARROW_WIDTH * snapshot.thickness, 0.12 * float(np.linalg.norm(vector))
        )
        panel.arrow(start, vector, width, style.CONTACT, FORCE, halo=True)


def outward(body: Balls, axis: np.ndarray) -> np.ndarray:
    """Unit direction (n, 3) from the body's axis (m, 3) m, or from its middle, to each particle: balls are shaded by it, so that the
    body reads as a bent rod and not as a band of balls."""
    axis = (axis if len(axis) > 1 else body.points.mean(axis=0)[None]).astype(np.float32)
    axis = axis[:: max(len(axis) // 40, 1)]
    # |p - a|^2 without |p|^2, which is the same for all a: one matrix product instead of an (n, m, 3) array.
    nearest = np.argmin((axis**2).sum(axis=1) - 2.0 * (body.points @ axis.T), axis=1)
    away = (body.points - axis[nearest]).astype(float)
    return np.asarray(away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12))


def pairs(points: np.ndarray) -> np.ndarray:
    """(n, 3) points along a line -> (n - 1, 2, 3) its segments."""
    return np.stack([points[:-1], points[1:]], axis=1)
