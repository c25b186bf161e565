"""Robots in the magneticMPM format: small valid and invalid ones made here, and the real ones if they lie beside the project."""

import errno
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from reference.solids import box

from magmpm.bodies.surface_mesh import Mesh, write_stl
from magmpm.errors import InputError
from magmpm.model import build
from magmpm.scene import load_scene
from magmpm.scene.magnetic_mpm_import import import_robot

REAL = Path(__file__).parents[2].parent / "shared" / "robots"
MESHES = {
    "base.STL": box((0, 0, 10), (2, 2, 12)),
    "robot - arm.STL": box((0, 0, 5), (2, 2, 10)),
    "tip.STL": box((0, 0, 0), (2, 2, 5)),
}


def segment(mesh: str, vector: list[float], **more: Any) -> dict[str, Any]:
    return {
        "mesh": mesh,
        "magnetisation_vector": vector,
        "density": 1882,
        "shear_modulus": 120000,
        "fixed": False,
        **more,
    }


def robot_file(folder: Path, meshes: dict[str, Mesh] | None = None, **changes: Any) -> Path:
    """A robot of three boxes that hang from the uppermost; changes: other values of keys, None omits a key."""
    (folder / "meshes").mkdir(parents=True, exist_ok=True)
    for name, mesh in {**MESHES, **(meshes or {})}.items():
        write_stl(mesh, folder / "meshes" / name)
    hub = segment("base.STL", [0, 0, 0], density=927, fixed=True)
    arm = segment("robot - arm.STL", [0, 0, 1])
    tip = segment("tip.STL", [0.8, 0, 0.6])
    content = {
        "name": "Tiny",
        "n_segments": 3,
        "remenance": 0.138,
        "segments": [hub, arm, tip],
        **changes,
    }
    path = folder / "tiny.yaml"
    path.write_text(yaml.safe_dump({k: v for k, v in content.items() if v is not None}))
    return path


def test_a_robot_becomes_a_scene_that_runs(tmp_path: Path, told) -> None:
    scene_file = tmp_path / "scenes" / "tiny.yaml"
    found = json.loads(
        told("import", robot_file(tmp_path / "robot"), "-o", scene_file, "--json").out
    )
    assert (found["name"], found["parts"], found["held"], found["warnings"]) == ("Tiny", 3, 1, [])
    text = scene_file.read_text()
    assert (
        "../robot/meshes/robot - arm.STL" in text
    )  # meshes are found from the folder of the scene
    scene = load_scene(scene_file)
    assert [region.held for region in scene.regions()] == [True, False, False]
    np.testing.assert_allclose(
        scene.region_remanence(), [[0, 0, 0], [0, 0, 0.138], [0.1104, 0, 0.0828]], atol=1e-12
    )
    assert [scene.region_material(k).density for k in range(3)] == [927, 1882, 1882]
    assert {m.bulk_to_shear for m in scene.materials.values()} == {20.0}
    model = build(scene)
    assert model.particles.volume.sum() == pytest.approx(48e-9, rel=1e-6)  # STL is single precision
    result = json.loads(told("run", scene_file, "--json", "--out", tmp_path / "out").out)
    assert result["converged"]
    assert result["tip"] is None  # of parts only where one is named
    # It hangs: its weight lowers the center of the last part, s = 7.5 mm of L = 10 mm below the clamp, by rho g (L s - s^2/2)/E = 2.44 um,
    # but for the clamp, which keeps the first of five thicknesses from getting thinner.
    assert 2.5e-3 - result["positions"]["tip"][2] == pytest.approx(2.44e-6, rel=0.1)


