"""Rods that follow one another: on the branch that a push comes to, and designs that are mended where they leave it."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from test_insertion import MAX, insertion

from magmpm.errors import SolveError
from magmpm.studies.rods.rod_path import BRINK, RodPath, search
from magmpm.studies.rods.rod_trajectory import RodDesign


def turning_back():
    """Directions and fields of three depths: held along the field while it is short, then turned against it step by step."""
    d = np.tile([1.0, 0.0, 0.0], (3, 1))
    return d, MAX * np.array([[0.6, 0.0, 0.1], [0.0, 0.0, 0.6], [-0.5, 0.0, 0.3]])


def test_the_end_does_not_depend_on_the_steps():
    """With twice the steps on the way, a push that meets no limit point ends in the same equilibria."""
    found = insertion()
    d, fields = turning_back()
    coarse = found.rods
    fine = RodPath(coarse.rods, tuple(tuple(each for depth in way for each in (depth, depth)) for way in coarse.ways))
    ends = [[stops[-1].position for stops in way.stops(d, fields)] for way in (coarse, fine)]
    for one, other in zip(*ends, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-9)


def test_what_stays_in_the_guide_is_straight_and_what_is_out_keeps_its_shape():
    """Between two stops of one field, material moves on by the length that came out: the first step from a depth changes little."""
    found = insertion()
    d, fields = turning_back()
    ways = found.rods.stops(d, fields)
    for stops in ways:
        for stop in stops:
            np.testing.assert_allclose(np.linalg.norm(stop.q, axis=1), 1.0, atol=1e-12)
            np.testing.assert_allclose(stop.position[0], 0.0, atol=1e-15)
            np.testing.assert_allclose(stop.q[0], [1.0, 0.0, 0.0, 0.0], atol=1e-9)
    lengths = [stop.depth.place[-1] for stops in ways for stop in stops]
    assert np.all(np.diff(lengths) > 0)
    assert [stops[-1].depth.place[-1] for stops in ways] == pytest.approx(found.study.depths)
    np.testing.assert_allclose([stops[-1].field for stops in ways], fields)


def test_shapes_for_the_body_are_the_stops():
    found = insertion()
    d, fields = turning_back()
    for stops in found.rods.stops(d, fields):
        shape = stops[-1].shape(d)
        np.testing.assert_allclose(shape.position, stops[-1].position, atol=1e-8)
        assert shape.stable


def test_a_design_whose_rods_are_elsewhere_is_mended():
    """Given shapes that the push does not come to: the answer's value is what the push gives, and better than before."""
    found = insertion()
    way = found.rods
    d, fields = turning_back()
    elsewhere = way.rods.settled(d, -0.5 * fields, None)
    assert elsewhere is not None
    pushed = np.sqrt(sum(stops[-1].squares for stops in way.stops(d, fields)))
    design = way.mended(RodDesign(d, fields, 0.0, elsewhere))
    assert design is not None
    squares = [stops[-1].squares for stops in way.stops(design.directions, design.fields)]
    assert np.sqrt(sum(squares)) == pytest.approx(design.value, rel=1e-6)
    assert design.value < 0.5 * pushed
    by_fields = way.mended(RodDesign(d, fields, 0.0, elsewhere), turning=False)
    assert by_fields is not None
    np.testing.assert_array_equal(by_fields.directions, d)
    assert np.abs(by_fields.fields - fields).max() > 0.01 * np.abs(fields).max()


def test_search_judges_on_the_way():
    """The best design's value is that of its rods on the way, and the arc is followed within a hundredth of the length."""
    found = insertion()
    best = search(found.rods, found.path, seed=1, starts=20, wanted=1, enough=0.01 * 30e-3)[0]
    assert found.rods.least_stability(best) > BRINK
    squares = [stops[-1].squares for stops in found.rods.stops(best.directions, best.fields)]
    assert np.sqrt(sum(squares)) == pytest.approx(best.value, rel=1e-6)
    assert best.value < 0.01 * 30e-3


def test_no_equilibrium_on_the_way_is_an_error():
    found = insertion()
    d, fields = turning_back()
    with pytest.raises(SolveError, match="no equilibrium"):
        found.rods.stops(d, 1e30 * fields)


def test_a_design_near_the_end_of_a_branch_comes_after_a_safe_one() -> None:
    risky, safe = (SimpleNamespace(value=value, stability=stability) for value, stability in ((1.0, 0.0), (2.0, 1.0)))
    grown = iter([risky, safe])
    way = SimpleNamespace(
        rods=SimpleNamespace(grown=lambda path, rng: next(grown)), mended=lambda one: one, least_stability=lambda one: one.stability
    )
    assert search(way, None, seed=1, starts=2) == [safe, risky]
    grown = iter([risky] * 3)
    assert search(way, None, seed=1, starts=3, enough=1.5) == [risky] * 2, "one more of its kind ends the search"
