"""Scenes as values: SI inside, immutable, hashed by content, rebuilt from their data; the example files."""

import copy
import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jsonschema import Draft202012Validator
from pydantic import ValidationError

from magmpm.errors import InputError
from magmpm.fields.measured_map import _BOUNDS
from magmpm.fields.over_time import Keyframe
from magmpm.inputs.csv_tables import read_centreline, write_centreline
from magmpm.inputs.settings import json_schema
from magmpm.inputs.yaml_document import read_yaml
from magmpm.scene import (
    Body,
    Catheter,
    Effects,
    FieldSource,
    Gravity,
    MagneticTorque,
    Material,
    Scene,
    Segment,
    load_scene,
)

ROOT = Path(__file__).resolve().parents[3]
SCENES = sorted((ROOT / "data/scenes").glob("*.yaml"))
FIVE = ROOT / "data/scenes/five_segments.yaml"


@pytest.fixture(scope="module")
def five() -> Scene:
    return load_scene(FIVE)


def scene_of(folder: Path, text: str) -> Scene:
    path = folder / "scene.yaml"
    path.write_text(text)
    return load_scene(path)


def test_five_segments_is_the_contracts(five: Scene) -> None:
    catheter = five.body.catheter
    material = five.materials["magnetic silicone"]
    assert (
        catheter.length,
        catheter.diameter,
        catheter.inner_diameter,
        catheter.segment_lengths(),
    ) == (0.04, 0.004, 0.0, [0.008] * 5)
    assert (
        material.shear_modulus,
        material.bulk_to_shear,
        material.density,
        material.remanence,
    ) == (120e3, 20.0, 1882.0, 0.138)
    assert five.field.uniform == (0.0, 0.006, 0.008)
    assert list(five.effects.named()) == ["magnetic_torque"]
    assert (
        five.solver.anti_locking,
        five.resolution.cells_across,
        five.resolution.particles_per_cell,
    ) == ("f-bar", 4, 2)
    assert five.magnetized_regions() == [0, 1, 2, 3, 4]


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("{azimuth: 90 deg}", (0.0, 1.0, 0.0)),  # from +x toward +y; default elevation: 0
        ("{azimuth: 0 deg, elevation: 90 deg}", (0.0, 0.0, 1.0)),
        (
            "{azimuth: 30 deg, elevation: 10 deg}",
            (np.cos(np.pi / 18) * np.cos(np.pi / 6), np.cos(np.pi / 18) / 2, np.sin(np.pi / 18)),
        ),
        ("[0, 0, -7]", (0.0, 0.0, -1.0)),
        ("[0, 0, 0]", (0.0, 0.0, 0.0)),
        *(
            (huge, (0.6, 0.0, 0.8))
            for huge in ("[3e200, 0, 4e200]", "[3e-200, 0, 4e-200]", "[3, 0, 4]")
        ),
    ],
)
def test_directions_by_angles_and_by_components(
    text: str, unit: tuple[float, ...], tmp_path: Path
) -> None:
    found = (
        scene_of(tmp_path, FIVE.read_text().replace("[1, 0, 0]", text))
        .body.catheter.segments[0]
        .magnetization
    )
    np.testing.assert_allclose(
        found, unit, rtol=0, atol=0 if set(unit) <= {-1.0, 0.0, 1.0} else 1e-15
    )  # roundings of a few operations


