"""Equilibria along time: the same answers as single equilibria, branches that end where theory says, files that can be resumed."""

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from reference.buckling import column
from reference.moving import moving_scene
from reference.solids import box, turned
from reference.stopped import switched_off
from scipy.integrate import simpson
from scipy.spatial.transform import Rotation

from magmpm import Motion, Result, Scene, SolveError, run
from magmpm.bodies.surface_mesh import pack_mesh
from magmpm.dynamics import quasi_static
from magmpm.model import build
from magmpm.results.file_names import MOTION, STEPS
from magmpm.rod.cosserat import rod_model
from magmpm.rod.kernels import frames_of, relax

ALONG = [{"magnetization": [1, 0, 0]}]


def scene(
    path: dict[str, Any],
    *,
    length: float = 20e-3,
    cells: int = 3,
    segments: Any = ALONG,
    **more: Any,
) -> Scene:
    """A catheter 2 mm thick; path: of solver.quasi_static."""
    silicone = {
        "shear_modulus": 120e3,
        "bulk_to_shear": 20.0,
        "density": 1100.0,
        "remanence": 138e-3,
    }
    catheter = {"length": length, "diameter": 2e-3, "material": "m", "segments": segments}
    given = {
        "body": {"catheter": catheter},
        "effects": {"magnetic_torque": {}},
        "materials": {"m": silicone},
    }
    given |= {
        "field": {"uniform": [0.0, 0.0, 3e-3], "over_time": {"ramp": {"duration": 1.0}}},
        "solver": {"quasi_static": path},
    }
    return moving_scene(**given | more, cells=cells)


def at_rest(of: Scene) -> Result:
    """The single equilibrium in the field at the end of the schedule."""
    return run(Scene.from_si({**of.to_si(), "solver": {"static": {}}}))


def test_a_ramp_ends_where_the_static_solve_does() -> None:
    """The same branch: the solves differ by their tolerance, 1e-11 of the energy, which is about 1e-6 of the length."""
    path = scene({"steps": 4}, effects={"magnetic_torque": {}, "gravity": {}})
    result = run(path)
    assert result.formulation == "quasi_static"
    assert result.converged
    assert len(result.steps) == 5
    assert result.jumps == []
    alone = at_rest(path)
    np.testing.assert_allclose(result.centreline, alone.centreline, atol=1e-6 * path.length)
    np.testing.assert_allclose(result.tip, alone.tip, atol=1e-6 * path.length)
    assert result.field == pytest.approx([0, 0, 3e-3])
    assert result.steps[-1]["stability"] == pytest.approx(
        alone.stability, rel=1e-5
    )  # what the iterations for it may leave
    first = result.steps[0]  # gravity acts in full from the first equilibrium on
    np.testing.assert_allclose(
        first["tip"], at_rest(path.with_field([0, 0, 1e-12])).tip, atol=1e-6 * path.length
    )


def test_energies_of_a_path_are_the_work_of_its_field(tmp_path: Path) -> None:
    """Of the greatest field B its share s acts, with the energy s e(s). In equilibrium the sum of all energies changes by e(s) ds alone,
    whatever the shape does (Hellmann and Feynman); Simpson's rule over nine frames is good to 1e-5 here.
    """
    path = scene({"steps": 8})
    run(path, folder=tmp_path)
    found = Motion.load(tmp_path).energies
    np.testing.assert_allclose(found["t"], np.linspace(0.0, 1.0, 9), atol=1e-12)
    parts = [found[name] for name in ("elastic", "magnetic_torque")]
    np.testing.assert_allclose(found["total"], sum(parts), rtol=1e-12)
    share = found["t"][1:]
    begin = 0.0  # of e: the straight body is magnetized across the field
    along = np.concatenate([[begin], found["magnetic_torque"][1:] / share])
    work = simpson(along, x=found["t"])
    assert found["total"][-1] - found["total"][0] == pytest.approx(work, rel=2e-5)
    alone = at_rest(path)
    assert found["total"][-1] == pytest.approx(alone.energy, rel=1e-6)


