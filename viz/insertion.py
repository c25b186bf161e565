"""Pictures of an insertion: the body at one depth or at several, its path, the lumen around it, the guide, field and magnetization.

An insertion is drawn from the axes of its depths, which trials store, not from particles: each is a tube around its axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from magmpm.bodies.curves import linear
from magmpm.compiled.arrays import Named, Plain
from magmpm.viz import style
from magmpm.viz.from_motion import gravity_of, scene_of
from magmpm.viz.from_result import segment_arrows
from magmpm.viz.meshes import TriangleSurface, fan, swept
from magmpm.viz.snapshot import DrawnSolid, Snapshot, spread

GUIDE = 3.0  # length of the guide that is shown, in diameters


@dataclass(frozen=True)
class InsertionPictures:
    """Data that all pictures of one insertion share. scene: plain SI data of the whole catheter; path (m, 4) m: rows [s, x, y, z]."""

    name: str
    scene: Named
    path: np.ndarray

    @property
    def catheter(self) -> Named:
        catheter: Named = self.scene["body"]["catheter"]
        return catheter

    def body(self, frame: Named, shift: np.ndarray) -> TriangleSurface:
        """The part outside the guide; its parts are the catheter's segments."""
        count = 80  # points of an axis as it is drawn
        axis = np.array(frame["axis_m"]) + shift
        s = np.linspace(0.0, 1.0, len(axis))
        line = linear(np.linspace(0.0, 1.0, count), s, axis)
        radius = self.catheter["diameter"] / 2
        surface = swept(line, radius)
        tip = swept(line[-2:] + 1e-3 * radius * (line[-1] - line[-2]), 1e-3 * radius)
        around = len(tip.points) // 2
        last = surface.points[-around:]
        place = frame["depth_m"] * (np.arange(count - 1) + 0.5) / (count - 1)
        part = self._segments(frame["depth_m"])(place)
        rings = surface.triangles.min(axis=1) // around
        whole = TriangleSurface(
            surface.points, surface.triangles, part[np.minimum(rings, count - 2)]
        )
        return TriangleSurface.joined(
            [
                whole,
                TriangleSurface(
                    np.vstack([last, line[-1:]]), fan(around), np.full(around, part[-1])
                ),
            ]
        )

    def _segments(self, depth: float) -> Any:
        """The number of the segment by the arc length outside (m)."""
        lengths = [segment["length"] for segment in self.catheter["segments"]]
        given = sum(length for length in lengths if length is not None)
        free = sum(length is None for length in lengths)
        total = self.catheter["length"]
        ends = np.cumsum(
            [(total - given) / free if length is None else length for length in lengths]
        )
        return lambda s: np.minimum(
            np.searchsorted(ends, np.asarray(s) + total - depth), len(ends) - 1
        )

    def snapshot(self, frames: Sequence[Named], *, lumen: bool, **caption: Any) -> Snapshot:
        """The bodies of these depths side by side along y, each over its path and, if there are several, next to its field."""
        diameter = float(self.catheter["diameter"])
        several = len(frames) > 1
        length = float(self.path[-1, 0])
        shifts = [
            np.array([0.0, 0.33 * length * (len(frames) - 1 - k), 0.0]) for k in range(len(frames))
        ]  # depths next to each other
        axes = [np.array(frame["axis_m"]) + shift for frame, shift in zip(frames, shifts)]
        arrows = np.vstack(
            [
                segment_arrows(
                    axis,
                    np.array(f["centers_m"]) + shift,
                    np.array(f["remanence_T"]),
                    self.catheter["length"],
                    diameter,
                )
                for axis, f, shift in zip(axes, frames, shifts)
            ]
        )
        scene = scene_of(self.scene)
        magnetized = np.array(
            [any(segment["magnetization"]) for segment in self.catheter["segments"]]
        )
        obstacles = [self._guide(shift) for shift in shifts] + ([self._lumen()] if lumen else [])
        dots = spread(
            self.path[:, 1:], style.TARGET_DOTS // 2 + 1 if several else style.TARGET_DOTS
        )
        return Snapshot(
            body=TriangleSurface.joined(
                [self.body(frame, shift) for frame, shift in zip(frames, shifts)]
            ),
            magnetized=magnetized,
            length=length,
            thickness=diameter,
            axis=np.zeros((0, 3)) if several else axes[0],
            target=np.vstack([dots + shift for shift in shifts]),
            target_name="path",
            arrows=arrows.reshape(-1, 2, 3),
            arrow_width=style.ARROW_WIDTH * diameter,
            obstacles=tuple(obstacles),
            gravity=gravity_of(scene),
            **(
                self._fields(frames, shifts)
                if several
                else {"field": np.array(frames[0]["field_T"], dtype=float)}
            ),
            **caption,
        )

    def _fields(self, frames: Sequence[Named], shifts: Sequence[np.ndarray]) -> Plain:
        """An arrow of each depth's field behind its guide, as long as it is strong, with depth and strength in words below it."""
        fields = np.array([frame["field_T"] for frame in frames], dtype=float)
        strength = np.linalg.norm(fields, axis=1)
        longest = 0.15 * float(self.path[-1, 0])
        vectors = longest * fields / max(float(strength.max()), 1e-300)
        places = np.array(shifts) - [GUIDE * self.catheter["diameter"] + 0.7 * longest, 0.0, 0.0]
        words = [
            f"at {1e3 * frame['depth_m']:.3g} mm: {1e3 * size:.1f} mT"
            for frame, size in zip(frames, strength)
        ]
        notes = tuple(zip(words, places - [0.0, 0.0, 0.7 * longest]))
        return {"fields": np.stack([places - 0.5 * vectors, vectors], axis=1), "notes": notes}

    def _guide(self, shift: np.ndarray) -> DrawnSolid:
        diameter = self.catheter["diameter"]
        guide = swept(
            np.array([[-GUIDE * diameter, 0.0, 0.0], [0.0, 0.0, 0.0]]) + shift, 0.75 * diameter, 48
        )
        return DrawnSolid("guide", guide.points, guide.triangles, style.CLAMP)

    def _lumen(self) -> DrawnSolid:
        tube = swept(
            self.path[:, 1:], 1.6 * self.catheter["diameter"] / 2, 48
        )  # no walls are named: a little wider than the body
        return DrawnSolid("lumen", tube.points, tube.triangles, style.WALL, hollow=True)

    def trial(self, frames: Sequence[Named], *, trial: int, rms: float) -> Snapshot:
        """A trial: bodies at several depths."""
        some = np.unique(
            np.linspace(0, len(frames) - 1, 5).round().astype(int)[1:]
        )  # four depths in a trial's picture
        return self.snapshot(
            [frames[k] for k in some], lumen=False, title=self.name, trial=trial, rms=rms
        )

    def moment(self, frame: Named) -> Snapshot:
        """One depth in its lumen, with depth and deviation in words."""
        words = (
            f"{1e3 * frame['depth_m']:.1f} mm inserted   deviation {1e3 * frame['rms_m']:.2f} mm"
        )
        return self.snapshot([frame], lumen=True, title=words)
