"""Drawings of scenes and results in notebooks: plain SVG and tables, without any library. viz draws the pictures of papers.

A body from the side and from above, to one scale, with an arrow for each magnetized segment, and what acts on it in a table; of an
equilibrium its axis, undeformed and deformed, and what counts; of a motion the path of its middle.
"""

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.errors import lengths, quantity, stability_in_words

# px of a panel
PANEL_WIDTH = 300.0
HEIGHT = 190.0
MARGIN = 26.0
VIEWS = (("side", "x", "z", 0, 2), ("top", "x", "y", 0, 1))
BODY = "#CC6644"
UNDEFORMED = "#AAAAAA"
INK = "#222222"
MOST_POINTS_DRAWN = 200  # points of a curve, arrows of a body
MOST_PARTS_LISTED = 12  # whose places a table shows


def of_scene(scene: Any) -> str:
    """A Scene as HTML: its body, m, and what acts on it."""
    effects = ", ".join(name for name, effect in scene.effects if effect is not None) or "none"
    rows = [
        (
            "body",
            (
                f"{scene.body.kind}, {1e3 * scene.length:g} mm long, {1e3 * scene.thickness:g} mm"
                f" thick, {len(scene.regions())} regions"
            ),
        ),
        *(
            (
                f"material {name}",
                f"G = {one.shear_modulus / 1e3:g} kPa, Br = {1e3 * one.remanence:g} mT",
            )
            for name, one in scene.materials.items()
        ),
        ("field", scene.field.text()),
        ("effects", effects),
        (
            "solver",
            (
                f"{'statics' if scene.static else f'until {scene.duration:g} s'}, cells of"
                f" {1e3 * scene.cell:.3g} mm"
            ),
        ),
    ]
    return _body(scene) + table(scene.name, rows)


def _body(scene: Any) -> str:
    """The undeformed body as boxes along x with arrows; of parts, the box around them all."""
    low, high = (np.array(corner, dtype=float) for corner in scene.box())
    shape = scene.body.shape
    lengths = list(shape.segment_lengths()) if hasattr(shape, "segment_lengths") else []
    regions = scene.regions()
    if len(lengths) != len(regions) or len(lengths) > MOST_POINTS_DRAWN:
        lengths = [float(high[0] - low[0])]
        regions = ()
    begins = low[0] + np.concatenate([[0.0], np.cumsum(lengths)])
    scale, middle = _fit(low, high)
    parts = []
    for k, (name, across, up, i, j) in enumerate(VIEWS):
        left = k * PANEL_WIDTH
        parts.append(_text(left + 6, 14, f"{name}: {across} right, {up} up"))
        for n, length in enumerate(lengths):
            x = left + PANEL_WIDTH / 2 + scale * (begins[n] - middle[0])
            y = HEIGHT / 2 - scale * (high[j] - middle[j])
            height = scale * (high[j] - low[j])
            box = f'x="{x:.1f}" y="{y:.1f}" width="{scale * length:.1f}" height="{height:.1f}"'
            parts.append(f'<rect {box} fill="#EEC9B7" stroke="{INK}" stroke-width="0.8"/>')
            if len(regions) and any(regions[n].magnetization):
                direction = np.array(regions[n].magnetization)
                size = 0.9 * min(scale * length, max(height, 24.0))
                parts += _arrow(
                    x + scale * length / 2, y + height / 2, direction[i], direction[j], size
                )
    return _whole(parts, scale, high - low)


