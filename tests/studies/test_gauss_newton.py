"""The Gauss-Newton sampler on plain least-squares problems, with Optuna alone."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import optuna
import pytest

from magmpm.studies.search.samplers.blocks import Array, Ball, Block, Direction, Number
from magmpm.studies.search.samplers.gauss_newton import (
    LEAST_GAIN,
    PLAN,
    GaussNewtonSampler,
    _judged,
)
from magmpm.studies.search.samplers.gauss_newton_steps import Coordinates
from magmpm.studies.search.samplers.optuna_ids import other_trials

Model = Callable[[Array], tuple[Array, Array]]

DIRECTIONS = [Direction(f"around_{k}", f"along_{k}") for k in range(4)]
BALL = Ball("strength", "azimuth", "elevation", 10.0, unit=1e-3)
BLOCKS: list[Block] = [
    DIRECTIONS[0],
    BALL,
    Number("length", 4.0, 12.0),
    Number("frequency", 2.0, 40.0, log=True),
]
ALL: list[Block] = [*DIRECTIONS, BALL, Number("length", 4.0, 12.0)]


def curved(blocks: list[Block], seed: int = 0, rows: int = 40) -> tuple[Model, Array]:
    """Residuals that are curved functions of the coordinates and vanish at a design; that design's coordinates."""
    rng = np.random.default_rng(seed)
    space = Coordinates(blocks)
    goal = space.anywhere(0.2 + 0.6 * rng.random(space.size))
    scale = np.concatenate(
        [
            np.full(block.size, 1.0 / block.radius if isinstance(block, Ball) else 1.0)
            for block in blocks
        ]
    )
    matrix = rng.normal(size=(rows, space.size))
    at_goal = matrix @ (goal * scale)

    def model(x: Array) -> tuple[Array, Array]:
        y = matrix @ (x * scale)
        return (
            y + 0.3 * np.sin(y) - at_goal - 0.3 * np.sin(at_goal),
            (1 + 0.3 * np.cos(y))[:, None] * matrix * scale,
        )

    return model, goal


def parameters(blocks: list[Block]) -> dict[str, Any]:
    return {name: kind for block in blocks for name, kind in block.distributions().items()}


def evaluated(asked: optuna.Trial, blocks: list[Block], model: Model, fails: bool = False) -> float:
    """The root of the sum of squares of a trial's design, whose residuals and Jacobian it then holds, unless it fails."""
    residuals, jacobian = model(Coordinates(blocks).read(asked.params))
    if not fails:
        asked.set_user_attr("residuals", residuals.tolist())
        asked.set_user_attr("jacobian", jacobian.tolist())
    return float(np.linalg.norm(residuals))


def trial(study: optuna.Study, blocks: list[Block], model: Model, fails: bool = False) -> float:
    """One trial by ask and tell; the root of its sum of squares."""
    asked = study.ask(parameters(blocks))
    value = evaluated(asked, blocks, model, fails)
    study.tell(asked, value)
    return value


def run(
    blocks: list[Block], model: Model, trials: int, seed: int = 1, **options: Any
) -> tuple[optuna.Study, list[float]]:
    study = optuna.create_study(sampler=GaussNewtonSampler(blocks, seed, **options))
    return study, [trial(study, blocks, model) for _ in range(trials)]


def plans(study: optuna.Study) -> list[dict[str, Any]]:
    return [t.system_attrs[PLAN] for t in study.trials]


@pytest.mark.parametrize("block", BLOCKS, ids=["direction", "ball", "number", "log"])
def test_coordinates_and_parameters_are_inverse(block: Any, rng: np.random.Generator) -> None:
    for _ in range(20):
        x = block.anywhere(rng.random(block.size))
        np.testing.assert_allclose(block.read(block.write(x)), x, rtol=0, atol=1e-14)
        assert all(
            kind.low <= block.write(x)[name] <= kind.high
            for name, kind in block.distributions().items()
        )


@pytest.mark.parametrize("block", BLOCKS, ids=["direction", "ball", "number", "log"])
def test_steps_go_along_the_tangent_and_stay_in_the_block(
    block: Any, rng: np.random.Generator
) -> None:
    """A small step changes the coordinates by basis times step, to second order; a large one is cut to what the block allows."""
    for _ in range(20):
        x = block.anywhere(rng.random(block.size))
        basis, low, high = block.tangent(x)
        p = 1e-5 * rng.normal(size=len(low))
        scale = np.abs(basis).max()
        np.testing.assert_allclose(
            block.moved(x, block.within(x, p)) - x, basis @ p, rtol=0, atol=1e-8 * scale
        )
        far = block.within(x, np.clip(2.0 * rng.normal(size=len(low)), low, high))
        there = block.moved(x, far)
        np.testing.assert_allclose(
            block.read(block.write(there)), there, rtol=0, atol=1e-12 * scale
        )


