"""Errors found only when the body is built are refused like those found during loading: file, line, key, value, rule, remedy."""

from __future__ import annotations

from pathlib import Path

import pytest

from magmpm.cli import main
from magmpm.errors import dotted, undotted

SCENE = """\
name: late
materials:
  magnetic: {shear_modulus: 120 kPa, bulk_to_shear: 20, density: 1882 kg/m^3, remanence: 100 mT}
body:
  catheter: {length: 16 mm, diameter: 4 mm, material: magnetic, segments: [{magnetization: [1, 0, 0]}]}
field:
  FIELD
effects:
  magnetic_torque: {}
  magnetic_force: {}
  EFFECT
solver: {dynamic: {duration: 1 ms}}
resolution: {cells_across: 2}
"""
FIELD, EFFECT = "uniform: [0 mT, 2 mT, 20 mT]", "gravity: {}"
TUBE = "walls: {tube: {radius: 3 mm, path: [[0 mm, 9 mm, 0 mm], [40 mm, 9 mm, 0 mm]]}}"
MOMENT = "moment: [0 A*m^2, 0 A*m^2, 0.5 A*m^2]"
NEAR = f"dipole:\n    - {{position: [60 mm, 0 mm, 0 mm], {MOMENT}}}\n    - {{position: [8 mm, 0 mm, 0 mm], {MOMENT}}}"
TURNING = (
    "magnet: {cylinder: {diameter: 20 mm, length: 20 mm}, position: [40 mm, 0 mm, 0 mm], remanence: 1.3 T}\n"
    "  over_time: {rotation: {frequency: 1 Hz, center: [20 mm, 0 mm, 0 mm], axis: [0, 1, 0]}}"
)


@pytest.mark.parametrize(
    ("field", "effect", "where", "says"),
    [
        (FIELD, "ground: {point: [0 mm, 0 mm, 1 mm]}", '11: effects.ground: received {"point": ["0 mm", "0 mm", "1 mm"]}; ',
         ("the body begins 3 mm inside", "just touching", "away from the body")),
        (FIELD, TUBE, '11: effects.walls: received {"tube": {"radius": "3 mm"',
         ("outside the lumen, farthest with segment 1 (body.catheter.segments[0]), at (", "make the lumen wider")),
        (NEAR, EFFECT, '9: field.dipole[1]: received {"position": ["8 mm", "0 mm", "0 mm"]', ("nearer than a cell", "move the dipole")),
        (TURNING, EFFECT, '7: field.magnet: received {"cylinder": {',
         ("the magnet, center (", " s, is in the box around the body", "move the magnet")),
    ],
    ids=["ground", "walls", "dipole", "magnet"],
)  # fmt: skip
def test_file_line_and_value_are_named(
    field: str, effect: str, where: str, says: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if "magnet:" in field:
        pytest.importorskip("magpylib")
    path = tmp_path / "scene.yaml"
    path.write_text(SCENE.replace("FIELD", field).replace("EFFECT", effect))
    assert main(["run", str(path), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    for part in (f"{path}:{where}", "\n  rule: ", "\n  remedy: ", *says):
        assert part in said, f"not said: {part}\nin:\n{said}"


def test_keys_are_read_as_they_are_written() -> None:
    for key in [("field", "dipole", 1, "position"), ("materials", "magnetic silicone", "density"), ("solver", "dynamic", "time_step"), ()]:
        assert undotted(dotted(key)) == key
