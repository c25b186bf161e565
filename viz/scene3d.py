"""The picture drawn in three dimensions, off screen, in a window that is used again for every picture."""

from __future__ import annotations

import numpy as np
import pyvista as pv

from viz import layout, page, stage3d, stage_layout, style
from viz.camera import Frame
from viz.canvas import Canvas, PanelCanvas
from viz.picture import Picture
from viz.shade import brightness, outward
from viz.shapes import normals
from viz.stage import Shot, Stage


class Scene3D:
    """Draws pictures one after another. Without OpenGL the process ends here, and no exception is raised."""

    def __init__(self) -> None:
        self._canvas = Canvas()

    def stage(
        self, stage: Stage, shot: Shot, size: tuple[int, int], layout: stage_layout.Layout
    ) -> np.ndarray:
        """A moment of a motion as an image (height, width, 3) uint8."""
        return stage3d.draw(self._canvas, stage, shot, size, layout)

    def draw(
        self, picture: Picture, frame: Frame | None = None, size: tuple[int, int] = style.TRIAL_SIZE
    ) -> np.ndarray:
        """The picture as an image (height, width, 3) uint8; frame: what is in view, else body and target."""
        frame = Frame.of(picture) if frame is None else frame
        views = layout.Views.of(frame, size[0] / size[1])
        # Things are moved towards the camera by up to six lengths, see _body.
        reach = 10.0 * picture.length + float(np.ptp(frame.points, axis=0).max())
        self._canvas.clear(size)
        main = self._canvas.panel(layout.MAIN, views.main, reach)
        _floor(main, picture, frame)
        _body(main, picture)
        _magnetisation(main, picture)
        for place, view in ((layout.TOP, views.top), (layout.SIDE, views.side)):
            _body(self._canvas.panel(place, view, reach), picture)
        around = layout.compass_view(views.main)
        _compass(self._canvas.panel(layout.COMPASS, around, reach=10.0), picture)
        _field(self._canvas.panel(layout.FIELD, around, reach=10.0), picture)
        return page.written_on(self._canvas.image(fine=size[0] > style.TRIAL_SIZE[0]), picture, views)

    def close(self) -> None:
        """Give the window back."""
        self._canvas.close()


def _body(panel: PanelCanvas, picture: Picture) -> None:
    """Clamp, magnets, particles or surface, axis and target.

    What the body must not hide is moved towards the camera: in a parallel projection that changes what hides
    what, and nothing else.
    """
    thickness = style.CLAMP_THICKNESS * picture.diameter
    if picture.clamp is not None:
        plate = pv.Cylinder(
            center=picture.clamp - np.array([0.5 * thickness, 0, 0]),
            direction=(1, 0, 0),
            radius=style.CLAMP_RADIUS * picture.diameter,
            height=thickness,
            resolution=48,
        )
        panel.solid(plate, style.CLAMP)
    for prop in picture.props:
        smooth = normals(prop.points, prop.triangles)
        panel.surface(prop.points, prop.triangles, prop.colour, normals=smooth, only_far_side=prop.hollow)
    colours = style.segment_colours(picture.magnetised)
    if picture.surface is not None:
        points, triangles = picture.surface.points.astype(float), picture.surface.triangles
        smooth = normals(points, triangles)
        panel.surface(points, triangles, colours[picture.surface.part], normals=smooth, glossy=True)
    else:
        colours = colours[picture.particle_segment]
        colours *= brightness(outward(picture), panel.view, contrast=0.15)[:, None]
        panel.balls(picture.particles, style.BALL_WIDTH * picture.particle_size, colours)
    panel.lines(_pairs(panel.view.lift(picture.axis, 2 * picture.length)), style.INK, 1.5)
    if picture.target is not None:
        dots = panel.view.lift(style.thinned(picture.target, style.TARGET_DOTS), 4 * picture.length)
        width = style.DOT_WIDTH * picture.thickness
        panel.balls(dots - width * panel.view.toward, 1.4 * width, "#FFFFFF", lit=False)
        panel.balls(dots, width, style.TARGET)


def _magnetisation(panel: PanelCanvas, picture: Picture) -> None:
    for start, vector in style.magnetisation_arrows(picture):
        width, halo = style.ARROW_WIDTH * picture.thickness, style.ARROW_HALO * picture.thickness
        panel.arrow(panel.view.lift(start, 6 * picture.length), vector, width, style.MAGNETISATION, halo=halo)


def _floor(panel: PanelCanvas, picture: Picture, frame: Frame) -> None:
    """A grid of squares as wide as the scale bar is long, with the shadows of body and target."""
    # Each layer a little nearer to the camera than the one below, or they would fight for one depth.
    layer = 2e-3 * picture.length
    low, high = frame.floor
    corners = [(low[0], low[1], low[2]), (high[0], low[1], low[2]), (high[0], high[1], low[2])]
    panel.solid(pv.Rectangle(corners), style.FLOOR, lit=False)
    panel.lines(panel.view.lift(layout.floor_lines(frame, layout.unit(picture)), layer), style.GRID, 1.2)
    body, target = layout.shadows(picture, frame)
    body = panel.view.lift(body, 2 * layer)
    if picture.surface is not None:
        panel.surface(body, picture.surface.triangles, style.SHADOW, lit=False)
    else:
        panel.balls(body, style.BALL_WIDTH * picture.particle_size, style.SHADOW, lit=False)
    if target is not None:
        width = 0.7 * style.DOT_WIDTH * picture.thickness
        panel.balls(
            panel.view.lift(target, 2 * layer + picture.diameter), width, style.TARGET_SHADOW, lit=False
        )


def _compass(panel: PanelCanvas, picture: Picture) -> None:
    for _, vector in layout.compass_arrows(picture):
        panel.arrow(np.zeros(3), vector, 0.04, style.FAINT_INK)


def _field(panel: PanelCanvas, picture: Picture) -> None:
    vector = layout.field_arrow(picture)
    if vector is not None:
        panel.arrow(-0.5 * vector, vector, 0.2, style.FIELD)


def _pairs(points: np.ndarray) -> np.ndarray:
    """(n, 3) points along a line -> (n - 1, 2, 3) its segments."""
    return np.stack([points[:-1], points[1:]], axis=1)