def frame_of_parts(angle: float, folder: Path) -> tuple[Motion, np.ndarray]:
    """The motion of an arm of two parts on a held block, all turned about (1, 2, 3) by an angle (rad); and the rotation."""
    axis = np.array([1.0, 2.0, 3.0])
    turn = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix()
    corners = [((-2, -2, -2), (0, 2, 2)), ((0, -1, -1), (3, 1, 1)), ((3, -1, -1), (6, 1, 1))]
    meshes = [
        {
            "mesh": pack_mesh(turned(box(*each), axis, angle)),
            "material": "m",
            "magnetization": (turn @ ([1.0, 0.0, 0.0] if k < 2 else [0.0, 0.6, 0.8])).tolist(),
            "clamp": k == 0,
        }
        for k, each in enumerate(corners)
    ]
    path = scene(
        {"steps": 2},
        body={"parts": {"unit": "mm", "meshes": meshes}},
        field={
            "uniform": (turn @ [1e-3, 2e-3, 6e-3]).tolist(),
            "over_time": {"ramp": {"duration": 1.0}},
        },
        cells=2,
    )
    run(path, folder=folder)
    return Motion.load(folder), turn


def test_frames_of_turned_parts_are_along_x_y_z(tmp_path: Path) -> None:
    """Remanence and magnetization turn with the body, and stress on both sides; files hold single precision."""
    straight, _ = frame_of_parts(0.0, tmp_path / "straight")
    oblique, turn = frame_of_parts(0.7, tmp_path / "oblique")
    np.testing.assert_allclose(oblique.remanence, straight.remanence @ turn.T, atol=1e-6 * 0.138)
    one, other = (motion[2] for motion in (straight, oblique))
    np.testing.assert_allclose(
        other.quantities["magnetisation"],
        one.quantities["magnetisation"] @ turn.T,
        atol=1e-5 * 0.138,
    )
    stress = one.quantities["cauchy_stress"].reshape(-1, 3, 3)
    wanted = turn @ stress @ turn.T
    found = other.quantities["cauchy_stress"].reshape(-1, 3, 3)
    assert np.abs(stress).max() > 100.0  # Pa
    np.testing.assert_allclose(found, wanted, atol=1e-4 * np.abs(stress).max())


def test_steps_in_between_are_single_equilibria_too() -> None:
    """In a field that turns each step is the equilibrium in the field of its time."""
    turning = {
        "uniform": [3e-3, 0.0, 0.0],
        "over_time": {"rotation": {"axis": [0, 1, 0], "frequency": -1.0, "turns": 0.25}},
    }
    path = scene({"at": [0.0, 0.1, 0.2]}, field=turning)
    result = run(path)
    for step in result.steps:
        alone = run(
            Scene.from_si(
                {**path.to_si(), "field": {"uniform": step["field"]}, "solver": {"static": {}}}
            )
        )
        np.testing.assert_allclose(step["tip"], alone.tip, atol=1e-6 * 20e-3)
    angle = 2 * np.pi * 0.2
    assert result.field == pytest.approx([3e-3 * np.cos(angle), 0, 3e-3 * np.sin(angle)])


def test_a_straight_catheter_buckles_at_its_load() -> None:
    """Perfectly straight in a field against its magnetization: found, located, and followed to the bent branch.

    Within 2 % here: with ten diameters of length, the clamp, which holds the section's shape, makes the body 1 % stiffer than a rod.
    """
    field = {"uniform": [-8e-3, 0.0, 0.0], "over_time": {"ramp": {"duration": 1.0}}}
    path = scene({"steps": 5}, field=field, cells=2)
    result = run(path)
    (jump,) = result.jumps
    assert jump["kind"] == "bifurcation"
    assert jump["field"] == pytest.approx(column(path).critical_field, rel=0.02)
    assert jump["field"] == pytest.approx(8e-3 * jump["time"], rel=1e-12)
    assert jump["within"] < 2e-3 * jump["time"]
    assert jump["released"] > 0
    before, after = (
        step
        for step in result.steps
        if step["time"] in (0.6, 0.8) or abs(step["time"] - 0.6) < 1e-12
    )
    assert abs(before["tip"][2]) < 1e-9
    assert after["tip"][2] > 0.3 * 20e-3
    alone = at_rest(path)
    np.testing.assert_allclose(
        result.tip, alone.tip, atol=1e-4 * 20e-3
    )  # along the neutral direction only to this (docs/design.md)
    assert "bifurcation" in " ".join(result.warnings)
    shares = [step["stability"] for step in result.steps]
    assert shares[0] == pytest.approx(1.0, abs=1e-6)
    assert shares[1] == pytest.approx(
        1 - 1.6 / (1e3 * jump["field"]), abs=0.02
    )  # linear in the load, to zero at the critical one


