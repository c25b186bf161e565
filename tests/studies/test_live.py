"""A scene at hand: its sliders, what they make of it, and the file that gives the same shape again."""

import csv
import json
import signal
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from magmpm import load_scene, run
from magmpm.compiled.process import Process
from magmpm.errors import InputError
from magmpm.scene import Scene
from magmpm.statics.neighbors import Neighbors
from magmpm.studies.explore.live import (
    Preview,
    SolverProcess,
    changed,
    checked,
    controls,
    ready,
    saved,
)
from magmpm.studies.explore.tip_map import (
    MARKS,
    _along,
    in_plane,
    map_tips,
    on_rays,
    rod_tips,
    solved,
)
from magmpm.studies.problem.variables import VaryNumber

ROOT = Path(__file__).resolve().parents[2]
SCENES = ROOT / "data" / "scenes"
FIVE = SCENES / "five_segments.yaml"
TURNS = {  # of each scene, values of sliders
    "five_segments": {
        "field.uniform[0]": -2.5,
        "field.uniform[2]": 6.125,
        "body.catheter.segments[1].magnetization.azimuth": 47.0,
        "body.catheter.segments[4].magnetization.elevation": 12.5,
    },
    "three_segments_3d": {
        "inserted": 17.3,
        "field.uniform[1]": 4.0,
        "body.catheter.segments[0].magnetization.azimuth": -30.0,
    },
    "pulled_by_magnet": {"field.magnet[0].position[0]": 80.0, "field.magnet[0].position[2]": 25.0},
    "snap_through": {"body.strip.segments[0].magnetization.azimuth": 175.0},
    "zhao_plane_strain": {"body.strip.segments[0].magnetization.elevation": 30.0},
}


def sliders(scene: Scene) -> dict:
    return {control.id: control for control in controls(scene)}


@pytest.mark.parametrize(
    "name",
    sorted(path.relative_to(SCENES).with_suffix("").as_posix() for path in SCENES.rglob("*.yaml")),
)
def test_untouched_sliders_change_nothing(name: str) -> None:
    """Their values are the scene's, within their ranges, in every scene at rest that there is."""
    scene = load_scene(SCENES / f"{name}.yaml")
    if scene.in_time:
        return
    known = sliders(scene)
    for control in known.values():
        assert control.low <= control.value <= control.high
    assert changed(scene, known, {control.id: control.value for control in known.values()}) == scene


@pytest.mark.parametrize("name", TURNS)
def test_the_saved_scene_is_the_one_shown(name: str, tmp_path: Path) -> None:
    """It is read back as the same scene (its hash: all that decides the answer, to 12 digits), from a folder elsewhere."""
    path = SCENES / f"{name}.yaml"
    scene = load_scene(path)
    known = sliders(scene)
    shown = changed(scene, known, TURNS[name])
    assert shown.hash() != scene.hash()
    again = saved(scene, path, shown, known, TURNS[name], tmp_path / "deep" / "view-1.yaml")
    assert again.hash() == shown.hash()
    assert (again.body, again.field) == (shown.body, shown.field)  # to the last bit


MORE = [
    VaryNumber(of="materials.magnetic silicone.remanence", min="50 mT", max="200 mT"),
    VaryNumber(of="resolution.cells_across", min=2, max=6),
]


def test_any_number_can_have_a_slider(tmp_path: Path) -> None:
    """By its address, in the unit of its bounds; whole numbers stay whole. What is saved is what is shown."""
    scene = load_scene(FIVE)
    known = {control.id: control for control in controls(scene, MORE)}
    values = {"materials.magnetic silicone.remanence": 99.5, "resolution.cells_across": 3.0}
    assert [known[name].value for name in values] == [138.0, 4]
    assert {known[name].group for name in values} == {"Numbers"}
    assert changed(scene, known, {name: known[name].value for name in values}) == scene
    shown = changed(scene, known, values)
    assert shown.materials["magnetic silicone"].remanence == pytest.approx(0.0995, rel=1e-15)
    assert shown.resolution.cells_across == 3
    again = saved(scene, FIVE, shown, known, values, tmp_path / "view-1.yaml")
    assert again.materials == shown.materials