def test_yaml_is_read_by_the_rules_of_1_2(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text(
        "a: 1e-9\nb: no\nc: 12:30\nd: 010\ne: true\nf: 2024-01-02\n1: x\ng: &x {h: 1}\ni: *x\n"
    )
    data = read_yaml(tmp_path / "a.yaml")
    assert data.pop("g") == data.pop("i") == {"h": 1}
    assert data == {
        "a": 1e-9,
        "b": "no",
        "c": "12:30",
        "d": 10,
        "e": True,
        "f": "2024-01-02",
        "1": "x",
    }
    assert data.lines[("g", "h")] == 8


def test_merged_mappings_and_bom(tmp_path: Path) -> None:
    text = "a: &a {x: 1, y: 2}\nb:\n  <<: *a\n  y: 3\n"
    (tmp_path / "a.yaml").write_bytes(b"\xef\xbb\xbf" + text.encode())
    assert read_yaml(tmp_path / "a.yaml")["b"] == {"x": 1, "y": 3}


def test_segments_without_length_share_the_rest(tmp_path: Path) -> None:
    hollow = load_scene(ROOT / "data/scenes/hollow.yaml")
    lengths = hollow.body.catheter.segment_lengths()
    assert lengths == [0.006, 0.008, 0.007, 0.006, 0.007, 0.006]
    assert hollow.magnetized_regions() == [1, 3, 5]
    assert hollow.region_material(0).remanence == 0.0
    remanence = hollow.region_remanence()
    assert remanence.shape == (6, 3)
    np.testing.assert_array_equal(remanence[[0, 2, 4]], 0.0)
    np.testing.assert_allclose(np.linalg.norm(remanence[[1, 3, 5]], axis=1), 0.138, rtol=1e-15)


def test_a_direction_without_remanence_is_unmagnetised(five: Scene) -> None:
    data = five.to_si()
    data["materials"]["magnetic silicone"]["remanence"] = 0.0
    assert Scene.from_si(data).magnetized_regions() == []


def test_warnings(tmp_path: Path) -> None:
    text = FIVE.read_text().replace("  magnetic_torque: {}", "  gravity: {}")
    assert scene_of(tmp_path, text).warnings() == [
        "effects: magnetic_torque is not named, so the field has no effect"
    ]
    text = FIVE.read_text().replace(
        "materials:", "materials:\n  spare: {shear_modulus: 1 kPa, bulk_to_shear: 20}", 1
    )
    assert scene_of(tmp_path, text).warnings() == ["materials: spare is not used"]


def test_a_magnetic_material_without_a_direction_is_told(five: Scene) -> None:
    """Segments that are left out or written as zeros; not where nothing magnetic is simulated, nor a material without remanence."""
    directions = np.array([region.magnetization for region in five.regions()])
    directions[[1, 3]] = 0.0
    bare = five.with_magnetizations(directions)
    (told,) = bare.warnings()
    assert "body.catheter.segments[1], body.catheter.segments[3]: not magnetized" in told
    assert "magnetic silicone has a remanence of 138 mT" in told
    assert "give a direction" in told
    assert five.warnings() == []
    assert (
        bare.with_effects(magnetic_torque=None, gravity={}).with_field([0, 0, 0]).warnings() == []
    )
    assert bare.with_material("magnetic silicone", remanence=0.0).warnings() == []


def test_the_layout_of_the_file_is_not_in_the_hash(five: Scene, tmp_path: Path) -> None:
    text = (
        FIVE.read_text()
        .replace("40 mm", "0.04 m")
        .replace("8 mT]", "80 G]")
        .replace("120 kPa", "0.12 MPa")
    )
    text = text.replace("30 deg", "0.52359877559829887 rad").replace(
        "name: five-segment catheter", "name: other"
    )
    head, rest = text.split("materials:", 1)
    materials, rest = rest.split("body:", 1)
    other = scene_of(tmp_path, f"{head}body:{rest}\nmaterials:{materials}")
    assert other.hash() == five.hash()
    assert len(five.hash()) == 64
    assert other != five  # the name differs


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("length: 40 mm", "length: 40.000001 mm"),
        ("diameter: 4 mm", "diameter: 4 mm\n    inner_diameter: 1 mm"),
        ("shear_modulus: 120 kPa", "shear_modulus: 121 kPa"),
        ("8 mT]", "8.1 mT]"),
        ("[1, 0, 0]", "[1, 0, 1e-6]"),
        ("[1, 0, 0]", "[-1, 0, 0]"),
        ("cells_across: 4", "cells_across: 5"),
        ("magnetic_torque: {}", "magnetic_torque: {}\n  gravity: {}"),
        ("static: {}", "anti_locking: none"),
    ],
)
def test_what_decides_the_answer_is_in_the_hash(
    five: Scene, tmp_path: Path, old: str, new: str
) -> None:
    assert scene_of(tmp_path, FIVE.read_text().replace(old, new, 1)).hash() != five.hash()


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_shipped_scenes_fit_the_schema_and_are_rebuilt_from_their_own_data(path: Path) -> None:
    Draft202012Validator(json_schema(Scene)).validate(dict(read_yaml(path)))
    scene = load_scene(path)
    assert scene.warnings() == []
    again = Scene.from_si(json.loads(json.dumps(scene.to_si())))
    assert again == scene
    assert again.to_si() == scene.to_si()  # bitwise: directions are not normalized anew
    assert again.hash() == scene.hash()
    assert hash(again) == hash(scene)
    assert pickle.loads(pickle.dumps(scene)) == scene == copy.deepcopy(scene)


