"""The numbers a study searches, and the scene they stand for.

Each magnetized segment has two angles, relative to the catheter and not to the room:

    around: turn about the catheter's axis, from +y toward +z, -180 to 180 deg
    along:  lift from the cross-section toward the tip, -90 to 90 deg
    d = (sin along, cos along cos around, cos along sin around)

`along` = 90 deg is magnetized along the axis toward the tip, 0 across it. The mechanics of a bent catheter refers to its axis, not
to +z, and searches in these angles needed fewer trials (docs/design.md, "Choosing trials", has the counts).
A varied field has its strength and the two angles of scene files: azimuth from +x toward +y, elevation to +z.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from magmpm.scene import Scene
from studies.definition import Study

if TYPE_CHECKING:
    from optuna.distributions import BaseDistribution

FIELD = ("field_mT", "field_azimuth_deg", "field_elevation_deg")


def direction(around: float, along: float) -> NDArray[np.float64]:
    """Unit vector (3,) in the undeformed body, axis +x; angles in degrees."""
    a, b = np.deg2rad(around), np.deg2rad(along)
    return np.array([np.sin(b), np.cos(b) * np.cos(a), np.cos(b) * np.sin(a)])


def angles(vector: NDArray[np.float64]) -> tuple[float, float]:
    """(around, along) in degrees of a direction (3,): the inverse of `direction`."""
    x, y, z = np.asarray(vector, dtype=float) / np.linalg.norm(vector)
    return float(np.rad2deg(np.arctan2(z, y))), float(np.rad2deg(np.arctan2(x, np.hypot(y, z))))


@dataclass(frozen=True)
class SearchSpace:
    """What is varied in a scene: magnetized segments (numbers from 0, base first) and the field up to field_max T."""

    scene: Scene
    segments: tuple[int, ...]
    field_max: float | None

    @classmethod
    def of(cls, study: Study) -> SearchSpace:
        """The space a study asks for."""
        segments = tuple(study.scene.magnetized_regions()) if study.vary_magnetization else ()
        return cls(scene=study.scene, segments=segments, field_max=study.field_max)

    @cached_property
    def bounds(self) -> dict[str, tuple[float, float]]:
        """Least and greatest value of each parameter, by name, base to tip and then the field."""
        bounds: dict[str, tuple[float, float]] = {}
        for name in self.segment_names():
            bounds[f"{name}_around_deg"] = (-180.0, 180.0)
            bounds[f"{name}_along_deg"] = (-90.0, 90.0)
        if self.field_max is not None:
            bounds.update(
                zip(FIELD, ((0.0, 1e3 * self.field_max), (-180.0, 180.0), (-90.0, 90.0)), strict=True)
            )
        return bounds

    def segment_names(self) -> list[str]:
        """segment_1 is the segment at the base; numbers have as many digits as the last one, so that they sort."""
        digits = len(str(len(self.scene.regions())))
        return [f"segment_{i + 1:0{digits}d}" for i in self.segments]

    @property
    def count(self) -> int:
        """Directions in a design: one a magnetized segment, and the field's."""
        return len(self.segments) + (self.field_max is not None)

    @property
    def numbers(self) -> int:
        """Plain numbers in a design: the field's strength."""
        return int(self.field_max is not None)

    def design(self, parameters: Mapping[str, float]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Parameters as directions (count, 3), segments base to tip and then the field, and numbers from 0 to 1."""
        found = [
            direction(parameters[f"{name}_around_deg"], parameters[f"{name}_along_deg"])
            for name in self.segment_names()
        ]
        if self.field_max is None:
            return np.array(found), np.zeros(0)
        azimuth, elevation = (np.deg2rad(parameters[name]) for name in FIELD[1:])
        found.append(_from_azimuth(azimuth, elevation))
        return np.array(found), np.array([parameters[FIELD[0]] / (1e3 * self.field_max)])

    def parameters(self, directions: NDArray[np.float64], numbers: NDArray[np.float64]) -> dict[str, float]:
        """The inverse of `design`."""
        found: dict[str, float] = {}
        for name, vector in zip(self.segment_names(), directions, strict=False):
            found[f"{name}_around_deg"], found[f"{name}_along_deg"] = angles(vector)
        if self.field_max is not None:
            x, y, z = directions[-1]
            found[FIELD[0]] = float(numbers[0]) * 1e3 * self.field_max
            found[FIELD[1]] = float(np.rad2deg(np.arctan2(y, x)))
            found[FIELD[2]] = float(np.rad2deg(np.arctan2(z, np.hypot(x, y))))
        return found

    def distributions(self) -> dict[str, BaseDistribution]:
        """The parameters as Optuna asks for them."""
        from optuna.distributions import FloatDistribution

        return {name: FloatDistribution(low, high) for name, (low, high) in self.bounds.items()}

    def directions(self, parameters: Mapping[str, float]) -> NDArray[np.float64]:
        """Magnetization of every segment of the scene, (k, 3) unit vectors or zeros, in the undeformed body."""
        found = np.array([region.magnetization for region in self.scene.regions()], dtype=float)
        for i, name in zip(self.segments, self.segment_names(), strict=True):
            found[i] = direction(parameters[f"{name}_around_deg"], parameters[f"{name}_along_deg"])
        return found

    def field(self, parameters: Mapping[str, float]) -> NDArray[np.float64]:
        """The uniform part of the field, (3,) T."""
        if self.field_max is None:
            return np.array(self.scene.field.uniform, dtype=float)
        strength = 1e-3 * parameters[FIELD[0]]
        azimuth, elevation = (np.deg2rad(parameters[name]) for name in FIELD[1:])
        return strength * _from_azimuth(azimuth, elevation)

    def scene_of(self, parameters: Mapping[str, float]) -> Scene:
        """The scene of a trial."""
        scene = self.scene
        if self.segments:
            scene = scene.with_magnetizations(self.directions(parameters))
        if self.field_max is not None:
            scene = scene.with_field(self.field(parameters))
        return scene


def _from_azimuth(azimuth: float, elevation: float) -> NDArray[np.float64]:
    """Unit vector (3,) of a scene file's angles, in rad."""
    return np.array(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )
