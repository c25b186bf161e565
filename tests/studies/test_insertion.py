"""Insertion: the path, the rods' trajectory, measures of a trajectory, and what a study keeps."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from reference.commands import ROOT

import magmpm
from magmpm import Scene
from magmpm.errors import SolveError
from magmpm.studies.evaluate.trajectory import (
    EXIT_WEIGHT,
    STATIONS_OF_INSERTION,
    InsertionTrajectory,
)
from magmpm.studies.problem.path import Path
from magmpm.studies.problem.study import Study
from magmpm.studies.problem.variables import Vary, VaryDirections, VaryField
from magmpm.studies.rods.rod_path import STABILITY_AT_BRINK, RodPath, search
from magmpm.studies.rods.rod_trajectory import RodTrajectory, RodTrajectoryDesign
from magmpm.studies.search.definition import load_study
from magmpm.studies.search.search_space import SearchSpace

RADIUS = 0.04
MAX = 10e-3


def arc(length=30e-3, rows=31):
    """A circle of RADIUS in the x-z plane, rows [s, x, y, z]."""
    s = np.linspace(0.0, length, rows)
    return np.column_stack(
        [s, RADIUS * np.sin(s / RADIUS), 0 * s, RADIUS * (1 - np.cos(s / RADIUS))]
    )


def catheter():
    body = {
        "length": 30e-3,
        "diameter": 3e-3,
        "material": "silicone",
        "segments": 3 * [{"magnetization": [1, 0, 0]}],
    }
    materials = {
        "silicone": {
            "shear_modulus": 120e3,
            "bulk_to_shear": 20,
            "density": 1882.0,
            "remanence": 0.138,
        }
    }
    about = {
        "name": "three",
        "effects": {"magnetic_torque": {}, "gravity": {}},
        "resolution": {"cells_across": 2},
    }
    return Scene.from_si({**about, "materials": materials, "body": {"catheter": body}})


def insertion(depths=(10e-3, 20e-3, 30e-3)):
    vary = Vary(magnetization=VaryDirections(), field=VaryField(max=MAX, at="each depth"))
    study = Study("arc", "arc", catheter(), arc(), vary, 3, "gauss-newton", 1, None, depths=depths)
    found = InsertionTrajectory.of(study, SearchSpace.of(study))
    assert found is not None
    return found


def test_a_path_follows_its_rows_and_leaves_along_x():
    path = Path(arc())
    s = np.linspace(0, 30e-3, 77)
    exact = np.stack(
        [RADIUS * np.sin(s / RADIUS), 0 * s, RADIUS * (1 - np.cos(s / RADIUS))], axis=1
    )
    np.testing.assert_allclose(
        path.at(s), exact, atol=1e-8
    )  # cubic: the fourth power of 1 mm over the radius
    assert path.smallest_radius() == pytest.approx(RADIUS, rel=1e-3)


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_a_flattened_path_has_that_share_of_the_curvature(share):
    """In its plane: frames that turned about the path would lead out of it."""
    flat = Path(arc()).flattened(share)
    assert flat.length == pytest.approx(30e-3)
    angle = share * 30e-3 / RADIUS
    end = [
        30e-3 * np.sinc(angle / np.pi),
        0.0,
        0.0 if share == 0 else RADIUS / share * (1 - np.cos(angle)),
    ]
    np.testing.assert_allclose(flat.end, end, atol=2e-5)


def test_slopes_of_the_trajectory_are_its_differences():
    """Directions and fields, at each depth: against central differences of settled rods."""
    found = insertion()
    rods = found.rods.rods
    rng = np.random.default_rng(3)
    d = np.array([1.0, 0, 0]) + 0.3 * rng.normal(size=(3, 3))
    d /= np.linalg.norm(d, axis=1)[:, None]
    fields = 4e-3 * np.array([[1, 0, 0.5], [0.8, 0.3, 0.5], [0.6, -0.2, 0.7]])
    state = rods.settled(d, fields, None)
    step = 1e-7
    for k in range(3):
        shift = np.zeros((3, 3))
        shift[k, 2] = step
        up, down = (rods.settled(d, fields + sign * shift, state.shapes) for sign in (1, -1))
        slope = (up.gaps[k] - down.gaps[k]) / (2 * step)
        np.testing.assert_allclose(slope, state.slopes[k][:, -1], atol=1e-5 * np.abs(slope).max())
        other = (k + 1) % 3  # fields of different depths do not touch each other's shapes
        np.testing.assert_array_equal(up.gaps[other], down.gaps[other])


def test_least_squares_recovers_a_design_that_made_the_path():
    """The rods of a known design are the targets: from a design beside it, they are met to a micrometer."""
    found = insertion()
    rods = found.rods.rods
    d = np.array([[1.0, 0, 0], [0.8, 0, 0.6], [0.8, 0.6, 0]])
    fields = 5e-3 * np.array([[1, 0, 0.6], [1, 0, 0.5], [1, 0.1, 0.4]])
    made = rods.settled(d, fields, None)
    depths = tuple(
        type(depth)(depth.rod, depth.segments, depth.place, position, depth.roots)
        for depth, position in zip(rods.depths, made.positions, strict=True)
    )
    known = RodTrajectory(depths, rods.max_field, rods.movable, rods.count)
    near = d + np.array([0.1, -0.1, 0.1])
    near /= np.linalg.norm(near, axis=1)[:, None]
    state = known.settled(near, 0.9 * fields, None)
    assert np.sqrt(state.squares) > 1e-4
    design = known.least_squares(RodTrajectoryDesign(near, 0.9 * fields, 1.0, state), 60)
    assert design.value < 1e-6


def fake(found, depth, shift):
    """A result whose axis is the path, shifted along y."""
    s = np.linspace(0.0, depth, 61)
    axis = found.path.at(s) + np.array([0.0, shift, 0.0])
    segment = {
        "particle_segment": np.array([0]),
        "segment_center": axis[:1],
        "segment_remanence": np.ones((1, 3)),
    }
    return SimpleNamespace(
        centreline=np.column_stack([s, axis]),
        tip=axis[-1],
        iterations=3,
        converged=True,
        stability=0.5,
        **segment,
    )


def test_measures_are_what_they_say():
    """Each depth counts the same, whatever its length; the exit is the last depth's tip."""
    found = insertion()
    params = found.parameters(
        RodTrajectoryDesign(
            np.tile([1.0, 0, 0], (3, 1)),
            MAX * np.array([[0.5, 0, 0], [0.5, 0, 0.3], [0.5, 0, 0]]),
            0.0,
        )
    )
    results = [
        fake(found, depth, shift)
        for depth, shift in zip(found.study.depths, (1e-3, 2e-3, 2e-3), strict=True)
    ]
    kept = found.measures(results, params)
    assert json.loads(json.dumps(kept)) == kept, "it can be stored"
    assert kept["rms_m"] == pytest.approx(np.sqrt((1 + 4 + 4) / 3) * 1e-3, rel=1e-6)
    assert kept["exit_error_m"] == pytest.approx(2e-3, rel=1e-6)
    assert kept["worst_m"] == pytest.approx(2e-3, rel=1e-6)
    assert kept["field_largest_change_T"] == pytest.approx(3e-3, rel=1e-9)
    assert kept["field_total_variation_T"] == pytest.approx(6e-3, rel=1e-9)