def test_scenes_are_immutable(five: Scene) -> None:
    with pytest.raises(ValidationError):  # of pydantic, as of all that is frozen
        five.name = "x"  # type: ignore[misc]
    with pytest.raises(ValidationError):
        five.body.catheter.segments[0].length = 1.0  # type: ignore[misc]
    for change in (
        lambda m: m.update(a=1),
        lambda m: m.pop("magnetic silicone"),
        lambda m: m.clear(),
    ):
        with pytest.raises(TypeError, match="immutable"):
            change(five.materials)
    with pytest.raises(TypeError, match="immutable"):
        five.materials["new"] = five.materials["magnetic silicone"]


def made_in_python(**changes: Any) -> Scene:
    """A rod of objects, some of them others."""
    segments = changes.pop("segments", [Segment(magnetization=(1, 0, 0))])
    material = changes.pop("material", "silicone")
    rod = Catheter(length=0.04, diameter=4e-3, material=material, segments=segments)
    silicone = Material(shear_modulus=120e3, bulk_to_shear=20, density=1100)
    effects = [MagneticTorque(), Gravity()]
    data = {"body": rod, "effects": effects, "materials": {"silicone": silicone}}
    return Scene(**{"name": "made", **data, **changes})


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"material": "silicon"}, 'Scene: body.material: received "silicon"'),
        ({"material": "silicon"}, 'did you mean "silicone"?'),
        (
            {"segments": [Segment(magnetization=(1, 0, 0), material="steel")]},
            'Scene: body.segments[0].material: received "steel"',
        ),
        ({"effects": [Gravity(), "damping"]}, 'Scene: effects[1]: received "damping"'),
        (
            {"materials": {"silicone": Material(shear_modulus=120e3, bulk_to_shear=20)}},
            "Scene: materials.silicone.density: received nothing",
        ),
    ],
)
def test_rules_of_the_whole_scene_are_told_in_python(changes: dict[str, Any], told: str) -> None:
    """By key and value of the objects that were given, not as pydantic's error."""
    with pytest.raises(InputError, match=r".") as error:
        made_in_python(**changes)
    assert told in str(error.value)


def test_one_effect_needs_no_list() -> None:
    one = made_in_python(effects=Gravity())
    assert list(one.effects.named()) == ["gravity"]
    assert one == made_in_python(effects=[Gravity()])


def test_a_key_that_is_there_already_is_not_what_was_meant() -> None:
    """Of a tube, `outer_diameter` is the diameter, though `inner_diameter` is spelled more like it."""
    with pytest.raises(InputError, match='did you mean "diameter"'):
        Catheter(length=0.04, outer_diameter=4e-3, material="m", segments=[])  # type: ignore[call-arg]


def test_scenes_are_made_in_python_in_si() -> None:
    silicone = Material(shear_modulus=120e3, bulk_to_shear=20, density=1882.0, remanence="138 mT")  # type: ignore[arg-type]
    segment = Segment(magnetization=(3, 0, 4))
    scene = Scene(
        name="made in Python",
        materials={"silicone": silicone},
        body=Body(
            catheter=Catheter(length=0.04, diameter=4e-3, material="silicone", segments=(segment,))
        ),
        field=FieldSource(uniform=(0, 0, 5e-3)),
        effects=Effects(magnetic_torque=MagneticTorque(), gravity=Gravity()),
    )
    assert scene.materials["silicone"].remanence == 0.138
    assert scene.body.catheter.segments[0].magnetization == pytest.approx((0.6, 0, 0.8), rel=1e-15)
    assert scene.effects.gravity.acceleration == (0.0, 0.0, -9.81)
    with pytest.raises(InputError, match="finite"):
        Material(shear_modulus=float("nan"), bulk_to_shear=20)
    data = scene.to_si()
    data["body"]["catheter"]["length"] = -1.0
    with pytest.raises(
        InputError, match=r"input: body\.catheter\.length: received -1\.0\n  rule: must be greater"
    ):
        Scene.from_si(data)


