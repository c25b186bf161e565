"""Broken strips and STL parts: each refused before the run with file, line, key, value received, rule and remedy."""

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import bad_studies
import numpy as np
import pytest
from bad_scene import BadScene
from reference.commands import scene_text
from reference.solids import box, stl_text
from test_commands import SCENE
from test_import import robot_file

from magmpm.bodies.surface_mesh import Mesh, write_stl
from magmpm.cli import main
from magmpm.errors import InputError, dotted, undotted
from magmpm.scene import load_scene

# ruff: noqa: E501  (a case a line reads best)
# fmt: off

STRIP = """\
name: probe
materials:
  magnetic: {shear_modulus: 120 kPa, bulk_to_shear: 20, density: 1882 kg/m^3, remanence: 138 mT}
body:
  strip:
    length: 10 mm
    width: 4 mm
    thickness: 1 mm
    material: magnetic
    clamp: base
    position: [0 mm, 0 mm, 1 mm]
    plane_strain: false
    magnetization_profile:
      harmonic: {periods: 1, phase: 45 deg, plane: xz, turn: cw}
field: {uniform: [0 mT, 6 mT, 8 mT]}
effects: {magnetic_torque: {}}
resolution: {cells_across: 2}
"""
PROFILE = "    magnetization_profile:\n      harmonic: {periods: 1, phase: 45 deg, plane: xz, turn: cw}\n"

PARTS = """\
name: probe
materials:
  magnetic: {shear_modulus: 120 kPa, bulk_to_shear: 20, density: 1882 kg/m^3, remanence: 138 mT}
body:
  parts:
    unit: mm
    spacing: 0.5 mm
    meshes:
      - {mesh: base.stl, material: magnetic, clamp: true}
      - {mesh: arm.stl, material: magnetic, magnetization: [1, 0, 0]}
field: {uniform: [0 mT, 6 mT, 8 mT]}
effects: {magnetic_torque: {}}
"""


def edit(name: str, old: str, new: str, key: str, received: str, *says: str, line: int | None = None) -> BadScene:
    return BadScene(name, ((old, new),), key, received, says, line=line)


STRIPS = [
    edit("thicker than long", "thickness: 1 mm", "thickness: 11 mm", "body.strip.thickness", '"11 mm"', "the length must be 1 to 500 times the thickness"),
    edit("a wire", "width: 4 mm", "width: 0.4 mm", "body.strip.thickness", '"1 mm"', "the width must be 0.5 to 500 times the thickness", line=8),
    edit("clamped at the tip", "clamp: base", "clamp: tip", "body.strip.clamp", '"tip"', "'base', 'both' or 'none'"),
    edit("free, in equilibrium", "clamp: base", "clamp: none", "body.strip.clamp", '"none"', "equilibrium needs a body that is held", "dynamic"),
    edit("placed in a plane", "[0 mm, 0 mm, 1 mm]", "[0 mm, 1 mm]", "body.strip.position", "[", "a list of 3"),
    edit("maybe plane strain", "plane_strain: false", "plane_strain: maybe", "body.strip.plane_strain", '"maybe"', "must be true or false"),
    edit("segments and a profile", PROFILE, PROFILE + "    segments: [{magnetization: [1, 0, 0]}]\n", "body.strip", "{", "`segments` or `magnetization_profile`, one of them", line=5),
    edit("no magnetisation at all", PROFILE, "", "body.strip", "{", "`segments` or `magnetization_profile`, one of them", line=5),
    edit("segments too long", PROFILE, "    segments: [{length: 8 mm}, {length: 3 mm}]\n", "body.strip.segments", "[", "must sum to the strip's length", "11 mm, the strip 10 mm"),
    edit("two pitches", "{periods: 1,", "{periods: 1, wavelength: 10 mm,", "body.strip.magnetization_profile.harmonic", "{", "give `wavelength` or `periods`, one of them"),
    edit("no pitch", "{periods: 1, ", "{", "body.strip.magnetization_profile.harmonic", "{", "give `wavelength` or `periods`, one of them"),
    edit("no turns", "periods: 1,", "periods: 0,", "body.strip.magnetization_profile.harmonic.periods", "0", "must be greater than 0"),
    edit("turns finer than cells", "periods: 1,", "periods: 4,", "resolution.cells_across", "2", "at least 8 cells long, and is 5", "raise cells_across to 4", line=17),
    edit("a plane of the fourth dimension", "plane: xz", "plane: xw", "body.strip.magnetization_profile.harmonic.plane", '"xw"', "'xz', 'xy' or 'yz'"),
    edit("turned left", "turn: cw", "turn: left", "body.strip.magnetization_profile.harmonic.turn", '"left"', "'ccw' or 'cw'"),
    edit("another material", "material: magnetic\n", "material: magnetc\n", "body.strip.material", '"magnetc"', 'did you mean "magnetic"?'),
    edit("two bodies", "body:\n", "body:\n  catheter: {length: 40 mm, diameter: 4 mm, material: magnetic, segments: [{}]}\n", "body", "{", "`catheter`, `strip` or `parts`, one of them", "keep one", line=4),
    edit("a misspelt body", "  strip:\n", "  stripe:\n", "body.stripe", "{", 'did you mean "strip"?'),
]

