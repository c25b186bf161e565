"""Numbers within bounds that a study varies, at their places in the scene, and the order of segments."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from magmpm.compiled.arrays import Array, Index, Plain
from magmpm.scene import Scene
from magmpm.scene.addresses import Place
from magmpm.studies.problem.variables import Vary
from magmpm.studies.search.knobs import Bounded, Choice, Knob, knobs
from magmpm.studies.search.parameters import VariedNumber

MOST_ORDERS = 1000


def with_own_materials(data: Plain, scene: Scene, numbers: Sequence[VariedNumber]) -> None:
    """Give each segment that has a number of a material to itself a material of its own, in place.

    Parameters
    ----------
    data : dict[str, Any]
        A scene's data, or the content of its file.
    scene : Scene
        The scene.
    numbers : sequence of VariedNumber
        Numbers that the study varies.
    """
    body = data["body"][scene.body.kind]
    for number in numbers:
        if number.segment is not None and number.place[0] == "materials":
            segment = body["segments"][number.segment]
            old = segment.get("material") or body["material"]
            segment["material"] = number.place[1]
            data["materials"].setdefault(number.place[1], dict(data["materials"][old]))


def _own(material: str, segment: int) -> str:
    """Name of a segment's own material."""
    ending = f" of segment {segment + 1}"
    return material.removesuffix(ending) + ending


def segment_names(scene: Scene) -> list[str]:
    """Name the segments of a scene.

    Parameters
    ----------
    scene : Scene
        The scene.

    Returns
    -------
    list of str
        segment_1, at the base, and so on; numbers have as many digits as the last one, so that
        they sort.
    """
    count = len(scene.regions())
    return [f"segment_{i + 1:0{len(str(count))}d}" for i in range(count)]


def within(
    name: str,
    what: str,
    ends: tuple[float, float],
    unit: float,
    place: Place,
    segment: int | None = None,
) -> VariedNumber:
    """Make a quantity between bounds.

    Parameters
    ----------
    name : str
        Of the parameter.
    what : str
        As of VariedNumber.
    ends : tuple of float, SI
        Least and greatest value.
    unit : float
        Units of the parameter in one of SI.
    place : Place
        Where the quantity stands in the scene's data.
    segment : int, optional
        Index of the segment that it belongs to.

    Returns
    -------
    VariedNumber
        The quantity.
    """
    low, high = ends
    return VariedNumber(
        name, unit * low, unit * high, what=what, unit=unit, place=place, segment=segment
    )


def numbers_of(vary: Vary, scene: Scene) -> tuple[VariedNumber, ...]:
    """Find the quantities that a study varies by words: lengths, and diameter, remanence, stiffness.

    Parameters
    ----------
    vary : Vary
        What the study's file says.
    scene : Scene
        Its scene.

    Returns
    -------
    tuple of VariedNumber
        The quantities.
    """
    found: list[VariedNumber] = []
    regions = scene.regions()
    names = segment_names(scene)
    if vary.length is not None:
        ends = (vary.length.min, vary.length.max)
        found += [
            within(
                f"{name}_length_mm", "length", ends, 1e3, ("body", *region.at, "length"), segment=i
            )
            for i, (name, region) in enumerate(zip(names, regions, strict=True))
        ]
    if vary.diameter is not None:
        ends = (vary.diameter.min, vary.diameter.max)
        place = ("body", scene.body.kind, "diameter")
        found.append(within("diameter_mm", "diameter", ends, 1e3, place))
    for what, given, of, factor, unit in (
        ("remanence", vary.remanence, scene.magnetized_regions(), 1e3, "mT"),
        ("shear_modulus", vary.shear_modulus, range(len(regions)), 1e-3, "kPa"),
    ):
        if given is None:
            continue
        ends = (given.min, given.max)
        if given.per == "segment":
            for i in of:
                place = ("materials", _own(regions[i].material_name, i), what)
                label = f"{names[i]}_{what}_{unit}"
                found.append(within(label, what, ends, factor, place, segment=i))
        else:
            for name in dict.fromkeys(regions[i].material_name for i in of):
                place = ("materials", name, what)
                found.append(within(f"{what}_of_{name}_{unit}", what, ends, factor, place))
    return tuple(
        one if one.segment is not None else replace(one, shared=_copies((one.place,), found, scene))
        for one in found
    )