def test_a_number_has_one_slider() -> None:
    """With the bounds that are asked for: two of one name would show different values of it."""
    scene = load_scene(FIVE)
    found = controls(scene, [VaryNumber(of="field.uniform[2]", min="-50 mT", max="50 mT")])
    assert [c.id for c in found] == [c.id for c in controls(scene)]
    assert {c.high for c in found if c.id == "field.uniform[2]"} == {50.0}


@pytest.mark.parametrize(
    ("number", "told"),
    [
        ({"of": "materials.magnetic silicone.remanense"}, "did you mean"),
        ({"of": "field.uniform[2]", "min": "1 mm", "max": "2 mm"}, "the scene refuses it"),
        ({"of": "field.uniform"}, "the scene refuses it"),
    ],
)
def test_a_slider_of_no_number_is_refused(number: dict[str, str], told: str) -> None:
    with pytest.raises(InputError) as error:
        controls(load_scene(FIVE), [VaryNumber(**{"min": "1 mT", "max": "2 mT"} | number)])
    assert told in str(error.value)


def test_one_turned_number_leaves_the_others_words(tmp_path: Path) -> None:
    """Settings that were not changed stay in the file as they were, with their units."""
    scene = load_scene(FIVE)
    known = sliders(scene)
    values = {"field.uniform[2]": 5.0}
    saved(scene, FIVE, changed(scene, known, values), known, values, tmp_path / "view.yaml")
    text = (tmp_path / "view.yaml").read_text(encoding="utf-8")
    for words in ("120 kPa", "azimuth: 30 deg", "0 mT, 6 mT, 5 mT", "[0.2, 1, -1]"):
        assert words in text, words


def test_chosen_effects_and_cells_are_written(tmp_path: Path) -> None:
    """With `effects: auto` and a requested error the file has what is shown: the effects that were chosen, and the cells."""
    text = FIVE.read_text(encoding="utf-8")
    text = (
        text[: text.index("      - magnetization: {azimuth: 30 deg")] + text[text.index("field:") :]
    )  # one segment: none act on others
    begin = text.index("effects:")
    end = text.index("solver:")
    path = tmp_path / "auto.yaml"
    path.write_text(
        text[:begin] + "effects: auto\n" + text[end:].replace("{cells_across: 4}", "{error: 1 %}"),
        encoding="utf-8",
    )
    scene = ready(load_scene(path), 3)
    again = saved(scene, path, scene, sliders(scene), {}, tmp_path / "view.yaml")
    assert again.hash() == scene.hash()
    assert again.resolution.cells_across == 3


@pytest.mark.parametrize(
    "values",
    [
        None,
        [],
        {"nonsense": 1.0},
        {"field.uniform[0]": "1"},
        {"field.uniform[0]": float("nan")},
        {"field.uniform[0]": True},
    ],
)
def test_wrong_values_are_refused(values: object) -> None:
    """Whatever a page may send."""
    with pytest.raises(InputError):
        checked(sliders(load_scene(FIVE)), values)


def test_what_the_scene_does_not_allow_is_refused() -> None:
    """A number can be typed beyond its slider's range: the scene's own rules decide."""
    scene = load_scene(FIVE)
    with pytest.raises(InputError, match="uniform"):
        changed(scene, sliders(scene), {"field.uniform[0]": 1e9})


def test_motions_of_free_bodies_have_no_rest() -> None:
    """With what to do about it."""
    scene = load_scene(SCENES / "gallery" / "walking_strip.yaml")
    data = {**scene.to_si(), "solver": {"static": {}}}
    data["effects"] = {"magnetic_torque": {}}
    data["field"] = {"uniform": [0.0, 0.0, 1e-3]}
    with pytest.raises(InputError, match="clamp"):
        ready(Scene.from_si(data))