def test_depths_and_tips_are_told_apart() -> None:
    """The second depth strays most, and most at its tip."""
    found = insertion()
    params = found.parameters(
        RodTrajectoryDesign(np.tile([1.0, 0, 0], (3, 1)), np.zeros((3, 3)), 0.0)
    )
    results = [fake(found, depth, 0.0) for depth in found.study.depths]
    results[1].centreline[:, 2] += 1e-3 * np.linspace(0.0, 1.0, 61)
    kept = found.measures(results, params)
    assert kept["worst_depth_m"] == 20e-3
    assert kept["insertion"][1]["tip_error_m"] == pytest.approx(1e-3)


def test_parameters_and_scenes_agree():
    """Each depth's scene has the design's directions, base segments missing, and its own field."""
    found = insertion()
    d = np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]])
    fields = 1e-3 * np.array([[1.0, 2, 3], [4, 5, 6], [7, 0, 1]])
    scenes = found.scenes(found.parameters(RodTrajectoryDesign(d, fields, 0.0)))
    assert [len(scene.regions()) for scene in scenes] == [1, 2, 3]
    for scene, field, count in zip(scenes, fields, (1, 2, 3), strict=True):
        np.testing.assert_allclose(scene.field.uniform, field, atol=1e-12)
        np.testing.assert_allclose(
            [region.magnetization for region in scene.regions()], d[3 - count :], atol=1e-9
        )