ASSEMBLIES = [
    edit("no unit", "    unit: mm\n", "", "body.parts.unit", "nothing", "this key is required", "mm", line=5),
    edit("feet", "unit: mm", "unit: feet", "body.parts.unit", '"feet"', "'mm'", "'inch'"),
    edit("missing mesh", "mesh: arm.stl", "mesh: arms.stl", "body.parts.meshes[1].mesh", '"arms.stl"', "can't be read", "relative to the scene file"),
    edit("no mesh at all", "mesh: arm.stl", "mesh: probe.yaml", "body.parts.meshes[1].mesh", '"probe.yaml"', "must be an STL mesh"),
    edit("an open mesh", "mesh: arm.stl", "mesh: open.stl", "body.parts.meshes[1].mesh", '"open.stl"', "must be watertight", "3 edges", "close the holes"),
    edit("a triangle twice", "mesh: arm.stl", "mesh: doubled.stl", "body.parts.meshes[1].mesh", '"doubled.stl"', "1 of this one appears again, the first near (0, ", "Remove Duplicate Faces"),
    edit("a triangle twice, facing back", "mesh: arm.stl", "mesh: back.stl", "body.parts.meshes[1].mesh", '"back.stl"', "at 3 edges of this one there is one too many", "remove the triangle that belongs to no solid"),
    edit("a number that is none", "mesh: arm.stl", "mesh: spoilt.stl", "body.parts.meshes[1].mesh", '"spoilt.stl"', "every coordinate must be a number, and this file has '3.5.1'", "export the part again"),
    edit("a mesh of meters", "mesh: arm.stl", "mesh: meters.stl", "body.parts.meshes[1].mesh", '"meters.stl"', "meters is 0.001 mm", "all of it is 3 µm long", "is its file in m? It would then be 3 mm long: export it in mm"),
    edit("an inverted mesh", "mesh: arm.stl", "mesh: inverted.stl", "body.parts.meshes[1].mesh", '"inverted.stl"', "its volume is negative", "flip the normals"),
    edit("a mesh of two minds", "mesh: arm.stl", "mesh: mixed.stl", "body.parts.meshes[1].mesh", '"mixed.stl"', "face opposite ways", "consistent"),
    edit("a piece inverted", "mesh: arm.stl", "mesh: pieces.stl", "body.parts.meshes[1].mesh", '"pieces.stl"', "2 shells: shell 2 of volume 1 faces inward", "flip the normals of what is inverted"),
    edit("a surface that crosses itself", "mesh: arm.stl", "mesh: crossed.stl", "body.parts.meshes[1].mesh", '"crossed.stl"', "must not cross itself", "counts twice", "merge overlapping solids"),
    edit("no mass", "mesh: arm.stl", "mesh: flat.stl", "body.parts.meshes[1].mesh", '"flat.stl"', "no mass", "export the solid part"),
    edit("corners beyond all numbers", "mesh: arm.stl", "mesh: absurd.stl", "body.parts.meshes[1].mesh", '"absurd.stl"', "at most 1e+08 in the file's unit, and this mesh has one of 1e+30", "export the part again"),
    edit("a mesh of kilometres", "mesh: arm.stl", "mesh: town.stl", "body.parts.meshes[1].mesh", '"town.stl"', "at most 10 m, and this mesh reaches to 3e+03 m", "check the unit (mm)"),
    edit("a mesh of nanometres", "mesh: arm.stl", "mesh: molecule.stl", "body.parts.meshes[1].mesh", '"molecule.stl"', "at least 1 um long, and this one is 0.003 um", "check the unit (mm)"),
    edit("an overlap", "mesh: arm.stl", "mesh: shifted.stl", "body.parts.meshes[1].mesh", '"shifted.stl"', "must not overlap", "shifted shares 0.5 mm^3 with base, 50 % of the smaller"),
    edit("a thin part", "mesh: arm.stl", "mesh: sheet.stl", "body.parts.spacing", '"0.5 mm"', "sheet is 0.2 mm, 0.4 cells of 0.5 mm", "at most `spacing: 0.1 mm`", line=7),
    edit("nothing held, in equilibrium", ", clamp: true", "", "body.parts.meshes", "[", "equilibrium needs a body that is held", line=8),
    edit("nothing free", "magnetization: [1, 0, 0]", "magnetization: [1, 0, 0], clamp: true", "body.parts.meshes", "[", "at least one part must be free", line=8),
    edit("a tip that is held", "    spacing: 0.5 mm\n", "    spacing: 0.5 mm\n    tip: base\n", "body.parts.tip", '"base"', "must be a part that moves: arm", "write a point", line=8),
    edit("a tip of another name", "    spacing: 0.5 mm\n", "    spacing: 0.5 mm\n    tip: arms\n", "body.parts.tip", '"arms"', "the name of a part that moves: arm", 'did you mean "arm"?', line=8),
    edit("a tip in the air", "    spacing: 0.5 mm\n", "    spacing: 0.5 mm\n    tip: [4 mm, 0.5 mm, 0.5 mm]\n", "body.parts.tip", '["4 mm", "0.5 mm", "0.5 mm"]', "this is 1 mm away from arm", "as the STL files have them", line=8),
    edit("a tip without units", "    spacing: 0.5 mm\n", "    spacing: 0.5 mm\n    tip: [3 mm, 0.5 mm, 0.5]\n", "body.parts.tip[2]", "0.5", "a length needs a unit", line=8),
    edit("the error of no tip", "effects: {magnetic_torque: {}}\n", "effects: {magnetic_torque: {}}\nresolution: {error: 1 %, of: tip}\n", "resolution.of", '"tip"', "parts have no tip unless the scene names it", "say `tip: arm` in body.parts", line=13),
    edit("held perhaps", "clamp: true", "clamp: perhaps", "body.parts.meshes[0].clamp", '"perhaps"', "must be true or false"),
]
# fmt: on