@pytest.mark.slow
def test_a_preview_is_near_the_solution_and_the_solver_finds_what_run_finds() -> None:
    """One process, two solves: the second starts from the first, and is run's answer to what solves from different starts agree to.
    The rod dressed by the first solve is within 0.5 % of L of the second (rod alone: up to 1 %)."""
    scene = load_scene(FIVE).with_cells(2)
    known = sliders(scene)
    preview = Preview()
    solver = SolverProcess()
    try:
        first = solver.solved(scene)
        assert first.result is not None
        preview.learn(first.result)
        near = changed(scene, known, {"field.uniform[0]": 1.0})
        second = solver.solved(near)
        alone = run(near)
        np.testing.assert_allclose(second.result.tip, alone.tip, atol=2e-6 * scene.length)
        shape = preview.shape(near)
        assert np.linalg.norm(shape.axis[-1] - alone.tip) < 5e-3 * scene.length
        solver.process.process.kill()
        lost = solver.solved(near)
        assert "was restarted" in lost.failure
        assert solver.solved(near).result is not None
    finally:
        solver.close()


# The map of tips: its tips are those of runs, its marks those of shapes that are not sure, its files say so


SCENE = ROOT / "data" / "scenes" / "axial_transverse.yaml"


def test_rays_cover_the_sphere_in_equal_steps() -> None:
    """1 000 fields: 125 directions whose mean vanishes, eight strengths each."""
    fields = on_rays(1000, 16e-3)
    assert fields.values.shape == (1000, 3)
    assert fields.shape == (125, 8)
    rays = fields.values.reshape(125, 8, 3)
    np.testing.assert_allclose(
        np.linalg.norm(rays, axis=2), np.tile(2e-3 * np.arange(1, 9), (125, 1)), rtol=1e-12
    )
    directions = rays[:, -1] / 16e-3
    assert np.abs(directions.mean(axis=0)).max() < 0.02
    # Covered evenly: second moments of the sphere are 1/3.
    np.testing.assert_allclose(directions.T @ directions / 125, np.eye(3) / 3, atol=0.01)


def test_a_planes_rows_run_to_and_fro() -> None:
    """Every field of a path is next to the one before it; eight paths at most. The first component changes within a row."""
    fields = in_plane(100, 9e-3, "xz")
    assert len(fields.paths) == 8
    assert sorted(k for path in fields.paths for k in path) == list(range(100))
    for path in fields.paths:
        np.testing.assert_allclose(
            np.linalg.norm(np.diff(fields.values[list(path)], axis=0), axis=1), 2e-3, rtol=1e-9
        )
    assert not fields.values[:, 1].any()
    np.testing.assert_allclose(
        fields.values.reshape(10, 10, 3)[3],
        [[b, 0.0, -3e-3] for b in np.linspace(-9e-3, 9e-3, 10)],
        atol=1e-15,
    )


@pytest.mark.parametrize(
    ("make", "place"),
    [
        (lambda: on_rays(0, 1e-3), "--fields"),
        (lambda: on_rays(10, 0.0), "--max"),
        (lambda: on_rays(10, 1e-3, 11), "--strengths"),
        (lambda: in_plane(10, 1e-3, "xx"), "--plane"),
        (lambda: in_plane(10, 1e-3, "xw"), "--plane"),
    ],
)
def test_wrong_fields_are_refused(make, place: str) -> None:
    with pytest.raises(InputError, match=place):
        make()


