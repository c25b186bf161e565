"""Two scenes compared: their distance against formulas that the program does not use, its uncertainty against finer grids, wrong pairs."""

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from reference.scenes import BR, G, X, rod_scene
from reference.solids import box
from reference.stopped import switched_off

import magmpm
from magmpm import Scene
from magmpm.bodies.surface_mesh import write_stl
from magmpm.fields.dipole import MU0
from magmpm.materials import young_modulus
from magmpm.runs import Comparison, compare, distance

LENGTH = 24e-3
PLAIN = rod_scene(length=LENGTH, field=[0.0, 0.0, 5e-3])
SLENDER = rod_scene(length=60e-3, diameter=3e-3, field=[0.0, 0.0, 0.1e-3], cells=3)
YOUNG = young_modulus(G, 20.0 * G)


def along(scene: Scene, solver: dict[str, Any], strengths: tuple[float, ...]) -> Scene:
    """The scene in a field of these strengths at 0, 1, 2 ... s."""
    frames = [{"time": float(t), "strength": s} for t, s in enumerate(strengths)]
    data = scene.to_si()
    field = {**data["field"], "over_time": {"keyframes": frames}}
    return Scene.from_si({**data, "field": field, "solver": solver})


def bent(young: float) -> float:
    """The way (m) of the tip of the slender catheter, to first order: the torque m = Br B A/mu0 on each length bends it by m L^3/(3 E I),
    from E I theta'' = -m with theta(0) = theta'(L) = 0; A/I = 16/D^2.
    """
    body = SLENDER.body.catheter
    assert body is not None
    torque_over_inertia = BR * SLENDER.field.uniform[2] / MU0 * 16.0 / body.diameter**2
    return float(torque_over_inertia * body.length**3 / (3.0 * young))


def test_a_ratio_of_moduli_counts_by_youngs_modulus() -> None:
    """E = 9 K G/(3 K + G); the clamp and shear add up to D/L = 5 % of a way, of the difference too."""
    ways = [bent(young_modulus(G, ratio * G)) for ratio in (4.0, 100.0)]
    found = compare(
        SLENDER.with_material(bulk_to_shear=4.0), SLENDER.with_material(bulk_to_shear=100.0)
    )
    assert found.distance == pytest.approx(ways[0] - ways[1], rel=0.05, abs=found.uncertainty)
    assert found.uncertainty < 0.2 * found.distance
    assert found.distinct
    assert found.time is None


def test_a_missing_magnet_is_missed_by_the_way_that_it_bends_the_body() -> None:
    """5 % of the length, so second order counts 0.2 %; D/L = 5 % as above."""
    found = compare(SLENDER, SLENDER.with_material(remanence=0.0), of="tip")
    assert found.distance == pytest.approx(bent(YOUNG), rel=0.05)
    assert found.uncertainty < 0.01 * found.distance
    whole = compare(SLENDER, SLENDER.with_material(remanence=0.0))
    assert whole.distance == pytest.approx(found.distance, rel=1e-5)  # the tip goes farthest


def test_a_law_of_magnetization_counts_by_the_stretch_that_it_allows() -> None:
    """In a field along the magnet F Br pulls by Br B/mu0, which stretches the body by as much over E; R Br does not pull. The held face,
    which can't contract, stiffens up to a fifth of a diameter, 1 % of the length here.
    """
    strength = 5e-3
    pulled = SLENDER.with_field([strength, 0.0, 0.0])
    found = compare(pulled, pulled.with_material(magnetization_law="rotates"))
    way = pulled.length * BR * strength / (MU0 * YOUNG)
    assert found.distance == pytest.approx(way, rel=0.015)
    assert found.uncertainty < 0.01 * found.distance


def test_a_tolerance_is_no_difference_that_grids_could_tell() -> None:
    """1e-8 of the energy for 1e-11; the solves leave more than the answers differ by."""
    rough = rod_scene(length=LENGTH, field=[0.0, 0.0, 5e-3], tolerance=1e-8)
    found = compare(PLAIN, rough)
    assert found.distance <= found.uncertainty < 1e-4 * LENGTH
    assert not found.distinct
    assert "no more than the grid may make it" in repr(found)


