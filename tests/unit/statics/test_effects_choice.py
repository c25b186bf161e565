"""`effects: auto`, and the warnings of `magmpm run` about effects that are not named."""

from __future__ import annotations

from pathlib import Path

import pytest
from reference.scenes import rod_scene

from magmpm.effects.acting import Effects
from magmpm.errors import InputError
from magmpm.model import build
from magmpm.scene import Scene, load_scene
from magmpm.simulate import missed_effects, run
from magmpm.statics.effects_choice import choose_effects

TEXT = """
name: small
materials: {m: {shear_modulus: 120 kPa, bulk_to_shear: 20, density: 1882 kg/m^3, remanence: 100 mT}}
body: {catheter: {length: 40 mm, diameter: 4 mm, material: m, segments: [{magnetization: [1, 0, 0]}]}}
field: {uniform: [0 mT, 0 mT, FIELD]}
effects: EFFECTS
resolution: {cells_across: 2}
"""


def written(folder: Path, effects: str, field: str = "5 mT", more: str = "") -> Scene:
    path = folder / "scene.yaml"
    path.write_text(TEXT.replace("EFFECTS", effects).replace("FIELD", field) + more)
    return load_scene(path)


def test_auto_takes_what_moves_the_answer_and_leaves_the_rest(tmp_path: Path) -> None:
    """5 mT and weight bend this catheter by centimeters; 1 uT by 4 um: left out, and gravity alone gives the same answer."""
    choice = choose_effects(written(tmp_path, "auto"))
    assert set(choice.scene.effects.named()) == {"magnetic_torque", "gravity"}
    assert [one["effect"] for one in choice.told] == list(Effects.every())
    result = run(written(tmp_path, "auto", field="0.001 mT"))
    assert result.effects_chosen is not None
    assert [one["effect"] for one in result.effects_chosen if one["chosen"]] == ["gravity"]
    named = run(written(tmp_path, "{gravity: {}}", field="0.001 mT"))
    assert result.particle_position.tobytes() == named.particle_position.tobytes()
    torque = next(one for one in result.effects_chosen if one["effect"] == "magnetic_torque")
    assert 0 < torque["shift_m"] < 1e-5
    assert "less than 1 %" in torque["why"]


def test_the_asked_error_decides(tmp_path: Path) -> None:
    """The same field, for a tenth of a micrometer."""
    scene = written(tmp_path, "auto", field="0.001 mT")
    data = scene.to_si()
    fine = Scene.from_si({**data, "resolution": {"error": "0.1 um"}})
    assert set(choose_effects(fine).scene.effects.named()) == {"magnetic_torque", "gravity"}


def test_what_is_not_named_and_matters_is_told_once(tmp_path: Path) -> None:
    """Gravity moves it by half of its length; a field of 1 uT does not matter; `advice: off` silences it and changes no hash."""
    scene = written(tmp_path, "{magnetic_torque: {}}")
    told = missed_effects(scene)
    assert len(told) == 1
    assert "gravity is not named" in told[0]
    quiet = written(tmp_path, "{magnetic_torque: {}}", more="advice: off\n")
    assert missed_effects(quiet) == []
    assert quiet.hash() == scene.hash()
    assert missed_effects(written(tmp_path, "{gravity: {}}", field="0.001 mT")) == []
    assert missed_effects(rod_scene(field=(0.0, 0.0, 5e-3), density=None)) == []  # type: ignore[arg-type]  # nothing known of its weight


def test_effects_named_beside_auto_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"effects.auto: (.|\n)*names gravity as well"):
        written(tmp_path, "{auto: true, gravity: {}}")
    with pytest.raises(InputError, match="effects must be named"):
        build(written(tmp_path, "auto"))
