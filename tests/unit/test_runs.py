"""Comparisons of runs: distances of frames, and the error of a grid for scenes of every kind."""

from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from reference import acting
from reference.scenes import rod_scene
from reference.solids import box
from reference.stopped import switched_off

import magmpm
from magmpm import Motion, Result, Scene, run
from magmpm.bodies.surface_mesh import write_stl
from magmpm.errors import SceneError, SolveError
from magmpm.results.measures import Frames, near_jumps
from magmpm.runs import distance
from magmpm.solving import several_grids
from magmpm.solving.several_grids import Runs, cost_in_words, grids_of, overloaded
from magmpm.statics.grids import Equilibria

ROOT = Path(__file__).parents[2]
LENGTH = 24e-3
PLAIN = rod_scene(length=LENGTH, field=[0.0, 0.0, 5e-3])
RAMP = {"over_time": {"ramp": {"duration": 1.0}}}


def along_a_ramp(steps: int = 3, **resolution: Any) -> Scene:
    """The short catheter in a field that is switched on, as equilibria along time."""
    data = PLAIN.to_si()
    field = {**data["field"], **RAMP}
    return Scene.from_si(
        {
            **data,
            "field": field,
            "solver": {"quasi_static": {"steps": steps}},
            "resolution": resolution,
        }
    )


def moving(**resolution: Any) -> Scene:
    """The short catheter as it begins to move."""
    data = PLAIN.to_si()
    dynamic = {"duration": 2e-3, "output_every": 1e-3}
    effects = {"magnetic_torque": {}, "damping": {"rate": 60.0}}
    return Scene.from_si(
        {**data, "effects": effects, "solver": {"dynamic": dynamic}, "resolution": resolution}
    )


def test_distance_of_two_results_is_that_of_their_axes_and_tips() -> None:
    """Against arithmetic on their rows: grids of 2 and 3 cells have rows at other places."""
    coarse, fine = (run(PLAIN.with_cells(n)) for n in (2, 3))
    assert distance(coarse, coarse) == 0.0
    apart = distance(coarse, fine)
    assert apart == distance(fine, coarse)
    ends = float(np.linalg.norm(coarse.centreline[-1, 1:] - fine.centreline[-1, 1:]))
    assert apart >= ends > 0.0
    assert distance(coarse, fine, of="tip") == pytest.approx(
        float(np.linalg.norm(coarse.tip - fine.tip))
    )


def test_distance_of_two_motions_is_that_of_all_frames(tmp_path: Path) -> None:
    """A field that is on for a moment: the ends agree, frames before do not."""
    frames = [{"time": t, "strength": s} for t, s in ((0.0, 0.02), (1.0, 2.0), (2.0, 0.02))]
    data = along_a_ramp(2, cells_across=2).to_si()
    data["field"]["over_time"] = {"keyframes": frames}
    pulse = Scene.from_si(data)
    data["field"]["over_time"] = {"keyframes": [{**frame, "strength": 0.02} for frame in frames]}
    ends = [
        run(scene, folder=tmp_path / name)
        for scene, name in ((pulse, "a"), (Scene.from_si(data), "b"))
    ]
    a, b = (Motion.load(tmp_path / name) for name in "ab")
    assert (
        distance(*ends) < 1e-6 * LENGTH
    )  # both end in the same field; equilibria are known to 1e-6 of the length
    middle = float(np.linalg.norm(np.subtract(ends[0].steps[1]["tip"], ends[1].steps[1]["tip"])))
    assert distance(a, b) == pytest.approx(
        middle, rel=1e-2
    )  # the tip goes farthest; sections' means, in single precision


def test_a_path_and_an_equilibrium_have_the_same_error() -> None:
    """The same body in a field that is switched on: the end is the same, and has the largest error. Proofs are known to 3 %."""
    rest = magmpm.error(PLAIN.with_cells(2))
    path = magmpm.error(along_a_ramp(cells_across=2))
    assert path.error == pytest.approx(rest.error, rel=0.1)
    assert path.report["largest_at"] == 1.0
    assert path.report["unknown"] == []
    assert [one["cells_across"] for one in path.report["tried"]] == [2, 3, 4]
    assert isinstance(grids_of(PLAIN), Equilibria)
    assert isinstance(grids_of(along_a_ramp(cells_across=2)), Runs)


def refused_before(kind: str, folder: Path) -> Scene:
    """A scene on 2 cells of a kind whose error was refused when errors of motions were those of a rest."""
    data = acting.scene(kind if kind in acting.SCENES else "magnetic_torque").to_si()
    data["solver"] = {"dynamic": {"duration": 0.5e-3, "output_every": 0.25e-3}}
    if kind in ("ground", "self_contact"):  # of one set of kernels, which other tests compile too
        data["effects"] |= {"gravity": {}, "damping": {"rate": 1e-6}}
    if kind == "self_contact":
        data["effects"]["ground"] = {"point": [0.0, 0.0, -0.1]}
        data["effects"]["gravity"] = {
            "acceleration": [0.0, 0.0, -3000.0]
        }  # the upper block falls onto the held one
        data["body"]["parts"]["meshes"][0]["clamp"] = True
        data["body"]["parts"]["spacing"] = None
    elif kind == "free body":
        data["body"]["catheter"]["clamp"] = "none"
    elif kind == "endless field":
        data["field"]["over_time"] = {"rotation": {"axis": [1.0, 0.0, 0.0], "frequency": 500.0}}
    elif kind == "parts at rest":
        meshes = []
        for name, ends in {"held": ((0, 0, 0), (2, 3, 3)), "end": ((2, 0, 0), (9, 3, 3))}.items():
            write_stl(box(*ends), folder / f"{name}.stl")
            meshes.append(
                {"mesh": str(folder / f"{name}.stl"), "material": "m", "clamp": name == "held"}
            )
        data["body"] = {"parts": {"unit": "mm", "spacing": 1.5e-3, "meshes": meshes}}
        data["effects"], data["solver"] = {"magnetic_torque": {}, "gravity": {}}, {"static": {}}
    return Scene.from_si(data)


KINDS = ["ground", "self_contact", "free body", "endless field", "parts at rest"]


@pytest.mark.parametrize(
    "kind", [*KINDS, *(pytest.param(name, marks=pytest.mark.slow) for name in ("walls", "feed"))]
)
def test_an_error_is_known_where_it_was_refused(kind: str, tmp_path: Path) -> None:
    """The whole runs are compared, and the bound holds against 5 cells."""
    scene = refused_before(kind, tmp_path)
    found = magmpm.error(scene)
    runs = Runs(scene)
    assert [one["cells_across"] for one in found.report["tried"]] == [2, 3, 4]
    for cells in (2, 5):
        runs.solve(cells)
    assert 0.1 * found.error < runs.distance_between(2, 5) < found.error
    assert found.report.get("largest_at", 1.0) > 0.0


def test_a_spacing_is_not_dropped_where_an_error_is_asked_for(tmp_path: Path) -> None:
    """Cells of 1 mm are 3 across a part of 3 mm, and the error of 2 would be another grid's."""
    data = refused_before("parts at rest", tmp_path).to_si()
    data["body"]["parts"]["spacing"] = 1e-3
    with pytest.raises(SceneError, match=r"spacing: received 1 mm\n.*\n.*cells_across: 3}"):
        magmpm.error(Scene.from_si(data))


def test_loads_that_no_silicone_bears_are_told_before_they_are_solved() -> None:
    """Scenes that ship have none; of those of silicone in a field or with a weight, kPa that are written as Pa are found."""
    files = [*(ROOT / "data/scenes").glob("*.yaml"), *(ROOT / "data/scenes/gallery").glob("*.yaml")]
    scenes = [magmpm.load_scene(file) for file in files]
    assert [warning for scene in scenes for warning in overloaded(scene)] == []
    soft = PLAIN.with_material(shear_modulus=120.0)
    (warning,) = overloaded(soft)
    assert "stretch a shear modulus of 120 Pa to more than 1.5 times its length" in warning
    assert overloaded(soft.with_field([0.0, 0.0, 0.0])) == []
    (warning,) = overloaded(soft.with_field([0.0, 0.0, 0.0]).with_effects(gravity={}))
    assert "the loads (440 Pa)" in warning


def test_an_error_that_would_take_longer_than_an_hour_is_refused_while_its_first_run_goes_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With an hour of a hundredth of a second: two grids would take longer, and only a part of the first one was run."""
    monkeypatch.setattr(several_grids, "LONGEST_RUN", 1e-2)
    seen: list[float] = []
    scene = moving(error=0.01)
    with pytest.raises(
        SceneError, match=r"within reach of 0\.01 s: a run on 2 cells across takes .* times as long"
    ) as refused:
        run(scene, on_progress=lambda step, at: seen.append(at))
    assert "resolution.error" in str(refused.value)
    assert "give cells_across: 2" in str(refused.value)
    assert max(seen, default=0.0) < scene.duration


@pytest.mark.parametrize(("share", "refused"), [(0.1, True), (0.9, False)])
def test_the_pace_of_a_first_run_tells_how_long_all_take(share: float, refused: bool) -> None:
    """A tenth of it in 40 s: 400 s for all of it, over two hours with two finer grids; nine tenths in 40 s: a quarter of an hour."""
    scene = moving(error=0.01)
    with (
        pytest.raises(SceneError, match=r"a run on 2 cells across takes 4e\+02 s")
        if refused
        else nullcontext()
    ):
        Runs(scene)._check_hopeful(2, 40.0, share * scene.duration)


@pytest.mark.parametrize("made", [pytest.param(along_a_ramp, marks=pytest.mark.slow), moving])
def test_runs_choose_the_grid_that_is_asked_for(made: Callable[..., Scene], tmp_path: Path) -> None:
    """Its frames are all in the folder, and an error out of reach leaves the folder as it was."""
    scene = made(error=0.05)
    result = run(scene, folder=tmp_path)
    assert result.resolution["cells_across"] == 2
    assert result.error_estimate < 0.05 * LENGTH
    assert result.scene_hash == scene.hash()
    assert len(Motion.load(tmp_path).times) == (4 if scene.static else 3)
    np.testing.assert_array_equal(result.tip, run(scene.with_cells(2)).tip)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(SceneError, match="within reach"):
        run(Scene.from_si({**scene.to_si(), "resolution": {"error": 2e-6}}), folder=tmp_path)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.slow
def test_a_time_for_what_runs_along_time() -> None:
    """Long enough on any machine for the coarsest grid; a microsecond ends its run at once."""
    for scene in (along_a_ramp(2, seconds=20.0), moving(seconds=20.0)):
        result = run(scene)
        assert result.error_estimate is not None
        cells = result.resolution["cells_across"]
        np.testing.assert_allclose(
            result.tip, run(scene.with_cells(cells)).tip, atol=1e-9 * LENGTH
        )  # the same run
        with pytest.raises(SceneError, match="must be enough for the coarsest grid"):
            run(Scene.from_si({**scene.to_si(), "resolution": {"seconds": 1e-6}}))


def test_a_path_that_fails_on_every_grid_leaves_files_of_one_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its last good state, in place of the results that were there; no grid was chosen, so there are no frames."""
    assert run(along_a_ramp(error=0.05), folder=tmp_path).converged
    switched_off(monkeypatch, 0.6)
    with pytest.raises(SolveError, match=r"t = 0\.75 s: switched off"):
        run(along_a_ramp(4, error=0.05), folder=tmp_path)
    saved = Result.load(tmp_path)
    assert (saved.converged, saved.time) == (False, 0.5)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["result.json", "state.npz"]


def test_where_grids_jump_no_error_is_known() -> None:
    """From jump to jump and as long on either side; of a jump that one grid alone has, all is compared."""
    times = [0.1 * k for k in range(11)]
    one, other = (
        Frames(times, [np.full((1, 3), x * (t > at)) for t in times], [None] * 11, [at])
        for x, at in ((1.0, 0.45), (1.0, 0.55))
    )
    (span,) = near_jumps(one, other)
    assert span == (pytest.approx(0.35), pytest.approx(0.65))
    assert max(one.distances(other).values()) > 1.0
    assert max(one.distances(other, "centreline", [span]).values()) == 0.0
    other.jumps = []
    assert near_jumps(one, other) == []


def test_the_cost_of_knowing_an_error_is_said() -> None:
    """A motion on 4 cells takes 16 times as long as on 2, on 3 cells 5 times, about."""
    assert cost_in_words(PLAIN) == ""
    assert "the whole motion is run on 2, 3 and 4 cells across: about 2" in cost_in_words(
        moving(error=0.01)
    )


def interacting(blocks: int, **more: Any) -> Scene:
    """A short rod, half of it magnetized along its axis and half across, whose halves act on each other by so many blocks across."""
    scene = rod_scene(
        length=8e-3, directions=[(1.0, 0.0, 0.0), (0.0, 1.0, 1.0)], field=[0.0, 2e-3, 3e-3], cells=2
    )
    named = scene.with_effects(magnetic_interaction={"blocks_across": blocks})
    return Scene.from_si({**named.to_si(), **more})


@pytest.mark.parametrize("path", [False, True])
def test_the_promised_error_has_that_of_the_blocks_which_do_not_follow_the_cells(
    path: bool,
) -> None:
    """One block across on every grid: a finer one says nothing of it. Against four, whose own error is a sixteenth."""
    more: dict[str, Any] = {}
    if path:
        data = interacting(1).to_si()
        more = {"field": {**data["field"], **RAMP}, "solver": {"quasi_static": {"steps": 2}}}
    coarse = interacting(1, **more)
    truth = run(interacting(4, **more).with_cells(4))
    missed = distance(run(coarse), truth)
    known = magmpm.error(coarse)
    assert missed <= known.error < 5 * missed
    compared = magmpm.compare(coarse, coarse.with_effects(magnetic_interaction=None))
    assert compared.uncertainty >= 0.5 * missed, "the difference of the two has the same error"
