"""Writes walking_field.csv, the field that makes walking_strip.yaml walk, and walking_field_back.csv, its mirror image.

    python data/scenes/gallery/make_walking_field.py

In each period of 0.1 s the field rotates uniformly by 45 degrees in the x-z plane, from 180 degrees (-x) to 225 degrees, while its
magnitude grows linearly from 0 to 10 mT; then it starts again within 1 ms. Such fields make strips with a one-harmonic magnetization
walk: Hu, Lum, Mastrangeli, Sitti, Nature 554 (2018) 81-85. The mirror image rotates from 270 to 225 degrees, because the magnetization
profile of the strip is its own mirror image about 225 degrees.
"""

from __future__ import annotations

import math
from pathlib import Path

PERIOD, PERIODS, MOST, RESTART, POINTS = 0.1, 6, 10.0, 1e-3, 20  # s, -, mT, s, rows per period


def rows(begin: float, end: float) -> list[str]:
    """Rows of time, Bx, By, Bz for a field that rotates from one angle to another (degrees), over all periods."""
    out = []
    for period in range(PERIODS):
        for k in range(POINTS + 1):
            share = k / POINTS * (1 - RESTART / PERIOD)
            angle = math.radians(begin + (end - begin) * share)
            size = MOST * share
            out.append(
                f"{PERIOD * (period + share):.5g},{size * math.cos(angle):.6f},0,{size * math.sin(angle):.6f}"
            )
    return out


if __name__ == "__main__":
    for name, begin, end in (("walking_field", 180, 225), ("walking_field_back", 270, 225)):
        table = Path(__file__).with_name(f"{name}.csv")
        table.write_text(
            "\n".join(["time_s,Bx_mT,By_mT,Bz_mT", *rows(begin, end)]) + "\n", encoding="utf-8"
        )