def test_the_stored_model_is_the_derivative_of_the_gaps():
    """Residuals and Jacobian against differences of solved trajectories, at two cells across."""
    from magmpm import run, sensitivities

    found = insertion((12e-3, 30e-3))
    design = RodTrajectoryDesign(
        np.tile([0.8, 0, 0.6], (3, 1)), MAX * np.array([[0.4, 0, 0.3], [0.5, 0.1, 0.2]]), 0.0
    )
    x = found.space.embedded(found.parameters(design))
    params = found.space.parameters_at(x)
    outcome = found.evaluate(run, sensitivities, params, None)
    assert outcome.reason is None
    residuals = np.array(outcome.model["residuals"])
    jacobian = np.array(outcome.model["jacobian"])

    def gaps(params):
        results = [
            run(scene, start=start)
            for scene, start in zip(found.scenes(params), found.starts(params), strict=True)
        ]
        return found._model(results, [np.zeros((3 * STATIONS_OF_INSERTION, 1))] * 2)["residuals"]

    raw = np.array(gaps(params))
    assert residuals @ residuals == pytest.approx(raw @ raw, rel=1e-6)
    assert raw @ raw == pytest.approx(outcome.rms**2 + EXIT_WEIGHT * outcome.tip_error**2, rel=1e-3)
    for k, step in ((2, 1e-4), (10, 1e-6), (14, 1e-6)):
        up = x.copy()
        down = x.copy()
        up[k] += step
        down[k] -= step
        squares = [np.sum(np.square(gaps(found.space.parameters_at(v)))) for v in (up, down)]
        moved = (
            found.space.embedded(found.space.parameters_at(up))
            - found.space.embedded(found.space.parameters_at(down))
        ) / (2 * step)
        slope = (squares[0] - squares[1]) / (2 * step)
        assert slope == pytest.approx(2 * residuals @ jacobian @ moved, rel=2e-3)


def test_a_depth_that_fails_costs_the_penalty_and_is_named():
    from magmpm.errors import SolveError

    found = insertion()

    def solve(scene, *, start):
        if scene.length > 15e-3:
            raise SolveError("no equilibrium")
        return fake(found, scene.length, 0.0)

    params = found.parameters(
        RodTrajectoryDesign(np.tile([1.0, 0, 0], (3, 1)), np.zeros((3, 3)), 0.0)
    )
    outcome = found.evaluate(solve, None, params, None)
    assert outcome.result is None
    assert outcome.rms == found.space.scene.length
    assert outcome.reason == "at 20 mm: no equilibrium"


