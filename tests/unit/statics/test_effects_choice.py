"""`effects: auto`, and the warnings of `magmpm run` about effects that are not named."""

from pathlib import Path

import numpy as np
import pytest
from reference.moving import resting_scene
from reference.scenes import rod_scene

from magmpm.effects.acting import Effects
from magmpm.errors import InputError
from magmpm.model import build
from magmpm.scene import Scene, load_scene
from magmpm.simulate import run, simulated
from magmpm.solving.effects_choice import choose_effects, missed_effects
from magmpm.solving.solve import RunOptions
from magmpm.statics.energy import Energy
from magmpm.statics.equilibrium import solve_static
from magmpm.statics.layout import static_model
from magmpm.statics.unnamed_loads import _stretched, first_order

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
    assert [one["effect"] for one in choice.reasons] == list(Effects.every())
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
    fine = Scene.from_si({**scene.to_si(), "resolution": {"error": "0.1 um"}})
    assert set(choose_effects(fine).scene.effects.named()) == {"magnetic_torque", "gravity"}


def told(scene: Scene) -> list[str]:
    """Effects of which a run warns that they are not named."""
    return [
        one.split()[1]
        for one in simulated(scene, RunOptions(advise=True)).warnings
        if "may move the answer" in one
    ]


def test_what_is_not_named_and_matters_is_told_once(tmp_path: Path) -> None:
    """Gravity moves it by half of its length; `advice: off` silences it and changes no hash; a stiff body has little weight."""
    scene = written(tmp_path, "{magnetic_torque: {}}")
    assert told(scene) == ["gravity"]
    assert told(Scene.from_si({**scene.to_si(), "resolution": {"error": 0.02}})) == ["gravity"]
    quiet = written(tmp_path, "{magnetic_torque: {}}", more="advice: off\n")
    assert told(quiet) == []
    assert quiet.hash() == scene.hash()
    assert told(rod_scene(field=(0.0, 0.0, 5e-3), density=None)) == []  # type: ignore[arg-type]  # nothing known of its weight
    assert told(rod_scene(field=(0.0, 0.0, 2e-3), shear=100 * 120e3)) == []


def test_a_path_and_a_motion_are_told_of_their_weight() -> None:
    """A path by its last equilibrium; a motion by its rod, and by what it reaches in its time: not in a hundredth of its period."""
    data = rod_scene(field=(0.0, 0.0, 2e-3)).to_si()
    over_time = {**data["field"], "over_time": {"ramp": {"duration": 1.0}}}
    assert told(
        Scene.from_si({**data, "field": over_time, "solver": {"quasi_static": {"steps": 2}}})
    ) == ["gravity"]
    moving = {
        time: Scene.from_si({**data, "solver": {"dynamic": {"duration": time}}})
        for time in (0.1, 0.002)
    }
    assert [len(missed_effects(scene)) for scene in moving.values()] == [1, 0]
    assert missed_effects(moving[0.1].with_effects(gravity={})) == []
    assert (
        missed_effects(moving[0.1].with_effects(ground={"point": [0, 0, -3e-3]})) == []
    )  # which may hold it


@pytest.mark.slow
def test_segments_that_act_on_each_other_are_told() -> None:
    """To first order they bend it by what two solves differ by: strong magnets across each other, in a soft body."""
    halves = [[1, 0, 0], [0, 0, 1]]
    scene = rod_scene(
        field=(0.0, 0.0, 1e-6),
        gravity=(0.0, 0.0, -9.81),
        directions=halves,
        shear=60e3,
        remanence=0.15,
        tolerance=1e-9,
    )
    assert told(scene) == ["magnetic_interaction"]
    named = scene.with_effects(magnetic_interaction={})
    assert told(named) == []
    assert (
        float(np.linalg.norm(run(named).centreline - run(scene).centreline, axis=1).max())
        > scene.allowed_error
    )


def test_effects_named_beside_auto_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"effects.auto: (.|\n)*names gravity as well"):
        written(tmp_path, "{auto: true, gravity: {}}")
    with pytest.raises(InputError, match="effects must be named"):
        build(written(tmp_path, "auto"))