def test_an_edited_scene_is_not_imported_over(tmp_path: Path, told) -> None:
    """A second import with the same file is accepted; one that would change it needs --overwrite."""
    scene_file = tmp_path / "tiny.yaml"
    command = ["import", robot_file(tmp_path / "robot"), "-o", scene_file]
    told(*command)
    made = scene_file.read_text()
    told(*command)
    edited = made.replace("0 mT, 0 mT, 0 mT", "0 mT, 0 mT, 8 mT")
    edited = edited if edited != made else made + "# mine\n"
    scene_file.write_text(edited)
    told(*command, status=2, says=(f"-o: received {scene_file}\n  rule: ", "--overwrite"))
    assert scene_file.read_text() == edited
    assert sorted(path.name for path in tmp_path.iterdir()) == ["robot", "tiny.yaml"]
    told(*command, "--overwrite")
    assert scene_file.read_text() == made


def test_import_into_what_cant_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, told
) -> None:
    """A read-only disk, where even deleting a missing file fails; a folder instead of the file."""
    robot = robot_file(tmp_path / "robot")

    def read_only(self: Path, *_: Any, **__: Any) -> Any:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(self))

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_text", read_only)
        patch.setattr(Path, "unlink", read_only)
        says = "tiny.yaml: can't be written (Read-only file system)"
        told("import", robot, "-o", tmp_path / "tiny.yaml", status=2, says=says)
    told(
        "import",
        robot,
        "-o",
        tmp_path / "robot",
        status=2,
        says="can't be written (this is a folder)",
    )


def test_a_robot_that_nothing_holds_stands_on_the_ground(tmp_path: Path) -> None:
    loose = [segment("robot - arm.STL", [0, 0, 1]), segment("tip.STL", [0, 0, 1])]
    scene, _ = import_robot(robot_file(tmp_path, n_segments=2, segments=loose), tmp_path / "s.yaml")
    assert scene.solver.dynamic is not None
    assert scene.effects.ground.point[2] == 0.0
    assert build(scene).free


def test_odd_input_is_warned_of(tmp_path: Path) -> None:
    odd = [
        segment("base.STL", [0, 0, 0], fixed=True),
        segment("robot - arm.STL", [0, 0, 2.0]),
        segment("tip.STL", [0, 0.707, 0.707]),  # three decimals: not an error
    ]
    far = {"left over.STL": box((0, 0, 0), (1, 1, 1)), "tip.STL": box((0, 0, -5), (2, 2, 0))}
    scene, warnings = import_robot(robot_file(tmp_path, far, segments=odd), tmp_path / "s.yaml")
    assert warnings == [
        (
            "segments[1].magnetisation_vector: [0, 0, 2] has length 2; it is made one, so the"
            " remanence is 0.138 T, not 0.276 T"
        ),
        "meshes: left over.STL: no segment uses it",
        "segments[2].mesh: tip.STL touches no other segment: the nearest is 5 mm away",
    ]
    np.testing.assert_allclose(np.linalg.norm(scene.region_remanence(), axis=1), [0, 0.138, 0.138])


def test_remanence_spelt_well_is_taken_too(tmp_path: Path) -> None:
    scene, _ = import_robot(
        robot_file(tmp_path, remenance=None, remanence=0.05), tmp_path / "s.yaml"
    )
    assert np.linalg.norm(scene.region_remanence()[1]) == pytest.approx(0.05)


def flipped(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices, mesh.faces[:, ::-1])


SEGMENTS = [
    segment("base.STL", [0, 0, 0], fixed=True),
    segment("robot - arm.STL", [0, 0, 1]),
    segment("tip.STL", [0, 0, 1]),
]


def changed(index: int, **more: Any) -> list[dict[str, Any]]:
    return [{**s, **more} if i == index else s for i, s in enumerate(SEGMENTS)]


