"""A grid chosen for an error or a time: the choice is told with its error, and the answer is that of the grid."""

from __future__ import annotations

import gc
import weakref
from pathlib import Path

import numpy as np
import pytest
from reference.scenes import rod_scene
from threadpoolctl import threadpool_info, threadpool_limits

from magmpm import Result, Scene, load_scene, run
from magmpm.dynamics.path_errors import differences
from magmpm.dynamics.path_judged import PathSeen
from magmpm.dynamics.quasi_static import loads_of
from magmpm.errors import SceneError, SolveError
from magmpm.model import build
from magmpm.results.measures import largest_distance
from magmpm.results.trajectory import Motion
from magmpm.rod.strongest_load import strongest
from magmpm.simulate import simulated
from magmpm.statics import resolution
from magmpm.statics.between_grids import carried
from magmpm.statics.error_estimate import JOINTED, SMOOTH, Convergence, caution, convergence, distance
from magmpm.statics.ladder import Ladder, Load
from magmpm.statics.layout import StaticModel, static_model
from magmpm.statics.resolution import at_rest, nothing

SCENES = Path(__file__).resolve().parents[3] / "data/scenes"
LENGTH = 24e-3
PLAIN = rod_scene(length=LENGTH, field=[0.0, 0.0, 5e-3])


def asked(**resolution: object) -> Scene:
    """A short catheter that bends, with this resolution."""
    return Scene.from_si({**PLAIN.to_si(), "resolution": resolution})


def test_an_asked_error_is_kept_and_proven(tmp_path: Path) -> None:
    """0.5 % of the length: the bar is within it and holds against 6 cells; the answer is bit for bit that of the chosen cells."""
    scene = asked(error=0.005)
    result = run(scene, folder=tmp_path)
    assert result.error_estimate is not None
    assert result.resolution is not None
    cells = result.resolution["cells_across"]
    plain, fine = run(PLAIN.with_cells(cells)), run(PLAIN.with_cells(6))
    np.testing.assert_allclose(result.centreline, plain.centreline, atol=1e-6 * LENGTH)  # as well as equilibria are known
    assert result.stability == pytest.approx(plain.stability, rel=1e-3)  # statics.stability.ENOUGH
    assert largest_distance(result, fine.centreline) < result.error_estimate < 0.005 * LENGTH
    assert (plain.error_estimate, plain.resolution) == (None, None)
    assert result.scene_hash == scene.hash() != plain.scene_hash

    loaded = Result.load(tmp_path)
    assert (loaded.error_estimate, loaded.resolution) == (result.error_estimate, result.resolution)


def test_an_error_in_mm_at_the_tip() -> None:
    """0.1 mm at the tip of 24 mm."""
    result = run(asked(error="0.1 mm", of="tip"))
    assert result.error_estimate is not None
    assert result.resolution is not None
    assert result.error_estimate < 0.1e-3
    assert np.linalg.norm(result.tip - run(PLAIN.with_cells(6)).tip) < result.error_estimate
    assert result.resolution["asked"] == {"error": "0.0001 m", "of": "tip"}


def test_what_is_asked_is_plain_data_and_read_back() -> None:
    for given in ({"error": 0.01}, {"error": "0.1 mm", "of": "tip"}, {"seconds": 2.0}):
        scene = asked(**given)
        assert Scene.from_si(scene.to_si()) == scene
        assert scene.hash() != PLAIN.hash()
        with pytest.raises(SceneError, match="cells must be given"):
            build(scene)
    assert asked(error="1 %").hash() == asked(error=0.01).hash() != asked(error="0.1 mm").hash()
    assert asked(error=0.01).with_cells(2).hash() == PLAIN.with_cells(2).hash()


@pytest.mark.parametrize(
    ("error", "says"),
    [
        ("1 m", "half of the length, 12 mm"),
        ("1 nm", "known to 0.0001 %"),
        (2e-6, "12 cells across, the most whose error can be proven, are off by"),
    ],
)
def test_what_no_grid_can_reach_is_refused_with_the_number(error: object, says: str) -> None:
    with pytest.raises(SceneError, match=says):
        run(asked(error=error))


