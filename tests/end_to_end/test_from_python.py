"""Scenes made, changed and saved in Python, and the commands' answers as functions."""

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import magmpm
from magmpm.cli.design import saved_target
from tests.end_to_end.small_study import finished, study_file

ROOT = Path(__file__).parents[2]
SCENES = sorted((ROOT / "data/scenes").rglob("*.yaml"))
FROM_TABLES = {
    "pulled_by_map",
    "walking_strip",
}  # a measured map, and a schedule that a table gives

SHORT = {
    "name": "short",
    "materials": {
        "silicone": {
            "shear_modulus": "120 kPa",
            "bulk_to_shear": 20,
            "density": "1882 kg/m^3",
            "remanence": 0.138,
        }
    },
    "body": {
        "catheter": {
            "length": "24 mm",
            "diameter": 4e-3,
            "material": "silicone",
            "segments": [{"magnetization": [1, 0, 0]}],
        }
    },
    "field": {"uniform": ["0 mT", "0 mT", "8 mT"]},
    "effects": {"magnetic_torque": {}},
    "resolution": {"cells_across": 2},
}


def test_a_scene_is_made_of_a_dict_with_units_or_in_si() -> None:
    scene = magmpm.load_scene(SHORT)
    assert (scene.length, scene.thickness, scene.field.uniform[2]) == (0.024, 0.004, 0.008)
    with pytest.raises(
        magmpm.InputError, match=r"materials.silicone.shear_modulus.*\n.*needs a unit"
    ):
        magmpm.load_scene(
            {
                **SHORT,
                "materials": {
                    "silicone": {**SHORT["materials"]["silicone"], "shear_modulus": "120"}
                },
            }
        )  # type: ignore[index]


def test_numbers_may_be_text_with_units() -> None:
    scene = magmpm.load_scene(SHORT)
    assert (
        scene.with_field(["0 mT", "1 mT", "4 mT"])
        == scene.with_field([0, 1e-3, 4e-3])
        == scene.with_field(np.array([0, 1e-3, 4e-3]))
    )
    assert scene.with_field("4 mT") == scene.with_field(4e-3) == scene.with_field([0, 0, 4e-3])
    assert scene.with_material(shear_modulus="90 kPa").materials["silicone"].shear_modulus == 90e3
    assert scene.with_material("silicone", remanence=0.1).materials["silicone"].remanence == 0.1
    assert scene.inserted("12 mm") == scene.inserted(0.012)
    for wrong in ("4 mm", "strong", ["0 mT", "4 mT"], None):
        with pytest.raises(magmpm.InputError, match=r"field\.uniform"):
            scene.with_field(wrong)  # type: ignore[arg-type]
    with pytest.raises(magmpm.InputError, match="direction"):
        scene.with_field([0, 0, 0]).with_field("4 mT")
    two = scene.with_material("stiff", shear_modulus="1 MPa", bulk_to_shear=20, density="2 g/cm^3")
    for unclear in (
        {"shear_modulus": "1 MPa"},
        {"name": "silicon", "remanence": 0.1},
    ):  # none of two, and none of them
        with pytest.raises(magmpm.InputError, match="silicone, stiff"):
            two.with_material(**unclear)


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_a_saved_scene_is_read_back_as_an_equal_one(path: Path, tmp_path: Path) -> None:
    """Bit for bit, or it is refused and nothing is written."""
    scene = magmpm.load_scene(path)
    file = tmp_path / "saved/x.yaml"
    if path.stem in FROM_TABLES:
        with pytest.raises(magmpm.InputError, match="tables and meshes"):
            scene.save(file)
        assert list(file.parent.iterdir()) == []
    else:
        assert scene.save(file) == file
        assert magmpm.load_scene(file) == scene


def test_numbers_without_a_short_text_are_saved_exactly(tmp_path: Path) -> None:
    scene = (
        magmpm.load_scene(SHORT)
        .with_field([1e-12 / 3, -np.pi * 1e-3, 0.1 + 0.2])
        .with_effects(gravity={"acceleration": [0, 0, -9.81]})
    )
    assert magmpm.load_scene(scene.save(tmp_path / "x.yaml")) == scene