def by_weight(energy: Energy, g: float) -> np.ndarray:
    density = energy.model.density
    return first_order(energy, np.zeros((len(density), 3, 3)), density[:, None] * [0.0, 0.0, -g])


@pytest.mark.slow
def test_a_weight_that_is_not_named_is_told_of_bodies_that_are_no_rods() -> None:
    """A strip that is held at both ends: by the factors of its solve, to first order as two solves say; not where it is silenced."""
    halves = [{"magnetization": [sign, 0.0, 0.0], "length": 15e-3} for sign in (1.0, -1.0)]
    strip = {
        "length": 30e-3,
        "width": 3e-3,
        "thickness": 1e-3,
        "material": "m",
        "clamp": "both",
        "segments": halves,
    }
    few = {"static": {"field_steps": 2}}  # small loads, which a few steps reach as well as many
    scene = resting_scene(
        {"strip": strip},
        {"magnetic_torque": {}},
        shear=1e6,
        field={"uniform": [0.0, 0.0, 1e-3]},
        solver=few,
    )
    data = scene.to_si()
    model = static_model(build(scene))

    def of(one):
        return solve_static(static_model(build(one))).point

    found = solve_static(model)
    assert isinstance(found.energy, Energy)
    little = 1e-3 * 9.81
    apart = (
        of(scene.with_effects(gravity={"acceleration": [0.0, 0.0, -little]})).grid
        - found.point.grid
    )
    shift = by_weight(found.energy, little)
    assert float(np.abs(shift).max()) == pytest.approx(
        float(np.abs(apart).max()), rel=0.1
    )  # coefficients bound their spline's values
    material = data["materials"]["m"]
    softer = {
        shear: Scene.from_si({**data, "materials": {"m": {**material, "shear_modulus": shear}}})
        for shear in (1e5, 1e7)
    }
    assert [told(one) for one in softer.values()] == [
        ["gravity"],
        [],
    ]  # soft, it sags by more than a hundredth of its length
    scene = softer[1e5]
    assert not any(
        "gravity" in one for one in run(scene.model_copy(update={"advice": "off"})).warnings
    )
    assert not any("gravity" in one for one in run(scene.with_effects(gravity={})).warnings)
    body = {**data["body"]["strip"], "length": 20e-3, "width": 1e-3, "thickness": 0.2e-3}
    body["segments"] = [{**half, "length": 10e-3} for half in halves]
    thin = {**data, "field": {"uniform": [0.0, 0.0, 1e-9]}, "body": {"strip": body}}
    first = solve_static(static_model(build(Scene.from_si(thin))))
    assert isinstance(first.energy, Energy)
    sag = float(np.linalg.norm(by_weight(first.energy, 9.81), axis=1).max())
    bare, heavy = (
        run(Scene.from_si(thin).with_effects(gravity=one)).particle_position for one in (None, {})
    )
    true = float(np.linalg.norm(heavy - bare, axis=1).max())
    assert sag > 2.0 * true  # to first order; its longer axis holds it
    assert _stretched(sag, 0.2e-3) == pytest.approx(true, rel=0.05)


def test_small_effects_that_add_up_are_not_left_out_together(tmp_path: Path) -> None:
    """Torque and weight move a stiff catheter by 0.9 % of its length each, to the same side: with neither it would be 1.8 % off."""
    path = tmp_path / "scene.yaml"
    stiff = (
        TEXT.replace("EFFECTS", "auto").replace("FIELD", "-3.5 mT").replace("120 kPa", "5500 kPa")
    )
    path.write_text(stiff)
    choice = choose_effects(load_scene(path))
    found = {one["effect"]: one for one in choice.reasons}
    assert found["magnetic_torque"]["shift_m"] < 0.4e-3
    assert found["gravity"]["shift_m"] < 0.4e-3
    assert set(choice.scene.effects.named()) == {"magnetic_torque"}
    assert "with what else was left out, by 1.8 %" in found["magnetic_torque"]["why"]
    path.write_text(stiff.replace("-3.5 mT", "3.5 mT"))  # to opposite sides: both may be left out
    assert not choose_effects(load_scene(path)).scene.effects.named()
