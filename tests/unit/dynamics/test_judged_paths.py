"""The error of a path of equilibria, and of a motion that settles: where they are judged, and on which grid."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from reference.scenes import rod_scene

from magmpm import Result, Scene, load_scene, run
from magmpm.dynamics.path_errors import differences
from magmpm.dynamics.path_judged import PathSeen
from magmpm.dynamics.quasi_static import loads_of
from magmpm.errors import SceneError, SolveError
from magmpm.results.measures import largest_distance
from magmpm.results.trajectory import Motion
from magmpm.rod.strongest_load import strongest
from magmpm.simulate import simulated
from magmpm.statics.branch import Branch, Jump
from magmpm.statics.error_estimate import distance
from magmpm.statics.ladder import Ladder

SCENES = Path(__file__).resolve().parents[3] / "data/scenes"
LENGTH = 24e-3
PLAIN = rod_scene(length=LENGTH, field=[0.0, 0.0, 5e-3])


def test_the_error_of_a_path_and_of_a_motions_rest() -> None:
    """The same body in a field that is switched on: its path's bar and its rest's are those of its equilibrium, for the end is the same."""
    data = {**PLAIN.to_si(), "resolution": {"error": 0.02}}
    rest = run(Scene.from_si(data))
    ramp = {**data["field"], "over_time": {"ramp": {"duration": 1.0}}}
    path = run(Scene.from_si({**data, "field": ramp, "solver": {"quasi_static": {"steps": 3}}}))
    assert path.error_estimate == pytest.approx(rest.error_estimate, rel=0.1)  # the largest load is judged in both; proofs are good to 3 %
    assert path.resolution is not None
    assert path.resolution["judged_at"][-1] == 1.0
    assert path.formulation == "quasi_static"

    effects = {"magnetic_torque": {}, "damping": {"rate": 60.0}}
    short = run(Scene.from_si({**data, "effects": effects, "solver": {"dynamic": {"duration": 2e-3, "output_every": 1e-3}}}))
    assert short.resolution is not None
    assert short.resolution["from_rest"] > 0.02 * LENGTH  # still on its way
    assert short.error_estimate == pytest.approx(rest.error_estimate + short.resolution["from_rest"], rel=1e-3)
    assert any("ends" in warning and "from its rest" in warning for warning in short.warnings)


@pytest.mark.parametrize(
    ("effects", "says"),
    [({"ground": {"point": [0.0, 0.0, -0.01]}}, "with ground that is not known"), ({"feed": {"speed": 0.01, "exit": 0.01}}, "with feed")],
)
def test_motions_without_a_known_rest_are_refused(effects: dict[str, object], says: str) -> None:
    data = {**PLAIN.to_si(), "resolution": {"error": 0.02}, "solver": {"dynamic": {"duration": 2e-3}}}
    with pytest.raises(SceneError, match=says):
        run(Scene.from_si({**data, "effects": {"magnetic_torque": {}, **effects}}))


def test_a_time_for_a_path_and_for_a_motion() -> None:
    """Both run on the coarsest grid first: its answer and bar are there whatever the machine; a time that it exceeds is refused at once."""
    ramp = {**PLAIN.to_si()["field"], "over_time": {"ramp": {"duration": 1.0}}}
    path = {"field": ramp, "solver": {"quasi_static": {"steps": 2}}}
    dynamic = {"duration": 2e-3, "output_every": 1e-3}
    motion = {"effects": {"magnetic_torque": {}, "damping": {"rate": 60.0}}, "solver": {"dynamic": dynamic}}
    for along in (path, motion):
        data = {**PLAIN.to_si(), **along}
        result = run(Scene.from_si({**data, "resolution": {"seconds": 5.0}}))
        assert result.resolution is not None
        assert result.error_estimate is not None
        cells = result.resolution["cells_across"]
        plain = run(Scene.from_si({**data, "resolution": {"cells_across": cells}}))
        np.testing.assert_allclose(result.tip, plain.tip, atol=1e-9 * LENGTH)
        with pytest.raises(SceneError, match="must be enough for the coarsest grid, 2 cells across"):
            run(Scene.from_si({**data, "resolution": {"seconds": 1e-6}}))


def test_a_path_is_judged_where_its_load_is_strongest() -> None:
    """A pulse between equal parts of the path: the error there is within what is told."""
    data = {**PLAIN.to_si(), "solver": {"quasi_static": {"steps": 16}}}
    frames = [{"time": t, "strength": s} for t, s in ((0.0, 0.02), (0.8, 0.02), (1.0, 2.0), (1.2, 0.02), (2.0, 0.02))]
    data["field"] = {**data["field"], "over_time": {"keyframes": frames}}
    result = run(Scene.from_si({**data, "resolution": {"error": 0.005}}))
    fine = run(Scene.from_si({**data, "resolution": {"cells_across": 6}}))
    assert result.resolution is not None
    assert 1.0 in result.resolution["judged_at"]
    apart = [np.linalg.norm(np.subtract(one["tip"], other["tip"])) for one, other in zip(result.steps, fine.steps, strict=True)]
    assert result.error_estimate is not None
    assert 0.3 * result.error_estimate < max(apart) < result.error_estimate
    assert strongest(Scene.from_si({**data, "resolution": {"cells_across": 2}})) == 1.0
    assert result.resolution["from_path"] < 1e-6 * LENGTH


def test_a_path_is_judged_on_its_own_branch() -> None:
    """A strip held bent, shortly before it snaps through: its errors are those of the branch that the path follows, where it is softest.
    Judged on the branch that grows from no load, 0.36 % was told of 1.2 %, with a finer tip on the other side.
    """
    data = load_scene(SCENES / "snap_through.yaml").to_si()
    data["solver"]["quasi_static"] = {"at": [0.0, 0.4, 0.75, 0.79]}
    path = run(Scene.from_si({**data, "resolution": {"error": 0.02}}))
    fine = run(Scene.from_si({**data, "resolution": {"cells_across": 8}}))
    assert path.resolution is not None
    assert path.error_estimate is not None
    assert 0.79 in path.resolution["judged_at"]
    assert np.linalg.norm(path.tip - path.resolution["finer"]["tip"]) < path.error_estimate
    apart = [np.linalg.norm(np.subtract(one["tip"], other["tip"])) for one, other in zip(path.steps, fine.steps, strict=True)]
    assert 0.3 * path.error_estimate < max(apart) < path.error_estimate
    assert path.resolution["from_path"] < 1e-4 * path.error_estimate


def test_where_a_path_jumps_no_error_is_told() -> None:
    """Around the jump grids are on different branches: nothing is judged there, and a warning says from when to when."""
    seen = PathSeen(1.0)
    times = np.linspace(0.0, 1.0, 11)
    seen.grids = {float(t): np.zeros(0) for t in times}
    bent = np.array([0.0, 0.1, 0.2, 0.3, 0.35, 0.4, -0.4, -0.4, -0.4, -0.4, -0.4])
    s = np.linspace(0.0, 1.0, 41)
    seen.bends = [np.column_stack([0 * s, 0 * s, b * s**2]) for b in bent]
    seen.stability, seen.jumps = [1.0, 0.8, 0.6, 0.4, 0.12, 0.05, 0.7, 0.7, 0.7, 0.7, 0.7], [0.57]
    seen.softness = list(zip(seen.grids, seen.stability, strict=True))
    assert seen.soft_at() is None
    [(begins, ends)] = seen.near_jumps()
    assert (begins, ends) == (pytest.approx(0.4), pytest.approx(0.57 + 0.17))
    judged = seen.judged({})
    assert judged[-1] == 1.0
    assert 0.3 in [round(t, 3) for t in judged]  # the softest away from the jump
    assert not any(begins <= t <= ends for t in judged)
    seen.jumps = [0.95]
    assert seen.near_jumps()[0][1] == 1.0  # nothing is told of times after the path
    seen.jumps = []
    assert seen.soft_at() == pytest.approx(0.4)


def test_a_path_is_judged_where_another_grid_differs_most() -> None:
    """Shapes far from each other say little of errors: a magnet that comes near for a moment. Peaks come first, then the rest."""
    seen = PathSeen(1.0)
    times = [float(t) for t in range(9)]
    seen.grids = {t: np.zeros(0) for t in times}
    s = np.linspace(0.0, 1.0, 41)
    seen.bends = [np.column_stack([0 * s, 0 * s, b * s**2]) for b in (0.0, 0.3, 0.5, 0.1, -0.1, -0.3, -0.5, 0.2, 0.19)]
    seen.stability = [1.0, 0.9, 0.8, 0.9, 1.0, 0.9, 0.5, 0.9, 1.0]
    seen.softness = list(zip(times, seen.stability, strict=True))
    assert 7.0 not in seen.judged({})  # it is like the last one
    differs = dict(zip(times, [0.1, 0.2, 0.5, 0.8, 2.0, 0.9, 0.3, 0.2, 0.1], strict=True))
    assert seen.judged(differs) == [2.0, 3.0, 4.0, 5.0, 6.0, 8.0]  # the last, the softest, the peak, and the largest of the rest
    differs[7.0] = 0.4
    assert seen.judged(differs) == [3.0, 4.0, 5.0, 6.0, 7.0, 8.0]  # a small peak counts before the rest
    differs.update({1.0: np.inf, 2.0: np.inf, 3.0: 1.9})
    assert seen.judged(differs) == [1.0, 2.0, 4.0, 6.0, 7.0, 8.0]  # of equal neighbors the first is the peak, the next is one of the rest


@pytest.mark.parametrize("of", ["centreline", "tip"])
def test_differences_along_a_path_are_those_of_the_finer_grid(of: str) -> None:
    """Against whole runs with 2 and 3 cells. 5 %: steps toward the finer grid end when they move by less than 3 % of the difference."""
    field = {"uniform": [1e-3, 0.0, 6e-3], "over_time": {"ramp": {"duration": 1.0}}}
    solver = {"quasi_static": {"steps": 5}}
    scene = Scene.from_si({**PLAIN.to_si(), "field": field, "solver": solver, "resolution": {"error": 0.1, "of": of}})
    seen, finer, ladder = PathSeen(scene.length), PathSeen(scene.length), Ladder(scene, lambda on_grid: [])
    simulated(scene.with_cells(2), on_state=seen.see)
    simulated(scene.with_cells(3), on_state=finer.see)
    found = differences(scene, seen, 2, None)
    assert len(found) >= 4
    for t, difference in found.items():
        if t > 0.0:
            points = [ladder.points(loads_of(ladder.on(n), 0.0).at(t), one.grids[t]) for n, one in ((2, seen), (3, finer))]
            assert difference == pytest.approx(distance(*points), rel=0.05)
    assert differences(scene, seen, 2, 0.0) == {}  # none are begun after their time


def test_grids_on_different_branches_are_refused_with_that_reason() -> None:
    """At 0.802 s 6 and 8 cells have snapped, and coarser grids have not: 6 are the answer. At 0.8002 s only 8 have, and nothing is told."""
    data = load_scene(SCENES / "snap_through.yaml").to_si()
    snapped, between = (
        Scene.from_si({**data, "solver": {"quasi_static": {"at": [0.0, 0.4, 0.79, end]}}, "resolution": {"error": 0.02}})
        for end in (0.802, 0.8002)
    )
    result = run(snapped)
    assert result.resolution is not None
    assert result.resolution["cells_across"] == 6
    assert largest_distance(result, run(snapped.with_cells(8)).centreline) < (result.error_estimate or 0.0)
    assert result.tip[2] < 0.0
    with pytest.raises(SceneError, match="must find the same equilibrium"):
        run(between)


def test_a_path_whose_error_is_refused_leaves_the_folder_as_it_was(tmp_path: Path) -> None:
    """It is found out of reach after the run on the coarsest grid, which writes nothing. The answer's frames are all there, on any grid."""
    ramp = {**PLAIN.to_si()["field"], "over_time": {"ramp": {"duration": 1.0}}}
    data = {**PLAIN.to_si(), "field": ramp, "solver": {"quasi_static": {"steps": 3}}}
    result = run(Scene.from_si({**data, "resolution": {"error": 0.05}}), folder=tmp_path)
    assert result.resolution is not None
    assert result.resolution["cells_across"] == 2
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()}
    assert len(Motion.load(tmp_path).times) == 4
    with pytest.raises(SceneError, match="within reach"):
        run(Scene.from_si({**data, "resolution": {"error": 2e-6}}), folder=tmp_path)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()} == before


def test_a_path_that_fails_leaves_files_of_one_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With an error that is asked for, over earlier results: its last good state comes with its own frames. It fails on every grid."""
    ramp = {**PLAIN.to_si()["field"], "over_time": {"ramp": {"duration": 1.0}}}
    data = {**PLAIN.to_si(), "field": ramp, "solver": {"quasi_static": {"steps": 3}}, "resolution": {"error": 0.05}}
    assert run(Scene.from_si(data), folder=tmp_path).converged
    advance = Branch.advance

    def stops(branch: Branch, until: float) -> list[Jump]:
        if until > 0.6:
            raise SolveError("switched off")
        return advance(branch, until)

    monkeypatch.setattr(Branch, "advance", stops)
    with pytest.raises(SolveError, match=r"t = 0\.75 s: switched off"):
        run(Scene.from_si({**data, "solver": {"quasi_static": {"steps": 4}}}), folder=tmp_path)
    saved = Result.load(tmp_path)
    assert not saved.converged
    assert saved.time == 0.5
    assert list(Motion.load(tmp_path).times) == [0.0, 0.25, 0.5]
