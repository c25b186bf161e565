"""Near an equilibrium, by factors used again: near enough, in either precision, and never a wrong place called near."""

from __future__ import annotations

import numpy as np
import pytest
from reference.scenes import rod_scene

from magmpm.model import build
from magmpm.scene import Scene
from magmpm.statics import axis
from magmpm.statics.axis import carried
from magmpm.statics.energy import Energy
from magmpm.statics.equilibrium import one_blas_thread, solve_static
from magmpm.statics.grids import SETTLED, SLENDER, approached
from magmpm.statics.layout import StaticModel, static_model
from magmpm.statics.newton import corrected

SCENE = rod_scene(length=24e-3, field=[0.0, 0.0, 5e-3])


def on_grid(cells: int) -> StaticModel:
    return static_model(build(SCENE.with_cells(cells)))


@pytest.fixture(scope="module")
def grids() -> tuple[StaticModel, np.ndarray, np.ndarray, np.ndarray]:
    """Three cells, where the equilibrium on 2 cells puts them, their own equilibrium, and the axis (k, 3) m on 2 cells."""
    coarse, fine = on_grid(2), on_grid(3)
    start = carried(coarse, solve_static(coarse).point.grid, fine)
    return fine, start, solve_static(fine).point.grid, points(fine, start)


def points(model: StaticModel, grid: np.ndarray) -> np.ndarray:
    return axis.centreline(model, grid)[:, 1:]


def apart(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.linalg.norm(one - other, axis=1).max())


@pytest.mark.parametrize("slenderness", [0.0, 2 * SLENDER])
def test_it_ends_where_the_equilibrium_is(grids, slenderness: float) -> None:
    """In single and in double precision, to a third more than SETTLED of what it was to tell (what is left shrinks by a quarter a step)."""
    fine, start, truth, compared = grids
    told: list[int] = []
    with one_blas_thread():
        near = approached(Energy(fine), start, lambda grid: points(fine, grid), compared, slenderness, lambda step, _: told.append(step))
    assert near is not None
    difference = apart(points(fine, truth), compared)
    assert difference > 1e-7, "there is something to tell"
    assert apart(points(fine, near), points(fine, truth)) < 4 / 3 * SETTLED * difference
    assert told == list(range(len(told)))


def test_in_plane_strain_a_plane_has_one_row_of_nodes() -> None:
    """What is carried from 2 to 3 cells is near the equilibrium there: to a hundredth of the displacement."""
    data = SCENE.to_si()
    strip = {key: data["body"]["catheter"][key] for key in ("length", "material", "segments")}
    strip |= {"width": 4e-3, "thickness": 1.5e-3, "plane_strain": True}
    scene = Scene.from_si({**data, "body": {"strip": strip}})
    coarse, fine = (static_model(build(scene.with_cells(cells))) for cells in (2, 3))
    truth = solve_static(fine).point.grid
    start = carried(coarse, solve_static(coarse).point.grid, fine)
    assert np.abs(start - truth).max() < 1e-2 * np.abs(truth).max()


def test_no_answer_where_steps_lead_away(grids) -> None:
    """Bent to the other side: it says None instead of a place."""
    fine, start, _, compared = grids
    with one_blas_thread():
        assert approached(Energy(fine), -start, lambda grid: points(fine, grid), compared, 0.0, lambda *_: None) is None


def test_no_answer_from_a_folded_start(grids) -> None:
    """det F <= 0 somewhere: nothing is factored."""
    fine, start, _, compared = grids
    folded = start.copy()
    folded[:, 0::3] -= 2.0 * np.linspace(0.0, 24e-3, len(start))[:, None]
    assert approached(Energy(fine), folded, lambda grid: points(fine, grid), compared, 0.0, lambda *_: None) is None


def test_steps_that_tell_nothing_are_left_out(rng: np.random.Generator) -> None:
    """A step of length zero, as where no load is left, would divide nothing by nothing; one along which the energy curves down, turn the
    direction around. With those left out, the direction is that of the factors."""
    q, step = rng.standard_normal((4, 3)), rng.standard_normal((4, 3))
    still = (np.zeros((4, 3)), np.zeros((4, 3)))
    np.testing.assert_array_equal(corrected(q, [still, (step, -step)], lambda right: -0.5 * right), -0.5 * q)
    exact = corrected(q, [still, (q, 2.0 * q)], lambda right: -right)  # the energy curves twice as much along q as the factors say
    np.testing.assert_allclose(exact, -0.5 * q, rtol=1e-14)
