"""Scenes drawn at random: valid by construction, the same for the same seed, each solved or stopped with a reason, none silently wrong."""

import json
from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np
import pytest
import yaml
from random_scenes.__main__ import main as random_scenes
from random_scenes.checks import FINER, LATE, checked
from random_scenes.drawn import drawn
from random_scenes.suite import BROKEN, remedied, solved
from random_scenes.twins import MIRROR, twin
from reference.scenes import rod_scene

from magmpm.scene import Scene, load_scene
from magmpm.scene.remedies import Remedy
from magmpm.scene.time_limit import limited
from magmpm.simulate import run


def as_file(folder: Path, seed: int, number: int) -> Scene:
    path = folder / "scene.yaml"
    path.write_text(yaml.safe_dump(drawn(seed, number)), encoding="utf-8")
    return load_scene(path)


def test_drawn_scenes_are_valid_and_various(tmp_path: Path) -> None:
    """As files, under all rules of files; each kind of body, source, solver and most effects are among forty."""
    scenes = [as_file(tmp_path, 7, number) for number in range(40)]
    assert {scene.body.kind for scene in scenes} == {"catheter", "strip", "parts"}
    assert {scene.static for scene in scenes} == {True, False}
    assert {"magnetic_torque", "magnetic_force", "gravity"} <= {
        name for scene in scenes for name in scene.effects.named()
    }
    assert len({scene.hash() for scene in scenes}) == len(scenes)
    assert as_file(tmp_path, 7, 3).hash() == scenes[3].hash() != as_file(tmp_path, 8, 3).hash()


@pytest.mark.parametrize("number", [129, 223, 502])
def test_profiles_turn_within_whole_cells(tmp_path: Path, number: int) -> None:
    """Short strips whose cells along the length, rounded, were too few for a turn of their magnetization: they were refused."""
    scene = as_file(tmp_path, 81, number)
    assert scene.body.strip.magnetization_profile is not None


@pytest.mark.slow
def test_three_hundred_random_scenes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """None is wrong, hangs, is refused or ends with a traceback; an order that is given again solves nothing again."""
    order = [
        "300",
        "--seed",
        "1",
        "--json",
        "--out",
        str(tmp_path / "random"),
    ]
    status = random_scenes(order)
    found = json.loads(capsys.readouterr().out)
    assert found["scenes"] == 300
    broken = [one for one in found["not_converged"] if one["ended"] in BROKEN]
    assert not broken
    assert status == 0
    assert all(Path(one["file"]).exists() and one["reason"] for one in found["not_converged"])
    outcomes = (tmp_path / "random/outcomes.jsonl").read_text(encoding="utf-8")
    assert len(outcomes.splitlines()) == 300
    assert random_scenes(order) == 0
    assert (tmp_path / "random/outcomes.jsonl").read_text(encoding="utf-8") == outcomes


@pytest.mark.parametrize("given", [["0"], ["3", "--seed", "-1"], []])
def test_orders_that_make_no_sense_are_refused(given: list[str]) -> None:
    with pytest.raises(SystemExit):
        random_scenes(given)


def test_twins_are_told_apart(tmp_path: Path) -> None:
    """A mirror image of a scene is another scene, of which the mirror image is the first again; its field is the mirrored axial vector."""
    for number in range(12):
        scene = as_file(tmp_path, 7, number)
        image = twin(scene, MIRROR)
        again = twin(image, MIRROR)
        assert np.allclose(again.region_remanence(), scene.region_remanence(), atol=1e-12)
        point = scene.box()[1] + np.array([0.1, 0.2, 0.3]) * scene.thickness
        if (
            not scene.field.coils and not scene.field.magnet
        ):  # those are on tables, which are made again
            there = scene.external_field().at(point)[0]
            assert np.allclose(
                image.external_field().at(MIRROR @ point)[0],
                -(MIRROR @ there),
                rtol=1e-9,
                atol=1e-15,
            )
            assert np.allclose(again.external_field().at(point)[0], there, rtol=1e-9, atol=1e-15)


