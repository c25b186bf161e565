"""Scenes drawn at random: valid by construction, the same for the same seed, each solved or stopped with a reason, none silently wrong."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml

from magmpm.cli import main
from magmpm.scene import Scene, load_scene
from studies.hard_cases.drawn import drawn
from studies.hard_cases.random_suite import BROKEN


def as_file(folder: Path, seed: int, number: int) -> Scene:
    path = folder / "scene.yaml"
    path.write_text(yaml.safe_dump(drawn(seed, number)), encoding="utf-8")
    return load_scene(path)


def test_drawn_scenes_are_valid_and_various(tmp_path: Path) -> None:
    """As files, under all rules of files; each kind of body, source, solver and most effects are among forty."""
    scenes = [as_file(tmp_path, 7, number) for number in range(40)]
    assert {scene.body.kind for scene in scenes} == {"catheter", "strip", "parts"}
    assert {scene.static for scene in scenes} == {True, False}
    assert {"magnetic_torque", "magnetic_force", "gravity"} <= {name for scene in scenes for name in scene.effects.named()}
    assert len({scene.hash() for scene in scenes}) == len(scenes)
    assert as_file(tmp_path, 7, 3).hash() == scenes[3].hash() != as_file(tmp_path, 8, 3).hash()


@pytest.mark.slow
def test_three_hundred_random_scenes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """None is wrong, hangs, is refused or ends with a traceback; an order that is given again solves nothing again."""
    order = ["stability", "--random", "300", "--seed", "1", "--json", "--out", str(tmp_path / "random")]
    status = main(order)
    found = json.loads(capsys.readouterr().out)
    assert found["scenes"] == 300
    broken = [one for one in found["not_converged"] if one["ended"] in BROKEN]
    assert not broken
    assert status == 0
    assert all(Path(one["file"]).exists() and one["reason"] for one in found["not_converged"])
    assert main(order) == 0
    assert json.loads(capsys.readouterr().out)["seconds"] < 0.1 * found["seconds"]


@pytest.mark.parametrize(("given", "named"), [(["--random", "0"], "--random"), (["--random", "3", "--seed", "-1"], "--seed")])
def test_orders_that_make_no_sense_are_refused(given: list[str], named: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["stability", *given]) == 2
    assert named in capsys.readouterr().err
