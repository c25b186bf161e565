"""The drawing of a design with its dimensions, as SVG: the undeformed body from the side, from above and along its axis.

Lengths are to scale along the body. A body that is too slender to hold its arrows is drawn thicker than it is, and the drawing says so.
Arrows show each segment's magnetization in the plane of the view; a dot or a cross in a circle, what points toward the reader or away.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np

from magmpm.compiled.arrays import Named, NamedNumbers
from magmpm.viz import style

# of the drawing and its margins, px
DRAWING_WIDTH = 860.0
LEFT = 96.0
NARROW = 30.0  # px: a segment in which its number finds room

VIEWS = (
    ("side", "x", "z", (0, 2), 1),
    ("top", "x", "y", (0, 1), 2),
)  # name, axes, their indices, the one along the line of sight
TOWARD = {
    "side": -1.0,
    "top": 1.0,
}  # the sign of that component that points toward the reader: side looks along +y, top along -z


def drawing(body: Named) -> str:
    """The drawing of a body (studies.sheet.facts.describe_body) as the text of an SVG element."""
    scale = (DRAWING_WIDTH - LEFT - 150.0) / body["length_m"]
    sizes = _sizes(body)
    heights, thicker = _heights(sizes, scale)
    parts = []
    top = 26.0
    for view, (name, across) in zip(VIEWS, sizes, strict=True):
        height = heights[view[0]]
        parts += _view(body, view, top, height, scale, f"{name} {_mm(across)}")
        top += height + (104.0 if view[0] == "side" else 56.0)
    parts += _section(body, top, max(heights.values()))
    total = top + max(heights.values()) + 46.0
    if thicker > 1.001:
        note = f"drawn {thicker:.1f} times thicker than it is; lengths to scale"
        parts.append(
            _text(DRAWING_WIDTH - 4, total - 10, note, anchor="end", color=style.FAINT_INK)
        )
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {DRAWING_WIDTH:g} {total:g}"'
        ' role="img"'
        ' aria-label="Drawing of the design with its dimensions" font-family="Helvetica, Arial,'
        ' sans-serif" font-size="13">'
    )
    return "\n".join([head, *parts, "</svg>"])


def _sizes(body: Named) -> list[tuple[str, float]]:
    """Sizes across the body as seen from the side and from above: the name and the size in m of each."""
    section = body["section_m"]
    if "diameter" in section:
        return [("\u00d8", section["diameter"])] * 2
    return [("thickness", section["thickness"]), ("width", section["width"])]


def _heights(sizes: Sequence[tuple[str, float]], scale: float) -> tuple[NamedNumbers, float]:
    """Height of each view, px, and how many times thicker than to scale the thinnest is drawn."""
    true = [scale * across for _, across in sizes]
    heights = [min(max(px, 44.0), 120.0) for px in true]
    return dict(zip((view[0] for view in VIEWS), heights, strict=True)), max(
        h / px for h, px in zip(heights, true, strict=True)
    )


def _view(
    body: Named,
    view: tuple[Any, ...],
    top: float,
    height: float,
    scale: float,
    across: str,
) -> list[str]:
    """The body seen from the side or from above, with its dimensions."""
    name, horizontal, vertical, (i, j), k = view
    middle = top + 20 + height / 2
    right = LEFT + scale * body["length_m"]
    low = middle + height / 2
    high = middle - height / 2
    parts = [_text(4, top + 2, f"{name} view", weight="bold")]
    for segment, color in zip(body["segments"], _colors(body), strict=True):
        x = LEFT + scale * segment["from_m"]
        width = scale * segment["length_m"]
        parts.append(
            f'<rect x="{x:.2f}" y="{high:.2f}" width="{width:.2f}" height="{height:.2f}"'
            f' fill="{color}" stroke="{style.INK}"/>'
        )
        d = np.array(segment["direction"], dtype=float)
        if d.any():
            parts += _arrow(
                x + width / 2,
                middle,
                d[i],
                d[j],
                d[k] * TOWARD[name],
                min(0.84 * width, 0.8 * height),
            )
        if name == "side" and width > NARROW:
            parts.append(
                _text(
                    x + width / 2,
                    high - 5,
                    str(segment["number"]),
                    anchor="middle",
                    color=style.FAINT_INK,
                )
            )
    parts += _bore(body, middle, height, right)
    parts += _clamp(body, low, high, right)
    parts += _axes(30, low - 4, horizontal, vertical)
    if name == "side":
        parts += _lengths(body, low + 20, low, scale)
        parts += _measure(LEFT, right, low + 44, low, _mm(body["length_m"]))
    x = right + 16
    parts += [
        _line(right + 3, high, x + 6, high),
        _line(right + 3, low, x + 6, low),
        _line(x, high, x, low, both=True),
    ]
    parts.append(_text(x + 8, middle + 4, across))
    return parts


def _colors(body: Named) -> list[str]:
    magnetized = np.array([any(segment["direction"]) for segment in body["segments"]])
    return [
        "#" + "".join(f"{round(255 * part):02x}" for part in color)
        for color in style.segment_colors(magnetized)
    ]


def _arrow(x: float, y: float, along: float, up: float, toward: float, size: float) -> list[str]:
    """A unit vector's projection at its true length in `size` px, and a dot or a cross for what points along the line of sight."""
    parts = []
    dx = 0.5 * size * along
    dy = -0.5 * size * up
    length = 2 * math.hypot(dx, dy)
    if length > 6.0:
        ux = 2 * dx / length
        uy = 2 * dy / length
        head = min(9.0, 0.6 * length)
        bx = x + dx - head * ux
        by = y + dy - head * uy
        wing = 0.45 * head
        points = (
            f"{x + dx:.1f},{y + dy:.1f} {bx - wing * uy:.1f},{by + wing * ux:.1f}"
            f" {bx + wing * uy:.1f},{by - wing * ux:.1f}"
        )
        parts.append(_line(x - dx, y - dy, bx, by, color=style.MAGNETIZATION, width=2.0))
        parts.append(f'<polygon points="{points}" fill="{style.MAGNETIZATION}"/>')
    if (
        abs(toward) >= 0.35
    ):  # of the direction is along the line of sight: a dot or a cross stands next to its arrow
        px, py = (x - dx, y - dy) if length > 6.0 else (x, y)
        parts.append(
            f'<circle cx="{px:.1f}" cy="{py:.1f}" r="5" fill="white" stroke="{style.MAGNETIZATION}"'
            ' stroke-width="1.4"/>'
        )
        if toward > 0:
            parts.append(
                f'<circle cx="{px:.1f}" cy="{py:.1f}" r="1.8" fill="{style.MAGNETIZATION}"/>'
            )
        else:
            for s in (1, -1):
                parts.append(
                    _line(
                        px - 3.3,
                        py - 3.3 * s,
                        px + 3.3,
                        py + 3.3 * s,
                        color=style.MAGNETIZATION,
                        width=1.4,
                    )
                )
    return parts