def test_a_ball_may_be_at_its_center() -> None:
    basis, low, high = BALL.tangent(np.zeros(3))
    np.testing.assert_allclose(basis.T @ basis, 1e-4 * np.eye(3), atol=1e-18)
    assert BALL.write(np.zeros(3)) == {"strength": 0.0, "azimuth": 0.0, "elevation": 0.0}
    assert (low < 0).all()
    assert (high > 0).all()


@pytest.mark.parametrize("seed", range(4))
def test_quadratic_convergence_to_a_design_that_fits(seed: int) -> None:
    """With residuals that vanish, each of the last steps squares the distance, from starts anywhere."""
    model, _ = curved(ALL, seed)
    _, values = run(ALL, model, 16, seed)
    first = next(k for k, value in enumerate(values) if value < 1e-2)
    assert values[first + 1] < 20 * values[first] ** 2
    assert min(values[: first + 4]) < 1e-11


def test_a_valley_that_winds() -> None:
    """Rosenbrock's function, 100 (y - x^2)^2 + (1 - x)^2, from (-1.2, 1): its valley ends at (1, 1)."""
    blocks: list[Block] = [Number("x", -2.0, 2.0), Number("y", -2.0, 2.0)]

    def model(u: Array) -> tuple[Array, Array]:
        x, y = 4 * u - 2
        return np.array([10 * (y - x * x), 1 - x]), 4 * np.array([[-20 * x, 10.0], [-1.0, 0.0]])

    study, values = run(blocks, model, 30, starts=[{"x": -1.2, "y": 1.0}], goal=1e-9)
    assert study.trials[0].params == {"x": -1.2, "y": 1.0}
    assert min(values) < 1e-9
    assert study.best_params == pytest.approx({"x": 1.0, "y": 1.0})


def test_bounds_hold_and_are_reached_where_the_least_lies_beyond() -> None:
    """Least squares against a design outside: the nearest point of the ball, the end of the interval."""
    blocks: list[Block] = [BALL, Number("length", 4.0, 12.0)]
    goal = np.array([12e-3, 9e-3, 0.0, 1.5])
    scale = np.array([1e2, 1e2, 1e2, 1.0])

    def model(x: Array) -> tuple[Array, Array]:
        return scale * (x - goal), np.diag(scale)

    study, _ = run(blocks, model, 12)
    best = Coordinates(blocks).read(study.best_params)
    least = float(np.sum(model(np.array([8e-3, 6e-3, 0.0, 1.0]))[0] ** 2))
    assert (
        least <= study.best_value**2 <= (1 + LEAST_GAIN) * least
    )  # where less is left to gain, a descent ends
    np.testing.assert_allclose(best, [8e-3, 6e-3, 0.0, 1.0], rtol=0, atol=1e-3)
    assert best[3] == 1.0, "the end of the interval exactly"


def test_a_bad_step_is_taken_back_and_made_shorter() -> None:
    """After a design that fails or violates a constraint the next one steps from the one before, less far; a start is left for the next."""
    model, _ = curved(ALL)
    for constrained in (False, True):
        study = optuna.create_study(sampler=GaussNewtonSampler(ALL, 1))
        trial(study, ALL, model)
        if constrained:
            asked = study.ask(parameters(ALL))
            asked.set_constraint("stability", 0.01)
            study.tell(asked, evaluated(asked, ALL, model))
        else:
            trial(study, ALL, model, fails=True)
        trial(study, ALL, model)
        _, second, third = plans(study)
        assert second["from"] == third["from"] == 0
        assert third["length"] <= second["length"] / 4 * (1 + 1e-9)
    study = optuna.create_study(sampler=GaussNewtonSampler(ALL, 1))
    for fails in (True, False):
        trial(study, ALL, model, fails)
    assert [plan["start"] for plan in plans(study)] == [0, 1]


def test_stuck_above_the_goal_it_begins_elsewhere_and_repeats_no_design() -> None:
    """Two valleys: from a start in the shallow one the sampler leaves it and finds the deep one."""
    blocks: list[Block] = [Number("x", -4.0, 4.0)]

    def model(u: Array) -> tuple[Array, Array]:
        x = 8 * u[0] - 4
        return np.array([x * x - 4, 0.6 * (x - 2)]), 8 * np.array([[2 * x], [0.6]])

    study, values = run(blocks, model, 25, starts=[{"x": -2.5}], goal=1e-6)
    starts = [plan["start"] for plan in plans(study)]
    assert starts[0] == 0
    assert max(starts) >= 1
    assert min(values) < 1e-6
    assert len({t.params["x"] for t in study.trials}) == 25