def test_the_least_stable_depth_counts_and_is_named():
    found = insertion()
    found = replace(found, study=replace(found.study, margin=0.3))

    def solve(scene, *, start):
        result = fake(found, scene.length, 0.0)
        result.stability = {10: 0.5, 20: 0.1, 30: 0.4}[round(1e3 * scene.length)]
        return result

    outcome = found.evaluate(
        solve,
        None,
        found.parameters(RodTrajectoryDesign(np.tile([1.0, 0, 0], (3, 1)), np.zeros((3, 3)), 0.0)),
        None,
    )
    assert (outcome.refused, outcome.stability) == (True, 0.1)
    assert outcome.reason == "the stability at 20 mm, 0.1, is below the margin, 0.3"


# Rods that follow one another: on the branch that a push comes to, and designs that are mended where they leave it


def turning_back():
    """Directions and fields of three depths: held along the field while it is short, then turned against it step by step."""
    d = np.tile([1.0, 0.0, 0.0], (3, 1))
    return d, MAX * np.array([[0.6, 0.0, 0.1], [0.0, 0.0, 0.6], [-0.5, 0.0, 0.3]])


def test_the_end_does_not_depend_on_the_steps():
    """With twice the steps on the way, a push that meets no limit point ends in the same equilibria."""
    found = insertion()
    d, fields = turning_back()
    coarse = found.rods
    fine = RodPath(
        coarse.rods,
        tuple(tuple(each for depth in way for each in (depth, depth)) for way in coarse.ways),
    )
    ends = [[stops[-1].position for stops in way.stops(d, fields)] for way in (coarse, fine)]
    for one, other in zip(*ends, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-9)


def test_what_stays_in_the_guide_is_straight_and_what_is_out_keeps_its_shape():
    """Between two stops of one field, material moves on by the length that came out: the first step from a depth changes little."""
    found = insertion()
    d, fields = turning_back()
    ways = found.rods.stops(d, fields)
    for stops in ways:
        for stop in stops:
            np.testing.assert_allclose(np.linalg.norm(stop.q, axis=1), 1.0, atol=1e-12)
            np.testing.assert_allclose(stop.position[0], 0.0, atol=1e-15)
            np.testing.assert_allclose(stop.q[0], [1.0, 0.0, 0.0, 0.0], atol=1e-9)
    lengths = [stop.depth.place[-1] for stops in ways for stop in stops]
    assert np.all(np.diff(lengths) > 0)
    assert [stops[-1].depth.place[-1] for stops in ways] == pytest.approx(found.study.depths)
    np.testing.assert_allclose([stops[-1].field for stops in ways], fields)


def test_a_movie_begins_at_the_first_depth_and_passes_through_all_with_their_fields():
    found = insertion()
    d, fields = turning_back()
    shown = list(found._moments(found.parameters(RodTrajectoryDesign(d, fields, 0.0))))
    depths = np.array([depth for depth, _, _ in shown])
    assert depths[0] == pytest.approx(found.study.depths[0])
    assert (np.diff(depths) > 0).all()
    for depth, field in zip(found.study.depths, fields, strict=True):
        at = int(np.argmin(np.abs(depths - depth)))
        assert depths[at] == pytest.approx(depth)
        np.testing.assert_allclose(shown[at][1], field, atol=1e-9)


def test_shapes_for_the_body_are_the_stops():
    found = insertion()
    d, fields = turning_back()
    for stops in found.rods.stops(d, fields):
        shape = stops[-1].shape(d)
        np.testing.assert_allclose(shape.position, stops[-1].position, atol=1e-8)
        assert shape.stable


def test_a_design_whose_rods_are_elsewhere_is_mended():
    """Given shapes that the push does not come to: the answer's value is what the push gives, and better than before."""
    found = insertion()
    way = found.rods
    d, fields = turning_back()
    elsewhere = way.rods.settled(d, -0.5 * fields, None)
    assert elsewhere is not None
    pushed = np.sqrt(sum(stops[-1].squares for stops in way.stops(d, fields)))
    design = way.mended(RodTrajectoryDesign(d, fields, 0.0, elsewhere))
    squares = [stops[-1].squares for stops in way.stops(design.directions, design.fields)]
    assert np.sqrt(sum(squares)) == pytest.approx(design.value, rel=1e-6)
    assert design.value < 0.5 * pushed
    by_fields = way.mended(RodTrajectoryDesign(d, fields, 0.0, elsewhere), turning=False)
    np.testing.assert_array_equal(by_fields.directions, d)
    assert np.abs(by_fields.fields - fields).max() > 0.01 * np.abs(fields).max()