def test_a_column_followed_in_fine_steps_does_not_turn_back() -> None:
    """Steps of half a per cent end next to the critical load, where what a solve leaves along the mode is more than what the load does."""
    against = {"uniform": [-8e-3, 0.0, 0.0], "over_time": {"ramp": {"duration": 1.0}}}
    near = [0.3454 * (0.95 + 0.005 * k) for k in range(13)]
    data = scene({"at": [0.0, 0.1727, 0.31086, *near]}, length=50e-3, field=against).to_si()
    data["body"]["catheter"]["diameter"] = 2.2e-3
    data["materials"]["m"] |= {"shear_modulus": 200e3, "remanence": 80e-3, "density": 1900.0}
    path = Scene.from_si(data)
    (jump,) = run(path).jumps
    assert jump["kind"] == "bifurcation"
    assert jump["field"] == pytest.approx(column(path).critical_field, rel=0.01)


def strip(frames: list[dict[str, Any]], steps: int) -> Scene:
    """A strip in plane strain, which can only bend up and down, in a uniform field that keyframes give."""
    body = {
        "length": 20e-3,
        "width": 5e-3,
        "thickness": 1e-3,
        "material": "m",
        "plane_strain": True,
        "segments": ALONG,
    }
    return scene({"steps": steps}, field={"over_time": {"keyframes": frames}}, body={"strip": body})


# T: 1.3 times the buckling load, and a transverse field that is enough to press the strip to the other side
BX = 2.8e-3
BZ = 0.6e-3


@pytest.mark.slow
def test_a_bent_strip_snaps_through() -> None:
    """Buckled to one side and pressed to the other by a transverse field, it snaps at a limit point; back at the opposite one.

    The rod, followed from shape to shape, snaps at the same field within 3 % (clamp and grid of 3 cells).
    """
    frames = [{"time": k, "uniform": [-BX, 0.0, BZ * (-1) ** k]} for k in range(3)]
    path = strip(frames, 20)
    result = run(path)
    down, up = result.jumps
    assert down["kind"] == up["kind"] == "limit point"
    assert down["moved"] > 0.5 * path.length
    there = BZ * (1 - 2 * down["time"])
    back = BZ * (2 * (up["time"] - 1) - 1)
    assert there < 0 < back  # hysteresis
    assert back == pytest.approx(-there, rel=5e-3)  # symmetric
    assert there == pytest.approx(_rod_snaps(path), rel=0.03)


@pytest.mark.slow
def test_a_step_far_too_long_is_no_jump() -> None:
    """1 T across in one step, some 300 times what turns the body along the field: a step of a thousandth of it is still too long where the
    body begins to bend, and was taken for the end of a branch. It ends where smaller steps end, without one.
    """
    ramp = {"uniform": [0.0, 8e-3, 1.0], "over_time": {"ramp": {"duration": 1.0}}}
    long, short = (
        run(scene({"steps": steps}, length=40e-3, field=ramp, cells=2)) for steps in (1, 40)
    )
    assert [jump for jump in long.jumps if jump["time"] < 0.1] == []
    assert np.linalg.norm(long.tip - short.tip) < 1e-4 * 40e-3


def _rod_snaps(path: Scene) -> float:
    """The transverse field (T) at which the rod snaps from +z to -z."""
    rod = rod_model(path, elements=60, time=0.0)
    shape = np.zeros((len(rod.length) + 1, 4))
    shape[:, 0] = 1.0
    for field in np.linspace(BZ, -BZ, 401):
        now = replace(rod, field=np.tile([-BX, 0.0, field], (len(rod.length) + 1, 1)))
        relax(shape, now.loaded())
        if frames_of(shape, now.loaded())[0][-1, 2] < 0:
            return float(field)
    raise AssertionError("the rod did not snap")


def test_a_round_catheter_turns_about_its_axis_instead() -> None:
    """Nothing holds the plane of a buckled round rod: as soon as the transverse field points the other way, it is unstable to a turn."""
    frames = [
        {"time": 0.0, "uniform": [-7e-3, 0.0, 0.6e-3]},
        {"time": 1.0, "uniform": [-7e-3, 0.0, -0.6e-3]},
    ]
    result = run(scene({"steps": 5}, field={"over_time": {"keyframes": frames}}, cells=2))
    (jump,) = result.jumps
    assert jump["kind"] == "bifurcation"
    assert jump["time"] == pytest.approx(
        0.5, abs=0.1
    )  # cells are a little stiffer along diagonals: 2 of them hold it for a while
    assert result.tip[2] < -0.3 * 20e-3


