"""Statics of jointed catheters and of tubes against 3D finite elements (data/references/jointed_catheters.json): whole centerlines.

Required: a largest distance of 0.4 % of L at 2 cells and 0.1 % at 4 cells for catheters whose segments differ in stiffness, and of
0.1 % at 4 cells for tubes of one stiffness (walls of 0.1 to 0.4 of the radius, K/G 20 and 200). The stated error of the finite elements
is not added to the bounds.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from reference.problems import Problem, finite_element_problems

from magmpm.results.measures import largest_distance
from magmpm.simulate import run

PROBLEMS = finite_element_problems(Path(__file__).resolve().parents[2] / "data/references/jointed_catheters.json")
TUBES = {name: problem for name, problem in PROBLEMS.items() if len(problem.content["materials"]) == 1}
JOINTED = {name: problem for name, problem in PROBLEMS.items() if name not in TUBES}


@pytest.mark.parametrize(("cells", "bound"), [(2, 0.4e-2), (4, 0.1e-2)])
@pytest.mark.parametrize("problem", JOINTED.values(), ids=JOINTED)
def test_jointed(problem: Problem, cells: int, bound: float) -> None:
    assert largest_distance(run(problem.scene(cells)), problem.centreline) <= bound * problem.length


@pytest.mark.parametrize("name", TUBES)
def test_tube(name: str) -> None:
    problem = TUBES[name]
    assert largest_distance(run(problem.scene(4)), problem.centreline) <= 0.1e-2 * problem.length
