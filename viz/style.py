"""Colors and sizes of every picture, whichever renderer draws it.

The segments' colors are the warm and green members of Paul Tol's "light" qualitative scheme
(https://sronpersonalpages.nl/~pault/, safe for the common kinds of color blindness). Its blues are left out on purpose: blue is
the target's color, and no body may compete with it. The scheme is pale, so that dark arrows and blue dots stand out in front of it.
"""

from __future__ import annotations

import numpy as np

RGB = tuple[float, float, float]


def rgb(code: str) -> RGB:
    """Color "#rrggbb" as red, green, blue in 0..1."""
    return int(code[1:3], 16) / 255, int(code[3:5], 16) / 255, int(code[5:7], 16) / 255


SEGMENTS: tuple[str, ...] = ("#EE8866", "#44BB99", "#EEDD88", "#FFAABB", "#AAAA00", "#BBCC33")
UNMAGNETIZED = "#BBBBBB"
TARGET = "#0033CC"
MAGNETIZATION = "#2B2B2B"
FIELD = "#882255"
CLAMP = "#9A9A9A"
HELD = "#6E6E6E"
INK = "#1A1A1A"
FAINT_INK = "#666666"
ALARM = "#B3261E"  # says that a picture shows no answer
FLOOR = "#F7F7F5"
GRID = "#DDDDDA"
SHADOW = "#E2E2DE"
TARGET_SHADOW = "#A9B8DE"
FRAME = "#BBBBBB"

# What stands around the body. North and south: red and blue of Tol's "vibrant" scheme, told apart by their lightness too.
NORTH = "#CC3311"
SOUTH = "#33608F"
POLES = "(N, S)"  # ends the names of obstacles that are red in the north and blue in the south
COIL = "#B87333"
WALL = "#C9D3DE"
GROUND = "#EFEADF"
GROUND_GRID = "#C9BFA8"
GROUND_SHADOW = "#CDC3AC"
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
CLAMP_RADIUS = 0.7
CLAMP_THICKNESS = 0.15

# Sizes in the body's thickness (Snapshot.thickness).
DOT_WIDTH = 0.28
ARROW_WIDTH = 0.13
MARK_WIDTH = 0.1

ARROW_HALO = 0.35  # white rim of an arrow, in widths of its shaft

# A ball is a little wider than the cube its particle stands for; otherwise one could see through the body.
BALL_WIDTH = 1.2

TARGET_DOTS = 21

# Heights of letters as a fraction of the picture's height.
TEXT_LARGE = 0.034
TEXT_MEDIUM = 0.028
TEXT_SMALL = 0.024


def segment_colors(magnetized: np.ndarray) -> np.ndarray:
    """Color (k, 3) in 0..1 of each segment; magnetized: (k,) bool.

    Gray where not magnetized. Magnetized segments take the palette's colors in order, base to tip, and start again at its end.
    """
    colors = np.empty((len(magnetized), 3))
    used = 0
    for k, is_magnet in enumerate(magnetized):
        colors[k] = rgb(SEGMENTS[used % len(SEGMENTS)] if is_magnet else UNMAGNETIZED)
        used += int(is_magnet)
    return colors


def floor_colors(has_ground: bool) -> tuple[str, str, str]:
    """Colors of the floor, its lines and its shadows: the ground is warm and darker, a floor that only guides the eye is faint."""
    return (GROUND, GROUND_GRID, GROUND_SHADOW) if has_ground else (FLOOR, GRID, SHADOW)


def nice_length(length: float) -> float:
    """The round number (1, 2 or 5 times a power of ten, in meters) nearest below length."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(max(f for f in (1.0, 2.0, 5.0) if f * power <= length * (1 + 1e-9)) * power)
