"""Insertion: the path, the rods' trajectory, measures of a trajectory, and what a study keeps."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest

from magmpm import Scene
from magmpm.studies.evaluate.trajectory import EXIT_WEIGHT, STATIONS, Insertion
from magmpm.studies.problem.path import Path
from magmpm.studies.problem.study import Study
from magmpm.studies.problem.variables import Vary, VaryField, VaryMagnetization
from magmpm.studies.rods.rod_trajectory import RodDesign, RodTrajectory
from magmpm.studies.search.search_space import SearchSpace

RADIUS = 0.04
MAX = 10e-3


def arc(length=30e-3, rows=31):
    """A circle of RADIUS in the x-z plane, rows [s, x, y, z]."""
    s = np.linspace(0.0, length, rows)
    return np.column_stack([s, RADIUS * np.sin(s / RADIUS), 0 * s, RADIUS * (1 - np.cos(s / RADIUS))])


def catheter():
    return Scene.from_si(
        {
            "name": "three",
            "materials": {"silicone": {"shear_modulus": 120e3, "bulk_to_shear": 20, "density": 1882.0, "remanence": 0.138}},
            "body": {
                "catheter": {"length": 30e-3, "diameter": 3e-3, "material": "silicone", "segments": 3 * [{"magnetization": [1, 0, 0]}]}
            },
            "effects": {"magnetic_torque": {}, "gravity": {}},
            "resolution": {"cells_across": 2},
        }
    )


def insertion(depths=(10e-3, 20e-3, 30e-3)):
    vary = Vary(magnetization=VaryMagnetization(), field=VaryField(max=MAX, at="each depth"))
    study = Study("arc", "arc", catheter(), arc(), vary, 3, "gauss-newton", 1, None, depths=depths)
    found = Insertion.of(study, SearchSpace.of(study))
    assert found is not None
    return found


def test_a_path_follows_its_rows_and_leaves_along_x():
    path = Path(arc())
    s = np.linspace(0, 30e-3, 77)
    exact = np.stack([RADIUS * np.sin(s / RADIUS), 0 * s, RADIUS * (1 - np.cos(s / RADIUS))], axis=1)
    np.testing.assert_allclose(path.at(s), exact, atol=1e-8)  # cubic: the fourth power of 1 mm over the radius
    assert path.smallest_radius() == pytest.approx(RADIUS, rel=1e-3)


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_a_flattened_path_has_that_share_of_the_curvature(share):
    """In its plane: frames that turned about the path would lead out of it."""
    flat = Path(arc()).flattened(share)
    assert flat.length == pytest.approx(30e-3)
    angle = share * 30e-3 / RADIUS
    end = [30e-3 * np.sinc(angle / np.pi), 0.0, 0.0 if share == 0 else RADIUS / share * (1 - np.cos(angle))]
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
    assert state is not None
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
    assert made is not None
    depths = tuple(
        type(depth)(depth.rod, depth.segments, depth.place, position, depth.roots)
        for depth, position in zip(rods.depths, made.positions, strict=True)
    )
    known = RodTrajectory(depths, rods.max_field, rods.movable, rods.count)
    near = d + np.array([0.1, -0.1, 0.1])
    near /= np.linalg.norm(near, axis=1)[:, None]
    state = known.settled(near, 0.9 * fields, None)
    assert state is not None
    assert np.sqrt(state.squares) > 1e-4
    design = known.least_squares(RodDesign(near, 0.9 * fields, 1.0, state), 60)
    assert design.value < 1e-6


def fake(found, depth, shift):
    """A result whose axis is the path, shifted along y."""
    s = np.linspace(0.0, depth, 61)
    axis = found.path.at(s) + np.array([0.0, shift, 0.0])
    return SimpleNamespace(
        centreline=np.column_stack([s, axis]),
        tip=axis[-1],
        iterations=3,
        converged=True,
        stability=0.5,
        particle_segment=np.array([0]),
        segment_center=axis[:1],
        segment_remanence=np.ones((1, 3)),
    )


def test_measures_are_what_they_say():
    """Each depth counts the same, whatever its length; the exit is the last depth's tip."""
    found = insertion()
    params = found.parameters(RodDesign(np.tile([1.0, 0, 0], (3, 1)), MAX * np.array([[0.5, 0, 0], [0.5, 0, 0.3], [0.5, 0, 0]]), 0.0))
    results = [fake(found, depth, shift) for depth, shift in zip(found.study.depths, (1e-3, 2e-3, 2e-3), strict=True)]
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
    params = found.parameters(RodDesign(np.tile([1.0, 0, 0], (3, 1)), np.zeros((3, 3)), 0.0))
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
    scenes = found.scenes(found.parameters(RodDesign(d, fields, 0.0)))
    assert [len(scene.regions()) for scene in scenes] == [1, 2, 3]
    for scene, field, count in zip(scenes, fields, (1, 2, 3), strict=True):
        np.testing.assert_allclose(scene.field.uniform, field, atol=1e-12)
        np.testing.assert_allclose([region.magnetization for region in scene.regions()], d[3 - count :], atol=1e-9)


def test_the_stored_model_is_the_derivative_of_the_gaps():
    """Residuals and Jacobian against differences of solved trajectories, at two cells across."""
    from magmpm import run, sensitivities

    found = insertion((12e-3, 30e-3))
    design = RodDesign(np.tile([0.8, 0, 0.6], (3, 1)), MAX * np.array([[0.4, 0, 0.3], [0.5, 0.1, 0.2]]), 0.0)
    x = found.space.embedded(found.parameters(design))
    params = found.space.parameters_at(x)
    outcome = found.evaluate(run, sensitivities, params, None)
    assert outcome.reason is None
    residuals, jacobian = np.array(outcome.model["residuals"]), np.array(outcome.model["jacobian"])

    def gaps(params):
        results = [run(scene, start=start) for scene, start in zip(found.scenes(params), found.starts(params), strict=True)]
        return found._model(results, [np.zeros((3 * STATIONS, 1))] * 2)["residuals"]

    raw = np.array(gaps(params))
    assert residuals @ residuals == pytest.approx(raw @ raw, rel=1e-6)
    assert raw @ raw == pytest.approx(outcome.rms**2 + EXIT_WEIGHT * outcome.tip_error**2, rel=1e-3)
    for k, step in ((2, 1e-4), (10, 1e-6), (14, 1e-6)):
        up, down = x.copy(), x.copy()
        up[k] += step
        down[k] -= step
        squares = [np.sum(np.square(gaps(found.space.parameters_at(v)))) for v in (up, down)]
        moved = (found.space.embedded(found.space.parameters_at(up)) - found.space.embedded(found.space.parameters_at(down))) / (2 * step)
        slope = (squares[0] - squares[1]) / (2 * step)
        assert slope == pytest.approx(2 * residuals @ jacobian @ moved, rel=2e-3)


def test_a_depth_that_fails_costs_the_penalty_and_is_named():
    from magmpm.errors import SolveError

    found = insertion()

    def solve(scene, *, start):
        if scene.length > 15e-3:
            raise SolveError("no equilibrium")
        return fake(found, scene.length, 0.0)

    params = found.parameters(RodDesign(np.tile([1.0, 0, 0], (3, 1)), np.zeros((3, 3)), 0.0))
    outcome = found.evaluate(solve, None, params, None)
    assert outcome.result is None
    assert outcome.rms == found.space.scene.length
    assert outcome.reason == "at 20 mm: no equilibrium"