def _bore(body: Named, middle: float, height: float, right: float) -> list[str]:
    inner = body["section_m"].get("inner_diameter", 0.0)
    if not inner:
        return []
    half = 0.5 * height * inner / body["section_m"]["diameter"]
    dashed = f'stroke="{style.INK}" stroke-dasharray="7 4"'
    return [
        f'<line x1="{LEFT:g}" y1="{y:.1f}" x2="{right:.1f}" y2="{y:.1f}" {dashed}/>'
        for y in (middle - half, middle + half)
    ]


def _clamp(body: Named, low: float, high: float, right: float) -> list[str]:
    """Hatched walls where the body is held."""
    parts = []
    reach = 8.0
    for x, way in ((LEFT, -1.0), (right, 1.0)):
        if body["clamp"] == "both" or (body["clamp"] == "base" and way < 0):
            parts.append(_line(x, low + reach, x, high - reach, width=2.4))
            count = max(int((low - high + 2 * reach) / 8), 2)
            for y in np.linspace(high - reach + 8, low + reach, count):
                parts.append(_line(x, y - 8, x + way * 8, y, width=0.9))
    return parts


def _lengths(body: Named, y: float, low: float, scale: float) -> list[str]:
    """The segments' lengths; where they are alike, how many there are of which length."""
    segments = body["segments"]
    lengths = [segment["length_m"] for segment in segments]
    if len(segments) == 1:
        return []
    if max(lengths) - min(lengths) < 1e-6 * sum(lengths):
        right = LEFT + scale * lengths[0]
        return _measure(
            LEFT, right, y, low, f"{len(lengths)} \u00d7 {_mm(lengths[0])}", beside=True
        )
    parts = []
    for segment in segments:
        x = LEFT + scale * segment["from_m"]
        width = scale * segment["length_m"]
        parts += _measure(
            x, x + width, y, low, _mm(segment["length_m"], unit=False) if width > NARROW else ""
        )
    return parts