def test_a_displacement_is_carried_between_grids_as_it_is() -> None:
    """What the splines of both grids hold, a quadratic that is at rest at the clamp, comes over to rounding."""
    coarse, fine = (static_model(build(PLAIN.with_cells(n))) for n in (2, 3))

    def coefficients(model: StaticModel) -> np.ndarray:
        """Of u = (x y, x z, x^2) at the nodes: c = f - h^2/8 f'' is exact for quadratics."""
        x = model.plane_coordinates()[:, None]
        y, z = (model.grid.node_coordinates(i + 1)[model.layout.node_yz[:, i]] for i in range(2))
        h = model.grid.spacing[0]
        u = np.stack(np.broadcast_arrays(x * y, x * z, x**2 - h * h / 4), axis=-1).reshape(model.layout.planes, -1)
        return np.ascontiguousarray(u)

    exact, found = coefficients(fine), carried(coarse, coefficients(coarse), fine)
    x = fine.plane_coordinates()
    inside = x > 4 * coarse.grid.spacing[0]  # x^2 is no spline where node 0 is minus node 1
    np.testing.assert_allclose(found[inside], exact[inside], atol=1e-4 * np.abs(exact).max())


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


def test_a_time_is_kept_and_one_too_short_is_refused() -> None:
    """5 s are enough for the coarsest grids on any machine, and a microsecond for none. What is kept of a time, make bench measures."""
    result = run(asked(seconds=5.0))
    assert result.error_estimate is not None
    with pytest.raises(SceneError, match="enough for the coarsest grid"):
        run(asked(seconds=1e-6))


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


def tube(length: float, bore: float, **cells: object) -> Scene:
    """A tube of 3 mm with segments of three directions, across a field."""
    data = rod_scene(length=length, directions=[(1, 0, 0), (0, 0.7, 0.7), (-0.9, 0, 0.45)], field=(0.0, 10e-3, 10e-3)).to_si()
    data["body"]["catheter"] |= {"diameter": 3e-3, "inner_diameter": bore}
    for material in data["materials"].values():
        material |= {"shear_modulus": 100e3, "bulk_to_shear": 20.0, "remanence": 0.12}
    return Scene.from_si({**data, "resolution": cells})


def test_bounds_are_wider_for_walls_far_below_a_cell() -> None:
    """A wall of a tenth of a cell at 2 cells: the plain bound was 1.2 times too small here, which no scene it was measured by had shown."""
    result = run(tube(18e-3, 2.7e-3, error=0.02))
    assert result.resolution is not None
    assert result.resolution["cells_across"] == 2
    fine = run(tube(18e-3, 2.7e-3, cells_across=6))
    assert 0.2 < largest_distance(result, fine.centreline) / result.error_estimate < 1.0


@pytest.mark.parametrize(("slenderness", "wall", "factor"), [(10.0, np.inf, 1.0), (10.0, 0.2, 1.0), (10.0, 0.1, 2.0), (2.0, np.inf, 1.6)])
def test_caution_is_for_what_was_not_measured(slenderness: float, wall: float, factor: float) -> None:
    assert caution(slenderness, wall) == factor


def test_errors_that_hardly_fall_are_no_ground_for_a_leap(monkeypatch: pytest.MonkeyPatch) -> None:
    """0.78 % at 2 cells and 0.56 % at 4 for 0.12 % asked: the next are 6, not the 12 that an order of 1.5 asks for."""
    search = resolution._Search(Ladder(asked(error=0.0012), at_rest), 0.0, nothing)
    monkeypatch.setattr(resolution._Search, "fits", lambda self, cells: True)
    monkeypatch.setattr(resolution._Search, "takes", lambda self, cells: 1.0)
    search.errors.update({2: 0.0078 * LENGTH, 4: 0.0056 * LENGTH})
    assert resolution._next(search, 4, None) == 6
    search.errors.update({4: 0.002 * LENGTH})  # order 2: 5 cells are told 0.13 %, 6 cells 0.09 %
    assert resolution._next(search, 4, None) == 6