def meshes(folder: Path) -> None:
    """The meshes of the scenes, valid and invalid, in mm."""
    arm = box((0, 0, 0), (3, 1, 1))
    piece = box((4, 0, 0), (5, 1, 1))
    crossed = arm.vertices.copy()
    crossed[0] = (5, 0.5, 0.5)  # a corner, pulled through the face at the other end
    mixed = arm.faces.copy()
    mixed[0] = mixed[0, ::-1]
    solids = {
        "base": box((-1, 0, 0), (0, 1, 1)),
        "arm": arm,
        "open": Mesh(arm.vertices, arm.faces[1:]),
        "doubled": Mesh(arm.vertices, np.concatenate([arm.faces, arm.faces[:1]])),
        "back": Mesh(arm.vertices, np.concatenate([arm.faces, arm.faces[:1, ::-1]])),
        "meters": Mesh(1e-3 * arm.vertices, arm.faces),
        "inverted": Mesh(arm.vertices, arm.faces[:, ::-1]),
        "crossed": Mesh(crossed, arm.faces),
        "mixed": Mesh(arm.vertices, mixed),
        "pieces": Mesh(
            np.concatenate([arm.vertices, piece.vertices]),
            np.concatenate([arm.faces, 8 + piece.faces[:, ::-1]]),
        ),
        "shifted": box((-0.5, 0, 0), (3, 1, 1)),
        "sheet": box((0, 0, 0), (3, 1, 0.2)),
        "absurd": box((0, 0, 0), (1e30, 1e30, 1e30)),
        "town": box((0, 0, 0), (3e6, 1e6, 1e6)),
        "molecule": box((0, 0, 0), (3e-6, 1e-6, 1e-6)),
    }
    for name, mesh in solids.items():
        write_stl(mesh, folder / f"{name}.stl")
    (folder / "spoilt.stl").write_text(stl_text(arm).replace("vertex 3 ", "vertex 3.5.1 ", 1))
    # Two triangles back to back: closed, without volume.
    lines = [
        f"facet normal 0 0 0\nouter loop\n{corners}\nendloop\nendfacet"
        for corners in (
            "vertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0",
            "vertex 0 0 0\nvertex 0 1 0\nvertex 1 0 0",
        )
    ]
    (folder / "flat.stl").write_text("solid flat\n" + "\n".join(lines) + "\nendsolid flat\n")