def test_given_designs_come_first_and_the_best_of_three_poor_ones_is_improved() -> None:
    model, goal = curved(ALL)
    space = Coordinates(ALL)
    given = [
        space.write(space.anywhere(np.random.default_rng(k).random(space.size))) for k in range(5)
    ]
    study, values = run(ALL, model, 4, starts=given, poor=0.0)
    assert [t.params for t in study.trials[:3]] == given[:3]
    assert plans(study)[3]["from"] == int(np.argmin(values[:3]))
    study, _ = run(ALL, model, 2, starts=[space.write(goal + 0.01), *given], poor=1e9)
    assert plans(study)[1]["from"] == 0, "a good one is improved at once"


def test_enqueued_designs_count_as_starts() -> None:
    model, goal = curved(ALL)
    study = optuna.create_study(sampler=GaussNewtonSampler(ALL, 1))
    study.enqueue_trial(Coordinates(ALL).write(Coordinates(ALL).moved(goal, np.full(12, 0.05))))
    values = [trial(study, ALL, model) for _ in range(6)]
    assert study.trials[1].system_attrs[PLAN]["from"] == 0
    assert values[-1] < 1e-8


def test_the_next_design_depends_on_seed_and_trials_alone() -> None:
    """A sampler made anew for each trial, from the trials of a copied study, suggests the same."""
    model, _ = curved(ALL)
    whole, _ = run(ALL, model, 12)
    parts = optuna.create_study()
    for _ in range(12):
        parts.sampler = GaussNewtonSampler(ALL, 1)
        trial(parts, ALL, model)
    assert [t.params for t in whole.trials] == [t.params for t in parts.trials]
    other, _ = run(ALL, model, 1, seed=2)
    assert other.trials[0].params != whole.trials[0].params


def test_optimize_with_an_objective_works_as_with_any_sampler() -> None:
    """As the module's text says: an objective that stores two attributes, and nothing of magmpm."""
    model, _ = curved(ALL)

    def objective(one: optuna.Trial) -> float:
        for name, kind in parameters(ALL).items():
            one.suggest_float(name, kind.low, kind.high)
        return evaluated(one, ALL, model)

    study = optuna.create_study(sampler=GaussNewtonSampler(ALL, 3))
    study.optimize(objective, n_trials=14)
    assert study.best_value < 1e-8


@pytest.mark.parametrize(("curvature", "step"), [(0.0, -0.3), (5.0, -0.2)])
def test_a_step_is_weighed_against_what_the_linear_model_does_not_know(
    curvature: float, step: float
) -> None:
    """The least of (0.6 + 2 p)^2 + (curvature p^2)^2, at 0.6 + 2 p + curvature^2 p^3 = 0."""
    found = Coordinates([Number("length", 4.0, 12.0)]).step(
        np.array([0.5]), np.array([0.6]), np.array([[2.0]]), 1.0, curvature
    )
    assert found.p[0] == pytest.approx(step, rel=0.02)
    assert found.promised == pytest.approx(0.6**2 - (0.6 + 2 * found.p[0]) ** 2)


def test_directions_without_effect_stay_as_they_are() -> None:
    """Residuals know nothing of the second direction: it stays at its start while the first finds its place."""
    blocks: list[Block] = DIRECTIONS[:2]
    goal = np.array([0.0, 0.6, 0.8])

    def model(x: Array) -> tuple[Array, Array]:
        return x[:3] - goal, np.hstack([np.eye(3), np.zeros((3, 3))])

    study, values = run(
        blocks,
        model,
        6,
        starts=[{"around_0": 10.0, "along_0": 20.0, "around_1": 50.0, "along_1": 60.0}],
    )
    assert values[4] < 1e-6
    found = DIRECTIONS[1].read(study.trials[4].params)
    np.testing.assert_allclose(found, DIRECTIONS[1].read(study.trials[0].params), rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("cost", "radius"), [(0.0, 4.0), (0.5, 3.0), (0.9, 2.0 / 1.9), (2.0, 2.0 / 3.0)]
)
def test_the_radius_follows_how_well_a_step_was_foreseen(cost: float, radius: float) -> None:
    """A step of length 2 within the radius 3 that promised to take all of a cost of 1; a poor one is cut at the parabola's least."""
    before, last = (
        SimpleNamespace(user_attrs={"residuals": [c**0.5], "jacobian": []}, constraints={})
        for c in (1.0, cost)
    )
    better, found = _judged(before, last, {"length": 2.0, "promised": 1.0, "radius": 3.0})  # type: ignore[arg-type]
    assert better is (last if cost < 1.0 else before)
    assert found == pytest.approx(min(radius, 1.0) if cost > 0.75 else radius)


