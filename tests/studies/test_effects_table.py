"""`magmpm effects`: what each effect would do to a scene, from estimates, and what it costs a step."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from reference.scenes import G, rod_scene

from magmpm import effects
from magmpm.cli import main
from magmpm.inputs import validate
from magmpm.materials import young_modulus
from magmpm.parts import Effects
from magmpm.rod import solve_rod
from magmpm.scene import Scene
from studies.effects_table import Row, costs, survey

FIELD, DOWN = (0.0, 0.0, 3e-3), (0.0, 0.0, -9.81)


def rows(scene: Scene) -> dict[str, Row]:
    return {row.effect: row for row in survey(scene, measure=False).rows}


def having(scene: Scene, **settings: dict[str, Any]) -> Scene:
    """The scene with effects of motion as well, past the rule that statics has no use for them."""
    named = validate(Effects, settings, "example.yaml")
    more = {key: getattr(named, key) for key in settings}
    return scene.model_copy(update={"effects": scene.effects.model_copy(update=more)})


def test_every_effect_has_its_row() -> None:
    """In the order of the phases; marked where the scene names it; and each file says something of its own."""
    table = survey(rod_scene(field=FIELD), measure=False)
    assert [row.effect for row in table.rows] == list(effects.every())
    assert [row.effect for row in table.rows if row.named] == ["magnetic_torque"]
    assert len({row.says for row in table.rows}) == len(table.rows)
    assert all(row.effect in table.text() for row in table.rows)


def test_shifts_are_the_rods() -> None:
    """Of a named effect, without it; of one not named, with it."""
    scene = rod_scene(field=FIELD)
    found = rows(scene)
    named, bare = solve_rod(scene).position, solve_rod(scene.with_effects(magnetic_torque=None)).position
    assert found["magnetic_torque"].shift == pytest.approx(np.linalg.norm(named - bare, axis=1).max())
    heavy = solve_rod(scene.with_effects(gravity={})).position
    assert found["gravity"].shift == pytest.approx(np.linalg.norm(heavy - named, axis=1).max())
    assert found["gravity"].shift > 5e-3


def test_damping_is_advised_from_the_first_frequency() -> None:
    """Twice 3.516 sqrt(E I / (rho A L^4)): 60 /s for the catheter of DESIGN section 8."""
    says = rows(rod_scene())["damping"].says
    E = young_modulus(G, 20 * G)
    frequency = 3.516 * np.sqrt(E * (4e-3) ** 2 / 16 / 1882) / (40e-3) ** 2
    assert f"{2 * frequency:.3g} 1/s settles" in says


def test_obstacles_are_looked_for_at_rest() -> None:
    """The resting body, were the obstacle not there, against plane and tube: by the tip's deflection and the radius."""
    scene = rod_scene(gravity=DOWN)
    low = solve_rod(scene).position[:, 2].min()
    plane = {"ground": {"point": ["0 mm", "0 mm", "-5 mm"]}}
    ends = [["-10 mm", "0 mm", "0 mm"], ["60 mm", "0 mm", "0 mm"]]
    lumen = {"walls": {"tube": {"radius": "5 mm", "path": ends}}}
    found = rows(having(scene, **plane, **lumen))
    assert found["ground"].shift == pytest.approx(-low - 5e-3 + 2e-3)
    assert found["walls"].shift == pytest.approx(-low - 5e-3 + 2e-3, rel=1e-6)
    straight = rows(having(rod_scene(), **plane, **lumen))
    assert straight["ground"].says == "the body comes to rest 3 mm above it"
    assert straight["walls"].says == "the body comes to rest 3 mm from it"


def test_costs_are_measured_for_what_has_a_part_in_a_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of three effects (each compiles a kernel): contact gathers velocities as well, and can't come for nothing."""
    three = {key: effects.module_of(key) for key in ("damping", "ground", "self_contact")}
    monkeypatch.setattr(effects, "every", lambda: three)
    found = costs(rod_scene(length=12e-3, density=None))  # type: ignore[arg-type]  # a static scene need not have one
    assert set(found) == {"damping", "ground"}
    assert found["ground"] > 0


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One JSON object, or a table for people; a broken scene ends with status 2."""
    scene = tmp_path / "scene.yaml"
    scene.write_text(
        "name: small\nmaterials:\n  m: {shear_modulus: 120 kPa, bulk_to_shear: 20, density: 1882 kg/m^3, remanence: 100 mT}\n"
        "body: {catheter: {length: 20 mm, diameter: 4 mm, material: m, segments: [{magnetization: [1, 0, 0]}]}}\n"
        "field: {uniform: [0 mT, 0 mT, 5 mT]}\neffects: {magnetic_torque: {}}\n"
    )
    assert main(["effects", str(scene), "--json", "--quick"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert {"effect", "named", "shift", "cost_percent", "says"} == set(told["rows"][0])
    assert told["length"] == 0.02
    assert main(["effects", str(scene), "--quick"]) == 0
    assert "magnetic_torque" in capsys.readouterr().out
    scene.write_text("name: small\n")
    assert main(["effects", str(scene)]) == 2
    assert "body: received nothing" in capsys.readouterr().err