def test_a_body_that_falls_is_behind_by_half_g_t_squared() -> None:
    """Not held, without a field. Leapfrog is exact under a constant force; the start is off by half a step, 1e-4 of the time at most."""
    data = rod_scene(length=LENGTH, gravity=[0.0, 0.0, -9.81]).to_si()
    data["body"]["catheter"]["clamp"] = "none"
    data["solver"] = {"dynamic": {"duration": 4e-3, "output_every": 2e-3}}
    falls = Scene.from_si(data)
    found = compare(falls, falls.with_effects(gravity=None))
    assert found.time == pytest.approx(4e-3)
    assert found.distance == pytest.approx(0.5 * 9.81 * 4e-3**2, rel=1e-3)
    assert found.uncertainty < 1e-3 * found.distance


def test_paths_are_compared_in_all_frames() -> None:
    """One is in twice the field for a moment: then they are as far apart as the two equilibria, and at the end they are not."""
    path = {"quasi_static": {"steps": 2}}
    one, other = (along(PLAIN, path, (0.1, peak, 0.1)) for peak in (1.0, 2.0))
    found = compare(one, other)
    rest = compare(PLAIN, PLAIN.with_field([0.0, 0.0, 10e-3]))
    assert found.time == 1.0
    assert found.distance == pytest.approx(
        rest.distance, abs=1e-6 * LENGTH
    )  # as equilibria are known
    assert found.uncertainty == pytest.approx(rest.uncertainty, rel=0.01)
    assert distance(*found.results) < 1e-6 * LENGTH


@cache
def finest(scene: Scene) -> magmpm.Result:
    return magmpm.run(scene.with_cells(7))


OTHERS = {
    "ratio of moduli": PLAIN.with_material(bulk_to_shear=200.0),
    "modulus": PLAIN.with_material(shear_modulus=100e3),
    "weight": PLAIN.with_effects(gravity={}),
    "bore": rod_scene(length=LENGTH, field=[0.0, 0.0, 5e-3], inner_diameter=1.5e-3),
}
ON_THREE_CELLS = ("ratio of moduli", "bore")


@pytest.mark.parametrize(
    ("name", "cells"),
    [
        pytest.param(
            name, cells, marks=[pytest.mark.slow] * (cells == 3 and name not in ON_THREE_CELLS)
        )
        for name in OTHERS
        for cells in (2, 3)
    ],
)
def test_the_uncertainty_holds_on_the_finest_grid(name: str, cells: int) -> None:
    """Against 7 cells; the distance is that of the two runs, the same both ways."""
    other = OTHERS[name]
    found = compare(PLAIN, other, cells=cells)
    fine = [finest(scene) for scene in (PLAIN, other)]
    assert abs(found.distance - distance(*fine)) < found.uncertainty < 0.1 * found.distance
    runs = [magmpm.run(scene.with_cells(cells)) for scene in (PLAIN, other)]
    assert found.distance == distance(*runs)
    back = compare(other, PLAIN, cells=cells)
    assert (back.distance, back.uncertainty) == (found.distance, found.uncertainty)


def test_jointed_bodies_are_told_by_finer_grids_from_either_side() -> None:
    """Where materials meet, 3 cells are proven by 6 (statics.resolution.proofs)."""
    sizes = {"directions": (X, X), "field": [0.0, 0.0, 2e-3], "length": LENGTH, "cells": 3}
    soft = rod_scene(**sizes)
    tip = rod_scene(**sizes, shear=(G, 2.0 * G))
    there = compare(soft, tip)
    assert there.finer_cells == compare(tip, soft).finer_cells == 6
    assert compare(soft, soft.with_material("m0", shear_modulus=1.1 * G)).finer_cells == 6


