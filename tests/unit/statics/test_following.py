"""Equilibria found from what others left: those that are found alone, near enough, and never a wrong place called near."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from reference.scenes import rod_scene

from magmpm import load_scene, run
from magmpm.compiled.thread_count import one_blas_thread
from magmpm.model import build
from magmpm.rod.cosserat import RodShape
from magmpm.scene import Scene
from magmpm.simulate import simulated
from magmpm.solving.solve import RunOptions
from magmpm.statics import axis
from magmpm.statics.axis import carried
from magmpm.statics.energy import Energy
from magmpm.statics.equilibrium import Following, solve_static
from magmpm.statics.grids import PROOF_SETTLED, SLENDER, approached
from magmpm.statics.layout import StaticModel, static_model
from magmpm.statics.newton import corrected

SHIPPED = Path(__file__).resolve().parents[3] / "data" / "scenes" / "axial_transverse.yaml"
FIELDS = ([0.0, 0.0, 2e-3], [0.0, 1e-3, 3e-3], [1e-3, 2e-3, 4e-3], [-2e-3, 2e-3, 4e-3])


CHANGES = {
    "another body": lambda scene: scene.with_material(
        shear_modulus=1.5 * scene.region_material(0).shear_modulus
    ),
    "turned magnets": lambda scene: scene.with_magnetizations([[0.6, 0.8, 0.0]]),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_they_are_those_found_alone(change: Callable[[Scene], Scene]) -> None:
    """Tips agree to 1e-6 L, as solves from different starts do, and stabilities to 1e-4, also after the body or its magnets were changed
    between two of them. Nothing that was left may count: not its stiffness, its remanence nor its soft modes.
    """
    scene = load_scene(SHIPPED).with_cells(2)
    last = [np.zeros((0, 0))]
    following = Following(lambda rod: last[-1])
    for k, field in enumerate(FIELDS):
        here = (scene if k < 2 else change(scene)).with_field(field)
        found = simulated(here, RunOptions(start=following))
        alone = run(here)
        last.append(found.grid_correction)
        np.testing.assert_allclose(found.tip, alone.tip, atol=1e-6 * scene.length)
        assert abs(found.stability - alone.stability) < 1e-4


def test_a_wrong_expectation_does_no_harm() -> None:
    """The solve begins at its rod if neighbors are nonsense, or of another grid."""
    scene = load_scene(SHIPPED).with_cells(2).with_field(FIELDS[2])
    alone = run(scene)
    shape = alone.grid_correction.shape

    def nonsense(rod: RodShape) -> np.ndarray:
        return np.asarray(1e-3 * np.random.default_rng(1).normal(size=shape))

    for expected in (nonsense, lambda rod: np.ones((2, 2)), lambda rod: None):
        found = simulated(scene, RunOptions(start=Following(expected)))
        np.testing.assert_allclose(found.tip, alone.tip, atol=1e-6 * scene.length)


def test_blas_has_one_thread_in_a_fresh_process() -> None:
    """SciPy's library too, loaded at the first solve: with a thread a core in each half of a factorization, moves took twice as long."""
    code = (
        "from magmpm.compiled.thread_count import one_blas_thread\n"
        "from threadpoolctl import threadpool_info, threadpool_limits\n"
        "def counts():\n"
        "    return [one['num_threads'] for one in threadpool_info() if one['user_api'] == 'blas']\n"
        "with one_blas_thread():\n"
        "    pass\n"
        "with threadpool_limits(2, user_api='blas'):\n"
        "    with one_blas_thread(), one_blas_thread():\n"
        "        inside = counts()\n"
        "    print([inside, counts()])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert [set(counts) for counts in json.loads(found.stdout)] == [{1}, {2}]


SCENE = rod_scene(length=24e-3, field=[0.0, 0.0, 5e-3])


def on_grid(cells: int) -> StaticModel:
    return static_model(build(SCENE.with_cells(cells)))


@pytest.fixture(scope="module")
def grids() -> tuple[StaticModel, np.ndarray, np.ndarray, np.ndarray]:
    """Three cells, where the equilibrium on 2 cells puts them, their own equilibrium, and the axis (k, 3) m on 2 cells."""
    coarse = on_grid(2)
    fine = on_grid(3)
    start = carried(coarse, solve_static(coarse).point.grid, fine)
    return fine, start, solve_static(fine).point.grid, points(fine, start)


def points(model: StaticModel, grid: np.ndarray) -> np.ndarray:
    return axis.centreline(model, grid)[:, 1:]


def apart(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.linalg.norm(one - other, axis=1).max())


@pytest.mark.parametrize("slenderness", [0.0, 2 * SLENDER])
def test_it_ends_where_the_equilibrium_is(grids, slenderness: float) -> None:
    """In single and in double precision, to a third more than PROOF_SETTLED of what it was to tell (what is left shrinks by a quarter a
    step)."""
    fine, start, truth, compared = grids
    told: list[int] = []
    with one_blas_thread():
        near = approached(
            Energy(fine),
            start,
            lambda grid: points(fine, grid),
            compared,
            slenderness,
            lambda step, _: told.append(step),
        )
    assert near is not None
    difference = apart(points(fine, truth), compared)
    assert difference > 1e-7, "there is something to tell"
    assert apart(points(fine, near), points(fine, truth)) < 4 / 3 * PROOF_SETTLED * difference
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
        assert (
            approached(
                Energy(fine),
                -start,
                lambda grid: points(fine, grid),
                compared,
                0.0,
                lambda *_: None,
            )
            is None
        )


def test_no_answer_from_a_folded_start(grids) -> None:
    """det F <= 0 somewhere: nothing is factored."""
    fine, start, _, compared = grids
    folded = start.copy()
    folded[:, 0::3] -= 2.0 * np.linspace(0.0, 24e-3, len(start))[:, None]
    assert (
        approached(
            Energy(fine), folded, lambda grid: points(fine, grid), compared, 0.0, lambda *_: None
        )
        is None
    )


def test_steps_that_tell_nothing_are_left_out(rng: np.random.Generator) -> None:
    """A step of length zero, as where no load is left, would divide nothing by nothing; one along which the energy curves down, turn the
    direction around. With those left out, the direction is that of the factors."""
    q = rng.standard_normal((4, 3))
    step = rng.standard_normal((4, 3))
    still = (np.zeros((4, 3)), np.zeros((4, 3)))
    np.testing.assert_array_equal(
        corrected(q, [still, (step, -step)], lambda right: -0.5 * right), -0.5 * q
    )
    exact = corrected(
        q, [still, (q, 2.0 * q)], lambda right: -right
    )  # the energy curves twice as much along q as the factors say
    np.testing.assert_allclose(exact, -0.5 * q, rtol=1e-14)
