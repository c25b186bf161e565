"""Laws of the static solve: symmetry, independence of the start, stability, reported failure."""

from dataclasses import replace
from pathlib import Path

import numba
import numpy as np
import pytest
from reference.scenes import field_for_load, rod_scene
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from magmpm.errors import SolveError
from magmpm.model import build
from magmpm.results.result import Result
from magmpm.rod.cosserat import solve_rod
from magmpm.scene import Scene, load_progress
from magmpm.simulate import run
from magmpm.statics import axis
from magmpm.statics.arcs import along_arc, rest_nodes
from magmpm.statics.energy import Energy
from magmpm.statics.equilibrium import solve_static
from magmpm.statics.layout import StaticModel, static_model
from magmpm.statics.newton import minimize
from magmpm.statics.rod_start import from_rod, straight

L = 32e-3
DIRECTIONS = np.array([(1, 0, 0), (0.7, 0.6, 0.4), (-0.2, -0.8, 0.6)])
FIELD = np.array([2e-3, 10e-3, -14e-3])
GRAVITY = np.array([0, -3, -9.81])


def spatial_scene(T: np.ndarray | None = None, **changes: object) -> Scene:
    """Three segments that bend and twist out of any plane, with a displacement of a third of the length; all vectors are rotated by T."""
    T = np.eye(3) if T is None else T
    given = {"directions": DIRECTIONS @ T.T, "field": T @ FIELD, "gravity": T @ GRAVITY}
    return rod_scene(length=L, **{**given, **changes})


@pytest.fixture(scope="module")
def spatial() -> Result:
    return run(spatial_scene())


def buckled() -> Scene:
    """A catheter magnetized along its axis, in a field against it, beyond the load at which it turns round: to +z or to -z."""
    return rod_scene(
        length=L, directions=np.array([[1.0, 0, 0]]), field=np.array([-14e-3, 0, 0]), gravity=None
    )


def test_a_rod_as_start_chooses_the_branch() -> None:
    """From the rod that is mirrored to the other side, the equilibrium on that side is found, the mirror of the first."""
    scene = buckled()
    rod = solve_rod(scene)
    flip = np.diag([1.0, 1.0, -1.0])
    frames = flip @ rod.frames @ flip
    below = replace(
        rod,
        position=rod.position @ flip,
        frames=frames,
        curvature=rod.curvature * [-1, -1, 1],
        strain=rod.strain * [1, 1, -1],
    )
    up = run(scene)
    down = run(scene, start=below)
    assert abs(up.tip[2]) > 0.2 * L
    assert np.sign(up.tip[2]) != np.sign(down.tip[2])
    np.testing.assert_allclose(down.tip, flip @ up.tip, atol=1e-6 * L)  # the solve's tolerance


def test_a_rod_of_another_length_is_refused() -> None:
    with pytest.raises(ValueError, match="the rod is 20 mm long, and the body 32 mm"):
        run(buckled(), start=solve_rod(rod_scene(length=20e-3, field=FIELD)))


def test_a_motion_takes_no_start() -> None:
    scene = buckled()
    moving = Scene.from_si({**scene.to_si(), "solver": {"dynamic": {"duration": 1e-3}}})
    with pytest.raises(ValueError, match="a scene that moves"):
        run(moving, start=solve_rod(scene))


def test_no_equilibrium_near_a_rod_is_an_error() -> None:
    """A straight rod is no equilibrium in that field, and the solve leads far away: it says so, and goes to no other branch. A stub is near
    its rod by its axis: its particles are as far from that as a tenth of its length."""
    scene = buckled()
    straight_rod = solve_rod(scene.with_field([0.0, 0.0, 0.0]))
    with pytest.raises(SolveError, match="near the rod"):
        run(scene, start=straight_rod)
    stub = rod_scene(length=4.5e-3, field=FIELD)
    assert (
        np.linalg.norm(run(stub, start=solve_rod(stub)).tip - run(stub).tip) < 1e-6 * 4.5e-3
    )  # the solve's tolerance


def largest_move(result: Result) -> float:
    return float(np.abs(result.particle_position - result.particle_reference).max())


