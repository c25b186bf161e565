"""A moment of a motion drawn in three dimensions, off screen, in the window that viz.scene3d keeps."""

from __future__ import annotations

import numpy as np

from viz import stage_layout, stage_page, style
from viz.canvas import Canvas, PanelCanvas
from viz.layout import compass_view
from viz.shapes import normals
from viz.stage import Shot, Stage, floor_colours
from viz.stage_layout import Layout


def draw(canvas: Canvas, stage: Stage, shot: Shot, size: tuple[int, int], layout: Layout) -> np.ndarray:
    """The stage as an image (height, width, 3) uint8."""
    views = stage_layout.views(shot, size, layout)
    canvas.clear(size)
    for place, view in zip(layout.mains, views):
        _main(canvas.panel(place, view, shot.reach), stage, shot)
    for place, view in zip(layout.compasses, views):
        compass = canvas.panel(place, compass_view(view), reach=10.0)
        for _, vector in stage_layout.compass_arrows(stage):
            compass.arrow(np.zeros(3), vector, 0.05, style.FAINT_INK)
    field = stage_layout.field_arrow(stage)
    if field is not None and layout.field is not None:
        arrow = canvas.panel(layout.field, compass_view(views[0]), reach=10.0, over=True)
        arrow.arrow(-0.5 * field, field, stage_layout.field_width(field), style.FIELD)
    image = canvas.image(fine=not layout.written or size[0] > style.TRIAL_SIZE[0])
    return stage_page.written_on(image, stage, views, layout) if layout.written else image


def _main(panel: PanelCanvas, stage: Stage, shot: Shot) -> None:
    """Ground, what stands around, body and signs."""
    _floor(panel, stage, shot)
    for prop in stage.props:
        smooth = normals(prop.points, prop.triangles)
        panel.surface(prop.points, prop.triangles, prop.colour, normals=smooth, only_far_side=prop.hollow)
    points, triangles = stage.points.astype(float), stage.triangles
    panel.surface(points, triangles, stage.colours, normals=normals(points, triangles), glossy=True)
    _signs(panel, stage, 0.3 * shot.reach)


def _signs(panel: PanelCanvas, stage: Stage, lift: float) -> None:
    """Arrows and marks, moved towards the camera so that the body does not hide them."""
    width, halo = stage.arrow_width, 0.35 * stage.arrow_width
    strong = 1.3 * style.ARROW_WIDTH * stage.thickness
    if len(stage.trace) > 1:
        pairs = np.stack([stage.trace[:-1], stage.trace[1:]], axis=1)
        panel.lines(pairs, style.TRACE, 2.0)
    for start, vector in stage.arrows:
        if np.linalg.norm(vector) > 2 * width:
            panel.arrow(panel.view.lift(start, lift), vector, width, style.MAGNETISATION, halo=halo)
    if len(stage.contact):
        # On the ground just above the shadow, elsewhere on the body.
        height = 8e-3 * stage.length if stage.ground is not None else 0.1 * stage.thickness
        panel.balls(panel.view.lift(stage.contact, height), 0.1 * stage.thickness, style.CONTACT, lit=False)
    for start, vector in stage.pushes:
        thick = min(strong, 0.12 * float(np.linalg.norm(vector)))
        panel.arrow(panel.view.lift(start, 1.2 * lift), vector, thick, style.CONTACT, halo=0.3 * thick)


def _floor(panel: PanelCanvas, stage: Stage, shot: Shot) -> None:
    """The ground, or a faint floor below everything: squares as wide as the scale bar is long, and shadows."""
    layer = 2e-3 * stage.length
    fill, grid, shade = floor_colours(stage.ground)
    corners = shot.floor()
    panel.surface(corners, np.array([[0, 1, 2], [0, 2, 3]]), fill, lit=False)
    panel.lines(panel.view.lift(shot.floor_lines(stage.unit), layer), grid, 1.4)
    dropped = shot.plane.dropped(stage.points.astype(float))
    panel.surface(panel.view.lift(dropped, 2 * layer), stage.triangles, shade, lit=False)
    if len(stage.contact):
        # Just above the shadow: marks of where the body stands.
        panel.balls(
            panel.view.lift(stage.contact, 4 * layer), 0.1 * stage.thickness, style.CONTACT, lit=False
        )