@pytest.mark.parametrize(("seen", "taken"), [(0.01, 0.1), (0.5, 0.5), (100.0, 10.0)])
def test_the_curvature_is_what_the_last_step_showed_within_ten_of_the_guess(
    seen: float, taken: float
) -> None:
    """A step of length 1 that the linear model left at 0.5, and that ended `seen` guesses above it."""
    sampler = GaussNewtonSampler([BALL], 1)
    x = np.array([0.0, 0.0, 5e-3])
    jacobian = 2e2 * np.eye(3)
    guess = sampler._space.curvature(x, jacobian)
    kept: Any = {
        "constraints": {},
        "system_attrs": {PLAN: {"from": 0, "promised": 0.75, "length": 1.0}},
    }
    before, last = (
        SimpleNamespace(user_attrs={"residuals": [r], "jacobian": []}, **kept)
        for r in (1.0, 0.5 + seen * guess)
    )
    assert sampler._curvature(last, {0: before}, x, jacobian) == pytest.approx(taken * guess)  # type: ignore[arg-type,dict-item]


@pytest.mark.parametrize(
    ("cost", "promised", "stuck"), [(0.55, 1.0, False), (0.58, 1.0, True), (0.55, 0.01, True)]
)
def test_a_descent_that_hardly_moves_is_left(cost: float, promised: float, stuck: bool) -> None:
    """Five accepted steps have to bring the value below three quarters, its square below 9/16; of two steps one promises something."""
    chain = {
        k: SimpleNamespace(
            values=[1.0],
            user_attrs={"residuals": [1.0 if k < 5 else cost**0.5], "jacobian": [[0.0]]},
            system_attrs={PLAN: {"from": k - 1 if k else None, "promised": promised}},
        )
        for k in range(6)
    }
    step = SimpleNamespace(promised=promised * cost)
    sampler = GaussNewtonSampler([BALL], 1)
    args: Any = (chain[5], step, 1.0, chain[5], chain)
    assert sampler._stuck(*args) is stuck


def test_workers_follow_a_descent_each() -> None:
    """Two begin at two starts; when both are told, one goes on from the second and the other, which finds that one busy, from the first."""
    model, _ = curved(ALL)
    study = optuna.create_study(sampler=GaussNewtonSampler(ALL, 1))
    for asked in [study.ask(parameters(ALL)) for _ in range(2)]:
        study.tell(asked, evaluated(asked, ALL, model))
    for _ in range(2):
        study.ask(parameters(ALL))
    assert [(plan["start"], plan["from"]) for plan in plans(study)] == [
        (0, None),
        (1, None),
        (1, 1),
        (0, 0),
    ]


def test_a_trial_that_ends_while_the_others_are_read_is_one_of_them() -> None:
    """Another session's: one that was missed would be chosen once more."""
    study = optuna.create_study()
    kind = {"x": optuna.distributions.FloatDistribution(0.0, 1.0)}
    other = study.ask(kind)
    mine = study.ask(kind)

    def get_trials(**options: Any) -> list[optuna.trial.FrozenTrial]:
        found = study.get_trials(**options)
        study.tell(other, 1.0, skip_if_finished=True)
        return found

    ended, running, before = other_trials(SimpleNamespace(get_trials=get_trials), mine, kind)  # type: ignore[arg-type]
    assert ([t.number for t in (*ended, *running)], before) == ([0], 1)


def test_given_designs_are_used_up_once_no_descent_from_them_gets_better() -> None:
    """The residuals keep a part that no design moves: the descent ends there, and a point of the sequence would be next."""
    blocks: list[Block] = [*DIRECTIONS[:2]]
    curve, goal = curved(blocks)

    def model(x: Array) -> tuple[Array, Array]:
        residuals, slopes = curve(x)
        return np.append(residuals, 1.0), np.vstack([slopes, np.zeros(slopes.shape[1])])

    start = Coordinates(blocks).write(goal + 0.2)
    sampler = GaussNewtonSampler(blocks, 1, starts=[start])
    study = optuna.create_study(sampler=sampler)
    used = []
    for _ in range(12):
        used.append(sampler.used_up(study.trials, []))
        if used[-1]:
            break
        trial(study, blocks, model)
    assert used[0] is False
    assert used[-1] is True
    assert all(plan["start"] == 0 for plan in plans(study)), "no trial began elsewhere"