TURNS = {
    "mirror y": np.diag([1.0, -1.0, 1.0]),
    "mirror z": np.diag([1.0, 1.0, -1.0]),
    "quarter turn": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "half turn": np.diag([1.0, -1.0, -1.0]),
    "swap y and z": np.array([[1.0, 0, 0], [0, 0, 1], [0, 1, 0]]),
}


@pytest.mark.parametrize("turn", TURNS)
def test_turned_scene_turned_answer(spatial: Result, turn: str) -> None:
    """The grid has the symmetry of a square: if the scene is mirrored or rotated by quarter turns about x, so is the result.

    Only the order of sums differs: the shapes agree to rounding, 1e-16 of the length, times the stiffest mode over bending, about 1e6.
    """
    T = TURNS[turn]
    result = run(spatial_scene(T))
    # the particle at the transformed position of a particle of the other scene
    distance, partner = cKDTree(spatial.particle_reference @ T.T).query(result.particle_reference)
    assert distance.max() < 1e-15
    expected = spatial.particle_position[partner] @ T.T
    np.testing.assert_allclose(result.particle_position, expected, rtol=0, atol=1e-10 * L)
    assert largest_move(spatial) > 0.3 * L


def test_answer_does_not_depend_on_the_start(spatial: Result) -> None:
    """From the rod, from the straight body in 1 or 6 load steps, from two neighboring designs: the same shape.

    The solve stops when a step lowers the energy by 1e-11, so shapes differ by at most about the square root of that, 3e-6.
    """
    near = run(spatial_scene().with_field(1.1 * FIELD))
    far = run(spatial_scene().with_magnetizations(DIRECTIONS[::-1]))
    others = {
        "one step": run(spatial_scene(field_steps=1)),
        "six steps": run(spatial_scene(field_steps=6)),
        "near design": run(spatial_scene(), start=near),
        "far design": run(spatial_scene(), start=far),
    }
    for name, other in others.items():
        gap = np.abs(other.particle_position - spatial.particle_position).max()
        assert gap < 3e-6 * L, name
    for other in (near, far):
        assert np.abs(other.particle_position - spatial.particle_position).max() > 1e-2 * L


def test_a_near_neighbour_saves_steps(spatial: Result) -> None:
    """From its own result it ends at once (a first step may be shifted); from a result 1 % away it takes fewer steps than from the rod."""
    assert run(spatial_scene(), start=spatial).iterations <= 2
    near = run(spatial_scene().with_field(1.01 * FIELD))
    assert run(spatial_scene(), start=near).iterations < spatial.iterations


def test_start_is_the_rod_dressed_as_a_body() -> None:
    """The shape of the rod on the grid: its axis agrees with the rod to second order in the cell size; sections contract correctly, so that
    volume changes little except at the clamp; without load there is no displacement at all."""
    model = static_model(build(spatial_scene(cells=4)))
    rod = solve_rod(model.scene)
    begin = from_rod(model, rod)
    line = axis.centreline(model, begin)
    inside = (
        line[:, 0] > model.grid.spacing[0]
    )  # at the clamp the section cannot rotate, which the rod ignores
    gap = line[inside, 1:] - rod.at(line[inside, 0])
    assert np.abs(gap).max() < 2e-3 * L
    point = Energy(model).at(begin)
    away = model.particles.position[:, 0] > 4e-3  # one diameter from the clamp
    det = np.linalg.det(point.F)
    assert np.abs(det[away] - 1).max() < 0.06
    assert 0.8 < point.min_det_F < point.max_det_F < 1.2
    rest = static_model(build(rod_scene(length=L)))
    assert not from_rod(rest, solve_rod(rest.scene)).any()


def test_it_is_a_stable_equilibrium() -> None:
    """At the solution the tangent is positive definite. A Newton step would lower the energy by less than 1e-11, move 3e-6 of L."""
    model = static_model(build(spatial_scene()))
    energy = Energy(model)
    found = solve_static(model)
    residual, matrix = energy.tangent(found.point)
    assert matrix.factor()
    step = -matrix.solve(residual)
    assert -np.sum(residual * step) / 2 < 1e-11 * abs(found.point.energy - energy.rest_energy())
    assert np.abs(step).max() < 3e-6 * L


