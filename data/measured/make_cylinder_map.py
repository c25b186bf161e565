"""Writes cylinder_map.csv: the field of a cylinder magnet on a regular grid, as a Hall probe would measure it, with its noise.

python data/measured/make_cylinder_map.py

The magnet: diameter 20 mm, length 20 mm, Br 1.3 T along +x, its center at the origin of the map. The noise, 0.02 mT in each
component, is that of a three-axis Hall probe; numbers are rounded to 0.001 mT. magpylib computes the exact field.
"""

from __future__ import annotations

from pathlib import Path

import magpylib
import numpy as np

OUT = Path(__file__).with_name("cylinder_map.csv")
NOISE = 0.02  # mT


def main() -> None:
    magnet = magpylib.magnet.Cylinder(
        polarization=(0, 0, 1.3), dimension=(20e-3, 20e-3)
    ).rotate_from_angax(90, "y")
    x, y, z = np.arange(-90, -17.9, 4.0), np.arange(-28, 28.1, 4.0), np.arange(-28, 28.1, 4.0)
    points = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3)
    field = 1e3 * magnet.getB(points / 1e3) + NOISE * np.random.default_rng(1).standard_normal(
        points.shape
    )
    lines = [
        "# Field of a cylinder magnet, 20 mm x 20 mm, Br 1.3 T along +x, centre at the origin; made by make_cylinder_map.py",
        "x_mm,y_mm,z_mm,Bx_mT,By_mT,Bz_mT",
        *(
            ",".join([*(f"{v:g}" for v in p), *(f"{b:.3f}" for b in B)])
            for p, B in zip(points, field, strict=True)
        ),
    ]
    OUT.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
