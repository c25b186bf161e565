"""A scene with some of its values changed: its data are edited once, and read as a file's are."""

from __future__ import annotations

import itertools
import math
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magmpm.compiled.arrays import Array
from magmpm.scene import Scene
from magmpm.studies.problem.variables import Vary
from magmpm.studies.search.parameters import VariedNumber

MOST_ORDERS = 1000
UNITS = {
    "length": (1e3, "mm"),
    "diameter": (1e3, "mm"),
    "remanence": (1e3, "mT"),
    "field": (1e3, "mT"),
    "shear_modulus": (1e-3, "kPa"),
}


class Edits:
    """Changes to a scene's data: its own (SI), or, where `content` is given, those of its file, with units as text."""

    def __init__(self, scene: Scene, content: dict[str, Any] | None = None) -> None:
        self.data = scene.to_si() if content is None else content
        self._as_text = content is not None
        self._body = self.data["body"][scene.body.kind]

    def _written(self, what: str, value: float) -> Any:
        """A value, SI, as the data have it: text has 15 digits, which are the value to rounding."""
        factor, unit = UNITS[what]
        return f"{factor * value:.15g} {unit}" if self._as_text else value

    def segment(self, index: int) -> dict[str, Any]:
        """The data of the segment with this number, from 0."""
        found: dict[str, Any] = self._body["segments"][index]
        return found

    @staticmethod
    def material_name(scene: Scene, number: VariedNumber) -> str:
        """The name of the material that a number belongs to; a segment's own is named after it."""
        if isinstance(number.of, str):
            return number.of
        assert number.of is not None
        return scene.regions()[number.of].material_name + _ending(number.of)

    def number(self, number: VariedNumber, value: float) -> None:
        """A diameter, or a quantity of a material, SI. A segment gets a material of its own where it needs one."""
        if number.what == "diameter":
            self._body["diameter"] = self._written("diameter", value)
            return
        name = number.of
        if isinstance(name, int):
            segment = self.segment(name)
            old = segment.get("material") or self._body["material"]
            name = old if old.endswith(_ending(name)) else old + _ending(name)
            self.data["materials"].setdefault(name, dict(self.data["materials"][old]))
            segment["material"] = name
        self.data["materials"][name][number.what] = self._written(number.what, value)

    def lengths(self, lengths: Array, *, keep: bool) -> None:
        """Lengths (k,) m of the segments; keep: they sum to the body's length to rounding, and leave it as it is."""
        for segment, length in zip(self._body["segments"], lengths.tolist(), strict=True):
            segment["length"] = self._written("length", length)
        if keep:
            del self._body["segments"][int(np.argmax(lengths))][
                "length"
            ]  # it takes the rest, to the last bit
        else:
            self._body["length"] = self._written("length", math.fsum(lengths.tolist()))

    def field(self, uniform: Array) -> None:
        """The uniform part of the field, (3,) T."""
        self.data["field"] = {
            **self.data.get("field", {}),
            "uniform": [self._written("field", x) for x in uniform.tolist()],
        }

    def order(self, pieces: NDArray[np.int64]) -> None:
        """The segments in this order, by their numbers in the scene."""
        self._body["segments"] = [self._body["segments"][piece] for piece in pieces]

    def scene(self) -> Scene:
        """The scene. Raises InputError for values that no scene has."""
        return Scene.from_si(self.data)


def _ending(segment: int) -> str:
    """Ending of the name of a segment's own material."""
    return f" of segment {segment + 1}"


def segment_names(scene: Scene) -> list[str]:
    """segment_1, at the base, and so on; numbers have as many digits as the last one, so that they sort."""
    count = len(scene.regions())
    return [f"segment_{i + 1:0{len(str(count))}d}" for i in range(count)]


def numbers_of(vary: Vary, scene: Scene) -> tuple[VariedNumber, ...]:
    """The numbers within bounds that a study varies: lengths, diameter, remanence, stiffness."""
    found: list[VariedNumber] = []
    regions = scene.regions()
    magnetized = scene.magnetized_regions()
    names = segment_names(scene)
    if vary.length is not None:
        low = vary.length.min
        high = vary.length.max
        found += [
            VariedNumber(f"{name}_length_mm", "length", low, high, 1e3, i)
            for i, name in enumerate(names)
        ]
    if vary.diameter is not None:
        found.append(
            VariedNumber("diameter_mm", "diameter", vary.diameter.min, vary.diameter.max, 1e3)
        )
    for what, given, of in (
        ("remanence", vary.remanence, magnetized),
        ("shear_modulus", vary.shear_modulus, range(len(regions))),
    ):
        if given is not None:
            factor, unit = UNITS[what]
            used = dict.fromkeys(regions[i].material_name for i in of)
            called = (
                {f"{names[i]}_{what}": i for i in of}
                if given.per == "segment"
                else {f"{what}_of_{name}": name for name in used}
            )
            found += [
                VariedNumber(f"{name}_{unit}", what, given.min, given.max, factor, whose)
                for name, whose in called.items()
            ]
    return tuple(found)


def kept_total(requested: Array, low: float, high: float, total: float) -> tuple[Array, Array]:
    """The lengths (k,) within low and high that sum to `total` and are nearest to those requested, and their derivatives (k, k).

    The projection on the sum and the bounds: all are shifted by one amount, and stop at their bounds. That amount is found exactly: the
    sum is piecewise linear in it, with corners where a length meets a bound. low k <= total <= high k.
    """
    k = len(requested)
    corners = np.unique(np.concatenate([low - requested, high - requested]))
    sums = np.array([np.clip(requested + shift, low, high).sum() for shift in corners])
    shift = float(np.interp(total, sums, corners))
    lengths = np.clip(requested + shift, low, high)
    free = (requested + shift > low) & (requested + shift < high)
    derivative = np.zeros((k, k))
    if free.any():
        derivative[np.ix_(free, free)] = np.eye(int(free.sum())) - 1.0 / free.sum()
    return lengths, derivative


@lru_cache(maxsize=8)
def _orders(pattern: str) -> tuple[str, ...]:
    places = range(len(pattern))
    return tuple(
        "".join("M" if i in chosen else "P" for i in places)
        for chosen in itertools.combinations(places, pattern.count("M"))
    )


def orders(scene: Scene, *, own: bool = False) -> tuple[str, ...]:
    """All orders of the scene's magnetized (M) and plain (P) segments, base to tip; own: only the scene's."""
    magnetized = scene.magnetized_regions()
    pattern = "".join("M" if i in magnetized else "P" for i in range(len(scene.regions())))
    return (pattern,) if own else _orders(pattern)


def arrangement(scene: Scene, order: str) -> NDArray[np.int64]:
    """The numbers (k,) of the scene's segments in this order: magnetized ones stay in sequence among themselves, and plain ones too."""
    magnetized = scene.magnetized_regions()
    pieces = {
        "M": iter(magnetized),
        "P": (i for i in range(len(scene.regions())) if i not in magnetized),
    }
    return np.array([next(pieces[kind]) for kind in order])