def antiparallel(load: float, **changes: object) -> Scene:
    """Magnetized along +x in a field along -x. The elastica buckles at load pi^2/4 = 2.467, this short coarse body at about 2.53."""
    given = {"length": 40e-3, "diameter": 4e-3}
    return rod_scene(field=field_for_load(load, np.pi, **given) * [1, 0, 1], **given, **changes)


def test_newton_leaves_an_unstable_equilibrium() -> None:
    """From the straight body, where all forces balance above the critical load, Newton's method follows the direction of negative curvature
    to the buckled shape that is also found from the rod. (Slowly: hence the rod.)"""
    scene = antiparallel(5.0)
    model = static_model(build(scene))
    found = minimize(Energy(model), straight(model), tolerance=1e-11, max_steps=300)
    tip = axis.along_axis(model, found.point.grid, axis.end_face_weights(model), np.array([40e-3]))[
        0
    ]
    expected = run(scene).tip
    assert tip[0] == pytest.approx(expected[0], abs=1e-5 * 40e-3)
    assert np.hypot(tip[1], tip[2]) == pytest.approx(expected[2], abs=1e-5 * 40e-3)


@pytest.mark.parametrize("load", [2.6, 5.0])
def test_ramp_follows_the_buckled_branch(load: float) -> None:
    """Load steps from the straight body end on the branch that is found from the rod: of all azimuths, which cost the same, toward +z."""
    given = run(antiparallel(load))
    assert given.tip[2] > 0.3 * 40e-3
    assert abs(given.tip[1]) < 1e-3 * 40e-3
    ramped = run(antiparallel(load, field_steps=5))
    np.testing.assert_allclose(
        ramped.particle_position, given.particle_position, rtol=0, atol=1e-5 * 40e-3
    )


def test_standing_column_falls_over() -> None:
    """Gravity along -x on 56 x 3 mm, rho g A L^3/(E I) = 16.3: above Greenhill's 7.84, it must leave the straight shape.

    Source of 7.837: Greenhill, Proc. Camb. Phil. Soc. 4 (1881) 65-73."""
    result = run(rod_scene(length=56e-3, diameter=3e-3, gravity=(-9.81, 0, 0)))
    assert result.tip[0] < 0
    assert result.tip[2] > 0.5 * 56e-3
    below = run(rod_scene(length=56e-3, diameter=3e-3, gravity=(-9.81 * 7.0 / 16.3, 0, 0)))
    assert np.hypot(*below.tip[1:]) < 1e-9 * 56e-3


def test_unloaded_body_is_exactly_undeformed(spatial: Result) -> None:
    """No load, no displacement: exactly from the undeformed start; to rounding from a bent start."""
    rest = spatial_scene(field=(0, 0, 0), gravity=(0, 0, 0))
    assert largest_move(run(rest)) == 0
    assert largest_move(run(rod_scene(length=L))) == 0
    returned = run(rest, start=spatial)
    assert largest_move(returned) < 1e-12 * L
    assert returned.max_det_F - returned.min_det_F < 1e-10


@pytest.mark.parametrize("kind", ["field", "gravity"])
def test_small_loads_are_linear(kind: str) -> None:
    """Tip deflection over load is constant, from far below rounding of the length up to where the square of the slope matters."""
    full = (
        3e-5 if kind == "field" else 0.02
    )  # deflection 1e-4 m; slope 0.004: 1 % of a percent from linear
    ratios = []
    for part in np.logspace(0, -7, 15):
        load = (0, 0, full * part)
        ratios.append(run(rod_scene(length=L, **{kind: load})).tip[2] / load[2])
    np.testing.assert_allclose(ratios, ratios[0], rtol=1e-4)
    assert abs(ratios[0]) > 0


def test_unconverged_run_says_so() -> None:
    """Too few steps: SolveError with exit status 3, a reason that names the setting, and the last good state or None."""
    with pytest.raises(
        SolveError,
        match=(
            r"no equilibrium within 1 Newton step.*to try: solver\.static: \{field_steps: 40,"
            r" max_steps: 150\}"
        ),
    ) as caught:
        run(spatial_scene(max_steps=1))
    assert caught.value.exit_status == 3
    assert "% of the load" in caught.value.reason
    state = caught.value.state
    assert state is None or (isinstance(state, Result) and not state.converged)