def test_with_magnetizations(five: Scene) -> None:
    directions = np.zeros((5, 3))
    directions[:4] = np.random.default_rng(1).normal(size=(4, 3))
    scene = five.with_magnetizations(directions)
    unit = directions[:4] / np.linalg.norm(directions[:4], axis=1, keepdims=True)
    np.testing.assert_allclose(scene.region_remanence()[:4], 0.138 * unit, rtol=1e-14)
    assert scene.magnetized_regions() == [0, 1, 2, 3]
    assert five.magnetized_regions() == [0, 1, 2, 3, 4]
    assert five.with_magnetizations([s.magnetization for s in five.body.catheter.segments]) == five
    assert (
        five.with_magnetizations(np.zeros((5, 3))).magnetized_regions() == []
    )  # no error: a limit to be tested
    with pytest.raises(InputError, match=r"shape \(4, 3\); must be \(5, 3\)"):
        five.with_magnetizations(directions[:4])
    with pytest.raises(InputError, match="finite"):
        five.with_magnetizations(np.full((5, 3), np.nan))


def test_with_field_cells_and_effects(five: Scene) -> None:
    assert five.with_field(np.array([0, 0, 1e-3])).field.uniform == (0.0, 0.0, 1e-3)
    assert five.with_field((0, 0, 0)).field.uniform == (0.0, 0.0, 0.0)
    assert five.with_field(five.field.uniform) == five
    for wrong in (["0 mT", "8 mT"], None, [0, 0], np.zeros((3, 3))):
        with pytest.raises(
            InputError, match=r"field\.uniform(: received [\s\S]*list of 3|\[0\]: received)"
        ):
            five.with_field(wrong)  # type: ignore[arg-type]
    assert five.with_cells(6).resolution.cells_across == 6
    assert five.with_cells(6).with_cells(4) == five
    with pytest.raises(InputError, match="must be at most 16"):
        five.with_cells(100)
    both = five.with_effects(gravity={})
    assert both.effects.magnetic_torque is not None
    assert both.effects.gravity == Gravity()
    assert five.with_effects(gravity=Gravity(acceleration=(0, 0, 0))).effects.gravity == Gravity(
        acceleration=(0, 0, 0)
    )
    assert both.with_effects(gravity=None) == five
    with pytest.raises(InputError, match=r"ground\.point: received nothing"):
        five.with_effects(ground={})
    with pytest.raises(InputError, match="damping acts in motion only"):
        five.with_effects(damping={"rate": 60.0})
    with pytest.raises(InputError, match='did you mean "gravity"'):
        five.with_effects(gravitiy={})


def essence(part: Any, at: str = "") -> set[tuple[str, str]]:
    """The content of a schema, without the wrapping (allOf, anyOf) that differs between versions of pydantic."""
    words = {
        "description",
        "title",
        "pattern",
        "type",
        "enum",
        "const",
        "required",
        "examples",
        "$ref",
    }
    words |= {
        "minimum",
        "maximum",
        "exclusiveMinimum",
        "minItems",
        "maxItems",
        "additionalProperties",
    }
    found = set()
    for key, value in part.items():
        if key in words and not isinstance(value, dict):
            found.add((at, f"{key} = {json.dumps(value)}"))
        for below in value if isinstance(value, list) else [value]:
            if isinstance(below, dict) and key != "examples":
                found |= essence(below, at if key in {"allOf", "anyOf", "oneOf"} else f"{at}/{key}")
    return found


def test_the_committed_schema_is_current() -> None:
    committed = json.loads((ROOT / "magmpm/scene.schema.json").read_text())
    assert essence(committed) == essence(json_schema(Scene)), "run make schema"
    assert (
        "/$defs/Catheter/properties/length",
        'description = "Length of the undeformed catheter."',
    ) in essence(committed)


def test_the_schema_explains_every_key() -> None:
    """By a description and by examples that fit it."""
    whole = json_schema(Scene)
    Draft202012Validator.check_schema(whole)
    for name, part in {"scene": whole, **whole["$defs"]}.items():
        for key, value in part.get("properties", {}).items():
            assert value.get("description"), f"{name}.{key} has no description"
            assert value.get("examples"), f"{name}.{key} has no example"
            for example in value["examples"]:
                Draft202012Validator({**value, "$defs": whole["$defs"]}).validate(example)


