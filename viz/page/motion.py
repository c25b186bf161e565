"""Data for the page of a motion: the surface at each frame, its arrows, what moves around it, and the curves below."""

from __future__ import annotations

from typing import Any

import numpy as np

from magmpm.compiled.arrays import Plain
from magmpm.scene import Scene
from magmpm.viz.body import DrawnBody
from magmpm.viz.page.stage import obstacles_of, put_obstacles, surface_arrays

CURVES = ("kinetic", "elastic", "total")  # of energies.csv, where there


class MotionStage:
    """A motion (magmpm.results.trajectory.Motion) for the page; `motion` may be replaced by the same one with more frames."""

    def __init__(self, scene: Scene, motion: Any) -> None:
        self.scene = scene
        self.motion = motion
        self._body = DrawnBody(
            scene, motion.reference, motion.volume, motion.part, motion.remanence
        )
        x = self._body.reference[:, 0]
        held = self._body.held.any()
        near_tip = x > x.max() - 1.5 * self._body.size
        self._traced = None if held else near_tip if scene.anchored else np.ones(len(x), dtype=bool)
        self._trace: list[list[float]] = []
        self._low = np.full(3, np.inf)
        self._high = np.full(3, -np.inf)

    def state(self) -> Plain:
        """Data of all frames so far: times (s), the box they fill (m), the path of the tip or middle (m), energies (J), jumps (s)."""
        for number in range(len(self._trace), len(self.motion)):
            position = self.motion.position(number)
            whole = position[np.isfinite(position).all(axis=1)]
            self._low = np.fmin(self._low, whole.min(axis=0))
            self._high = np.fmax(self._high, whole.max(axis=0))
            self._trace.append(
                []
                if self._traced is None
                else position[self._traced].mean(axis=0, dtype=float).tolist()
            )
        energies = {
            name: values.tolist() for name, values in self.motion.energies.items() if name in CURVES
        }
        return {
            "times": self.motion.times.tolist(),
            "box": [self._low.tolist(), self._high.tolist()],
            "trace": [place for place in self._trace if place],
            "energies": {"t": self.motion.energies.get("t", np.zeros(0)).tolist(), **energies},
            "jumps": [jump["time"] for jump in self.motion.jumps],
        }

    def frame(self, number: int, known: str) -> tuple[Plain, dict[str, np.ndarray]]:
        """Header and arrays of a frame; known: name of the surface that the page has."""
        frame = self.motion[number]
        field = np.zeros(3) if frame.field is None else frame.field
        header: Plain = {
            "state": "frame",
            "number": number,
            "time": frame.time,
            "surface": "motion",
            "field": field,
            "arrow_width": self._body.arrow_width,
        }
        arrays = {
            "points": np.nan_to_num(self._body.points(frame.position)),
            "arrows": self._body.arrows(
                frame.position, frame.quantities.get("magnetisation", self.motion.remanence)
            ),
        }
        if known != "motion":
            arrays |= surface_arrays(self._body)
        if known != "motion" or self.scene.field.varies:
            put_obstacles(obstacles_of(self.scene, frame.time), header, arrays)
        return header, arrays