@pytest.mark.skipif(numba.config.NUMBA_NUM_THREADS < 2, reason="Numba was started with one thread")
def test_the_same_bits_for_any_number_of_threads() -> None:
    """Shape, energy, steps: the order of sums is given by the slabs, not by the threads."""
    scene = spatial_scene(lengths=[9e-3, 14e-3, 9e-3], cells=3)
    before = numba.get_num_threads()
    results = []
    try:
        for threads in (1, 2, 2):
            numba.set_num_threads(threads)
            results.append(run(scene))
    finally:
        numba.set_num_threads(before)
    for other in results[1:]:
        assert np.array_equal(results[0].particle_position, other.particle_position)
        assert np.array_equal(results[0].centreline, other.centreline)
        assert (results[0].energy, results[0].iterations) == (other.energy, other.iterations)


def test_numbers_that_are_not_finite_end_in_an_error() -> None:
    """NaN in the material never gives a result, and is detected at once."""
    model = static_model(build(spatial_scene()))
    shear = model.shear.copy()
    shear[7] = np.nan
    with np.errstate(all="ignore"), pytest.raises(SolveError):
        minimize(Energy(replace(model, shear=shear)), straight(model), tolerance=1e-11, max_steps=5)


def test_torn_start_is_refused() -> None:
    """A start with det F <= 0 has no energy to lower."""
    model = static_model(build(spatial_scene()))
    torn = straight(model)
    torn[3] = 2 * model.grid.spacing[0]
    with pytest.raises(SolveError, match="det F <= 0"):
        minimize(Energy(model), torn, tolerance=1e-11, max_steps=60)


def test_neighbour_on_another_grid_is_refused() -> None:
    other = run(spatial_scene(cells=3))
    with pytest.raises(ValueError, match="same grid"):
        run(spatial_scene(), start=other)


def test_progress_is_told_of_each_step() -> None:
    """on_progress(step, decrement): steps count up, decrements fall below the first."""
    told: list[tuple[int, float]] = []
    scene = rod_scene(length=L, field=(0, 0, 3e-3), field_steps=1)
    run(scene, on_progress=lambda step, decrement: told.append((step, decrement)))
    assert [step for step, _ in told] == list(range(1, len(told) + 1))
    assert len(told) >= 3
    assert told[-1][1] < told[0][1]


def test_progress_can_tell_the_share_of_a_growing_load() -> None:
    """While a load grows in steps, who is told of a Newton step can ask between which shares it is; a load at once has none."""
    shares = set()
    for steps in (4, 1):
        scene = rod_scene(length=L, field=(0, 0, 3e-3), field_steps=steps)
        run(scene, on_progress=lambda *_: shares.add(load_progress.now()))
    assert shares == {None, (0.0, 0.25), (0.25, 0.5), (0.5, 0.75), (0.75, 1.0)}
    assert load_progress.now() is None


@pytest.fixture(scope="module")
def model() -> StaticModel:
    return static_model(build(rod_scene(length=0.03, diameter=3e-3)))


def turning(model: StaticModel, axis: np.ndarray) -> np.ndarray:
    """The direction (planes, m) in which the whole body turns about the origin."""
    return np.cross(axis, rest_nodes(model)).reshape(model.layout.planes, -1)


def test_a_body_that_turns_as_a_whole_is_not_strained(model: StaticModel) -> None:
    axis = np.array([0.3, -1.1, 0.7])
    reached = along_arc(
        model, np.zeros((model.layout.planes, model.layout.m)), turning(model, axis), 1.0
    )
    turned = rest_nodes(model) @ Rotation.from_rotvec(axis).as_matrix().T
    # The center of the first plane goes straight; seen from it the body is turned exactly, to rounding.
    found = rest_nodes(model) + reached.reshape(turned.shape)
    assert np.abs((found - found[0].mean(axis=0)) - (turned - turned[0].mean(axis=0))).max() < 1e-14


