"""docs/effects.md: its examples are valid settings, and it lists every effect."""

from __future__ import annotations

import re
from pathlib import Path

import yaml

from magmpm.effects import acting as effects
from magmpm.effects.acting import NO_LOADS, Effects
from magmpm.inputs.settings import validate

TEXT = (Path(__file__).resolve().parents[3] / "docs/effects.md").read_text(encoding="utf-8")


def test_its_example_names_all_effects_but_loads() -> None:
    (block,) = re.findall(r"```yaml\n(.*?)```", TEXT, re.DOTALL)
    settings = yaml.safe_load(block)
    named = validate(Effects, settings, "effects.md")
    assert set(settings) == set(NO_LOADS)
    assert named.ground is not None
    assert named.ground.friction == 0.3


def test_its_table_has_every_effect() -> None:
    for key in effects.Effects.every():
        assert f"| `{key}` |" in TEXT