def parts(folder: Path, names: tuple[str, str] = ("held", "arm"), **more: Any) -> Scene:
    """Two blocks end to end at rest under their weight, the first held."""
    meshes = []
    for name, ends in zip(names, (((0, 0, 0), (2, 3, 3)), ((2, 0, 0), (9, 3, 3))), strict=True):
        write_stl(box(*ends), folder / f"{name}.stl")
        clamp = name == names[0]
        mesh = str(folder / f"{name}.stl")
        meshes.append({"mesh": mesh, "material": "m0", "clamp": clamp})
    data = rod_scene(gravity=[0.0, 0.0, -9.81]).to_si()
    return Scene.from_si({**data, "body": {"parts": {"unit": "mm", "meshes": meshes, **more}}})


def test_parts_are_compared_at_their_centers(tmp_path: Path) -> None:
    """To first order a weight twice as large bends twice as far; here 0.3 % of the length, so to 1 %."""
    scene = parts(tmp_path)
    heavy = scene.with_material("m0", density=2.0 * 1882.0)
    found = compare(scene, heavy)
    center = found.results[0].segment_center[1] - np.array([5.5e-3, 1.5e-3, 1.5e-3])
    assert found.distance == pytest.approx(float(np.linalg.norm(center)), rel=0.01)
    assert found.uncertainty < 0.2 * found.distance


def test_a_run_that_fails_says_which_scene_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    path = {"quasi_static": {"steps": 2}}
    scene = along(PLAIN, path, (0.1, 1.0))
    switched_off(monkeypatch, 0.6)
    with pytest.raises(
        magmpm.SolveError, match=r"the first scene on 2 cells across: .*switched off"
    ):
        compare(scene, scene)


MOTION = {"dynamic": {"duration": 1.0, "output_every": 0.5}}
PATH = {"quasi_static": {"steps": 2}}
WRONG: dict[str, tuple[Callable[[Path], tuple[Scene, Scene]], dict[str, Any], str]] = {
    "other cells": (lambda at: (PLAIN, PLAIN.with_cells(3)), {}, "of 2 and 3 cells across"),
    "error requested": (
        lambda at: (PLAIN, Scene.from_si({**PLAIN.to_si(), "resolution": {"error": 0.01}})),
        {},
        r"gives no cells_across\n.*\n.*cells=4",
    ),
    "a rest and a path": (
        lambda at: (PLAIN, along(PLAIN, PATH, (0.1, 1.0))),
        {},
        "an equilibrium and a run along time",
    ),
    "other ends": (
        lambda at: (along(PLAIN, MOTION, (1.0, 1.0)), along(PLAIN, PATH, (1.0, 1.0, 1.0))),
        {},
        "runs of 1 s and 2 s",
    ),
    "catheter and parts": (
        lambda at: (PLAIN, parts(at)),
        {},
        "a straight body and parts held, arm",
    ),
    "other parts": (
        lambda at: (parts(at), parts(at, ("held", "leg"))),
        {},
        "parts held, arm and parts held, leg",
    ),
    "one tip": (lambda at: (parts(at), parts(at, tip="arm")), {}, "where both scenes name one"),
    "no tip": (lambda at: (parts(at), parts(at)), {"of": "tip"}, "where both scenes name one"),
    "no place": (lambda at: (PLAIN, PLAIN), {"of": "middle"}, "is centreline or tip"),
    "too fine": (lambda at: (PLAIN, PLAIN), {"cells": 13}, "must be at most 12"),
    "too coarse": (lambda at: (PLAIN, PLAIN), {"cells": 1}, "at least 2"),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_pairs_are_refused_with_the_reason(name: str, tmp_path: Path) -> None:
    made, more, says = WRONG[name]
    with pytest.raises(magmpm.InputError, match=says):
        compare(*made(tmp_path), **more)


def test_it_is_public_and_says_its_numbers(tmp_path: Path) -> None:
    files = [
        scene.save(tmp_path / f"{name}.yaml")
        for name, scene in (("one", PLAIN), ("other", PLAIN.with_material(shear_modulus=100e3)))
    ]
    found = magmpm.compare(files[0], str(files[1]))
    assert isinstance(found, Comparison)
    assert repr(found).startswith(f"Comparison({1e3 * found.distance:.3g} +- ")
    assert "2 cells across, known from 4" in repr(found)
