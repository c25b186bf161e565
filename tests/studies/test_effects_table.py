"""`magmpm effects`: the estimated influence of each effect on a scene, and its cost per step."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from reference.commands import scene_text
from reference.moving import moving_scene
from reference.scenes import G, rod_scene

from magmpm.effects import acting as effects
from magmpm.effects.acting import Effects
from magmpm.inputs.settings import validate
from magmpm.materials import young_modulus
from magmpm.rod.cosserat import solve_rod
from magmpm.runs import distance
from magmpm.scene import Scene
from magmpm.simulate import run
from magmpm.solving.influence import EffectRow, Variants, advise, motion_seconds
from magmpm.studies.explore.effects_costs import costs
from magmpm.studies.explore.effects_table import needs, survey

FIELD = (0.0, 0.0, 3e-3)
DOWN = (0.0, 0.0, -9.81)


def row(scene: Scene, key: str) -> EffectRow:
    (found,) = survey(scene, measure=False, only=key).effects
    return found


def having(scene: Scene, **settings: dict[str, Any]) -> Scene:
    """The scene with effects of motion, without the rule that statics refuses them."""
    named = validate(Effects, settings, "example.yaml")
    more = {key: getattr(named, key) for key in settings}
    return scene.model_copy(update={"effects": scene.effects.model_copy(update=more)})


def test_every_effect_has_its_row() -> None:
    """Rows in the order of the phases, marked if the scene names the effect; every effect has its own text."""
    table = survey(rod_scene(field=FIELD), measure=False)
    assert [row.effect for row in table.effects] == list(effects.Effects.every())
    assert [row.effect for row in table.effects if row.named] == ["magnetic_torque"]
    assert all(row.effect in table.text() for row in table.effects)
    rows = [row for row in table.effects if f" {row.effect:21} " in table.text()]
    assert len(rows) < len(table.effects)
    assert {row.effect for row in table.effects if row.advice != "irrelevant"} <= {
        row.effect for row in rows
    }
    assert "negligible here: " in table.text()
    assert "negligible here: " not in table.text(every=True)


@pytest.mark.parametrize("resolution", [{"error": 0.001}, {"seconds": 2.0}])
def test_scenes_that_ask_for_an_error_or_a_time(resolution: dict[str, float]) -> None:
    """Advice is for the error asked for; all else is that of the coarsest grid, which such a run tries first."""
    plain = rod_scene(field=FIELD)
    table = survey(Scene.from_si({**plain.to_si(), "resolution": resolution}), measure=False)
    assert table.error_m == pytest.approx(resolution.get("error", 0.01) * plain.length)
    same = survey(plain.with_cells(2), error=table.error_m, measure=False)
    assert [asdict(row) for row in table.effects] == [asdict(row) for row in same.effects]


LOADED = rod_scene(field=(0.0, 0.0, 1e-3), gravity=DOWN)
LYING = rod_scene(gravity=DOWN).with_effects(ground={"point": [0.0, 0.0, -4e-3]})


@pytest.mark.parametrize(
    ("scene", "key"),
    [
        (LOADED, "magnetic_torque"),
        (LOADED, "gravity"),
        pytest.param(LYING, "ground", marks=pytest.mark.slow),
    ],
    ids=["torque", "gravity", "ground"],
)
def test_shifts_are_those_of_finer_runs(scene: Scene, key: str) -> None:
    """A named effect is compared without it; obstacles at rest too. Within what the table says."""
    found = row(scene, key)
    fine = scene.with_cells(4)
    other = scene.with_effects(**{key: None}).with_cells(4)
    assert found.shift_m == pytest.approx(
        distance(run(fine), run(other)), abs=found.uncertainty_m or 0.0
    ), key
    assert found.advice == "keep"


def test_an_effect_that_is_not_named_is_compared_with_it() -> None:
    light = row(rod_scene(field=FIELD), "gravity")
    assert light.advice == "add"
    assert (light.shift_m or 0.0) > 5e-3


def test_damping_is_advised_from_the_first_frequency() -> None:
    """Twice 3.516 sqrt(E I / (rho A L^4)): 60 /s for this catheter."""
    why = row(rod_scene(), "damping").why
    E = young_modulus(G, 20 * G)
    frequency = 3.516 * np.sqrt(E * (4e-3) ** 2 / 16 / 1882) / (40e-3) ** 2
    assert f"{2 * frequency:.3g} 1/s settles" in why


def test_costs_of_what_can_act() -> None:
    """In motion every effect that this body can have is timed, and one that its example does not fit is not; at rest, what acts at rest.

    How much each costs is for `make bench`: a test that times fails on a busy machine."""
    found = costs(moving_scene(BODY, {"damping": {"rate": 60.0}}, field={"uniform": [0, 0, 3e-3]}))
    assert {"magnetic_torque", "gravity", "viscosity", "walls", "damping"} <= found.keys()
    assert all(np.isfinite(percent) for percent in found.values())
    still = costs(
        rod_scene(field=FIELD, directions=[[1, 0, 0], [1, 0, 0]], density=None, tolerance=1e-9)
    )  # type: ignore[arg-type]
    assert {"magnetic_torque", "magnetic_interaction"} <= still.keys()
    assert not {"damping", "viscosity", "ground"} & still.keys()


def test_the_command(tmp_path: Path, told) -> None:
    """One JSON object, or a table for people; a broken scene ends with status 2."""
    scene = tmp_path / "scene.yaml"
    scene.write_text(scene_text())
    found = json.loads(told("effects", scene, "--json", "--quick").out)
    assert {"effect", "named", "shift_m", "uncertainty_m", "cost_percent", "advice", "why"} <= set(
        found["effects"][0]
    )
    assert found["length_m"] == 0.02
    assert "magnetic_torque" in told("effects", scene, "--quick").out
    scene.write_text("name: small\n")
    told("effects", scene, status=2, says="body: received nothing")


BODY = {
    "catheter": {
        "length": 40e-3,
        "diameter": 4e-3,
        "material": "m",
        "segments": [{"magnetization": [1, 0, 0]}],
    }
}


@pytest.mark.slow
def test_walls_of_a_vessel_are_not_without_effect(told) -> None:
    """They move the fed catheter's axis by 5.729 and 5.718 mm at the end of runs on 3 and 4 cells, where it moves farthest; gravity by
    0.25 mm there and a millimeter before it meets the wall, and damping hardly matters."""
    path = str(Path(__file__).parents[2] / "data/scenes/fed_into_vessel.yaml")
    found = {
        row["effect"]: row
        for row in json.loads(told("effects", path, "--quick", "--json").out)["effects"]
    }
    assert {key: found[key]["advice"] for key in ("walls", "feed", "gravity", "damping")} == {
        "walls": "keep",
        "feed": "keep",
        "gravity": "add",
        "damping": "drop",
    }
    walls = found["walls"]
    assert (
        abs(walls["shift_m"] - 5.72e-3) < walls["uncertainty_m"] < 0.2e-3
    )  # looked at with one cell more, as all contact is
    assert found["feed"]["shift_m"] == pytest.approx(60e-3 * 0.25, rel=0.05)  # speed times duration
    for key in ("magnetic_torque", "magnetic_interaction", "ground", "viscosity"):
        assert found[key]["advice"] == "irrelevant", key
    assert "does not say its viscosity" in found["viscosity"]["why"]


@pytest.mark.slow
def test_motions_tell_whether_a_body_touches_the_ground() -> None:
    """Let go under its weight it swings to nearly twice the depth of its equilibrium, which stays clear of a ground 3 mm further down."""
    low = -float(solve_rod(rod_scene(gravity=DOWN, shear=240e3)).position[:, 2].min())
    depths = [-low - 2e-3 - gap for gap in (1e-3, 30e-3)]
    effects = {"gravity": {}, "damping": {"rate": 1e-6}}
    scenes = [
        moving_scene(BODY, {**effects, "ground": {"point": [0, 0, z]}}, duration=0.1, shear=240e3)
        for z in depths
    ]
    near, far = (row(scene, "ground") for scene in scenes)
    assert (near.advice, far.advice) == ("keep", "drop")
    assert far.shift_m == 0.0


@pytest.mark.slow
def test_advice_for_a_body_that_nothing_holds() -> None:
    body = {"catheter": {**BODY["catheter"], "clamp": "none"}}
    effects = {"gravity": {}, "damping": {"rate": 1e-6}, "ground": {"point": [0, 0, -5e-3]}}
    scene = moving_scene(body, effects, field={"uniform": [0, 0, 3e-3]}, duration=0.05)
    assert {key: row(scene, key).advice for key in ("ground", "magnetic_torque")} == {
        "ground": "keep",
        "magnetic_torque": "add",
    }


def test_a_body_that_can_not_begin_has_no_table(tmp_path: Path, told) -> None:
    """A tube that does not contain the body and is out of its reach: `run` and the table refuse it, with file and line."""
    path = tmp_path / "scene.yaml"
    far = "walls: {tube: {radius: 5 mm, path: [[480 mm, 0 mm, 0 mm], [560 mm, 0 mm, 0 mm]]}}"
    effects = f"\n  magnetic_torque: {{}}\n  damping: {{rate: 60 1/s}}\n  {far}"
    path.write_text(
        scene_text(
            "far tube", length="40 mm", effects=effects, solver="{dynamic: {duration: 0.1 s}}"
        )
    )
    says = (
        f"{path}:8: effects.walls: ",
        "the body starts outside the lumen, before an open end of its tube",
    )
    for command in (["effects", path, "--quick"], ["run", path, "--out", tmp_path / "out"]):
        assert told(*command, status=2, says=says).out == ""


def strip(width: float, clamp: str = "base", shear: float = 7e6, length: float = 20e-3) -> Scene:
    """A strip 1 mm thick, magnetized along its length, across a field of 1 mT; where both ends are held, one half against the other."""
    body = {"length": length, "width": width, "thickness": 1e-3, "material": "m", "clamp": clamp}
    half = {"magnetization": [1.0, 0.0, 0.0], "length": length / 2}
    segments = [
        half,
        {"magnetization": [-1.0 if clamp == "both" else 1.0, 0.0, 0.0], "length": length / 2},
    ]
    materials = {
        "m": {"shear_modulus": shear, "bulk_to_shear": 20.0, "density": 1882.0, "remanence": 0.1}
    }
    about = {
        "name": "strip",
        "effects": {"magnetic_torque": {}},
        "field": {"uniform": [0.0, 0.0, 1e-3]},
        "resolution": {"cells_across": 2},
    }
    return Scene.from_si(
        {**about, "materials": materials, "body": {"strip": {**body, "segments": segments}}}
    )


@pytest.mark.slow
def test_shifts_of_a_strip_held_at_both_ends_are_those_of_whole_runs() -> None:
    """With and without each effect, within what the table says that it is uncertain by."""
    asked = strip(5e-3, "both", 1e6, 30e-3)
    for key in ("magnetic_torque", "gravity"):
        moved = distance(
            run(asked.with_effects(**{key: {}})), run(asked.with_effects(**{key: None}))
        )
        found = row(asked, key)
        assert found.shift_m == pytest.approx(moved, abs=found.uncertainty_m or 0.0), key


@pytest.mark.slow
def test_more_blocks_than_may_act_on_each_other_cost_nothing_that_is_not_named() -> None:
    """A wide strip has 3 200 blocks, more than magnetic_interaction takes: it is not named, and its table is made."""
    (found,) = survey(strip(40e-3), only="magnetic_interaction").effects
    assert found.advice == "irrelevant"
    assert "magnetic_interaction" not in costs(strip(40e-3))


def test_a_motion_that_takes_too_long_is_judged_by_its_first_part() -> None:
    """Its weight moves it by a tenth of its length soon, and how far in all is not known."""
    swinging = moving_scene(BODY, {"gravity": {}, "damping": {"rate": 1e-6}})
    told = advise(swinging, "gravity", Variants(swinging, longest=0.05))
    assert (told.shift_m, told.advice) == (None, "keep")
    assert "more than 1 % of its length, within its first" in told.why


def test_a_viscous_motion_is_estimated_by_the_steps_that_it_takes() -> None:
    """40 us a step and 15 million particles a second, in steps of the body's bound, to the 10 % by which steps shorten as it bends."""
    swinging = moving_scene(BODY, {"gravity": {}, "viscosity": {"viscosity": 20.0}}, duration=2e-3)
    result = run(swinging)
    expected = result.iterations * (40e-6 + result.particles / 15e6)
    assert motion_seconds(swinging) == pytest.approx(expected, rel=0.1)


