"""Scenes at the limits of what a user may request: they converge, in few steps, to the result of the rod or of a milder scene.

Rod and statics differ by about 0.05 D/L of the deflection on a solid rod (tests/validation/test_rod_statics.py); bounds here are a few
times that, because these bodies are neither slender nor smooth.
"""

import json

import numpy as np
import pytest
from reference.scenes import G, rod_scene

from magmpm.rod.cosserat import solve_rod
from magmpm.scene import Scene
from magmpm.simulate import run
from magmpm.studies.hard_cases import CASES, Case, run_cases

SPATIAL = [(1, 0, 0), (0.7, 0.6, 0.4), (-0.2, -0.8, 0.6)]
FIELD = np.array([2e-3, 10e-3, -14e-3])


def tips(scene: Scene, most_steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Tips of statics and rod over the length; det F stays between 1/2 and 3/2."""
    result = run(scene)
    rod = solve_rod(scene)
    assert result.converged
    assert not [
        text for text in result.warnings if not ("wall" in text or "not magnetized" in text)
    ]
    assert result.iterations <= most_steps
    assert 0.5 < result.min_det_F <= result.max_det_F < 1.5
    length = scene.body.catheter.length
    return result.tip / length, rod.position[-1] / length


def test_any_bulk_modulus() -> None:
    """K/G from a sponge (nu = 0.02) to nu = 0.4997, tip rotated by 50 to 100 degrees: within 2.5 % of L of the rod (see also the table).

    With F-bar the shape tends to a limit as K grows: from 500 G to 2000 G it changes only with E, by 9/(2000 x 3) = 0.1 %.
    """
    found = {}
    for ratio, most_steps in ((0.7, 8), (2, 8), (500, 30), (2000, 40)):
        found[ratio], rod = tips(
            rod_scene(directions=SPATIAL, field=FIELD, bulk_to_shear=ratio, cells=3), most_steps
        )
        assert np.linalg.norm(found[ratio] - rod) < 2.5e-2, ratio
    assert np.linalg.norm(found[500] - found[2000]) < 0.2e-2


@pytest.mark.parametrize("ratio", [10, 1000])
@pytest.mark.parametrize("first", ["stiff", "soft"])
def test_stiffness_contrast(ratio: float, first: str) -> None:
    """Segments alternate between G and G/ratio, like magnetic rings on soft joints. Stiff neighbors restrain joints: 1 to 2 % of L."""
    moduli = np.array([G, G / ratio, G, G / ratio])
    moduli = moduli if first == "stiff" else moduli[::-1]
    directions = [(1, 0, 0), (0, 0, 1), (1, 0, 0), (0, 0, 1)]
    statics, rod = tips(
        rod_scene(directions=directions, shear=moduli, field=(0, 0, 10e-3 / ratio), cells=3),
        8 if ratio == 10 else 25,
    )
    assert np.linalg.norm(statics - rod) < 3e-2
    assert statics[2] > 0.05


def test_cells_with_slivers() -> None:
    """At 6 and 7 cells across, corner cells contain 0.2 to 3 % material: no more steps than at 5, and a consistent result."""
    found = {}
    for cells in (5, 6, 7):
        found[cells], _ = tips(
            rod_scene(length=16e-3, directions=SPATIAL, field=5 * FIELD, cells=cells), 8
        )
    one = np.linalg.norm(found[6] - found[5])
    two = np.linalg.norm(found[7] - found[6])
    assert two < one < 0.3e-2  # error of the grid at 5 cells and L/D = 4


@pytest.mark.slow
@pytest.mark.parametrize("cells", [9, 10, 11])
def test_cells_with_smaller_slivers(cells: int) -> None:
    """At 9, 10 and 11 cells across, corner cells contain as little as 1e-3 of a full cell."""
    length = 16e-3
    coarse = run(rod_scene(length=length, directions=SPATIAL, field=5 * FIELD, cells=7))
    fine, _ = tips(rod_scene(length=length, directions=SPATIAL, field=5 * FIELD, cells=cells), 8)
    assert (
        np.linalg.norm(fine - coarse.tip / length) < 0.2e-2
    )  # error of the grid at 7 cells and L/D = 4


@pytest.mark.parametrize(
    ("wall", "cells"), [(0.4e-3, 2), (0.01e-3, 2), (0.1e-3, 3), (0.04e-3, 4), (0.01e-3, 4)]
)
def test_thin_tube(wall: float, cells: int) -> None:
    """Walls down to a hundredth of a cell, bent far less than for kinking (Brazier): within 0.2 % of L of the rod."""
    statics, rod = tips(
        rod_scene(inner_diameter=4e-3 - 2 * wall, field=(0, 0, 0.5e-3), cells=cells), 8
    )
    assert np.linalg.norm(statics - rod) < 0.2e-2
    assert statics[2] > 0.03


@pytest.mark.parametrize("B", [0.1, 0.4])
def test_strong_field(B: float) -> None:
    """100 to 400 times a field that bends it: sharply at the clamp, magnetic stress up to a quarter of G, strains of tens of percent."""
    result = run(rod_scene(field=(0, 0, B), cells=3))
    assert result.converged
    assert result.tip[2] > 0.9 * 40e-3
    assert result.min_det_F > 0.5
    against = run(rod_scene(directions=SPATIAL, field=(-B / 4, B / 20, 0), cells=3))
    assert against.converged


def test_as_long_as_thick() -> None:
    """L = D, where the rod model is not valid: it converges, rotated toward the field, to the same shape on every grid within 5 %."""
    *coarse, finer = (
        run(rod_scene(length=4e-3, field=(0, 0, 50e-3), cells=cells)) for cells in (2, 3, 4, 6)
    )
    assert all(result.converged for result in coarse)
    assert [result.tip[2] for result in coarse] == pytest.approx([finer.tip[2]] * 3, rel=0.05)


@pytest.mark.parametrize(
    ("lengths", "bound"), [([10.1, 0.1, 29.8], 2e-6), ([39.9, 0.1], 2e-6), ([0.1, 39.9], 0.2e-2)]
)
def test_segments_far_shorter_than_a_cell(lengths: list[float], bound: float) -> None:
    """A slice of 0.1 mm in cells of 1.3 mm: dividing a cell in two changes nothing where the strain varies slowly.

    At the clamp it does not: the volume constraint of two regions is stiffer than that of one. The bound is twice the grid's error.
    """
    given = {"field": (0, 5e-3, 5e-3), "cells": 3}
    whole, _ = tips(rod_scene(directions=[(1, 0, 0)], **given), 8)
    slices = {
        "directions": [(1, 0, 0)] * len(lengths),
        "lengths": [1e-3 * part for part in lengths],
    }
    cut, _ = tips(rod_scene(**slices, **given), 8)
    assert np.linalg.norm(whole - cut) < bound


def test_slice_of_another_magnetisation() -> None:
    """A slice of 1/13 of a cell, magnetized transversely, at an axially magnetized tip: its torque rotates the tip as in the rod model."""
    given = {"lengths": [39.9e-3, 0.1e-3], "field": (8e-3, 0, 0), "cells": 3}
    statics, rod = tips(rod_scene(directions=[(0, 0, 0), (0, 0, -1)], **given), 8)
    assert rod[2] > 1e-3
    assert statics[2] == pytest.approx(rod[2], rel=0.03)


def test_fifty_segments() -> None:
    statics, rod = tips(
        rod_scene(directions=[(1, 0, 0), (0, 1, 0.5)] * 25, field=(0, 5e-3, 8e-3), cells=3), 8
    )
    assert np.linalg.norm(statics - rod) < 1e-2


# Every hard case that `magmpm stability` runs stays within its bound; motions, with kernels of their own, in the long run


PARAMETERS = [
    pytest.param(
        one, id=one.name, marks=[pytest.mark.slow] if one.slow or not one.scene().static else []
    )
    for one in CASES
]


@pytest.mark.parametrize("case", PARAMETERS)
def test_hard_case(case: Case) -> None:
    measure, _, reason = case.run()
    assert measure <= case.bound, (
        f"{case.quantity}: {measure:.3g}, at most {case.bound:.3g}; {reason}"
    )


@pytest.mark.slow
def test_cases_in_two_processes() -> None:
    """They come back in their order, with the same numbers as in one process."""
    some = [case for case in CASES if case.name.startswith(("thin tube", "no load"))]
    one, two = (run_cases(some, processes=count) for count in (1, 2))
    assert [(o.case, o.measure, o.passed) for o in one] == [
        (o.case, o.measure, o.passed) for o in two
    ]


def test_names_tell_cases_apart() -> None:
    assert len({case.name for case in CASES}) == len(CASES) >= 38


def test_command(told) -> None:
    """A table or one JSON object; exit status 0 if all pass, 3 if one fails, 2 for an unknown case."""
    quick = "no load, begun from a loaded neighbor"
    found = json.loads(told("stability", "--case", "LOADED NEIGHBOR", "--json").out)
    assert [case["name"] for case in found["cases"]] == [quick]
    assert found["failed"] == []
    told("stability", "--case", "perpetual motion", status=2, says=quick)
    [case] = [case for case in CASES if case.name == quick]
    object.__setattr__(case, "bound", -1.0)
    try:
        printed = told("stability", "--case", quick, status=3, says=quick)
    finally:
        object.__setattr__(case, "bound", 1e-8)
    assert "FAILED" in printed.out
    assert case.weak in printed.out