SEGMENTS = [
    {"length": 6e-3},
    {"magnetization": [0, 0, 1], "length": 6e-3},
    {"magnetization": [1, 0, 0], "length": 8e-3},
]


def fed(**path: Any) -> Scene:
    """A catheter that is pushed out of a guide."""
    effects = {"magnetic_torque": {}, "gravity": {}, "feed": {"speed": 12e-3, "exit": 20.5e-3}}
    return scene(
        {"at": [0.0, 0.2, 0.4, 0.9], **path},
        segments=SEGMENTS,
        effects=effects,
        field={"uniform": [0.0, 0.0, 3e-3]},
    )


def test_what_is_fed_is_the_equilibrium_of_the_part_outside_the_guide() -> None:
    """At each length that of `Scene.inserted`, moved to the exit; straight while less than a diameter is out."""
    path = fed()
    result = run(path)
    assert [step["inserted"] for step in result.steps] == pytest.approx(
        [0.0, 1.9e-3, 4.3e-3, 10.3e-3]
    )
    assert result.steps[1]["tip"] == pytest.approx([22.4e-3, 0, 0])
    for step in result.steps[2:]:
        part = run(path.inserted(step["inserted"]))
        np.testing.assert_allclose(
            step["tip"], part.tip + np.array([20.5e-3, 0, 0]), atol=1e-6 * path.length
        )
    x = result.particle_position
    held = result.particle_reference[:, 0] < 20e-3 - 10.3e-3
    np.testing.assert_allclose(
        x[held], result.particle_reference[held] + [10.8e-3, 0, 0], atol=1e-15
    )
    np.testing.assert_allclose(result.particle_det_F[held], 1.0)
    assert result.centreline[-1, 1:] == pytest.approx(
        result.tip, abs=2e-5
    )  # the axis at the end, and the mean of the end's face


def in_a_bend(steps: int) -> Scene:
    """A catheter that is pushed along a vessel which bends by 30 degrees, and lies against its wall from the bend on."""
    path = [[20e-3, 0, 0], [30e-3, 0, 0], [40e-3, 0, 2.5e-3], [46e-3, 0, 6e-3]]
    effects = {
        "magnetic_torque": {},
        "feed": {"speed": 12e-3, "exit": 20.5e-3},
        "walls": {"tube": {"radius": 1.8e-3, "path": path}},
    }
    return scene(
        {"steps": steps, "duration": 1.0},
        cells=2,
        effects=effects,
        field={"uniform": [0.0, 0.0, 3e-3]},
    )


@pytest.mark.slow
def test_a_catheter_is_fed_along_a_wall_in_few_steps() -> None:
    """Sought from how the last two equilibria went on, those beside a wall need no steps between; other steps lead to the same end.

    From the last equilibrium alone they took 20 times as many.
    """
    few, many = (run(in_a_bend(steps)) for steps in (5, 20))
    assert few.contacts["walls"]["count"] > 0, "it lies against the wall"
    assert sum(step["iterations"] for step in few.steps) < 100
    np.testing.assert_allclose(few.tip, many.tip, atol=1e-6 * 20e-3)


