"""A scene at hand: its sliders, what they make of it, and the file that gives the same shape again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from magmpm import load_scene, run
from magmpm.errors import InputError
from magmpm.scene import Scene
from magmpm.studies.explore.live import Preview, Shape, Solver, changed, checked, controls, ready, saved

ROOT = Path(__file__).resolve().parents[2]
SCENES = ROOT / "data" / "scenes"
FIVE = SCENES / "five_segments.yaml"
TURNS = {  # of each scene, values of sliders
    "five_segments": {"field.x": -2.5, "field.z": 6.125, "direction.1.azimuth": 47.0, "direction.4.elevation": 12.5},
    "three_segments_3d": {"inserted": 17.3, "field.y": 4.0, "direction.0.azimuth": -30.0},
    "pulled_by_magnet": {"magnet.0.x": 80.0, "magnet.0.z": 25.0},
    "snap_through": {"direction.0.azimuth": 175.0},
    "zhao_plane_strain": {"direction.0.elevation": 30.0},
}


def sliders(scene: Scene) -> dict:
    return {control.id: control for control in controls(scene)}


@pytest.mark.parametrize("name", sorted(path.relative_to(SCENES).with_suffix("").as_posix() for path in SCENES.rglob("*.yaml")))
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


def test_one_turned_number_leaves_the_others_words(tmp_path: Path) -> None:
    """Settings that were not changed stay in the file as they were, with their units."""
    scene = load_scene(FIVE)
    known = sliders(scene)
    values = {"field.z": 5.0}
    saved(scene, FIVE, changed(scene, known, values), known, values, tmp_path / "view.yaml")
    text = (tmp_path / "view.yaml").read_text(encoding="utf-8")
    for words in ("120 kPa", "azimuth: 30 deg", "0 mT, 6 mT, 5 mT", "[0.2, 1, -1]"):
        assert words in text, words


def test_chosen_effects_and_cells_are_written(tmp_path: Path) -> None:
    """With `effects: auto` and a requested error the file has what is shown: the effects that were chosen, and the cells."""
    text = FIVE.read_text(encoding="utf-8")
    begin, end = text.index("effects:"), text.index("solver:")
    path = tmp_path / "auto.yaml"
    path.write_text(text[:begin] + "effects: auto\n" + text[end:].replace("{cells_across: 4}", "{error: 1 %}"), encoding="utf-8")
    scene = ready(load_scene(path), 3)
    again = saved(scene, path, scene, sliders(scene), {}, tmp_path / "view.yaml")
    assert again.hash() == scene.hash()
    assert again.resolution.cells_across == 3


@pytest.mark.parametrize("values", [None, [], {"nonsense": 1.0}, {"field.x": "1"}, {"field.x": float("nan")}, {"field.x": True}])
def test_wrong_values_are_refused(values: object) -> None:
    """Whatever a page may send."""
    with pytest.raises(InputError):
        checked(sliders(load_scene(FIVE)), values)


def test_what_the_scene_does_not_allow_is_refused() -> None:
    """A number can be typed beyond its slider's range: the scene's own rules decide."""
    scene = load_scene(FIVE)
    with pytest.raises(InputError, match="uniform"):
        changed(scene, sliders(scene), {"field.x": 1e9})


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
    known, preview, solver = sliders(scene), Preview(), Solver()
    try:
        first = solver.solved(scene)
        assert first.result is not None
        preview.learn(first.result)
        near = changed(scene, known, {"field.x": 1.0})
        second, alone = solver.solved(near), run(near)
        assert second.result is not None
        np.testing.assert_allclose(second.result.tip, alone.tip, atol=2e-6 * scene.length)
        shape = preview.shape(near)
        assert isinstance(shape, Shape)
        assert np.linalg.norm(shape.axis[-1] - alone.tip) < 5e-3 * scene.length
        solver.process.process.kill()
        lost = solver.solved(near)
        assert "started anew" in lost.failure
        assert solver.solved(near).result is not None
    finally:
        solver.close()