BAD: dict[str, tuple[dict[str, Any], list[str]]] = {
    "missing file": (
        {"segments": changed(1, mesh="robot - arn.STL")},
        [
            "segments[1].mesh: received robot - arn.STL",
            "the file must be in",
            'did you mean "robot - arm.STL"?',
        ],
    ),
    "overlap": (
        {"meshes": {"tip.STL": box((0, 0, 0), (2, 2, 6))}},
        [
            "segments[2].mesh: received tip.STL",
            "shares 4 mm^3 with segments[1], robot - arm.STL: 20 % of the smaller",
            "trim",
        ],
    ),
    "the same mesh twice": (
        {"segments": changed(2, mesh="base.STL")},
        ["segments[2].mesh", "100 % of the smaller"],
    ),
    "inverted": (
        {"meshes": {"tip.STL": flipped(MESHES["tip.STL"])}},
        ["segments[2].mesh", "face inward", "flip the normals"],
    ),
    "hole": (
        {"meshes": {"tip.STL": Mesh(MESHES["tip.STL"].vertices, MESHES["tip.STL"].faces[1:])}},
        ["segments[2].mesh", "watertight", "close the holes"],
    ),
    "density": (
        {"segments": changed(1, density=-5)},
        ["segments[1].density: received -5", "greater than 0"],
    ),
    "stiffness": (
        {"segments": changed(1, shear_modulus=0)},
        ["segments[1].shear_modulus: received 0", "greater than 0"],
    ),
    "vector of two": (
        {"segments": changed(1, magnetisation_vector=[0, 1])},
        ["segments[1].magnetisation_vector", "a list of 3"],
    ),
    "no number": (
        {"segments": changed(1, magnetisation_vector=[0, 1, float("nan")])},
        ["magnetisation_vector[2]", "finite"],
    ),
    "fixed is no yes or no": (
        {"segments": changed(0, fixed="maybe")},
        ["segments[0].fixed", "must be true or false"],
    ),
    "all fixed": (
        {"segments": [{**s, "fixed": True} for s in SEGMENTS]},
        ["at least one segment must be free"],
    ),
    "count": ({"n_segments": 4}, ["n_segments: received 4", "there are 3"]),
    "unknown key": ({"colour": "red"}, ["colour", "remove"]),
    "no remenance": ({"remenance": None}, ["remenance", "this key is required"]),
}


@pytest.mark.parametrize("name", BAD)
def test_what_would_make_a_wrong_robot_is_refused(name: str, tmp_path: Path, told) -> None:
    """Exit 2, a message with file, key, value, rule and remedy, and no scene written."""
    changes, says = BAD[name]
    path = robot_file(tmp_path, **changes)
    told(
        "import",
        path,
        "-o",
        tmp_path / "s.yaml",
        status=2,
        says=(str(path), "\n  rule: ", "\n  remedy: ", *says),
    )
    assert not (tmp_path / "s.yaml").exists()


def test_a_folder_without_meshes_is_said(tmp_path: Path) -> None:
    path = tmp_path / "r.yaml"
    path.write_text(
        yaml.safe_dump({"name": "r", "n_segments": 1, "remenance": 0.1, "segments": [SEGMENTS[1]]})
    )
    with pytest.raises(InputError, match=r"the folder .*meshes must be there"):
        import_robot(path, tmp_path / "s.yaml")


@pytest.mark.skipif(not REAL.is_dir(), reason="the real robots are not beside the project")
@pytest.mark.parametrize(
    ("robot", "volume", "held", "odd"),
    [
        ("Tentacle/tentacleA", 1182.75, 1, 4),
        ("Tentacle/tentacleF", 1182.75, 1, 4),
        ("SmallScaleBot/SmallScaleBot", 1.02675, 0, 0),
    ],
)
def test_real_robots(robot: str, volume: float, held: int, odd: int, tmp_path: Path) -> None:
    """Volume (mm^3, sum over the meshes, computed by trimesh), the held part, and vectors that are not of unit length."""
    scene, warnings = import_robot(REAL / f"{robot}.yaml", tmp_path / "s.yaml")
    assert len(scene.regions()) == 9
    assert sum(region.held for region in scene.regions()) == held
    assert len([w for w in warnings if "magnetisation_vector" in w]) == odd == len(warnings)
    model = build(scene)
    assert 1e9 * model.particles.volume.sum() == pytest.approx(volume, rel=1e-4)
    assert max(model.section.values()) < 1e-6