@pytest.mark.parametrize("good", [STRIP, PARTS], ids=["strip", "parts"])
def test_the_good_ones_are_good(good: str, tmp_path: Path) -> None:
    meshes(tmp_path)
    (tmp_path / "probe.yaml").write_text(good)
    assert load_scene(tmp_path / "probe.yaml").warnings() == []


@pytest.mark.parametrize(
    ("good", "case"),
    [(STRIP, case) for case in STRIPS] + [(PARTS, case) for case in ASSEMBLIES],
    ids=lambda value: value.name.replace(" ", "-") if isinstance(value, BadScene) else "",
)
def test_what_is_wrong_is_said(good: str, case: BadScene, tmp_path: Path) -> None:
    meshes(tmp_path)
    ((old, new),) = case.edits
    assert good.count(old) == 1, f"{old!r} stands {good.count(old)} times in the good scene"
    path = tmp_path / "probe.yaml"
    path.write_text(good.replace(old, new))
    with pytest.raises(InputError) as caught:
        load_scene(path)
    message = str(caught.value)
    same = next((n for n, (a, b) in enumerate(zip(old, new, strict=False)) if a != b), 0)
    line = case.line or 1 + good[: good.index(old)].count("\n") + new[:same].count("\n")
    phrases = [
        f"{path}:{line}: {case.key}: received {case.received}",
        "\n  rule: ",
        "\n  remedy: ",
        *case.says,
    ]
    missing = [phrase for phrase in phrases if phrase not in message]
    assert not missing, f"not said: {missing}\nin:\n{message}"
    assert "problems in" not in message, f"one mistake, one problem:\n{message}"