def test_the_schema_wants_units_and_knows_no_other_keys() -> None:
    validator = Draft202012Validator(json_schema(Scene))
    data = json.loads(json.dumps(read_yaml(FIVE)))
    data["body"]["catheter"]["length"] = 0.04
    data["body"]["catheter"]["lenght"] = "40 mm"
    assert {error.json_path for error in validator.iter_errors(data)} == {
        "$.body.catheter",
        "$.body.catheter.length",
    }


def test_centreline_tables(tmp_path: Path) -> None:
    rows = np.array([[0, 0, 0, 0], [0.02, 0.0195, 1e-6, 0.003]])
    write_centreline(tmp_path / "a.csv", rows, comment="made here\nin two lines")
    np.testing.assert_allclose(
        read_centreline(tmp_path / "a.csv"), rows, rtol=0, atol=5e-10
    )  # written to 1 nm
    (tmp_path / "b.csv").write_text("# note\n\nz_mm, s_mm, x_mm, y_mm\r\n3,0,1,2\r\n\n6,1,4,5\n")
    np.testing.assert_allclose(
        read_centreline(tmp_path / "b.csv"),
        1e-3 * np.array([[0, 1, 2, 3], [1, 4, 5, 6]]),
        rtol=1e-15,
    )
    (tmp_path / "c.csv").write_text("s_mm,x_mm,y_mm,z_mm\n-1,0,0,0\n1,1,0,0\n")
    with pytest.raises(
        InputError, match=r"c\.csv:2: received \"-1,0,0,0\"\n  rule: s_mm must not be negative"
    ):
        read_centreline(tmp_path / "c.csv")
    with pytest.raises(InputError, match="no such file"):
        read_centreline(tmp_path / "d.csv")
    with pytest.raises(
        InputError, match=r"this is a folder\n  rule: the table must be a regular file"
    ):
        read_centreline(tmp_path)


def test_a_wall_is_told_as_an_inner_diameter(tmp_path: Path) -> None:
    text = FIVE.with_name("hollow.yaml").read_text(encoding="utf-8")
    for wall, remedy in (
        ("0.4 mm", "write `inner_diameter: 3.2 mm` in its place"),
        ("3 mm", "write inner_diameter in its place"),
    ):
        path = tmp_path / "tube.yaml"
        path.write_text(text.replace("inner_diameter: 2 mm", f"wall: {wall}"), encoding="utf-8")
        with pytest.raises(InputError, match=remedy):
            load_scene(path)


def test_a_wall_thinner_than_a_cell_is_warned_of() -> None:
    """With the sufficient number of cells: (4 - 3) / 2 mm of wall is half a cell of 1 mm, so with 8 cells it is one cell."""
    data = load_scene(FIVE.with_name("hollow.yaml")).to_si()
    catheter = data["body"]["catheter"]
    catheter["inner_diameter"] = 0.75 * catheter["diameter"]
    data["resolution"]["cells_across"] = 4
    assert not any(
        "cells thick" in text for text in Scene.from_si(data).warnings()
    )  # in statics cells lie around the axis
    thin = {
        **data,
        "body": {"catheter": {**catheter, "inner_diameter": 0.92 * catheter["diameter"]}},
    }
    assert any(
        "cells thick" in text for text in Scene.from_si(thin).warnings()
    )  # but for walls below 0.1 of the radius
    data["solver"]["dynamic"] = {"duration": 0.1}
    scene = Scene.from_si(data)
    assert any(
        "0.50 cells thick" in text and "cells_across: 8 or more" in text
        for text in scene.warnings()
    )
    assert not any("cells thick" in text for text in scene.with_cells(8).warnings())


@pytest.mark.parametrize("column", _BOUNDS)
def test_bounds_of_a_schedule_s_table_are_a_keyframe_s(column: str) -> None:
    """Keyframes accept the limits of a table, and refuse values just beyond."""
    key = {"B": "uniform", "x": "move", "y": "move", "z": "move"}.get(column[:1], column)
    low, high = _BOUNDS[column][:2]

    def accepts(number: float) -> bool:
        try:
            Keyframe(**{"time": 0.0, key: number if key == column else [number, 0.0, 0.0]})
        except InputError:
            return False
        return True

    assert [accepts(low), accepts(high), accepts(low - 1e-6), accepts(high + 1e-6)] == [
        True,
        True,
        False,
        False,
    ]
