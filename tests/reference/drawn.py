"""Scenes and motions to draw, and what to look for in the pictures."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from reference import motions

from magmpm.results.trajectory import Motion, MotionWriter
from magmpm.viz import style
from magmpm.viz.from_motion import MotionRenderer

SIZE = (320, 180)
CATHETER = {
    "length": 0.04,
    "diameter": 0.004,
    "material": "silicone",
    "segments": [{"length": 0.01}, {}, {}],
}
MAGNET = {
    "cylinder": {"diameter": 0.01, "length": 0.02},
    "position": [0.05, 0.0, 0.02],
    "axis": [0, 0, 1],
    "remanence": 1.3,
}


def scene(**more: Any) -> dict[str, Any]:
    """A scene in SI: a catheter in motion, with nothing around it."""
    silicone = {
        "shear_modulus": 120e3,
        "bulk_to_shear": 20.0,
        "density": 1882.0,
        "remanence": 0.138,
    }
    about = {
        "name": "bending",
        "materials": {"silicone": silicone},
        "solver": {"dynamic": {"duration": 0.4}},
    }
    return {**about, "body": {"catheter": CATHETER}, **more}


def surrounded(**more: Any) -> dict[str, Any]:
    """The same with gravity, above the ground and beside a magnet."""
    effects = {"ground": {"point": [0, 0, -0.006], "normal": [0, 0, 1]}, "gravity": {}}
    return scene(**{"effects": effects, "field": {"magnet": [MAGNET]}, **more})


def moving(folder: Path, said: dict[str, Any] | None = None, frames: int = 9) -> MotionRenderer:
    """A catheter that bends up, and down into the ground."""
    return written(
        folder,
        motions.body(),
        np.linspace(0.0, 0.4, frames),
        surrounded() if said is None else said,
    )


def written(
    folder: Path, model: SimpleNamespace, times: Any, said: dict[str, Any]
) -> MotionRenderer:
    """The motion of a body in such a scene, saved and read back."""
    model.scene = SimpleNamespace(to_si=lambda: said, name="bending")
    motions.write(MotionWriter(folder, model), motions.bending(model, times))
    return MotionRenderer(Motion.load(folder))


def count(image: np.ndarray, color: str, within: int = 40) -> int:
    """Pixels near a color."""
    return int(
        np.count_nonzero(
            np.abs(image.astype(int) - np.round(255 * np.array(style.rgb(color)))).max(axis=2)
            < within
        )
    )
