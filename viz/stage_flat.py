"""A moment of a motion drawn by matplotlib alone: what is used where no OpenGL library is found.

The projection is parallel and known, so every triangle is projected here and drawn flat, the farthest first.
"""

from __future__ import annotations

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from viz import stage_layout, stage_page, style
from viz.layout import compass_view
from viz.matplotlib_scene import FlatPanel
from viz.shapes import Surface
from viz.stage import Shot, Stage, floor_colours
from viz.stage_layout import Layout

_DPI = 100.0


def draw(stage: Stage, shot: Shot, size: tuple[int, int], layout: Layout) -> np.ndarray:
    """The stage as an image (height, width, 3) uint8, laid out and seen as viz.stage3d draws it."""
    figure = Figure(figsize=(size[0] / _DPI, size[1] / _DPI), dpi=_DPI, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    views = stage_layout.views(shot, size, layout)
    for place, view in zip(layout.mains, views):
        main = FlatPanel(figure, place, view)
        _floor(main, stage, shot)
        _solids(main, stage)
        _signs(main, stage)
    for place, view in zip(layout.compasses, views):
        compass = FlatPanel(figure, place, compass_view(view))
        for _, vector in stage_layout.compass_arrows(stage):
            compass.arrow(np.zeros(3), vector, 0.05, style.FAINT_INK)
    field = stage_layout.field_arrow(stage)
    if field is not None and layout.field is not None:
        arrow = FlatPanel(figure, layout.field, compass_view(views[0]))
        arrow.arrow(-0.5 * field, field, stage_layout.field_width(field), style.FIELD)
    canvas.draw()
    image = np.asarray(canvas.buffer_rgba())[:, :, :3].copy()
    return stage_page.written_on(image, stage, views, layout) if layout.written else image


def _solids(panel: FlatPanel, stage: Stage) -> None:
    """Body and props as one heap of triangles; of a hollow prop the far side, of all else the near one."""
    colours = [stage.colours, *(np.tile(style.rgb(p.colour), (len(p.triangles), 1)) for p in stage.props)]
    whole = Surface.joined(
        [
            Surface(points, triangles, np.full(len(triangles), part))
            for points, triangles, part in [
                (stage.points.astype(float), stage.triangles, False),
                *((p.points, p.triangles, p.hollow) for p in stage.props),
            ]
        ]
    )
    panel.surface(whole.points, whole.triangles, np.vstack(colours), 3.0, hollow=whole.part)


def _signs(panel: FlatPanel, stage: Stage) -> None:
    width, strong = stage.arrow_width, 1.3 * style.ARROW_WIDTH * stage.thickness
    if len(stage.trace) > 1:
        panel.lines(np.stack([stage.trace[:-1], stage.trace[1:]], axis=1), style.TRACE, 2.0, 2.5)
    for start, vector in stage.arrows:
        if np.linalg.norm(vector) > 2 * width:
            panel.arrow(start, vector, width, style.MAGNETISATION, halo=True)
    if len(stage.contact):
        panel.balls(
            stage.contact, 0.1 * stage.thickness, style.CONTACT, 1.3 if stage.ground is not None else 3.5
        )
    for start, vector in stage.pushes:
        thick = min(strong, 0.12 * float(np.linalg.norm(vector)))
        panel.arrow(start, vector, thick, style.CONTACT, halo=True)


def _floor(panel: FlatPanel, stage: Stage, shot: Shot) -> None:
    fill, grid, shade = floor_colours(stage.ground)
    panel.faces([shot.floor()], fill, 1.0)
    panel.lines(shot.floor_lines(stage.unit), grid, 1.4, 1.1)
    dropped = shot.plane.dropped(stage.points.astype(float))
    flat = panel.view.project(dropped)[:, :2][stage.triangles]
    panel.axes.add_collection(
        PolyCollection(list(flat), facecolors=shade, edgecolors=shade, linewidths=0.3, zorder=1.2),
        autolim=False,
    )
