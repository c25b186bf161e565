"""Result.stability: the smallest eigenvalue of the tangent over the unloaded body's."""

from pathlib import Path

import numpy as np
import pytest
from reference.scenes import field_for_load, rod_scene
from scipy.linalg import eigh

import magmpm
from magmpm.model import build
from magmpm.scene import Scene
from magmpm.statics.equilibrium import solve_static
from magmpm.statics.layout import static_model

SCENE = Path(__file__).parents[3] / "data" / "scenes" / "axial_transverse.yaml"


def against(share: float, cells: int = 2, axis: int = 0) -> float:
    """Scene of a catheter magnetized along its axis, in a field against it of a share of the rod's critical field."""
    scene = magmpm.load_scene(SCENE).with_cells(cells)
    (material,) = scene.materials.values()
    G = material.shear_modulus
    E = 9 * material.bulk_to_shear * G / (3 * material.bulk_to_shear + 1)
    # Euler's column with a couple m B sin(angle) per length: E I theta'' + m B theta = 0, clamped and free: m B = (pi / 2 L)^2 E I.
    critical = (
        (np.pi / (2 * scene.length)) ** 2
        * E
        * scene.thickness**2
        / 16
        * 4e-7
        * np.pi
        / material.remanence
    )
    stability = magmpm.run(scene.with_field([-share * critical, 0.0, 0.0])).stability
    assert stability is not None
    return stability


def test_it_is_one_at_rest_and_falls_linearly_to_zero_at_the_rods_critical_field() -> None:
    values = [against(share) for share in (1e-9, 0.25, 0.5, 0.75, 0.9)]
    assert values[0] == pytest.approx(
        1.0, abs=1e-4
    )  # products by differences, in a field that is hardly zero
    slope, at_rest = np.polyfit([0.0, 0.25, 0.5, 0.75, 0.9], values, 1)
    np.testing.assert_allclose(
        np.polyval([slope, at_rest], [0.0, 0.25, 0.5, 0.75, 0.9]), values, atol=0.01
    )  # the mode changes a little
    assert -at_rest / slope == pytest.approx(
        1.0, abs=0.04
    )  # a body 10 diameters long, 2 cells: 2 % stiffer at its clamp


def test_two_grids_agree() -> None:
    assert against(0.5, 3) == pytest.approx(against(0.5), abs=0.01)


@pytest.mark.parametrize("cells", [4, 8])
def test_in_plane_strain_no_number_overflows(cells: int) -> None:
    """There is one place across the width, and nothing twists: its distance from the middle, over the width of nothing, once was 1e280."""
    scene = magmpm.load_scene(SCENE.with_name("zhao_plane_strain.yaml")).with_cells(cells)
    with np.errstate(all="raise", under="ignore"):
        assert magmpm.run(scene).stability == pytest.approx(2.90, abs=0.01)


def test_it_does_not_depend_on_the_direction_of_a_section() -> None:
    """The same load along y and along z."""
    scene = magmpm.load_scene(SCENE).with_cells(2)
    values = [
        magmpm.run(scene.with_field(field)).stability
        for field in ([0.0, 4e-3, 0.0], [0.0, 0.0, 4e-3])
    ]
    assert values[0] == pytest.approx(values[1], rel=2e-3)  # ENOUGH, of either


NEEDLE = {"length": 200e-3, "diameter": 1e-3}
BENT = {
    "directions": [(1, 0, 0), (0.7, 0.6, 0.4), (-0.2, -0.8, 0.6)],
    "field": (2e-3, 10e-3, -14e-3),
    "cells": 3,
}


def smallest(scene: Scene) -> tuple[float, float]:
    """The eigenvalue by subspace iteration with factors of the true tangent, and the share of the unloaded body's that a result gives."""
    found = solve_static(static_model(build(scene)))
    assert found.stability is not None
    energy = found.energy
    _, matrix = energy.tangent(found.point)
    assert matrix.factor()
    X = energy.free_columns(
        np.random.default_rng(1).standard_normal((energy.shape[0], 4, energy.shape[1]))
    )
    for _ in range(12):
        Y = matrix.solve_columns(energy.mass(X))
        values, vectors = eigh(*(np.einsum("pam,pbm->ab", Y, energy.mass(one)) for one in (X, Y)))
        X = np.ascontiguousarray(np.einsum("pam,ab->pbm", Y, vectors))
    return float(values[0]), found.stability


@pytest.mark.parametrize(
    "given",
    [
        {**NEEDLE, "field": field_for_load(5.0, np.pi / 2, **NEEDLE)},
        {**BENT, "bulk_to_shear": 2000},
        {**BENT, "bulk_to_shear": 20},
    ],
    ids=["L/D 200", "K/G 2000", "K/G 20"],
)
def test_it_is_the_tangents_where_stretching_is_far_stiffer_than_bending(given: dict) -> None:
    """Against factors of the true tangent, loaded and at rest. The quotient is true to the square of the soft vector's error: 1e-3."""
    loaded, share = smallest(rod_scene(**given))
    rest, one = smallest(rod_scene(**{**given, "field": (1e-12, 0.0, 0.0)}))
    assert one == pytest.approx(1.0, abs=2e-3)
    assert share == pytest.approx(loaded / rest, rel=5e-3)
