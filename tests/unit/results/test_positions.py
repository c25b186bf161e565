"""Where the parts of a body are, by their names; and the tip, which parts have only where the scene names one."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from reference.moving import resting_scene
from reference.solids import box, turned

import magmpm
from magmpm.bodies.assembly import different_names
from magmpm.bodies.surface_mesh import Mesh, pack_mesh, write_stl
from magmpm.cli import main
from magmpm.model import build
from magmpm.runs import distance
from magmpm.scene import Scene
from magmpm.studies.fitting import read_measured

NAMES = ("base", "arm", "end")
MESHES = {
    "base": box((-3, -2, -2), (0, 2, 2)),
    "arm": box((0, -2, -2), (8, 2, 2)),
    "end": box((8, -2, -2), (14, 2, 2)),
}  # mm
RAMP = {"over_time": {"ramp": {"duration": 0.1}}}


def parts(
    tip: Any = None,
    names: tuple[str, ...] = NAMES,
    solver: dict[str, Any] | None = None,
    **more: Any,
) -> Scene:
    """A base that is held, an arm, and its end, in a field that bends them up."""
    meshes = [
        {
            "mesh": pack_mesh(mesh),
            "name": name,
            "material": "m",
            "clamp": k == 0,
            "magnetization": [float(k > 0), 0, 0],
        }
        for k, (name, mesh) in enumerate(zip(names, MESHES.values(), strict=True))
    ]
    field = {"uniform": [0.0, 0.0, 10e-3], **(RAMP if solver and "quasi_static" in solver else {})}
    body = {"parts": {"unit": "mm", "spacing": 2e-3, "meshes": meshes, "tip": tip}}
    return resting_scene(
        body, {"magnetic_torque": {}}, field=field, solver=solver or {"static": {}}, **more
    )


@pytest.fixture(scope="module")
def result() -> magmpm.Result:
    """The equilibrium of parts that name no tip."""
    return magmpm.run(parts())


def test_parts_have_positions_by_name_and_no_tip(result: magmpm.Result, tmp_path: Path) -> None:
    assert result.tip is None
    assert tuple(result.positions) == NAMES
    for k, place in enumerate(result.positions.values()):
        mine = result.particle_segment == k
        mean = (
            result.particle_volume[mine]
            @ result.particle_position[mine]
            / result.particle_volume[mine].sum()
        )
        np.testing.assert_allclose(place, mean, atol=1e-16)  # rounding of a few mm
    np.testing.assert_allclose(result.positions["base"], [-1.5e-3, 0, 0], atol=1e-16)
    assert result.positions["end"][2] > result.positions["arm"][2] > 1e-4
    assert "3 parts, moved by at most 1.5" in repr(result)
    assert "tip" not in repr(result)
    page = result._repr_html_()
    assert ">tip<" not in page
    assert all(f">{name}<" in page for name in NAMES)
    saved = json.loads((result.save(tmp_path / "r") / "result.json").read_text())
    assert saved["tip"] is None
    assert saved["positions"] == {name: place.tolist() for name, place in result.positions.items()}
    again = magmpm.Result.load(tmp_path / "r")
    assert again.tip is None
    assert {name: place.tolist() for name, place in again.positions.items()} == saved["positions"]


def test_what_earlier_versions_called_the_tip_of_parts_is_not_read(
    result: magmpm.Result, tmp_path: Path
) -> None:
    before = replace(result, tip=result.segment_center[-1])
    assert magmpm.Result.load(before.save(tmp_path / "r")).tip is None


def test_a_table_of_parts_has_their_names(result: magmpm.Result) -> None:
    pandas = pytest.importorskip("pandas")
    frame = result.to_dataframe()
    assert isinstance(frame, pandas.DataFrame)
    assert list(frame.columns) == ["part", "x_m", "y_m", "z_m"]
    assert list(frame["part"]) == list(NAMES)
    np.testing.assert_array_equal(
        frame[["x_m", "y_m", "z_m"]].to_numpy(), np.stack(list(result.positions.values()))
    )


def test_a_straight_body_has_a_tip_and_no_positions() -> None:
    assert build(parts()).tip_weights is None
    strip = {"length": 6e-3, "width": 2e-3, "thickness": 2e-3, "material": "m", "segments": [{}]}
    scene = resting_scene(
        {"strip": strip}, {"magnetic_torque": {}}, field={"uniform": [0.0, 0.0, 1e-3]}
    )
    found = magmpm.run(scene)
    assert found.positions == {}
    np.testing.assert_allclose(
        found.tip, [6e-3, 0, 0], atol=1e-12
    )  # where the solve ends: nothing is magnetized


def test_a_named_part_or_point_is_the_tip(result: magmpm.Result) -> None:
    """Its center; the point of a particle, wherever that goes; a face's middle, as far as the face's particles say."""
    by_name = magmpm.run(parts("end"))
    np.testing.assert_allclose(by_name.tip, by_name.positions["end"], atol=1e-16)  # rounding
    k = int(np.argmax(result.particle_reference @ [1.0, 0.1, 0.2]))
    by_place = magmpm.run(parts(result.particle_reference[k].tolist()))
    np.testing.assert_allclose(by_place.tip, by_place.particle_position[k], atol=1e-15)  # rounding
    face = magmpm.run(parts([14e-3, 0.0, 0.0]))
    assert "tip (13.9" in repr(face)
    assert face.tip[2] > face.particle_position[:, 2].mean() > 0.0


SPLINES = {
    "on the axes": MESHES["end"],
    "oblique": turned(box((0, -2, -2), (9, 2, 2)), (1, 2, 3), 0.7),
}


@pytest.mark.parametrize("shape", SPLINES)
def test_a_point_moves_as_the_splines_of_the_grid_do(shape: str, rng: np.random.Generator) -> None:
    """Against random coefficients, in full cells to rounding; in cut cells what is linear is exact, and the rest nearly so."""
    mesh = SPLINES[shape]
    base = Mesh(mesh.vertices - [20.0, 0.0, 0.0], mesh.faces)
    corner = mesh.vertices[np.argmax(mesh.vertices[:, 0])]
    inside = mesh.vertices.mean(axis=0)
    for point in (1e-3 * inside, 1e-3 * corner):
        meshes = [
            {"mesh": pack_mesh(base), "name": "base", "material": "m", "clamp": True},
            {"mesh": pack_mesh(mesh), "name": "free", "material": "m"},
        ]
        body = {"parts": {"unit": "mm", "spacing": 1.1e-3, "meshes": meshes, "tip": point.tolist()}}
        model = build(resting_scene(body, {}, solver={"dynamic": {"duration": 1e-3}}))
        weights = model.tip_weights
        assert weights is not None
        position = model.particles.position
        grid = model.grid
        slope = rng.normal(size=(3, 3))
        np.testing.assert_allclose(
            weights @ (position @ slope + 1.0), point @ slope + 1.0, rtol=1e-10
        )  # rounding
        cell = np.clip(
            np.floor((point - grid.origin) / grid.spacing).astype(np.int64),
            0,
            np.array(grid.cells) - 1,
        )
        coefficients = rng.normal(size=grid.nodes)

        def moved(
            points: np.ndarray, cells: np.ndarray, grid: Any = grid, at: np.ndarray = coefficients
        ) -> np.ndarray:
            values = grid.splines(points, cells)[0]
            total = np.zeros(len(points))
            for a, b, c in np.ndindex(3, 3, 3):
                total += (
                    values[:, 0, a]
                    * values[:, 1, b]
                    * values[:, 2, c]
                    * at[tuple((cells + np.array([a, b, c])).T)]
                )
            return total

        found = weights @ moved(position, model.particles.cell)
        want = moved(point[None], cell[None])[0]
        # Cut cells at a corner hold points too close to each other to tell all splines apart: a tenth of what they differ by.
        assert found == pytest.approx(
            want, abs=1e-9 if shape == "on the axes" or point is not corner else 0.1
        )


def test_parts_that_share_a_name_have_their_numbers() -> None:
    assert different_names(["arm", "", "arm", "part 2"]) == (
        "arm (part 1)",
        "part 2 (part 2)",
        "arm (part 3)",
        "part 2 (part 4)",
    )
    scene = parts("arm (part 3)", names=("base", "arm", "arm"))
    assert build(scene).tip_weights is not None
    with pytest.raises(
        magmpm.InputError, match=r"the name of a part that moves: arm \(part 2\), arm \(part 3\)"
    ):
        parts("arm", names=("base", "arm", "arm"))


def test_motions_and_paths_of_parts_keep_where_the_parts_are(tmp_path: Path) -> None:
    moving = parts([14e-3, 0.0, 0.0], solver={"dynamic": {"duration": 2e-3, "output_every": 1e-3}})
    end = magmpm.run(moving, folder=tmp_path / "motion")
    motion = magmpm.Motion.load(tmp_path / "motion")
    assert {name: places.shape for name, places in motion.positions.items()} == dict.fromkeys(
        NAMES, (3, 3)
    )
    for name in NAMES:
        np.testing.assert_allclose(
            motion.positions[name][-1], end.positions[name], atol=1e-15
        )  # rounding
    header, *rows = (tmp_path / "motion" / "positions.csv").read_text().splitlines()
    assert header == "t,part,x,y,z"
    assert len(rows) == 9
    longer = parts([14e-3, 0.0, 0.0], solver={"dynamic": {"duration": 4e-3, "output_every": 1e-3}})
    magmpm.run(longer, folder=tmp_path / "motion", resume=True)
    magmpm.run(longer, folder=tmp_path / "whole")
    tables = [(tmp_path / name / "positions.csv").read_text() for name in ("motion", "whole")]
    assert tables[0] == tables[1]
    assert len(tables[0].splitlines()) == 16
    followed = magmpm.run(parts(solver={"quasi_static": {"steps": 2}}), folder=tmp_path / "path")
    path = magmpm.Motion.load(tmp_path / "path")
    stepped = [step["positions"]["end"] for step in followed.steps]
    np.testing.assert_allclose(path.positions["end"], stepped, atol=1e-15)  # rounding of sums
    assert not [column for column in path.steps if column.startswith(("tip", "positions"))]
    assert not [step for step in followed.steps if "tip" in step]
    lines = (tmp_path / "motion" / "positions.csv").read_text().splitlines(keepends=True)
    (tmp_path / "motion" / "positions.csv").write_text("".join(lines[:4]))
    with pytest.raises(
        magmpm.InputError, match=r"positions\.csv: received 1 rows that do not match the 5 frames"
    ):
        magmpm.Motion.load(tmp_path / "motion")


def test_what_needs_a_tip_says_that_there_is_none(result: magmpm.Result, tmp_path: Path) -> None:
    with pytest.raises(
        magmpm.InputError,
        match=r"no tip unless the scene names one\n.*say `tip: arm` in body.parts",
    ):
        distance(result, result, of="tip")
    assert distance(result, result) == 0.0
    (tmp_path / "tips.csv").write_text("field_z_mT,tip_z_mm\n5,1\n10,2\n")
    with pytest.raises(magmpm.InputError, match="parts have no tip unless the scene names one"):
        read_measured(tmp_path / "tips.csv", parts())
    read_measured(tmp_path / "tips.csv", parts("end"))
    with pytest.raises(magmpm.InputError, match=r"resolution\.of"):
        parts(resolution={"error": 1e-3, "of": "tip"})


def test_the_command_shows_parts_of_a_requested_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its report failed for bodies without an axis."""
    for name, mesh in MESHES.items():
        write_stl(mesh, tmp_path / f"{name}.stl")
    meshes = "".join(
        f"      - {{mesh: {name}.stl, material: m, magnetization: [1, 0, 0], clamp:"
        f" {str(name == 'base').lower()}}}\n"
        for name in NAMES
    )
    (tmp_path / "s.yaml").write_text(
        "name: s\nmaterials: {m: {shear_modulus: 120 kPa, bulk_to_shear: 20, remanence: 100"
        " mT}}\nbody:\n  parts:\n    unit: mm\n    tip: [14 mm, 0 mm, 0 mm]\n   "
        f" meshes:\n{meshes}field: {{uniform: [0 mT, 0 mT, 10 mT]}}\neffects: {{magnetic_torque:"
        " {}}\nadvice: off\nresolution: {error: 5 %, of: tip}\n"
    )
    assert main(["run", str(tmp_path / "s.yaml"), "--out", str(tmp_path / "out")]) == 0
    told = capsys.readouterr().out
    assert "  tip             (13.9" in told
    assert "mm: end\n" in told
    assert "% of the length: 2 cells across" in told