def test_to_first_order_it_is_the_straight_step(model: StaticModel) -> None:
    rng = np.random.default_rng(1)
    shape = (model.layout.planes, model.layout.m)
    grid = 1e-4 * rng.normal(size=shape)
    direction = 1e-3 * rng.normal(size=shape) + turning(model, np.array([1.0, 2.0, -1.0]))

    def off(fraction: float) -> float:
        return float(
            np.abs(along_arc(model, grid, direction, fraction) - grid - fraction * direction).max()
        )

    assert np.log2(off(2e-3) / off(1e-3)) == pytest.approx(2.0, abs=0.02)


def test_bending_along_an_arc_keeps_the_length(model: StaticModel) -> None:
    """Every plane turned by its own angle about y, a straight step of half a turn at the tip."""
    X = rest_nodes(model)
    angle = X[..., 0] / X[..., 0].max() * np.pi / 2
    d = np.zeros_like(X)
    d[..., 0] = angle * X[..., 2]
    gap = np.diff(X[:, 0, 0], prepend=0.0)
    d[..., 2] = -np.cumsum(gap * angle.mean(axis=1))[:, None]
    direction = d.reshape(model.layout.planes, -1)
    arc = along_arc(model, np.zeros_like(direction), direction, 1.0).reshape(X.shape)
    centers = (X + arc).mean(axis=1)
    assert np.linalg.norm(np.diff(centers, axis=0), axis=1) == pytest.approx(
        np.diff(X[:, 0, 0]), rel=1e-3
    )
    straight = (X + d).mean(axis=1)
    assert np.linalg.norm(np.diff(straight, axis=0), axis=1).max() > 1.3 * np.diff(X[:, 0, 0]).max()


def test_a_soft_curved_valley_takes_few_steps() -> None:
    """A slender catheter about to turn round, from a search for insertions: straight steps with the usual shift found no end in 300."""
    directions = [
        [-0.0697, -0.4462, -0.8922],
        [0.711, 0.4182, -0.5654],
        [0.7258, -0.2357, -0.6462],
        [0.9261, 0.0052, -0.3772],
        [0.9139, 0.0393, 0.404],
        [-0.4517, 0.0057, 0.8921],
    ]
    shape = {"length": 0.056, "diameter": 3e-3, "directions": directions, "remanence": 0.138}
    found = rod_scene(**shape, field=(2.131697e-3, -1.814e-6, 9.669181e-3), gravity=(0, 0, -9.81))
    made = static_model(build(found))
    steps = minimize(
        Energy(made), from_rod(made, solve_rod(found)), tolerance=1e-11, max_steps=300
    ).steps
    assert steps <= 40  # 23 when this was written


def in_the_field(**changes: object) -> Scene:
    """A short catheter that bends to the side, a tenth of its length."""
    return rod_scene(length=24e-3, field=[0.0, 0.0, 5e-3], **changes)


def test_a_result_says_what_its_solve_began_from(tmp_path: Path) -> None:
    """Each way leads to the same equilibrium, on one grid; a file keeps the word."""
    scene = in_the_field()
    alone = run(scene)
    ways = {
        "rod": alone,
        "neighbor": run(scene, start=alone),
        "given rod": run(scene, start=solve_rod(scene)),
        "growing load": run(in_the_field(field_steps=3)),
        "whole load": run(in_the_field(field_steps=1)),
    }
    assert {name: result.start for name, result in ways.items()} == {name: name for name in ways}
    for result in ways.values():
        # as equilibria are known
        np.testing.assert_allclose(result.centreline, alone.centreline, atol=1e-6 * 24e-3)
    assert Result.load(alone.save(tmp_path)).start == alone.summary()["start"] == "rod"


def test_a_chosen_grid_begins_at_a_coarser_one() -> None:
    """2 cells begin from the rod; what is chosen beyond them, at them."""
    fine = Scene.from_si({**in_the_field().to_si(), "resolution": {"error": 5e-4}})
    result = run(fine)
    assert result.resolution is not None
    assert result.resolution["cells_across"] > 2
    assert result.start == "coarser grid"


def test_what_moves_its_end_begins_along_the_growing_branch() -> None:
    data = in_the_field().to_si()
    moved = Scene.from_si({**data, "move": {"base": {"along": [0, 0, 1], "distance": 1e-3}}})
    assert run(moved).start == "growing branch"
