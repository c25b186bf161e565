"""Every example of docs/fields.md is a valid field of a scene."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from magmpm.fields.sources import FieldSource
from magmpm.scene import load_scene

ROOT = Path(__file__).parents[3]
EXAMPLES = re.findall(r"```yaml\n(field:.*?)```", (ROOT / "docs/fields.md").read_text(), re.DOTALL)
SCENE = """name: example
materials: {silicone: {shear_modulus: 120 kPa, bulk_to_shear: 20, remanence: 138 mT}}
body: {catheter: {length: 40 mm, diameter: 4 mm, material: silicone, segments: [{magnetization: [1, 0, 0]}]}}
effects: {magnetic_torque: {}, magnetic_force: {}}
"""


@pytest.mark.parametrize("number", range(len(EXAMPLES)))
def test_example_is_valid(number: int, tmp_path: Path) -> None:
    (tmp_path / "measured").symlink_to(ROOT / "data/measured")
    (tmp_path / "scenes").mkdir()
    path = tmp_path / "scenes" / "probe.yaml"
    path.write_text(SCENE + EXAMPLES[number])
    assert load_scene(path).field.acts


def test_the_examples_name_every_source() -> None:
    assert all(re.search(rf"^  {key}:", "".join(EXAMPLES), re.MULTILINE) for key in FieldSource.model_fields)