@pytest.mark.slow
def test_tips_are_those_of_runs(tmp_path: Path) -> None:
    """Every tip of a small map is that of `magmpm run`, to what solves from different starts agree to (1e-6 L); the files say so."""
    scene = load_scene(SCENE).with_cells(2)
    found = map_tips(scene, on_rays(12, 6e-3, 3))
    for field, tip, stability in zip(found.fields.values, found.tip, found.stability, strict=True):
        alone = run(scene.with_field(field))
        np.testing.assert_allclose(tip, alone.tip, atol=2e-6 * scene.length)
        assert alone.stability is not None
        assert abs(stability - alone.stability) < 1e-3
    assert found.counts() == {**dict.fromkeys(MARKS, 0), "sure": 12}
    table, numbers = found.save(tmp_path)
    rows = list(csv.DictReader(table.read_text(encoding="utf-8").splitlines()))
    kept = json.loads(numbers.read_text(encoding="utf-8"))
    np.testing.assert_allclose(
        [[float(row[f"{a}_mm"]) for a in "xyz"] for row in rows],
        1e3 * found.tip,
        rtol=1e-5,
        atol=1e-9,
    )
    np.testing.assert_allclose(kept["tip_m"], found.tip)


@pytest.mark.slow
def test_no_soft_mode_is_lost_on_a_symmetric_way() -> None:
    """While the body bends in one plane only, its lowest mode changes from one in the plane to one out of it, or to twist. Modes that were
    followed from field to field never learned of those of another symmetry: at [0, 0, 5.7] mT the least stability was 15 % too large.
    """
    scene = ready(load_scene(SCENE), 2)
    fields = in_plane(225, 20e-3, "xz")
    path = next(path for path in fields.paths if 142 in path)
    way = [(k, fields.values[k].tolist()) for k in path[: path.index(142) + 1]]
    last = list(_along(scene, way))[-1]
    alone = run(scene.with_field(way[-1][1]))
    assert alone.stability is not None
    assert abs(last.stability - alone.stability) < 1e-4


