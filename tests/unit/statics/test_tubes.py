"""Tubes at rest, on cells around their axis: nothing changes as the grid turns, and what will kink is said to."""

from pathlib import Path

import numpy as np
import pytest
from reference.problems import finite_element_problems
from reference.scenes import rod_scene

from magmpm.errors import SolveError
from magmpm.model import build
from magmpm.rod.cantilever import kink_warning
from magmpm.rod.cosserat import solve_rod
from magmpm.scene import Scene, load_scene
from magmpm.scene.coarsest import knots_of
from magmpm.statics import axis, equilibrium
from magmpm.statics.energy import Energy
from magmpm.statics.equilibrium import solve_static
from magmpm.statics.layout import static_model
from magmpm.statics.rod_start import from_rod


def tip(scene: Scene, turn: float = 0.0) -> np.ndarray:
    at = scene.resolution
    made = scene.body.shape.discretize(
        at.cells_across, at.particles_per_cell, knots_of(scene), (turn, 0.0)
    )  # type: ignore[call-arg]
    model = static_model(build(scene, made))
    return axis.tip(model, solve_static(model).point.grid)


def test_nothing_changes_as_the_grid_turns() -> None:
    """A third of a cell around: by less than the grid's error of 0.02 % of the length, and the plane of bending stays."""
    scene = rod_scene(length=48e-3, inner_diameter=3.2e-3, field=(0, 0, 4.5e-3), cells=3)
    change = tip(scene, 1 / 3) - tip(scene)
    assert np.linalg.norm(change) < 1e-4 * scene.length


@pytest.mark.parametrize(("field", "kinks"), [(0.5e-3, False), (5e-3, True)])
def test_a_solve_that_fails_where_a_tube_kinks_says_so(
    field: float, kinks: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At the shape of its rod: a wall of 0.1 mm, bent to 300 mm and to 30 mm; Brazier's radius is 71 mm."""
    scene = rod_scene(inner_diameter=3.8e-3, field=(0, 0, field))
    model = static_model(build(scene))
    state = Energy(model).at(from_rod(model, solve_rod(scene)))

    def fails(*_: object) -> None:
        raise SolveError("no equilibrium", state)

    monkeypatch.setattr(equilibrium, "_branch", fails)
    with pytest.raises(SolveError, match="the tube kinks.*71" if kinks else "^no equilibrium$"):
        solve_static(model)


@pytest.mark.parametrize(
    ("wall", "ratio", "field"),
    [(0.1, 20, 4.24e-3), (0.1, 200, 4.38e-3), (0.1, 200, 5.77e-3), (0.2, 200, 25.1e-3)],
)
def test_a_tube_that_will_kink_is_told_before_the_solve(
    wall: float, ratio: float, field: float
) -> None:
    """Tubes that end 16 to 39 % of the length from their rod, or without an equilibrium, after 6 to 49 s."""
    length = {0.1: 60e-3, 0.2: 48e-3}[wall]
    scene = rod_scene(
        length=length, inner_diameter=4e-3 * (1 - wall), bulk_to_shear=ratio, field=(0, 0, field)
    )
    assert "will kink: the load bends it with 1." in (kink_warning(scene) or "")


def test_no_tube_that_stays_round_is_said_to_kink() -> None:
    """Those held against finite elements, up to 0.91 of what the wall bears, and the scenes of data/."""
    data = Path(__file__).resolve().parents[3] / "data"
    scenes = [
        problem.scene(2)
        for problem in finite_element_problems(data / "references/jointed_catheters.json").values()
    ]
    scenes += [
        load_scene(data / "scenes" / name)
        for name in ("hollow.yaml", "gallery/steerable_guidewire.yaml")
    ]
    assert sum(scene.body.catheter.hollow for scene in scenes if scene.body.catheter) >= 10
    assert [kink_warning(scene) for scene in scenes] == [None] * len(scenes)