def test_checks_that_run_out_of_time_refute_nothing_and_say_so(tmp_path: Path) -> None:
    scene = rod_scene(
        length=16e-3, directions=[(1, 0, 0), (0.7, 0.6, 0.4)], field=(1e-3, 4e-3, 6e-3), cells=2
    )
    result = run(scene)
    for looks in (1, 3, 5, 7):
        with limited(looks, clock=count().__next__):
            found = checked(scene, replace(result, stability=0.015), tmp_path, 0)
        assert (found.wrong, found.done[-1]) == ([], LATE)


def test_a_wrong_answer_is_found(tmp_path: Path) -> None:
    """A check refutes an equilibrium that was moved by a part in a thousand; the answer itself passes."""
    scene = rod_scene(
        length=16e-3, directions=[(1, 0, 0), (0.7, 0.6, 0.4)], field=(1e-3, 4e-3, 6e-3), cells=2
    )
    result = run(scene)
    assert checked(scene, result, tmp_path, 2).wrong == []
    off = replace(result, tip=result.tip + np.array([0.0, 1e-3 * scene.length, 0.0]))
    found = checked(scene, off, tmp_path, 2)
    assert any("mirror image" in text for text in found.wrong)
    assert checked(scene, replace(result, stability=-0.1), tmp_path, 2).wrong
    for number in range(
        3
    ):  # far away as well, where two equilibria are usual: this is none, though its energy is another
        far = replace(
            result,
            tip=result.tip + np.array([0.0, 0.4 * scene.length, 0.0]),
            energy=1.05 * result.energy,
        )
        assert any("mirror image" in text for text in checked(scene, far, tmp_path, number).wrong)
    soft = replace(far, stability=0.015)  # nothing else is compared with it
    assert any("as closely" in text for text in checked(scene, soft, tmp_path, 2).wrong)
    assert checked(scene, replace(result, tip=np.full(3, np.nan)), tmp_path, 2).wrong


def test_an_answer_far_from_the_rod_is_wrong(tmp_path: Path) -> None:
    """Stiff segments next to soft ones as short as the strip is thick: with knots at the joints the rod is near enough."""
    scene = as_file(tmp_path, 81, 269)
    result = run(scene)
    found = checked(scene, result, tmp_path, 2)
    assert (found.wrong, found.branches) == ([], [])
    off = checked(
        scene,
        replace(result, tip=result.tip + np.array([0.0, 0.0, FINER * scene.length])),
        tmp_path,
        2,
    )
    assert any(text.startswith("rod") for text in off.wrong)


def test_each_remedy_has_its_share_of_the_time() -> None:
    """One that takes too long leaves the next its time; where none is left, no remedy has brought an answer."""
    data = rod_scene(length=16e-3, field=(0, 0, 8e-3), cells=2).to_si()
    scene = Scene.from_si(data)
    slow = Remedy("a motion of a minute", {"solver.dynamic": {"duration": 60.0}})
    quick = Remedy("nothing changed", {"solver.static.max_steps": 99})
    assert remedied(scene, (slow, quick), 6.0) == quick.words
    assert remedied(scene, (slow,), 0.1) == ""


@pytest.mark.slow
def test_ends_of_processes(tmp_path: Path) -> None:
    """A scene that takes too long ends its process, which is replaced; the next one, which is not valid, is refused."""
    good = next(
        drawn(7, k)
        for k in range(40)
        if "static" in drawn(7, k)["solver"] and "uniform" in drawn(7, k)["field"]
    )
    for number, content in enumerate((good, {**good, "materials": {}})):
        (tmp_path / f"{number:06d}.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    jobs = [
        (number, tmp_path / f"{number:06d}.yaml", tmp_path / f"state{number}") for number in (0, 1)
    ]
    (first, late), (second, refused) = solved(jobs, 1, 0.001)
    assert (first, late["ended"]) == (0, "hung")
    assert (second, refused["ended"]) == (1, "refused")
    assert "materials" in refused["reason"]