def _copies(
    places: Sequence[Place], numbers: Sequence[VariedNumber], scene: Scene
) -> tuple[Place, ...]:
    """Places where segments with materials of their own have numbers of the materials that these copy, unless they vary by themselves."""
    regions = scene.regions()
    own = {n.place: n for n in numbers if n.segment is not None and n.place[0] == "materials"}
    found = {
        ("materials", copy[1], *place[2:]): None
        for place in places
        for copy, number in own.items()
        if place[:2] == ("materials", regions[number.segment or 0].material_name)
    }
    return tuple(place for place in found if place not in own)


def addressed(
    vary: Vary, scene: Scene, others: Sequence[VariedNumber]
) -> tuple[list[VariedNumber], list[Knob]]:
    """Find what a study varies by addresses.

    Parameters
    ----------
    vary : Vary
        What its file says.
    scene : Scene
        Its scene.
    others : sequence of VariedNumber
        What it varies by words.

    Returns
    -------
    tuple of (list of VariedNumber, list of Knob)
        Numbers within bounds, and what turns in other ways: choices, directions, vectors.

    Raises
    ------
    InputError
        As `knobs` does, and for what a word varies as well.
    """
    places: list[Place] = [other.place for other in others]
    if vary.field is not None:
        places.append(("field", "uniform"))
    if vary.length is not None:
        places.append(("body", scene.body.kind, "length"))
    regions = scene.regions()
    if vary.magnetization is not None:
        turned = vary.magnetization.regions(scene)
        places += [("body", *regions[k].at, "magnetization") for k in turned]
    for other in others:
        if other.segment is not None and other.what != "length":  # has a material of its own
            at = regions[other.segment].at
            places += [("body", *at, "material"), ("body", at[0], "material")]
    words = [Choice("another key of `vary`", (place,), ()) for place in dict.fromkeys(places)]
    numbers: list[VariedNumber] = []
    rest: list[Knob] = []
    for alone in knobs(vary.numbers or (), scene, words)[len(words) :]:
        knob = replace(alone, places=(*alone.places, *_copies(alone.places, others, scene)))
        if not isinstance(knob, Bounded):
            rest.append(knob)
            continue
        place, *shared = knob.places
        thick = place == ("body", scene.body.kind, "diameter") and not shared
        what = "diameter" if thick else "number"
        own = knob.name, knob.low, knob.high, knob.log, knob.whole
        numbers.append(VariedNumber(*own, what, 1.0 / knob.scale, place, shared=tuple(shared)))
    return numbers, rest


def kept_total(requested: Array, low: float, high: float, total: float) -> tuple[Array, Array]:
    """Find lengths within bounds that have a given sum and are nearest to those requested, and their derivatives.

    It is the projection on the sum and the bounds: all are shifted by one amount, and stop at their
    bounds. That amount is found exactly: the sum is piecewise linear in it, with corners where a
    length meets a bound.

    Parameters
    ----------
    requested : array (k,), m
        The lengths that are requested.
    low : float, m
        Least length; low k is at most `total`.
    high : float, m
        Greatest length; high k is at least `total`.
    total : float, m
        The sum.

    Returns
    -------
    lengths : array (k,), m
        The lengths.
    derivatives : array (k, k), no unit
        Of each by those requested.
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
    """Find all orders of a scene's magnetized (M) and plain (P) segments.

    Parameters
    ----------
    scene : Scene
        The scene.
    own : bool, default False
        Only the scene's own order.

    Returns
    -------
    tuple of str
        The orders, letters from base to tip.
    """
    magnetized = scene.magnetized_regions()
    pattern = "".join("M" if i in magnetized else "P" for i in range(len(scene.regions())))
    return (pattern,) if own else _orders(pattern)


def arrangement(scene: Scene, order: str) -> Index:
    """Find which of the scene's segments stands where in an order; magnetized ones stay in sequence among themselves, and plain ones too.

    Parameters
    ----------
    scene : Scene
        The scene.
    order : str
        Letters from base to tip.

    Returns
    -------
    array (k,) of int
        Numbers of the segments, from 0.
    """
    magnetized = scene.magnetized_regions()
    pieces = {
        "M": iter(magnetized),
        "P": (i for i in range(len(scene.regions())) if i not in magnetized),
    }
    return np.array([next(pieces[kind]) for kind in order])