def test_a_part_far_from_the_others_is_refused_before_the_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A part in another unit is far away: the box around all parts has too many cells."""
    meshes(tmp_path)
    write_stl(box((5000, 4000, 3000), (5003, 4001, 3001)), tmp_path / "arm.stl")
    path = tmp_path / "probe.yaml"
    path.write_text(PARTS)
    assert main(["run", str(path), "--out", str(tmp_path / "out")]) == 2
    message = capsys.readouterr().err
    assert "the box around all parts" in message
    assert "check the units and positions of the parts" in message


# Errors found only when the body is built are refused like those found during loading: file, line, key, value, rule, remedy


FIELD = "uniform: [0 mT, 2 mT, 20 mT]"
EFFECT = "gravity: {}"
TUBE = "walls: {tube: {radius: 3 mm, path: [[0 mm, 9 mm, 0 mm], [40 mm, 9 mm, 0 mm]]}}"
MOMENT = "moment: [0 A*m^2, 0 A*m^2, 0.5 A*m^2]"
NEAR = (
    f"dipole:\n    - {{position: [60 mm, 0 mm, 0 mm], {MOMENT}}}\n    - {{position: [8 mm, 0 mm, 0"
    f" mm], {MOMENT}}}"
)
TURNING = (
    "magnet: {cylinder: {diameter: 20 mm, length: 20 mm}, position: [40 mm, 0 mm, 0 mm], remanence:"
    " 1.3 T}\n  over_time: {rotation: {frequency: 1 Hz, center: [20 mm, 0 mm, 0 mm], axis: [0, 1,"
    " 0]}}"
)


@pytest.mark.parametrize(
    ("field", "effect", "where", "says"),
    [
        (
            FIELD,
            "ground: {point: [0 mm, 0 mm, 1 mm]}",
            '9: effects.ground: received {"point": ["0 mm", "0 mm", "1 mm"]}; ',
            ("initial overlap of 3 mm with the ground", "just touching", "away from the body"),
        ),
        (
            FIELD,
            TUBE,
            '9: effects.walls: received {"tube": {"radius": "3 mm"',
            (
                "outside the lumen, farthest in segment 1 (body.catheter.segments[0]), at (",
                "make the lumen wider",
            ),
        ),
        (
            NEAR,
            EFFECT,
            '7: field.dipole[1]: received {"position": ["8 mm", "0 mm", "0 mm"]',
            ("nearer than a cell", "move the dipole"),
        ),
        (
            TURNING,
            EFFECT,
            '5: field.magnet: received {"cylinder": {',
            ("the magnet, center (", " s, is in the box around the body", "move the magnet"),
        ),
    ],
    ids=["ground", "walls", "dipole", "magnet"],
)
def test_file_line_and_value_are_named(field, effect, where, says, tmp_path, told) -> None:
    if "magnet:" in field:
        pytest.importorskip("magpylib")
    path = tmp_path / "scene.yaml"
    effects = f"\n  magnetic_torque: {{}}\n  magnetic_force: {{}}\n  {effect}"
    path.write_text(
        scene_text(
            "late",
            length="16 mm",
            field=f"\n  {field}",
            effects=effects,
            solver="{dynamic: {duration: 1 ms}}",
        )
    )
    told(
        "run",
        path,
        "--out",
        tmp_path / "out",
        status=2,
        says=(f"{path}:{where}", "\n  rule: ", "\n  remedy: ", *says),
    )


def test_keys_are_read_as_they_are_written() -> None:
    for key in [
        ("field", "dipole", 1, "position"),
        ("materials", "magnetic silicone", "density"),
        ("solver", "dynamic", "time_step"),
        (),
    ]:
        assert undotted(dotted(key)) == key


# A pipe, a device, a folder or a huge file instead of a scene, mesh, table or study is refused at once


PATIENCE = (
    30  # s for a command that takes one; without the check it waits forever, or fills the memory
)


@pytest.fixture
def _impatient() -> Iterator[None]:
    """Ends a test that hangs."""

    def end(number: int, frame: object) -> None:
        raise TimeoutError(f"no answer in {PATIENCE} s")

    before = signal.signal(signal.SIGALRM, end)
    signal.alarm(PATIENCE)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def odd(kind: str, path: Path) -> str:
    """Put something odd in place of a file; returns its name in the message."""
    path.unlink(missing_ok=True)
    if kind == "pipe":
        os.mkfifo(path)
        return "a named pipe (FIFO)"
    if kind == "device":
        path.symlink_to("/dev/zero")
        return "a device"
    if kind == "folder":
        path.mkdir()
        return "a folder"
    with path.open("wb") as stream:
        stream.truncate(10**9)  # a sparse file, which would fill the memory
    return f"received {10**9} bytes"


@pytest.mark.parametrize("kind", ["pipe", "device", "folder", "huge"])
@pytest.mark.parametrize(
    "place", ["scene", "mesh", "reference", "study", "target", "robot", "segment"]
)
@pytest.mark.usefixtures("_impatient")
def test_what_is_no_usable_file_is_refused_at_once(
    place, kind, tmp_path, monkeypatch, told
) -> None:
    monkeypatch.chdir(tmp_path)
    names = {
        "scene": "scene.yaml",
        "mesh": "base.stl",
        "reference": "reference.csv",
        "study": "study.yaml",
        "target": "target.csv",
    }
    path = tmp_path / names.get(place, "tiny.yaml" if place == "robot" else "meshes/tip.STL")
    command: list[object] = ["run", "scene.yaml"]
    Path("scene.yaml").write_text(
        PARTS if place == "mesh" else SCENE + "reference: {centreline: reference.csv}\n"
    )
    if place in ("study", "target"):
        for name, text in bad_studies.FILES.items():
            (tmp_path / name).write_text(text)
        command = ["design", "study.yaml"]
    elif place in ("robot", "segment"):
        command = ["import", robot_file(tmp_path), "-o", "imported.yaml"]
    what = odd(kind, path)
    said = told(*command, status=2, says=(path.name, "rule: ")).err
    assert what in said or (place == "segment" and "the file must be in" in said)
    assert not (tmp_path / "runs").exists()
