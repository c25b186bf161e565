"""Minima and intervals of fits on problems whose answer is known, without a simulation."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from magmpm import load_scene
from magmpm.studies.fitting import Refused, search
from magmpm.studies.fitting.constants import constants_of
from magmpm.studies.fitting.identify import refuse_twins
from magmpm.studies.fitting.prediction import Label, Prediction
from magmpm.studies.fitting.solve import Minimum, interval_of, least_squares
from magmpm.studies.fitting.table import Measured

SCENE = load_scene(Path(__file__).resolve().parents[2] / "data/scenes/axial_transverse.yaml").with_cells(2)


def exponential(y: float) -> tuple[object, Minimum]:
    """One number, r = exp(x) - y: the least sum is 0 at log y, and it rises by q^2 at log(y +- q)."""

    def model(x: np.ndarray, slopes: bool) -> tuple[np.ndarray, np.ndarray]:
        return np.exp(x) - y, np.exp(x)[:, None]

    return model, least_squares(model, np.zeros(1), scale=1.0)


def test_the_profile_of_a_curved_problem() -> None:
    """Ends where exp(x) = y +- q exactly; 1 % of q is the accuracy that is sought (solve._end)."""
    model, best = exponential(4.0)
    covariance = np.linalg.inv(best.slopes.T @ best.slopes)
    found = interval_of(model, best, covariance, 0, 1.96, lambda: None)
    assert found.method == "profile"
    assert np.exp(found.low) == pytest.approx(4 - 1.96, abs=0.02 * 1.96)
    assert np.exp(found.high) == pytest.approx(4 + 1.96, abs=0.02 * 1.96)


def test_one_curved_side_takes_the_profile() -> None:
    """Residuals twice as steep below: that end is half as far."""
    best = Minimum(np.zeros(1), np.zeros(1), np.ones((1, 1)), 1, True)
    found = interval_of(lambda x, _: ((1 + (x < 0)) * x, 1.0 + (x < 0)[:, None]), best, np.ones((1, 1)), 0, 2.0, lambda: None)
    assert (found.method, found.low, found.high) == ("profile", pytest.approx(-1.0, abs=0.02), pytest.approx(2.0, abs=0.04))


def test_an_end_that_the_data_do_not_give_is_open() -> None:
    """exp(x) = 1 +- 1.96 has no lower end: the sum of squares never rises that much."""
    model, best = exponential(1.0)
    found = interval_of(model, best, np.linalg.inv(best.slopes.T @ best.slopes), 0, 1.96, lambda: None)
    assert found.low is None
    assert np.exp(found.high) == pytest.approx(2.96, abs=0.04)


def test_the_profile_of_a_linear_problem_is_the_t_interval(rng: np.random.Generator) -> None:
    A, b = rng.normal(size=(9, 3)), rng.normal(size=9)
    best = least_squares(lambda x, slopes: (A @ x - b, A), np.zeros(3))
    np.testing.assert_allclose(best.x, np.linalg.lstsq(A, b, rcond=None)[0], atol=1e-6)
    covariance = np.linalg.inv(A.T @ A)
    found = interval_of(lambda x, slopes: (A @ x - b, A), best, covariance, 1, 2.0, lambda: None)
    assert found.method == "linear"
    assert found.high - found.low == pytest.approx(4 * np.sqrt(covariance[1, 1]), rel=1e-9)


def test_least_squares_finds_a_curved_valley() -> None:
    """Rosenbrock's function as two residuals: its minimum is (1, 1)."""

    def model(x: np.ndarray, slopes: bool) -> tuple[np.ndarray, np.ndarray]:
        return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]]), np.array([[-20 * x[0], 10.0], [-1.0, 0.0]])

    np.testing.assert_allclose(least_squares(model, np.array([-1.2, 1.0]), scale=1.0).x, [1, 1], atol=1e-4)


def test_a_descent_ends_where_it_comes_to_a_known_minimum() -> None:
    """A fit's further descents need not settle at what the first one found."""
    model, best = exponential(4.0)
    found = least_squares(model, np.zeros(1), scale=1.0, known=lambda x: bool(abs(x - best.x)[0] < 0.2))
    assert found.converged
    assert found.steps < best.steps


def test_noise_from_residuals_counts_what_the_constants_took_of_the_lengths() -> None:
    """Four lengths and an angle, which has half of the one constant's leverage, leave 4 - 1/2 numbers."""
    labels = [Label(k, "", angle=k == 4) for k in range(5)]
    best = Minimum(np.zeros(1), np.array([1.0, -1.0, 2.0, 0.0, 9.0]), np.array([[1.0], [1.0], [0.0], [0.0], [2**0.5]]), 1, True)
    one: Any = search._Search(Prediction(SCENE, Measured(Path(), "tips", (), (), (0, 1, 2)), (), 0, labels), (), None, None, 1.0, print)
    one.prediction.measured = SimpleNamespace(angles_alone=False)
    assert one._estimated(best, search._Noise(1e-3, 1.0, False))[0].length == pytest.approx(1e-3 * (6 / 3.5) ** 0.5)


def test_two_answers_are_refused() -> None:
    constants = constants_of(SCENE, ["shear_modulus"])
    one, other = (Minimum(np.array([x]), np.full(3, 0.1), np.full((3, 1), 30.0), 5, True) for x in (0.0, 0.9))
    with pytest.raises(Refused, match="two sets of constants"):
        refuse_twins(constants, one, [other], 1.96)
    refuse_twins(constants, one, [one], 1.96)