@pytest.mark.slow
def test_a_process_that_dies_costs_one_field(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another process takes up the rest of its path, and finds the same tips."""
    scene = load_scene(SCENE).with_cells(2)
    begun = list[Process]()

    start = Process.start
    monkeypatch.setattr(Process, "start", lambda self: (start(self), begun.append(self)))
    path = [(k, [0.0, 0.0, 1e-3 * k]) for k in range(1, 6)]
    whole = list(solved(scene, [path], 1))
    tips = solved(scene, [path], 1)
    found = [next(tips)]
    begun[-1].process.send_signal(signal.SIGSTOP)  # so that it does not finish before it is killed
    begun[-1].process.kill()
    found += list(tips)
    assert sorted(one.index for one in found) == [1, 2, 3, 4, 5]
    lost = [one for one in found if one.tip is None]
    assert len(lost) <= 1
    assert all("ended by SIGKILL" in one.failure for one in lost)
    assert len(found) - len(lost) >= 4
    for one in found:
        if one.tip is not None:
            np.testing.assert_allclose(one.tip, whole[one.index - 1].tip, atol=2e-6 * scene.length)


@pytest.mark.slow
def test_a_rod_against_the_field_has_two_shapes() -> None:
    """Magnetized along its axis, in a field against it past the critical load: turned up or down is a matter of history. Below it, and
    along the field, there is one shape. Critical load of a clamped rod under a following compass torque: B A Br L^2/(mu0 E I) = pi^2/4.
    """
    scene = load_scene(SCENE).with_cells(2)
    E = 2.951 * 120e3
    r = 2e-3
    critical = (
        (np.pi**2 / 4)
        * E
        * (np.pi * r**4 / 4)
        * 4e-7
        * np.pi
        / (np.pi * r**2 * 0.1 * scene.length**2)
    )
    fields = np.array(
        [
            [x * critical, 0.0, z * critical]
            for x in (-1.6, -0.5, 0.5)
            for z in (-0.2, -0.1, 0.0, 0.1, 0.2)
        ]
    )
    rods = rod_tips(scene, fields, len(fields))
    assert np.isfinite(rods.tip).all()
    two = np.isfinite(rods.other).all(axis=1).reshape(3, 5)
    assert two[0, 2]
    assert not two[1:].any()
    # turned to the other side by as much; a round rod is free to turn about its axis
    own = rods.tip[2]
    other = rods.other[2]
    np.testing.assert_allclose(
        [other[0], np.hypot(*other[1:])], [own[0], np.hypot(*own[1:])], atol=1e-3 * scene.length
    )
    assert other[1:] @ own[1:] < -0.9 * (own[1:] @ own[1:])


def test_scenes_without_a_map_are_refused(told) -> None:
    """With what to do about it, and exit status 2."""
    for name, words in [
        ("pulled_by_magnet", "uniform fields"),
        ("fed_into_vessel", "at rest"),
        ("gallery/gripper", "shapes at rest"),
    ]:
        told("map", ROOT / f"data/scenes/{name}.yaml", status=2, says=words)


# Starts of a solve from its neighbors: interpolation, exact for answers linear in the rod's curvature


RNG = np.random.default_rng(3)
MAP = RNG.normal(
    size=(6, 4, 6)
)  # from six numbers of a rod to what is added (4 planes, 6 coefficients)


def rod(numbers: np.ndarray) -> Any:
    """A rod of length 2 whose curvature is linear along it, by six numbers."""
    s = np.linspace(0.0, 2.0, 61)
    return SimpleNamespace(
        s=s, curvature=np.stack([s**0, s - 1.0], axis=1) @ numbers.reshape(2, 3) / 3
    )


def added(numbers: np.ndarray) -> np.ndarray:
    return np.asarray(np.einsum("k,kpm->pm", numbers, MAP))


def taught(count: int, most: int | None = None) -> Neighbors:
    neighbors = Neighbors(most)
    for numbers in np.random.default_rng(5).normal(size=(count, 6)):
        neighbors.expected(rod(numbers))
        neighbors.learn(added(numbers))
    return neighbors


def test_nothing_is_expected_before_something_is_known() -> None:
    neighbors = Neighbors()
    assert neighbors.expected(rod(np.ones(6))) is None
    neighbors.learn(np.zeros((4, 6)))  # of a solve that did not begin at its rod
    assert neighbors.expected(rod(np.ones(6))) is None


def test_what_is_known_is_expected_again() -> None:
    """To the nugget, 1e-8 of the variance, times what the inverse of the covariance makes of it."""
    first = np.random.default_rng(5).normal(size=(12, 6))[4]
    np.testing.assert_allclose(
        taught(12).expected(rod(first)), added(first), atol=1e-5 * np.abs(MAP).max()
    )


@pytest.mark.parametrize(("far", "share"), [(0.5, 0.25), (0.25, 0.25), (3.0, 0.75)])
def test_what_is_linear_is_found(far: float, share: float) -> None:
    """Forty solves tell six numbers: among them a new one is expected with less than a quarter of the error of the nearest known one. Far
    beyond all of them, where it goes on along a plane, with less than three quarters."""
    known = np.random.default_rng(5).normal(size=(40, 6))
    new = far * np.random.default_rng(6).normal(size=6)
    nearest = known[np.argmin(np.linalg.norm(known - new, axis=1))]
    found = taught(40).expected(rod(new))
    assert found is not None
    assert np.linalg.norm(found - added(new)) < share * np.linalg.norm(added(nearest) - added(new))


def test_another_grid_begins_anew_and_the_oldest_are_forgotten() -> None:
    neighbors = taught(12, most=5)
    first = np.random.default_rng(5).normal(size=(12, 6))[0]
    forgotten = neighbors.expected(rod(first))
    assert forgotten is not None
    assert np.abs(forgotten - added(first)).max() > 1e-3
    neighbors.learn(np.ones((3, 3)))
    again = neighbors.expected(rod(first))
    assert again.shape == (3, 3)
