"""The map of tips: its tips are those of runs, its marks those of shapes that are not sure, its files say so."""

from __future__ import annotations

import csv
import json
import signal
from pathlib import Path

import numpy as np
import pytest

from magmpm import load_scene, run
from magmpm.cli import main
from magmpm.compiled.process import Process
from magmpm.errors import InputError
from magmpm.model import build
from magmpm.statics.layout import static_model
from magmpm.studies.explore.live import ready
from magmpm.studies.explore.tip_map import MARKS, _along, in_plane, map_tips, on_rays, rod_tips, solved

ROOT = Path(__file__).resolve().parents[2]
SCENE = ROOT / "data" / "scenes" / "axial_transverse.yaml"


def test_rays_cover_the_sphere_in_equal_steps() -> None:
    """1 000 fields: 125 directions whose mean vanishes, eight strengths each."""
    fields = on_rays(1000, 16e-3)
    assert fields.values.shape == (1000, 3)
    assert fields.shape == (125, 8)
    rays = fields.values.reshape(125, 8, 3)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=2), np.tile(2e-3 * np.arange(1, 9), (125, 1)), rtol=1e-12)
    directions = rays[:, -1] / 16e-3
    assert np.abs(directions.mean(axis=0)).max() < 0.02
    # Covered evenly: second moments of the sphere are 1/3.
    np.testing.assert_allclose(directions.T @ directions / 125, np.eye(3) / 3, atol=0.01)


def test_a_planes_rows_run_to_and_fro() -> None:
    """Every field of a path is next to the one before it; eight paths at most."""
    fields = in_plane(100, 9e-3, "xz")
    assert len(fields.paths) == 8
    assert sorted(k for path in fields.paths for k in path) == list(range(100))
    for path in fields.paths:
        np.testing.assert_allclose(np.linalg.norm(np.diff(fields.values[list(path)], axis=0), axis=1), 2e-3, rtol=1e-9)
    assert not fields.values[:, 1].any()


@pytest.mark.parametrize(("make", "place"), [
    (lambda: on_rays(0, 1e-3), "--fields"), (lambda: on_rays(10, 0.0), "--max"), (lambda: on_rays(10, 1e-3, 11), "--strengths"),
    (lambda: in_plane(10, 1e-3, "xx"), "--plane"), (lambda: in_plane(10, 1e-3, "xw"), "--plane"),
])  # fmt: skip
def test_wrong_fields_are_refused(make, place: str) -> None:
    with pytest.raises(InputError, match=place):
        make()


@pytest.mark.slow
def test_tips_are_those_of_runs(tmp_path: Path) -> None:
    """Every tip of a small map is that of `magmpm run` in this field, to what solves from different starts agree to (1e-6 L), and the files
    say the same."""
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
    np.testing.assert_allclose([[float(row[f"{a}_mm"]) for a in "xyz"] for row in rows], 1e3 * found.tip, rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(kept["tip_m"], found.tip)


@pytest.mark.slow
def test_no_soft_mode_is_lost_on_a_symmetric_way() -> None:
    """While the body bends in one plane only, its lowest mode changes from one in the plane to one out of it, or to twist. Modes that were
    followed from field to field never learned of those of another symmetry: at [0, 0, 5.7] mT the least stability was 15 % too large."""
    scene, fields = ready(load_scene(SCENE), 2), in_plane(225, 20e-3, "xz")
    path = next(path for path in fields.paths if 142 in path)
    way = [(k, fields.values[k].tolist()) for k in path[: path.index(142) + 1]]
    last = list(_along(scene, static_model(build(scene)), way))[-1]
    alone = run(scene.with_field(way[-1][1]))
    assert alone.stability is not None
    assert abs(last.stability - alone.stability) < 1e-4


@pytest.mark.slow
def test_a_process_that_dies_costs_one_field(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another process takes up the rest of its path, and finds the same tips."""
    scene, begun = load_scene(SCENE).with_cells(2), list[Process]()

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
    along the field, there is one shape. Critical load of a clamped rod under a following compass torque: B A Br L^2/(mu0 E I) = pi^2/4."""
    scene = load_scene(SCENE).with_cells(2)
    E, r = 2.951 * 120e3, 2e-3
    critical = (np.pi**2 / 4) * E * (np.pi * r**4 / 4) * 4e-7 * np.pi / (np.pi * r**2 * 0.1 * scene.length**2)
    fields = np.array([[x * critical, 0.0, z * critical] for x in (-1.6, -0.5, 0.5) for z in (-0.2, -0.1, 0.0, 0.1, 0.2)])
    rods = rod_tips(scene, fields, len(fields))
    assert np.isfinite(rods.tip).all()
    two = np.isfinite(rods.other).all(axis=1).reshape(3, 5)
    assert two[0, 2]
    assert not two[1:].any()
    own, other = rods.tip[2], rods.other[2]  # turned to the other side by as much; a round rod is free to turn about its axis
    np.testing.assert_allclose([other[0], np.hypot(*other[1:])], [own[0], np.hypot(*own[1:])], atol=1e-3 * scene.length)
    assert other[1:] @ own[1:] < -0.9 * (own[1:] @ own[1:])


def test_scenes_without_a_map_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    """With what to do about it, and exit status 2."""
    for name, words in [("pulled_by_magnet", "uniform fields"), ("fed_into_vessel", "at rest"), ("gallery/gripper", "shapes at rest")]:
        assert main(["map", str(ROOT / "data" / "scenes" / f"{name}.yaml")]) == 2
        assert words in capsys.readouterr().err