def test_a_search_leaves_no_matrices(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its end frees them, without a collection of circles: the next search uses their memory again."""
    searches: list[weakref.ref[Ladder]] = []

    class Watched(Ladder):
        def __init__(self, *given: object) -> None:
            super().__init__(*given)  # type: ignore[arg-type]
            searches.append(weakref.ref(self))

    monkeypatch.setattr(resolution, "Ladder", Watched)
    gc.disable()
    try:
        resolution.choose(asked(error=0.005))
        assert len(searches) == 1
        assert searches[0]() is None
    finally:
        gc.enable()


def test_a_search_keeps_blas_on_one_thread() -> None:
    """Between its solves too: the threads that a small fit starts spin on for a while, and kernels then run at half their pace."""
    seen: list[int] = []

    def loads(scene: Scene) -> list[Load]:
        seen.append(max(library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"))
        return at_rest(scene)

    with threadpool_limits(2, user_api="blas"):
        resolution.choose(asked(error=0.005), loads)
    assert len(seen) >= 3  # the answer, its witness, its proof
    assert set(seen) == {1}


def test_an_error_out_of_reach_is_answered_with_one_in_reach() -> None:
    """What the coarsest grid gives, and what finer ones should."""
    with pytest.raises(SceneError, match=r"ask for .* % or more, which \d+ cells give, or try .* %, which \d+ cells give only if"):
        run(asked(error=2e-6))


def test_a_solve_that_fails_keeps_its_last_good_state() -> None:
    """With an error asked for as with cells given: the last equilibrium of its ramp, as a Result."""
    data = asked(error=0.01).to_si()
    data["solver"]["static"] = {"max_steps": 2, "field_steps": 4}
    data["field"]["uniform"] = [40.0 * b for b in data["field"]["uniform"]]
    for grid in ({"error": 0.01}, {"cells_across": 2}):
        with pytest.raises(SolveError) as failed:
            run(Scene.from_si({**data, "resolution": grid}))
        assert isinstance(failed.value.state, Result)
        assert not failed.value.state.converged


def hinged(**cells: object) -> Scene:
    """A plane strip of two stiff and two soft segments, whose moduli differ 167 times, across a field."""
    lengths, stiff = (7.2e-3, 2.1e-3, 5.37e-3, 5.33e-3), (True, False, True, False)
    soft = {"shear_modulus": 120e3, "bulk_to_shear": 20.0, "density": 1882.0, "remanence": 0.138}
    segments = [
        {"magnetization": [1.0, 0.0, 0.0], "length": length, "material": "rigid" if rigid else "soft"}
        for length, rigid in zip(lengths, stiff, strict=True)
    ]
    strip = {"length": 20e-3, "width": 4e-3, "thickness": 1e-3, "plane_strain": True, "material": "soft", "segments": segments}
    materials = {"soft": soft, "rigid": {**soft, "shear_modulus": 20e6, "remanence": 0.0}}
    content = {"name": "hinged", "materials": materials, "body": {"strip": strip}, "field": {"uniform": [0.0, 0.0, 8e-3]}}
    return Scene.from_si({**content, "effects": {"magnetic_torque": {}}, "resolution": cells})


def test_bounds_of_soft_and_stiff_segments_hold() -> None:
    """6 and 8 cells give nearly the same shape by chance, and the bound of other bodies is seven times too small. Against 16 cells, whose
    own error is some tenth of a per cent of the length.
    """
    scene = hinged(cells_across=2)
    law = convergence(scene)
    solved = {n: run(scene.with_cells(n)) for n in (2, 3, 4, 5, 6, 7, 8, 9)}
    true = {n: largest_distance(solved[n], run(scene.with_cells(16)).centreline) for n in (2, 4, 6)}

    def told(by: Convergence, n: int) -> float:
        proof = by.proof[n]
        apart = {k: largest_distance(solved[k], solved[proof].centreline) for k in (n, *by.witness.get(n, ()))}
        return by.bound(n, proof, apart.pop(n), apart)

    assert law is JOINTED
    assert told(SMOOTH, 6) < 0.2 * true[6]
    for n, error in true.items():
        assert 0.3 * told(law, n) < error < told(law, n)
    with pytest.raises(SceneError, match="ask for"):  # it was promised, and missed
        run(hinged(error=0.001))


@pytest.mark.parametrize(("ratio", "law"), [(1.0, SMOOTH), (1.4, SMOOTH), (1.6, JOINTED), (0.6, JOINTED)])
def test_a_body_is_jointed_where_stiffness_jumps(ratio: float, law: Convergence) -> None:
    data = hinged(cells_across=2).to_si()
    data["materials"]["rigid"]["shear_modulus"] = ratio * 120e3
    assert convergence(Scene.from_si(data)) is law
    data["materials"]["rigid"] |= {"shear_modulus": 120e3, "bulk_to_shear": 20.0 * ratio}
    assert convergence(Scene.from_si(data)) is law


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


def test_runs_on_given_cells_tell_of_joints_and_proven_ones_do_not() -> None:
    told = [warning for warning in run(hinged(cells_across=3)).warnings if warning.startswith("joints: ")]
    assert len(told) == 1
    assert "moduli 167 times apart" in told[0]
    assert "within 1 % of the length" in told[0]
    assert not any(warning.startswith("joints: ") for warning in run(hinged(error=0.05)).warnings)
    assert not any(warning.startswith("joints: ") for warning in run(PLAIN).warnings)


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


def test_a_path_that_fails_leaves_files_of_one_run(tmp_path: Path) -> None:
    """With an error that is asked for, over earlier results: its last good state comes with its own frames."""
    ramp = {**PLAIN.to_si()["field"], "over_time": {"ramp": {"duration": 1.0}}}
    data = {**PLAIN.to_si(), "field": ramp, "solver": {"quasi_static": {"steps": 3}}, "resolution": {"error": 0.05}}
    assert run(Scene.from_si(data), folder=tmp_path).converged
    magnet = {"position": [LENGTH, 0.0, -40e-3], "moment": [0.0, 0.0, 20.0], "diameter": 5e-3}
    frames = [{"time": float(k), "move": [0.0, 0.0, z]} for k, z in ((0, -0.1), (1, 35e-3))]
    pulled = {"dipole": [magnet], "over_time": {"keyframes": frames}}
    effects = {"magnetic_torque": {}, "magnetic_force": {}}
    with pytest.raises(SolveError) as caught:
        run(Scene.from_si({**data, "field": pulled, "effects": effects, "solver": {"quasi_static": {"steps": 4}}}), folder=tmp_path)
    if caught.value.state is not None:
        saved = Result.load(tmp_path)
        assert not saved.converged
        assert Motion.load(tmp_path).times[-1] == saved.time


def test_an_error_that_no_grid_met_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """The coarsest grid does not meet it, and finer ones fail: 185 % of the length was told once, of 1 % asked for, without a word."""
    solve = Ladder.solve

    def coarse_only(self: Ladder, cells: int) -> object:
        if cells > 2:
            raise SolveError("no equilibrium within 60 Newton steps; to try: a weaker load")
        return solve(self, cells)

    monkeypatch.setattr(Ladder, "solve", coarse_only)
    with pytest.raises(SceneError, match=r"cells across found no equilibrium \(no equilibrium within 60 Newton steps\)") as told:
        run(asked(error=2e-4))
    assert "ask for" in str(told.value)
    monkeypatch.setattr(resolution._Search, "algebraic", lambda self: LENGTH)  # as if the grids had found different equilibria
    for wanted in ({"error": 2e-4}, {"seconds": 10.0}):
        with pytest.raises(SceneError, match="must find the same equilibrium"):
            run(asked(**wanted))
