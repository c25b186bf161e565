"""The error that statics promises (`resolution: {error: ...}`) holds against finite elements that were not used for it."""

from pathlib import Path

import pytest
from reference.problems import Problem, finite_element_problems

from magmpm import Scene, run
from magmpm.results.measures import largest_distance

PROBLEMS = finite_element_problems(
    Path(__file__).resolve().parents[2] / "data" / "references" / "fem.json"
)


@pytest.mark.slow
@pytest.mark.parametrize("asked", [0.01, 0.001])
@pytest.mark.parametrize("problem", PROBLEMS.values(), ids=PROBLEMS)
def test_the_promise_holds_against_finite_elements(problem: Problem, asked: float) -> None:
    """True error at most the bar, but for what the finite elements themselves may be off; and the bar within the error asked for."""
    scene = problem.scene(2)
    result = run(Scene.from_si({**scene.to_si(), "resolution": {"error": asked}}))
    assert result.error_estimate is not None
    assert result.error_estimate <= asked * problem.length
    true = largest_distance(result, problem.centreline)
    print(
        f"{problem.name}: asked {asked:.3%}, true over promised {true / result.error_estimate:.2f},"
        f" own error {problem.error:.4%}"
    )
    assert true <= result.error_estimate + problem.error * problem.length
