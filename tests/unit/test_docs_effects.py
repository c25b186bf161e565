"""docs/effects.md: its examples are settings that scenes take, and it knows every effect."""

from __future__ import annotations

import re
from pathlib import Path

import yaml

from magmpm import effects
from magmpm.inputs import validate
from magmpm.parts import Effects
from magmpm.surroundings import IN_MOTION

TEXT = (Path(__file__).resolve().parents[2] / "docs/effects.md").read_text(encoding="utf-8")


def test_its_example_names_all_effects_of_motion() -> None:
    (block,) = re.findall(r"```yaml\n(.*?)```", TEXT, re.DOTALL)
    settings = yaml.safe_load(block)
    named = validate(Effects, settings, "effects.md")
    assert set(settings) == set(IN_MOTION)
    assert named.ground is not None
    assert named.ground.friction == 0.3


def test_its_table_has_every_effect() -> None:
    for key in effects.every():
        assert f"| `{key}` |" in TEXT
