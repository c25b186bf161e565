"""Colours and sizes shared by every picture, whichever backend draws it.

The segments' colours are the warm and green members of Paul Tol's "light" qualitative scheme
(https://sronpersonalpages.nl/~pault/, safe for the common kinds of colour blindness). Its blues are left
out on purpose: blue is the target's colour and no body may compete with it. The scheme is pale, so that
dark arrows and blue dots stand out in front of it.
"""

from __future__ import annotations

import numpy as np

from magmpm.results import readable
from viz.picture import Picture

RGB = tuple[float, float, float]


def rgb(code: str) -> RGB:
    """Colour "#rrggbb" as red, green, blue in 0..1."""
    return int(code[1:3], 16) / 255, int(code[3:5], 16) / 255, int(code[5:7], 16) / 255


SEGMENTS: tuple[str, ...] = ("#EE8866", "#44BB99", "#EEDD88", "#FFAABB", "#AAAA00", "#BBCC33")
UNMAGNETISED = "#BBBBBB"
TARGET = "#0033CC"
MAGNETISATION = "#2B2B2B"
FIELD = "#882255"
GRAVITY = "#777777"
CLAMP, CLAMP_EDGE = "#9A9A9A", "#7C7C7C"
HELD = "#6E6E6E"
INK = "#1A1A1A"
FAINT_INK = "#666666"
ALARM = "#B3261E"  # a picture of what is no answer says so in this colour
FLOOR = "#F7F7F5"
GRID = "#DDDDDA"
SHADOW = "#E2E2DE"
TARGET_SHADOW = "#A9B8DE"
FRAME = "#BBBBBB"

# What stands around a moving body. North and south: red and blue of Tol's "vibrant" scheme, told apart also by their lightness.
NORTH, SOUTH = "#CC3311", "#33608F"
COIL = "#B87333"
WALL = "#C9D3DE"
GROUND, GROUND_GRID, GROUND_SHADOW = "#EFEADF", "#C9BFA8", "#CDC3AC"
CONTACT = "#0033CC"
TRACE = "#888888"
COMPONENTS = (
    "#882255",
    "#CC6677",
    "#999933",
)  # of the field along x, y, z: wine, rose, olive of Tol's "muted" scheme

FINAL_SIZE = (1200, 900)
MOVIE_SIZE = (1280, 720)
TRIAL_SIZE = (800, 600)

# Sizes in diameters of the body.
CLAMP_RADIUS, CLAMP_THICKNESS = 0.7, 0.15

# Sizes in the body's thickness (Picture.thickness).
DOT_WIDTH, ARROW_WIDTH, ARROW_HALO = 0.28, 0.13, 0.045

# A ball is a little wider than the cube its particle stands for, or the body would be seen through.
BALL_WIDTH = 1.2

TARGET_DOTS = 21

# Heights of letters as a fraction of the picture's height.
TEXT_LARGE, TEXT_MEDIUM, TEXT_SMALL = 0.034, 0.028, 0.024


def segment_colours(magnetised: np.ndarray) -> np.ndarray:
    """Colour of each segment.

    magnetised: (k,) bool. Returns (k, 3) in 0..1: grey where not magnetised; magnetised segments take the
    palette's colours in order, base to tip, and start again when it is used up.
    """
    colours = np.empty((len(magnetised), 3))
    used = 0
    for k, is_magnet in enumerate(magnetised):
        colours[k] = rgb(SEGMENTS[used % len(SEGMENTS)] if is_magnet else UNMAGNETISED)
        used += int(is_magnet)
    return colours


def magnetisation_arrows(picture: Picture) -> list[tuple[np.ndarray, np.ndarray]]:
    """Start (3,) and vector (3,), m, of an arrow through the axis in each magnetised segment.

    The strongest is nearly as long as the segments are apart; the others in proportion to their remanence.
    The centre of a segment bent far lies beside its axis: the arrow goes through the axis's nearest point.
    """
    strength = np.linalg.norm(picture.segment_remanence, axis=1)
    apart = picture.length / max(len(strength), 1)
    longest = float(np.clip(0.9 * apart, 1.2 * picture.thickness, 2.4 * picture.thickness))
    arrows = []
    for k in np.flatnonzero(picture.magnetised):
        vector = picture.segment_remanence[k] / strength.max() * longest
        distance = np.linalg.norm(picture.axis - picture.segment_center[k], axis=1)
        arrows.append((picture.axis[np.argmin(distance)] - 0.5 * vector, vector))
    return arrows


def thinned(points: np.ndarray, most: int) -> np.ndarray:
    """At most `most` of the points (n, 3), evenly spread and with the last one, so that dots stay apart."""
    keep = np.linspace(len(points) - 1, 0, min(len(points), most)).round().astype(int)
    return points[np.unique(keep)]


def nice_length(length: float) -> float:
    """The round number (1, 2 or 5 times a power of ten, in metres) nearest below length."""
    power = 10.0 ** np.floor(np.log10(length))
    factor = max(f for f in (1.0, 2.0, 5.0) if f * power <= length * (1 + 1e-9))
    return float(factor * power)


def in_mm(length: float) -> str:
    """A length in metres as text, "10 mm"; of what is smaller than a hundredth of one "5 nm"."""
    return readable.length(length)


def caption(mark: str) -> str:
    """Colour of the caption, where a mark may stand in its place."""
    return ALARM if mark else INK