def test_a_fed_path_that_stops_between_two_equilibria_keeps_the_last(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It stops where another length is outside, whose grid is not that of the last: its state once could not be told (171: 94)."""
    path = fed(at=[0.5, 0.6, 0.9])
    switched_off(monkeypatch, 0.75)
    with pytest.raises(SolveError, match=r"t = 0\.9 s") as failed:
        run(path)
    assert isinstance(failed.value.state, Result)
    assert failed.value.state.time == 0.6
    whole = run(fed(at=[0.5, 0.6]))
    np.testing.assert_array_equal(failed.value.state.particle_position, whole.particle_position)


def test_the_particles_of_a_fed_part_move_as_its_own_do() -> None:
    """The whole catheter's particles show the same deformation as those of the part's own grid: the mean of det F, the farthest point."""
    path = fed(at=[0.0, 0.9])
    whole = run(path)
    part = run(path.inserted(10.3e-3))
    free = whole.particle_reference[:, 0] > 20e-3 - 10.3e-3
    assert whole.particle_position[free, 2].max() == pytest.approx(
        part.particle_position[:, 2].max(), abs=0.05e-3
    )
    means = [
        np.average(np.abs(one.particle_det_F - 1)[some], weights=build(of).particles.volume[some])
        for one, of, some in ((whole, path, free), (part, path.inserted(10.3e-3), slice(None)))
    ]
    assert means[0] == pytest.approx(means[1], rel=0.1)  # the particles lie elsewhere


def test_a_path_that_fails_keeps_its_frames(tmp_path: Path) -> None:
    """A dipole that comes too near: the frames up to then stay, and the last good state is the result."""
    moves = [{"time": 0.0, "move": [0.0, 0.0, 0.0]}, {"time": 1.0, "move": [0.0, 0.0, -30e-3]}]
    field = {
        "dipole": [{"position": [18e-3, 0.0, 30e-3], "moment": [0.0, 0.0, 0.02]}],
        "over_time": {"keyframes": moves},
    }
    path = scene(
        {"steps": 10}, field=field, effects={"magnetic_torque": {}, "magnetic_force": {}}, cells=2
    )
    with pytest.raises(SolveError, match=r"equilibrium at t = 0\.\d* s: .*dipole") as caught:
        run(path, folder=tmp_path)
    state = caught.value.state
    assert isinstance(state, Result)
    assert not state.converged
    motion = Motion.load(tmp_path)
    assert 3 < len(motion) < 11
    assert len(state.steps) == len(motion)
    assert state.time == pytest.approx(motion.times[-1])
    with (tmp_path / STEPS).open(newline="") as stream:
        assert len(list(csv.DictReader(stream))) == len(motion)


def hurried(of: Scene, steps: int) -> Scene:
    """The scene with so few of Newton's steps, which a file can't say of a path."""
    few = of.solver.static.model_copy(update={"field_steps": 4, "max_steps": steps})
    return of.model_copy(update={"solver": of.solver.model_copy(update={"static": few})})


def test_a_path_without_a_first_equilibrium_keeps_what_its_load_reached(tmp_path: Path) -> None:
    """A ramp of the load that ends on its way: its last good state takes the place of the motion that was there."""
    good = scene({"steps": 1}, cells=2)
    run(good, folder=tmp_path)
    assert (tmp_path / MOTION).exists()
    field = {
        "uniform": [-25e-3, 0.0, 2e-3],
        "over_time": {"ramp": {"duration": 1.0, "begin": 1.0, "end": 0.5}},
    }
    bad = Scene.from_si({**good.to_si(), "field": field})
    with pytest.raises(
        SolveError, match=r"equilibrium at t = 0 s: at .* % of the load: .*; to try: a weaker field"
    ) as caught:
        run(hurried(bad, 3), folder=tmp_path)
    state = caught.value.state
    assert isinstance(state, Result)
    assert 0.1 < state.load_share < 1.0
    reached = {"uniform": [state.load_share * b for b in (-25e-3, 0.0, 2e-3)]}
    there = run(Scene.from_si({**bad.to_si(), "field": reached, "solver": {"static": {}}}))
    np.testing.assert_allclose(state.tip, there.tip, atol=1e-5 * good.length)
    assert (state.converged, state.steps, state.stability) == (False, [], None)
    assert not (tmp_path / MOTION).exists()
    saved = Result.load(tmp_path)
    assert saved.failure == state.failure != ""
    assert not any(
        "quasi_static" in remedy.words for remedy in caught.value.remedies
    )  # more of them change nothing at the first
    np.testing.assert_array_equal(saved.particle_position, state.particle_position)


@pytest.mark.slow
def test_a_round_rod_buckles_once_and_then_turns_freely() -> None:
    """Beyond Euler's load a round rod may turn about its axis: an eigenvalue that is rounding, whose trend is no second critical load.

    What is followed in its place grows from the critical load on: an eigenvalue that falls linearly before a bifurcation rises twice as
    fast behind it.
    """
    against = {
        "uniform": [-0.000_179_562_364_95, 0.0, 0.0],
        "over_time": {"ramp": {"duration": 1.0}},
    }
    data = scene(
        {"at": [0.0, 0.75, 0.7625, 0.775, 0.7875]}, length=60e-3, cells=2, field=against
    ).to_si()
    data["body"]["catheter"]["diameter"] = 1e-3
    data["materials"]["m"]["density"] = 1882.0
    state = quasi_static.follow(Scene.from_si(data))
    assert [jump["kind"] for jump in state.jumps] == ["bifurcation"]
    branch = state.branch
    assert branch is not None
    lowest = branch.now.lowest
    free = branch._near.definite.free(branch.energy_at(state.time))
    assert lowest is not None
    beyond = state.time / state.jumps[0]["time"] - 1.0
    # linear to first order in what is beyond, 3 %, and the lumped mass of one mode is not that of the other
    assert lowest / free == pytest.approx(2.0 * beyond, rel=0.2)