def _measure(
    left: float, right: float, y: float, edge: float, text: str, beside: bool = False
) -> list[str]:
    """A dimension line from `left` to `right` below an edge, with its text."""
    parts = [_line(x, edge + 3, x, y + 5) for x in (left, right)]
    parts.append(_line(left, y, right, y, both=True))
    if text:
        wide = 8.4 * len(text) + 8
        if beside or wide + 18 > right - left:
            parts.append(_text(right + 6, y + 4, text))
        else:
            middle = (left + right) / 2
            parts.append(
                f'<rect x="{middle - wide / 2:.1f}" y="{y - 8:.1f}" width="{wide:.1f}" height="16"'
                ' fill="white"/>'
            )
            parts.append(_text(middle, y + 4, text, anchor="middle"))
    return parts


def _section(body: Named, top: float, height: float) -> list[str]:
    """The section as seen from the tip: y to the right, z up."""
    section = body["section_m"]
    size = 0.9 * height
    middle = top + 14 + height / 2
    x = LEFT + size / 2
    parts = [_text(4, top + 2, "section, seen from the tip", weight="bold")]
    color = _colors(body)[-1]
    if "diameter" in section:
        parts.append(
            f'<circle cx="{x:.1f}" cy="{middle:.1f}" r="{size / 2:.1f}" fill="{color}"'
            f' stroke="{style.INK}"/>'
        )
        words = f"\u00d8 {_mm(section['diameter'])}"
        if section["inner_diameter"]:
            inner = size / 2 * section["inner_diameter"] / section["diameter"]
            parts.append(
                f'<circle cx="{x:.1f}" cy="{middle:.1f}" r="{inner:.1f}" fill="white"'
                f' stroke="{style.INK}"/>'
            )
            words += f", bore \u00d8 {_mm(section['inner_diameter'])}"
        wide = size
    else:
        share = max(section["width"], section["thickness"])
        wide, tall = (
            max(1.6 * size * section[name] / share, 5.0) for name in ("width", "thickness")
        )
        x = LEFT + wide / 2
        parts.append(
            f'<rect x="{LEFT:.1f}" y="{middle - tall / 2:.1f}" width="{wide:.1f}"'
            f' height="{tall:.1f}" fill="{color}" stroke="{style.INK}"/>'
        )
        words = f"{_mm(section['width'])} wide, {_mm(section['thickness'])} thick"
    parts += _axes(30, middle + 16, "y", "z")
    parts.append(_text(LEFT + wide + 18, middle + 4, words))
    return parts


def _axes(x: float, y: float, horizontal: str, vertical: str) -> list[str]:
    return [
        _line(x, y, x + 26, y, end=True),
        _line(x, y, x, y - 26, end=True),
        _text(x + 30, y + 4, horizontal, style_="italic"),
        _text(x - 4, y - 30, vertical, style_="italic"),
    ]


def _line(
    x1: float,
    y1: float,
    x2: float,
    y2: float,
    *,
    both: bool = False,
    end: bool = False,
    color: str = style.INK,
    width: float = 0.9,
) -> str:
    """A line, with small arrow heads at its end or at both."""
    text = (
        f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="{color}"'
        f' stroke-width="{width:g}"/>'
    )
    size = math.hypot(x2 - x1, y2 - y1)
    for px, py, way in ((x2, y2, 1.0), (x1, y1, -1.0)):
        if size > 0 and (both or (end and way > 0)):
            ux = way * (x2 - x1) / size
            uy = way * (y2 - y1) / size
            head = min(6.0, 0.4 * size)
            bx = px - head * ux
            by = py - head * uy
            wx = 0.35 * head * uy
            wy = 0.35 * head * ux
            points = f"{px:.1f},{py:.1f} {bx - wx:.1f},{by + wy:.1f} {bx + wx:.1f},{by - wy:.1f}"
            text += f'<polygon points="{points}" fill="{color}"/>'
    return text


def _text(
    x: float,
    y: float,
    words: str,
    anchor: str = "start",
    color: str = style.INK,
    weight: str = "normal",
    style_: str = "normal",
) -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{color}"'
        f' font-weight="{weight}" font-style="{style_}">{escape(words)}</text>'
    )


def _mm(value: float, unit: bool = True) -> str:
    """A length (m) in mm, to a micrometer."""
    return f"{1e3 * value:.3f}".rstrip("0").rstrip(".") + (" mm" if unit else "")