def test_a_result_is_a_table_and_a_mesh(monkeypatch: pytest.MonkeyPatch) -> None:
    result = magmpm.run(magmpm.load_scene(SHORT))
    monkeypatch.setitem(
        sys.modules, "pandas", SimpleNamespace(DataFrame=lambda rows, columns: (rows, columns))
    )  # type: ignore[arg-type]
    rows, columns = result.to_dataframe()
    assert rows is result.centreline
    assert columns == ["s_m", "x_m", "y_m", "z_m"]
    monkeypatch.setitem(sys.modules, "pandas", None)  # type: ignore[arg-type]
    with pytest.raises(magmpm.InputError, match=r"pip install .*\[dataframe\]'"):
        result.to_dataframe()
    pytest.importorskip("pyvista")
    mesh = result.mesh()
    volume = np.pi / 4 * 4e-3**2 * 24e-3
    assert mesh.volume == pytest.approx(
        volume, rel=0.02
    )  # a circle of 40 chords has 0.4 % less; det F differs from 1 by up to a per cent
    np.testing.assert_allclose(
        mesh.points[np.argmax(mesh.points[:, 2])], result.tip, atol=2.5e-3
    )  # within a radius and the tip's tilt


def test_a_design_and_the_influence_of_an_effect(tmp_path: Path) -> None:
    out = finished(tmp_path, trials=1)
    report = magmpm.design(study_file(tmp_path), folder=out, trials=2)
    assert repr(report).startswith("StudyReport('short': 2 trials by random; best trial ")
    assert magmpm.Result.load(out / "best").converged
    with pytest.raises(TypeError, match="the folder of the results is `folder`"):
        magmpm.design(study_file(tmp_path), out=out)
    row = magmpm.influence(tmp_path / "scene.yaml", "gravity")
    assert repr(row).startswith("Influence of gravity: ")
    assert row.cost_percent is None  # type: ignore[union-attr]
    with pytest.raises(magmpm.InputError, match="magnetic_torque"):
        magmpm.influence(SHORT, "levity")


def height(result: magmpm.Result) -> float:
    """Height of the tip, m: what a study below makes large."""
    return float(result.tip[2])


def test_a_study_is_made_of_a_dict(tmp_path: Path) -> None:
    """With a scene, an array and a function of Python; kept as files, from which the same study goes on. Another one is refused."""
    scene = magmpm.load_scene(SHORT)
    line = np.linspace(0, 24e-3, 7)
    straight = np.column_stack([line, 0 * line, 0 * line])
    study = {"scene": scene, "vary": {"magnetization": {}}, "sampler": "random", "trials": 1}
    shape = {**study, "match": {"centreline": straight}}
    report = magmpm.design(shape, folder=tmp_path / "shape")
    (file,) = (tmp_path / "shape").glob("study_*/*.yaml")
    assert file.name == "short.yaml"
    assert magmpm.load_scene(file.parent / "files/scene.yaml") == scene
    assert magmpm.design(file, folder=tmp_path / "shape").best == report.best
    beside = saved_target(tmp_path / "shape")  # what `magmpm render` draws beside the best design
    assert beside is not None
    np.testing.assert_allclose(beside[:, 1:], straight, atol=1e-9)
    with pytest.raises(magmpm.InputError, match="another"):
        magmpm.design({**shape, "match": {"centreline": 0.9 * straight}}, folder=tmp_path / "shape")
    assert magmpm.design(shape, folder=tmp_path / "shape").best == report.best
    goal = {**study, "goal": {"maximize": {"python": height}}}
    best = magmpm.design(goal, folder=tmp_path / "goal").best
    assert best["values"] == [height(magmpm.Result.load(tmp_path / "goal/best"))]