@pytest.mark.slow
def test_a_motion_that_takes_too_long_is_judged_by_its_rest() -> None:
    """A slow one moves by less than the error in its first part, and is at rest by more."""
    data = rod_scene(field=FIELD).to_si()
    data["effects"]["viscosity"] = {"viscosity": 15000.0}
    slow = Scene.from_si({**data, "solver": {"dynamic": {"duration": 60.0}}})
    found = row(slow, "gravity")
    assert (found.shift_m, found.advice) == (None, "add")
    assert "in motion not estimated: a whole run takes too long" in found.why
    assert row(slow, "viscosity").advice == "keep"


class Known(Variants):
    """Variants whose distances (mm) on the coarsest grid and on a finer one are given."""

    millimeters = (0.0, 0.0)

    def _distance(self, scene: Scene, other: Scene, finer: int) -> float:
        return 1e-3 * self.millimeters[min(finer, 1)]


@pytest.mark.parametrize(
    ("shift", "finer", "value", "uncertainty"),
    [(0.4, 9.9, 0.4, 0.2), (0.9, 1.2, 1.2, 0.3), (1.6, 1.2, 1.2, 0.4)],
)
def test_what_may_matter_is_looked_at_with_one_cell_more(
    shift: float, finer: float, value: float, uncertainty: float
) -> None:
    """A shift below half of the error is not; of others the grid's part is known, and the uncertainty is no smaller (mm)."""

    scene = rod_scene(field=FIELD)
    known = Known(scene, error=1e-3)
    known.millimeters = (shift, finer)
    found = known.shift(scene, scene)
    assert found.value == pytest.approx(1e-3 * value)
    assert 1e-3 * uncertainty * (1 - 1e-9) <= found.uncertainty < 1.2e-3 * uncertainty