@pytest.mark.parametrize(("squares", "taken"), [(1.0, 5.0), (3.0, 0.0)])
def test_a_fitted_field_is_taken_where_it_is_nearer(squares, taken):
    """A rod that has left the design's shape is off by 2 (squared) in the design's field, no field, and by `squares` in the fitted one."""

    class Left(RodPath):
        def _go(self, way, directions, last, field):
            here = (
                {"squares": 2.0, "field": field}
                if field is not None
                else {"squares": squares, "field": np.full(3, 5.0)}
            )
            return [SimpleNamespace(position=np.ones((2, 3)), q=None, **here)]

    rods = SimpleNamespace(
        depths=[SimpleNamespace(place=np.array([0.0, 1.0]))], settled=lambda *_: "state"
    )
    design = SimpleNamespace(
        directions=None,
        fields=np.zeros((1, 3)),
        state=SimpleNamespace(positions=[np.zeros((2, 3))]),
    )
    fields, _, strayed = Left(rods, ((),))._followed(design)
    assert strayed
    assert fields[0, 0] == taken


def test_search_judges_on_the_way():
    """The best design's value is that of its rods on the way, and the arc is followed within a hundredth of the length."""
    found = insertion()
    best = search(found.rods, found.path, seed=1, starts=20, wanted=1, enough=0.01 * 30e-3)[0]
    assert found.rods.least_stability(best) > STABILITY_AT_BRINK
    squares = [stops[-1].squares for stops in found.rods.stops(best.directions, best.fields)]
    assert np.sqrt(sum(squares)) == pytest.approx(best.value, rel=1e-6)
    assert best.value < 0.01 * 30e-3


def test_no_equilibrium_on_the_way_is_an_error():
    found = insertion()
    d, fields = turning_back()
    with pytest.raises(SolveError, match="no equilibrium"):
        found.rods.stops(d, 1e30 * fields)


def test_a_design_near_the_end_of_a_branch_comes_after_a_safe_one() -> None:
    risky, safe = (
        SimpleNamespace(value=value, stability=stability)
        for value, stability in ((1.0, 0.0), (2.0, 1.0))
    )
    grown = iter([risky, safe])
    way = SimpleNamespace(
        rods=SimpleNamespace(grown=lambda path, rng: next(grown)),
        mended=lambda one: one,
        least_stability=lambda one: one.stability,
    )
    assert search(way, None, seed=1, starts=2) == [safe, risky]
    grown = iter([risky] * 3)
    assert search(way, None, seed=1, starts=3, enough=1.5) == [risky] * 2, (
        "one more of its kind ends the search"
    )


@pytest.mark.slow
def test_an_insertion_ends_when_only_other_branches_are_left(tmp_path):
    """No descent from the rod's designs gets better: the study ends by itself, says so, and does nothing when it is begun again."""
    shipped = load_study(ROOT / "data/studies/insertion_s.yaml")
    study = replace(
        shipped, scene=shipped.scene.with_cells(2), depths=(15e-3, 30e-3, 45e-3), trials=20
    )
    report = magmpm.design(study, folder=tmp_path)
    assert report.ended == "exhausted"
    assert 2 <= report.trials < 20
    assert "the search is exhausted" in report.why
    assert report.best["rms_m"] < 0.01 * study.scene.length
    again = magmpm.design(study, folder=tmp_path)
    assert (again.ended, again.trials) == ("exhausted", report.trials)