def test_a_study_of_a_dict_is_refused_in_words(tmp_path: Path) -> None:
    study = {"scene": magmpm.load_scene(SHORT), "vary": {"magnetization": {}}}
    for goal, words in (
        ({"match": {"centreline": np.zeros(4)}}, r"match\.centreline: received an array \(4,\)"),
        (
            {"goal": {"maximize": {"python": lambda result: 0.0}}},
            r"goal\.maximize\.python: .*lambda",
        ),
    ):
        with pytest.raises(magmpm.InputError, match=words):
            magmpm.design({**study, **goal}, folder=tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_result_and_a_motion_draw_themselves(tmp_path: Path) -> None:
    """In one line, into a folder that is made; a target is drawn as well."""
    pytest.importorskip("PIL")
    from PIL import Image

    result = magmpm.run(magmpm.load_scene(SHORT))
    path = result.render(tmp_path / "new/result.png")
    assert path == tmp_path / "new/result.png"
    line = np.linspace(0, 24e-3, 7)
    curve = np.column_stack([line, 0 * line, 0.2 * line])
    targeted = result.render(tmp_path / "target.png", target=curve)
    moving = {**SHORT, "solver": {"dynamic": {"duration": "2 ms", "output_every": "1 ms"}}}
    magmpm.run(magmpm.load_scene(moving), folder=tmp_path / "motion")
    moments = magmpm.Motion.load(tmp_path / "motion").render(
        tmp_path / "moments.png", frames=[0, 2]
    )
    for made in (path, targeted, moments):
        with Image.open(made) as image:
            assert len(np.unique(np.asarray(image).reshape(-1, 3), axis=0)) > 50


def test_constants_are_fitted(tmp_path: Path) -> None:
    scene = magmpm.load_scene(SHORT)
    lines = ["field_z_mT,tip_x_mm,tip_y_mm,tip_z_mm"]
    for strength in (4, 8):
        x, y, z = 1e3 * magmpm.run(scene.with_field(f"{strength} mT")).tip
        lines.append(f"{strength},{x:.6f},{y:.6f},{z:.6f}")
    (tmp_path / "tips.csv").write_text("\n".join(lines) + "\n")
    found = magmpm.fit(
        tmp_path / "tips.csv",
        scene.with_material(shear_modulus="150 kPa"),
        vary=["shear_modulus"],
        thorough=False,
    )
    assert found.constants[0].value == pytest.approx(120e3, rel=1e-3)  # the tips have 6 digits
    assert repr(found).startswith("Fit('short': shear_modulus")


IN_THE_WAY = "raise ImportError('a file of the user, which magmpm must not import')\n"


def test_users_own_studies_and_viz_are_in_nobodys_way(tmp_path: Path) -> None:
    """Beside a script or a notebook (`-c` has its folder on the path as these have), and on PYTHONPATH; another process draws."""
    for name in ("studies", "viz"):
        (tmp_path / f"{name}.py").write_text(IN_THE_WAY)
        (tmp_path / "packages" / name).mkdir(parents=True)
        (tmp_path / "packages" / name / "__init__.py").write_text(IN_THE_WAY)
    out = finished(tmp_path, trials=1)
    code = (
        f"import magmpm\nprint(magmpm.design({str(study_file(tmp_path))!r}, folder={str(out)!r},"
        " trials=1))\n"
    )
    path = f"{tmp_path}:{tmp_path / 'packages'}"
    for arguments in (
        ["-m", "magmpm", "design", str(study_file(tmp_path)), "--out", str(out), "--trials", "1"],
        ["-c", code],
    ):
        done = subprocess.run(
            [sys.executable, *arguments],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": path},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        assert "a file of the user" not in done.stderr
    assert (out / "best.png").stat().st_size > 5_000


def test_the_shell_completes_the_whole_command_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """argcomplete, which is called only when the shell asks, gets the parser with all its commands."""
    from magmpm.cli import main

    asked: list[str] = []
    monkeypatch.setitem(
        sys.modules,
        "argcomplete",
        SimpleNamespace(autocomplete=lambda parser: asked.append(parser.format_help())),
    )  # type: ignore[arg-type]
    for variables in ({}, {"_ARGCOMPLETE": "1"}):
        for name, value in variables.items():
            monkeypatch.setenv(name, value)
        with pytest.raises(SystemExit):
            main(["--version"])
        assert len(asked) == len(variables)
    assert "design" in asked[0]