@pytest.mark.parametrize(
    ("ground", "value"), [({}, 2.0), ({"ground": {"point": [0, 0, -0.1]}}, 2.3)]
)
def test_shifts_where_a_body_may_touch_are_those_of_a_finer_grid(
    ground: dict[str, Any], value: float
) -> None:
    """Of ten fed motions in a vessel, shifts of damping and gravity were off by 9 to 22 % on 2 cells in four; without contact by 2.5 % at
    most.
    """
    scene = moving_scene(BODY, {"gravity": {}, "damping": {"rate": 1.0}, **ground}, duration=1e-4)
    known = Known(scene, error=1e-3)
    known.millimeters = (2.0, 2.3)
    found = known.shift(scene, scene.with_effects(gravity=None))
    assert found.value == pytest.approx(1e-3 * value)
    assert (found.uncertainty > 0.3e-3) == bool(ground)


def test_a_rod_would_do_where_it_was_found_to() -> None:
    """Compared with equilibria: 1.1 % of this catheter's deflection."""
    scene = rod_scene(field=FIELD)
    [need] = [
        one
        for one in needs(scene, Variants(scene, scene.allowed_error))
        if one.question == "three dimensions"
    ]
    fine = run(scene.with_cells(5)).centreline
    rod = solve_rod(scene)
    off = float(np.linalg.norm(fine[:, 1:] - fine[0, 1:] - rod.at(fine[:, 0]), axis=1).max())
    assert need.error_added_m is not None
    assert off < need.error_added_m < off + 0.005 * scene.length
    assert need.needed is (need.error_added_m > 0.01 * scene.length)


@pytest.mark.slow
def test_a_slow_feed_needs_no_dynamics() -> None:
    """A catheter that is pushed slowly goes through equilibria, which solver.quasi_static gives."""
    data = rod_scene(field=(0.0, 0.0, 0.5e-3)).to_si()
    data["effects"].update(feed={"speed": 0.002, "exit": 0.02}, damping={"rate": 300.0})
    slow = Scene.from_si({**data, "solver": {"dynamic": {"duration": 0.2}}})
    [need] = [
        one for one in needs(slow, Variants(slow, slow.allowed_error)) if one.question == "dynamics"
    ]
    assert "can only be had in motion" not in need.why