def _arrow(x: float, y: float, along: float, up: float, size: float) -> list[str]:
    """A unit vector's projection, `size` px for its whole length; a dot for what has none."""
    dx = 0.5 * size * along
    dy = -0.5 * size * up
    length = 2 * float(np.hypot(dx, dy))
    if length < 3.0:
        return [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2" fill="{INK}"/>']
    ux = 2 * dx / length
    uy = 2 * dy / length
    head = min(7.0, 0.6 * length)
    bx = x + dx - head * ux
    by = y + dy - head * uy
    wing = (
        f"{bx - 0.45 * head * uy:.1f},{by + 0.45 * head * ux:.1f}"
        f" {bx + 0.45 * head * uy:.1f},{by - 0.45 * head * ux:.1f}"
    )
    return [
        (
            f'<line x1="{x - dx:.1f}" y1="{y - dy:.1f}" x2="{bx:.1f}" y2="{by:.1f}" stroke="{INK}"'
            ' stroke-width="1.6"/>'
        ),
        f'<polygon points="{x + dx:.1f},{y + dy:.1f} {wing}" fill="{INK}"/>',
    ]


def _fit(low: Array, high: Array) -> tuple[float, Array]:
    """The scale, px per m, at which a box fits both views, and its middle."""
    extent = max(float(np.max(high - low)), 1e-9)
    across = max(float(np.max((high - low)[1:])), 0.35 * extent)
    return min((PANEL_WIDTH - 2 * MARGIN) / extent, (HEIGHT - 2 * MARGIN) / across), (
        low + high
    ) / 2


def panels(curves: Sequence[Array], width: float = 4.0) -> str:
    """The curves (n, 3), m, from the side and from above, to one scale; the last one is colored, others are gray and dashed."""
    points = np.concatenate(curves)
    low = points.min(axis=0)
    high = points.max(axis=0)
    (scale, middle), parts = _fit(low, high), []
    for k, (name, across, up, i, j) in enumerate(VIEWS):
        left = k * PANEL_WIDTH
        parts.append(_text(left + 6, 14, f"{name}: {across} right, {up} up"))
        for number, curve in enumerate(curves):
            last = number == len(curves) - 1
            x = left + PANEL_WIDTH / 2 + scale * (curve[:, i] - middle[i])
            y = HEIGHT / 2 - scale * (curve[:, j] - middle[j])
            look = (
                f'stroke="{BODY}" stroke-width="{width:g}"'
                if last
                else f'stroke="{UNDEFORMED}" stroke-width="2" stroke-dasharray="5 4"'
            )
            some = np.linspace(0, len(x) - 1, min(len(x), MOST_POINTS_DRAWN)).astype(int)
            path = " ".join(f"{x[n]:.1f},{y[n]:.1f}" for n in some)
            parts.append(f'<polyline points="{path}" fill="none" {look}/>')
            if last:
                parts.append(f'<circle cx="{x[-1]:.1f}" cy="{y[-1]:.1f}" r="4" fill="{INK}"/>')
    return _whole(parts, scale, high - low)


def _whole(parts: list[str], scale: float, extent: Array) -> str:
    """The picture with its scale bar."""
    bar = 10.0 ** np.floor(np.log10(max(0.4 * float(np.max(extent)), 1e-9)))
    y = HEIGHT - 12
    parts = [
        *parts,
        (
            f'<line x1="{MARGIN:g}" y1="{y:g}" x2="{MARGIN + scale * bar:.1f}" y2="{y:g}"'
            f' stroke="{INK}" stroke-width="2"/>'
        ),
    ]
    parts.append(_text(MARGIN + scale * bar + 6, HEIGHT - 8, f"{1e3 * bar:g} mm"))
    size = (
        f'width="{2 * PANEL_WIDTH:g}" height="{HEIGHT:g}" viewBox="0 0 {2 * PANEL_WIDTH:g}'
        f' {HEIGHT:g}"'
    )
    look = 'style="background:#fff" font-family="sans-serif" font-size="11"'
    return f'<svg xmlns="http://www.w3.org/2000/svg" {size} {look}>{"".join(parts)}</svg>'


def _text(x: float, y: float, words: str) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" fill="{INK}">{escape(words)}</text>'


def table(title: str, rows: Iterable[tuple[str, str]]) -> str:
    """Names and texts under a title."""
    left = "style='text-align:left'"
    cells = "".join(
        f"<tr><th {left}>{escape(name)}</th><td {left}>{escape(text)}</td></tr>"
        for name, text in rows
    )
    return f"<table><caption {left}><b>{escape(title)}</b></caption>{cells}</table>"


def of_result(result: Any) -> str:
    """A Result as HTML: its axis, m, and figures."""
    places = [] if result.tip is None else [("tip", lengths(result.tip))]
    named = list(result.positions.items())
    places += [(name, lengths(place)) for name, place in named[:MOST_PARTS_LISTED]]
    if len(named) > MOST_PARTS_LISTED:
        places.append(("more parts", f"{len(named) - MOST_PARTS_LISTED}, in `positions`"))
    rows = [*places, ("det F", f"{result.min_det_F:.4f} to {result.max_det_F:.4f}")]
    if not result.converged:
        rows.insert(0, ("NOT CONVERGED", result.failure or "the last good state"))
    if result.stability is not None:
        rows.append(("stability", stability_in_words(result.stability)))
    if result.error_estimate is not None:
        rows.append(("error of the grid", f"at most {quantity(result.error_estimate, 'm')}"))
    rows += [
        ("unknowns, particles", f"{result.dof}, {result.particles}"),
        ("solve", quantity(result.seconds.get("solve", 0.0), "s")),
    ]
    rows += [("warning", text) for text in result.warnings]
    axis = result.centreline
    if not len(axis):
        return table(result.name, rows)
    straight = np.column_stack(
        [axis[:, 0] + axis[0, 1] - axis[0, 0], np.full((len(axis), 2), axis[0, 2:])]
    )
    return panels([straight, axis[:, 1:]]) + table(result.name, rows)


def of_motion(motion: Any) -> str:
    """A Motion as HTML: how the middle of its particles moves, m, and its times."""
    some = (
        np.unique(np.linspace(0, len(motion) - 1, 40).astype(int)).tolist() if len(motion) else []
    )
    middles = np.array([np.asarray(motion[k].position).mean(axis=0) for k in some])
    last = quantity(float(motion.times[-1]), "s") if len(motion) else "none yet"
    rows = [
        ("frames", str(len(motion))),
        ("last", last),
        ("particles", str(len(motion.reference))),
        ("folder", str(motion.folder)),
    ]
    return (panels([middles], width=2.0) if len(middles) > 1 else "") + table(motion.name, rows)
