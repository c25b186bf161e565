"""magmpm.sensitivities against central differences of equilibria, for every kind of variable, effect of statics and body."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from reference.differences import STEPS, differences, solution, tight
from reference.moving import resting_scene
from reference.solids import ball, box
from scipy.linalg import eigh

import magmpm
from magmpm.bodies.surface_mesh import write_stl
from magmpm.inputs.settings import validate
from magmpm.results.measures import centreline_at
from magmpm.scene import Scene
from magmpm.scene.variables import KINDS, check_differentiable, tangents, variables
from magmpm.solving import solve
from magmpm.statics.changes import touched_by
from magmpm.statics.energy import Energy
from magmpm.statics.interacting import InteractingEnergy
from magmpm.statics.linearized import Linearized
from magmpm.statics.newton import refined
from magmpm.statics.stability import Products, unloaded

MATERIALS = """
name: sensitive
materials:
  soft: {shear_modulus: 100 kPa, bulk_to_shear: 20, density: 1800 kg/m^3, remanence: 100 mT}
  hard: {shear_modulus: 150 kPa, bulk_to_shear: 15, density: 2100 kg/m^3, remanence: 60 mT}
resolution: {cells_across: 2}
solver: {static: {tolerance: 1.0e-14, max_steps: 200}}
"""
CATHETER = """
body:
  catheter:
    length: 24 mm
    diameter: 4 mm
    material: soft
    segments: [{magnetization: [1, 0.2, 0]}, {magnetization: [0, 0, 1], material: hard}, {magnetization: [-0.3, 0.5, 0.6], length: 6.6 mm}]
"""
STRIP = """
body:
  strip:
    length: 20 mm
    width: 4 mm
    thickness: 1.5 mm
    material: soft
    segments: [{magnetization: [1, 0, 0.3], length: 8.2 mm}, {magnetization: [0.5, 0, -0.6], material: hard}]
"""
UNIFORM = "field: {uniform: [1 mT, 4 mT, 7 mT]}\neffects: {magnetic_torque: {}, gravity: {}}\n"
DIPOLE = """
field:
  uniform: [1 mT, 0 mT, 2 mT]
  dipole: {position: [40 mm, 10 mm, 20 mm], moment: [2 A*m^2, 1 A*m^2, -3 A*m^2]}
effects: {magnetic_torque: {}, magnetic_force: {}, gravity: {}}
"""
LUMEN = (
    "gravity: {}, walls: {tube: {radius: 2.5 mm, path: [[-9 mm, 0 mm, 0 mm], [20 mm, 0 mm, 0.1 mm],"
    " [40 mm, 0 mm, 0.6 mm]]}}"
)
CASES = {
    "catheter": CATHETER + UNIFORM,
    "tube": (
        CATHETER.replace("diameter: 4 mm", "diameter: 4 mm\n    inner_diameter: 1.3 mm") + UNIFORM
    ),
    "strip": STRIP + UNIFORM,
    "both ends": STRIP.replace("thickness", "clamp: both\n    thickness") + UNIFORM,
    "plane strain": (
        STRIP.replace("thickness", "plane_strain: true\n    thickness")
        + UNIFORM.replace("4 mT", "0 mT")
    ),
    "pulled": CATHETER + DIPOLE,
    "inserted": CATHETER + UNIFORM + "resolution: {cells_across: 2, from_tip: true}\n",
    "on the ground": (
        CATHETER
        + UNIFORM.replace(
            "gravity: {}",
            "gravity: {}, ground: {point: [0 mm, 0 mm, -3 mm], normal: [0.02, 0.1, 1]}",
        )
    ),
    "in a lumen": CATHETER + UNIFORM.replace("gravity: {}", LUMEN),
    "rotating": CATHETER + UNIFORM,
    "rotating, pulled": CATHETER + DIPOLE,
    "interacting": (
        CATHETER + UNIFORM.replace("gravity: {}", "gravity: {}, magnetic_interaction: {}")
    ),
    "parts": UNIFORM
    + """
body:
  parts:
    unit: mm
    meshes:
    - {mesh: base.stl, material: soft, clamp: true}
    - {mesh: beam.stl, material: soft, magnetization: [1, 0, 0.2]}
    - {mesh: end.stl, material: hard, magnetization: [0.2, 0.3, 1]}
    tip: end
""",
}
CASES["a point of parts"] = CASES["parts"].replace("tip: end", "tip: [1.5 mm, 3 mm, 13 mm]")
RAMP = UNIFORM.replace("}\neffects", ", over_time: {ramp: {duration: 1 s}}}\neffects")
WITHIN = "solver: {quasi_static: {at: [0 s, 0.3 s, 0.7 s]}}\n"  # of the schedule: before it ends
TRAVELS = DIPOLE.replace(
    "effects",
    "  over_time: {keyframes: [{time: 0 s, move: [0 mm, 0 mm, 10 mm]}, {time: 1 s, move: [-6 mm, 0"
    " mm, 0 mm]}]}\neffects",
)
PRESSED = "move: {tip: {along: [-1, 0, 0.1], distance: 1 mm, over_time: {ramp: {duration: 1 s}}}}\n"
PATHS = {
    "ramp": CATHETER + RAMP + WITHIN,
    "turning field": (
        CATHETER
        + RAMP.replace("ramp: {duration: 1 s}", "rotation: {axis: [1, 0.2, 0], frequency: 1 Hz}")
        + WITHIN
    ),
    "traveling magnet": CATHETER + TRAVELS + WITHIN,
    "rotating, traveling magnet": CATHETER + TRAVELS + WITHIN,
    "interacting along a path": (
        CATHETER + RAMP.replace("gravity: {}", "gravity: {}, magnetic_interaction: {}") + WITHIN
    ),
    "pressed and bent": (
        STRIP.replace("thickness", "clamp: both\n    thickness") + RAMP + WITHIN + PRESSED
    ),
}
CASES |= PATHS
MESHES = {
    "base.stl": box((0, 0, -2), (3, 3, 0)),
    "beam.stl": box((0, 0, 0), (3, 3, 9)),
    "end.stl": box((0, 0, 9), (3, 3, 13)),
}  # mm
SLOW = [
    pytest.param(name, marks=pytest.mark.slow)
    for name in (
        "tube",
        "inserted",
        "both ends",
        "plane strain",
        "pulled",
        "rotating",
        "rotating, pulled",
        "interacting",
        "parts",
    )
]
# Of the largest entry. Differences are as exact as solutions, some 1e-11 of the tip's motion, over the step's share in it, 1e-3 or more.
CLOSE = 1e-7


def scene_of(name: str, folder: Path) -> Scene:
    data = yaml.safe_load(MATERIALS) | yaml.safe_load(CASES[name])
    if "rotating" in name:
        data["materials"]["soft"]["magnetization_law"] = "rotates"
    for file, mesh in MESHES.items():
        write_stl(mesh, folder / file)
    return validate(Scene, data, folder / "scene.yaml")


def assert_like(found: np.ndarray, expected: np.ndarray) -> None:
    """Within CLOSE of the largest entry; what is held at both ends does not move but for rounding."""
    np.testing.assert_allclose(
        found, expected, rtol=0, atol=max(CLOSE * np.abs(expected).max(), 1e-15)
    )


@pytest.mark.parametrize("name", ["catheter", *SLOW])
def test_derivatives_are_those_of_equilibria(name: str, tmp_path: Path) -> None:
    """Every variable that the scene has; and the adjoint gives what the columns do."""
    scene = scene_of(name, tmp_path)
    found = magmpm.sensitivities(scene)
    assert len(found.names) == len(set(found.names)) == len(found.units) == found.tip.shape[-1]
    for k, variable in enumerate(found.variables):
        rows, tip = differences(scene, variable)
        assert_like(found.tip[:, k], tip)
        assert found.centreline[..., k].shape == rows.shape
        if len(rows):
            assert_like(found.centreline[..., k], rows)
    gradient = np.random.default_rng(1).standard_normal(found.centreline.shape[:2])
    by_columns = np.einsum("rik,ri->k", found.centreline, gradient)
    np.testing.assert_allclose(
        found.adjoint(gradient),
        by_columns,
        rtol=0,
        atol=1e-8 * np.abs(by_columns).max(initial=1e-300),
    )


SOURCES = """
field:
  uniform: [0 mT, 0 mT, 1 mT]
  magnet: {cylinder: {diameter: 20 mm, length: 20 mm}, position: [30 mm, 5 mm, 35 mm], axis: [0.2, 0, 1], remanence: 1.3 T}
  coils: {position: [0 mm, 0 mm, -60 mm], diameter: 80 mm, current: 5 A, turns: 200}
effects: {magnetic_torque: {}, magnetic_force: {}, gravity: {}}
"""
ADDRESSES = {  # of a scene: addresses, and steps (SI) of differences between equilibria
    CATHETER + SOURCES: {
        "field.magnet[0].position[2]": 1e-5,
        "field.magnet[0].axis[0]": 5e-4,
        "field.coils[0].current": 2e-2,
        "field.coils[0].position[0]": 1e-4,
        "effects.gravity.acceleration[1]": 1e-2,
        "materials.hard.bulk_to_shear": 3e-2,
        "body.catheter.segments[1].magnetization[0]": 1e-3,
    },
    CATHETER + DIPOLE: {
        "field.dipole[0].position[0]": 2e-5,
        "field.dipole[0].moment[2]": 3e-3,
        "field.uniform[0]": 2e-5,
    },
}


@pytest.mark.parametrize(
    "about",
    [
        pytest.param(about, id=name, marks=pytest.mark.slow if name != "dipole" else ())
        for about, name in zip(ADDRESSES, ["magnet and coils", "dipole"], strict=True)
    ],
)
def test_numbers_by_their_addresses_are_differentiated(about: str, tmp_path: Path) -> None:
    """Poses of magnets and dipoles, moments, currents, bulk moduli, directions: as differences of equilibria have it."""
    data = yaml.safe_load(MATERIALS) | yaml.safe_load(about)
    scene = validate(Scene, data, tmp_path / "scene.yaml")
    found = magmpm.sensitivities(scene, list(ADDRESSES[about]))
    assert found.names == tuple(ADDRESSES[about])
    for k, variable in enumerate(found.variables):
        rows, tip = differences(scene, variable, h=ADDRESSES[about][variable.name])
        assert_like(found.tip[:, k], tip)
        assert_like(found.centreline[..., k], rows)
    if "dipole" in about:
        assert found.units == ("m", "A*m^2", "T")
        by_kind = magmpm.sensitivities(scene, ["field"])
        assert_like(found.tip[:, 2], by_kind.tip[:, 0])


@pytest.mark.slow
def test_the_bulk_modulus_of_a_slender_strip(tmp_path: Path) -> None:
    """A strip 50 times as long as thick bends far with it: differences of refined equilibria come near as the square of their step."""
    data = yaml.safe_load(MATERIALS) | yaml.safe_load(STRIP + UNIFORM)
    data["body"]["strip"]["thickness"] = "0.4 mm"
    data["field"]["uniform"] = ["0 mT", "0 mT", "0.5 mT"]
    scene = tight(validate(Scene, data, tmp_path / "scene.yaml"))
    found = magmpm.sensitivities(scene, ["materials.soft.bulk_to_shear"])
    (variable,) = found.variables
    apart = []
    for h in (0.1, 0.03):
        ahead, behind = (solution(variable.changed(scene, side * h))[1] for side in (1, -1))
        apart.append(np.linalg.norm((ahead - behind) / (2 * h) - found.tip[:, 0]))
    assert apart[1] < 1e-5 * np.linalg.norm(found.tip[:, 0])
    assert apart[1] == pytest.approx(0.09 * apart[0], rel=0.1)


def test_what_tells_when_a_path_ends_moves_its_last_step(tmp_path: Path) -> None:
    """Equal steps up to the end of a ramp end in its whole field, however long it takes; a time that is given stays."""
    ramp = CATHETER + RAMP + "solver: {quasi_static: {steps: 2}}\n"
    data = yaml.safe_load(MATERIALS) | yaml.safe_load(ramp)
    scene = validate(Scene, data, tmp_path / "scene.yaml")
    data["solver"] = {"quasi_static": {"at": ["0 s", "0.5 s"]}}
    within = validate(Scene, data, tmp_path / "scene.yaml")
    for one, moves in ((scene, False), (within, True)):
        found = magmpm.sensitivities(one, ["field.over_time.ramp.duration"])
        tip = differences(one, found.variables[0], h=1e-3)[1]
        assert (np.linalg.norm(tip) > 1e-4) == moves
        assert found.tip[:, 0] == pytest.approx(tip, abs=1e-7)


@pytest.mark.slow
def test_numbers_of_parts_by_their_addresses(tmp_path: Path) -> None:
    scene = scene_of("parts", tmp_path)
    of = ["effects.gravity.acceleration[0]", "materials.soft.bulk_to_shear"]
    found = magmpm.sensitivities(scene, of)
    for k, (variable, h) in enumerate(zip(found.variables, (1e-2, 3e-2), strict=True)):
        assert_like(found.tip[:, k], differences(scene, variable, h=h)[1])


@pytest.mark.parametrize(
    ("address", "told"),
    [
        ("field.unifrom[2]", "did you mean field.uniform"),
        ("field.uniform", "must be the address of a real number"),
        ("body.catheter.length", "name `length`"),
        ("resolution.cells_across", "real number"),
    ],
)
def test_addresses_without_a_derivative_are_refused(
    address: str, told: str, tmp_path: Path
) -> None:
    with pytest.raises(magmpm.InputError, match=told):
        magmpm.sensitivities(scene_of("catheter", tmp_path), [address])


def test_a_stream_that_is_not_there_yet_has_no_derivative() -> None:
    """Drag grows with the speed of the slowest stream, and is no load that a still fluid has."""
    still = {"gravity": {}, "fluid": {"density": 1000.0, "viscosity": 1e-3}}
    rod = {"length": 20e-3, "diameter": 4e-3, "material": "m", "segments": [{}]}
    scene = resting_scene({"catheter": rod}, still)
    (found,) = variables(scene, ["effects.fluid.density"])
    assert found.unit == "kg/m^3"
    with pytest.raises(magmpm.InputError, match="makes a stream"):
        variables(scene, ["effects.fluid.velocity[1]"])


@pytest.mark.parametrize(
    "name",
    [name if name == "ramp" else pytest.param(name, marks=pytest.mark.slow) for name in PATHS],
)
def test_along_a_path_they_are_those_of_its_last_equilibrium(name: str, tmp_path: Path) -> None:
    """In the field of that time, with what is moved where it is then; and the result is the path's. One variable of each kind is
    compared: the others of a kind differ at rest, not along a path."""
    scene = scene_of(name, tmp_path)
    found = magmpm.sensitivities(
        scene, [kind for kind in KINDS if kind not in ("length", "diameter")]
    )
    assert len(found.result.steps) == 3
    np.testing.assert_array_equal(found.result.tip, magmpm.run(scene).tip)
    last = {variable.kind: k for k, variable in enumerate(found.variables)}
    for k in last.values():
        variable = found.variables[k]
        rows, tip = differences(scene, variable)
        assert_like(found.tip[:, k], tip)
        assert_like(found.centreline[..., k], rows)


@pytest.mark.parametrize(
    ("more", "key"),
    [
        (
            "ground: {point: [0 mm, 0 mm, -3 mm], friction: 0.4}",
            "effects.ground.friction: received 0.4",
        ),
        (
            (
                "walls: {tube: {radius: 5 mm, path: [[-9 mm, 0 mm, 0 mm], [40 mm, 0 mm, 0 mm]]},"
                " friction: 0.1}"
            ),
            "effects.walls.friction",
        ),
        ("self_contact: {friction: 0.4}", "effects.self_contact.friction: received 0.4"),
        ("feed: {speed: 10 mm/s, exit: 20 mm}", "effects.feed"),
    ],
)
def test_what_remembers_its_way_is_refused(more: str, key: str, tmp_path: Path) -> None:
    """Friction, wherever it is named, and a body that grows out of its guide; without them the same path has derivatives."""
    path = CATHETER + RAMP.replace("gravity: {}", "gravity: {}, " + more) + WITHIN
    data = yaml.safe_load(MATERIALS) | yaml.safe_load(path)
    with pytest.raises(
        magmpm.InputError, match=f"(?s){key}.*remedy: (take finite differences|differentiate)"
    ):
        magmpm.sensitivities(validate(Scene, data, tmp_path / "scene.yaml"))
    slippery = {
        kind: {**effect, "friction": 0}
        for kind, effect in data["effects"].items()
        if kind in ("ground", "walls", "self_contact")
    }
    if slippery:
        data["effects"] |= slippery
        check_differentiable(validate(Scene, data, tmp_path / "scene.yaml"))
        data["materials"]["hard"]["friction"] = 0.2
        with pytest.raises(
            magmpm.InputError, match=f"(?s){key.split(':')[0]}: received 0.2.*also in materials"
        ):
            magmpm.sensitivities(validate(Scene, data, tmp_path / "scene.yaml"))


def test_without_stiffness_there_are_none(tmp_path: Path) -> None:
    """What counts as zero along a path counts as zero here, too: a derivative would be rounding over rounding."""
    _, found = solve.at_rest(scene_of("catheter", tmp_path), None, None)
    Linearized(found, ())
    with pytest.raises(
        magmpm.SolveError, match=r"critical load, or free to turn.*5.0e-05 of the unloaded"
    ):
        Linearized(replace(found, stability=5e-5), ())


@pytest.mark.slow
def test_of_a_grid_that_is_chosen(tmp_path: Path) -> None:
    """A path, and effects, that the program resolves: the derivatives are those of the grid and effects that it has chosen."""
    data = yaml.safe_load(MATERIALS) | yaml.safe_load(CATHETER + RAMP + WITHIN)
    asked = validate(Scene, data | {"resolution": {"error": "5 %"}}, tmp_path / "scene.yaml")
    found = magmpm.sensitivities(asked, ["field"])
    assert found.result.error_estimate is not None
    assert found.result.resolution is not None
    cells = found.result.resolution["cells_across"]
    np.testing.assert_array_equal(
        found.tip, magmpm.sensitivities(asked.with_cells(cells), ["field"]).tip
    )
    auto = validate(
        Scene, data | {"effects": "auto", "solver": {"static": {}}}, tmp_path / "scene.yaml"
    )
    chosen = magmpm.sensitivities(auto, ["field"])
    assert chosen.result.effects_chosen is not None
    assert np.abs(chosen.tip).max() > 0


@pytest.mark.parametrize(
    "name", ["parts", "a point of parts", pytest.param("interacting", marks=pytest.mark.slow)]
)
def test_one_derivative_of_what_takes_long(name: str, tmp_path: Path) -> None:
    """The tip of parts, and magnets that pull each other, by one plain difference: all variables of them are slow cases above."""
    scene = tight(scene_of(name, tmp_path))
    found = magmpm.sensitivities(scene, ["remanence"])
    h = STEPS["remanence"]
    ahead, behind = (
        magmpm.run(found.variables[0].changed(scene, sign * h)).tip for sign in (1, -1)
    )
    slope = (ahead - behind) / (2 * h)
    # the difference's own error: (h / remanence)^2, 1e-5, and what the solves leave, 1e-7 of the motion over h / remanence, 3e-5
    np.testing.assert_allclose(found.tip[:, 0], slope, rtol=0, atol=5e-5 * np.abs(slope).max())


@pytest.mark.slow
@pytest.mark.parametrize("name", ["on the ground", "in a lumen"])
def test_where_it_touches_derivatives_hold_until_other_points_touch(
    name: str, tmp_path: Path
) -> None:
    """The tip, against differences of a tenth of the usual steps, within 1e-5 of the largest: moduli and densities stiffen the contact."""
    scene = scene_of(name, tmp_path)
    found = magmpm.sensitivities(scene)
    assert next(iter(found.result.contacts.values()))["count"] > 0
    for k, variable in enumerate(found.variables):
        step = 0.1 * STEPS[variable.kind]
        ahead, behind = (solution(variable.changed(scene, side * step))[1] for side in (1, -1))
        slope = (ahead - behind) / (2 * step)
        np.testing.assert_allclose(found.tip[:, k], slope, rtol=0, atol=1e-5 * np.abs(slope).max())


def test_the_force_of_a_wall_is_differentiated(tmp_path: Path) -> None:
    """Against differences of equilibria that Newton's method has refined; the same points touch. Loads, moduli, and the contact's own.

    A difference has the force's rounding, 1e-13 of it, over the step's share in it, 1e-4 or more; and that of a soft wall bends with the
    field: (h / field)^2, 1e-6 at most.
    """
    scene = tight(scene_of("in a lumen", tmp_path))
    steps = {
        "field.uniform[1]": 1e-6,
        "field.uniform[2]": 1e-6,
        "materials.soft.remanence": 2e-5,
        "materials.soft.shear_modulus": 20.0,
        "materials.hard.density": 0.4,
        "materials.soft.bulk_to_shear": 1e-2,
        "effects.gravity.acceleration[2]": 2e-3,
        "effects.walls.stiffness": 1e-3,
    }
    found = magmpm.sensitivities(scene, list(steps))
    slopes = found.contact_force("walls")
    count = found.result.contacts["walls"]["count"]
    assert count > 2

    def force(near: Scene) -> np.ndarray:
        _, solved = solve.at_rest(near, None, None)
        energy = solved.energy
        assert isinstance(energy, Energy)
        on = touched_by(energy.model, refined(energy, energy.at(solved.point.grid)).grid, "walls")
        assert len(on.on) == count
        return np.asarray(on.f.sum(axis=0))

    for k, variable in enumerate(found.variables):
        h = steps[variable.name]
        ahead = force(variable.changed(scene, h))
        behind = force(variable.changed(scene, -h))
        slope = (ahead - behind) / (2 * h)
        np.testing.assert_allclose(slopes[:, k], slope, rtol=0, atol=1e-6 * np.abs(slope).max())
    shares = [found.contact_force(f"walls: {region.name}") for region in scene.regions()]
    most = np.abs(shares).max()  # of sums of differences: their rounding
    np.testing.assert_allclose(np.sum(shares, axis=0), slopes, rtol=0, atol=1e-9 * most)
    with pytest.raises(ValueError, match="is not one of the scene's"):
        found.contact_force("ground")


def test_the_force_of_one_part_on_another_is_differentiated(tmp_path: Path) -> None:
    """A finger that a field presses on a held ball: against differences of equilibria that Newton's method has refined, with the same
    points in touch. The tolerance has the rounding of a difference, and its curvature, (h / field)^2, 1e-8.
    """
    solids = {
        "palm": (box((-2e-3, -1e-3, 0.0), (0.0, 1e-3, 2e-3)), {"clamp": True}),
        "finger": (box((0.0, -1e-3, 0.0), (8e-3, 1e-3, 2e-3)), {"magnetization": [1.0, 0.0, 0.0]}),
        "stone": (ball((7e-3, 0.3e-3, -2.05e-3), 2e-3), {"clamp": True}),
    }
    listed = []
    for name, (mesh, more) in solids.items():
        write_stl(mesh, tmp_path / f"{name}.stl")
        about = {"mesh": str(tmp_path / f"{name}.stl"), "name": name, "material": "m"}
        listed.append({**about, **more})
    body = {"parts": {"unit": "m", "spacing": 1e-3, "meshes": listed}}
    effects = {"magnetic_torque": {}, "gravity": {}, "self_contact": {}}
    scene = tight(resting_scene(body, effects, field={"uniform": [0.0, 1e-3, -8e-3]}))
    steps = {
        "field.uniform[1]": 1e-6,
        "field.uniform[2]": 1e-6,
        "body.parts.meshes[1].magnetization[1]": 1e-4,
        "materials.m.shear_modulus": 20.0,
        "effects.self_contact.stiffness": 1e-3,
    }
    pair = "self_contact: finger, stone"
    found = magmpm.sensitivities(scene, list(steps))
    slopes = found.contact_force(pair)
    count = found.result.contacts[pair]["count"]
    assert count > 1

    def force(near: Scene) -> np.ndarray:
        _, solved = solve.at_rest(near, None, None)
        energy = solved.energy
        assert isinstance(energy, Energy)
        pairs = energy.model.pairs
        assert pairs is not None
        one = pairs.touched(refined(energy, energy.at(solved.point.grid)).grid).report()[pair]
        assert one["count"] == count
        return np.asarray(one["force"])

    for k, variable in enumerate(found.variables):
        h = steps[variable.name]
        slope = (force(variable.changed(scene, h)) - force(variable.changed(scene, -h))) / (2 * h)
        np.testing.assert_allclose(slopes[:, k], slope, rtol=0, atol=1e-6 * np.abs(slope).max())
    with pytest.raises(ValueError, match="is not one of the scene's"):
        found.contact_force("self_contact: palm, fingre")


@pytest.mark.parametrize(
    "along",
    [
        pytest.param(["[1, 0, 0]", "[1, 0, 0]", "[1, 0, 0]"], marks=pytest.mark.slow),
        ["[1, 0, 0]", "[0, 0, 1]", "[-1, 0, 0]"],
    ],
)
def test_magnets_that_press_each_other_together(along: list[str], tmp_path: Path) -> None:
    """A stable body that would buckle if the forces of its segments did not follow it.

    Its derivatives are those of equilibria, and the stability that `run` reports is its smallest eigenvalue.
    """
    segments = ", ".join(f"{{magnetization: {direction}}}" for direction in along)
    text = f"""
name: pressed together
materials: {{soft: {{shear_modulus: 30 kPa, bulk_to_shear: 20, remanence: 140 mT}}}}
body: {{catheter: {{length: 30 mm, diameter: 3 mm, material: soft, segments: [{segments}]}}}}
field: {{uniform: [0 mT, 2 mT, 5 mT]}}
effects: {{magnetic_torque: {{}}, magnetic_interaction: {{}}}}
resolution: {{cells_across: 2}}
"""
    scene = tight(validate(Scene, yaml.safe_load(text), tmp_path / "scene.yaml"))
    _, solved = solve.at_rest(scene, None, None)
    energy = solved.energy
    assert energy is not None
    assert not energy.alone.tangent(energy.at(solved.point.grid))[1].factor()
    found = magmpm.sensitivities(scene, ["field", "remanence"])
    # rounding of a matrix whose eigenvalues span 1e9 (stretching over bending), 1e-7, and a tenth of stability.ENOUGH
    assert found.result.stability == pytest.approx(
        smallest_eigenvalue(energy, solved.point.grid), abs=2e-6
    )
    h = STEPS["field"]
    ahead, behind = (solution(found.variables[1].changed(scene, sign * h))[1] for sign in (1, -1))
    slope = (ahead - behind) / (2 * h)
    # the difference's own error is (h / field)^2, 1e-5; the bound is the one that users are promised
    np.testing.assert_allclose(found.tip[:, 1], slope, rtol=0, atol=1e-4 * np.abs(slope).max())


def test_lengths_of_magnets_that_act_on_each_other(tmp_path: Path) -> None:
    """Segments of whole cells: a little longer, the first one has a sliver of the next cell, which is of its last dipole."""
    text = """
name: two magnets
materials: {soft: {shear_modulus: 60 kPa, bulk_to_shear: 20, density: 1100 kg/m^3, remanence: 120 mT}}
body:
  catheter:
    length: 15 mm
    diameter: 3 mm
    material: soft
    segments: [{magnetization: [1, 0, 0]}, {magnetization: [0, 0, 1]}]
field: {uniform: [0 mT, 0 mT, 1 mT]}
effects: {magnetic_torque: {}, magnetic_interaction: {}, gravity: {}}
resolution: {cells_across: 2}
"""
    scene = tight(validate(Scene, yaml.safe_load(text), tmp_path / "scene.yaml"))
    found = magmpm.sensitivities(scene, ["length"])
    for k, variable in enumerate(found.variables):
        step = 1e-5  # m: its square over the length's, 1e-6, is the difference's own error
        ahead, behind = (solution(variable.changed(scene, sign * step))[1] for sign in (1, -1))
        slope = (ahead - behind) / (2 * step)
        np.testing.assert_allclose(found.tip[:, k], slope, rtol=0, atol=1e-4 * np.abs(slope).max())


def smallest_eigenvalue(energy: Energy | InteractingEnergy, grid: np.ndarray) -> float:
    """The smallest eigenvalue of the whole tangent, as a full matrix, over the unloaded body's."""
    at = energy.at(grid)
    whole = full_matrices(lambda columns: energy.products(at, columns), grid.shape)
    bare, rest = unloaded(energy.model)
    unmoved = full_matrices(lambda columns: bare.products(rest, columns), grid.shape)
    one, other = (
        eigh(stiff, heavy, eigvals_only=True, subset_by_index=[0, 0])[0]
        for stiff, heavy in (whole, unmoved)
    )
    return float(one / other)


def full_matrices(products: Products, shape: tuple[int, int]) -> list[np.ndarray]:
    """Stiffness and mass as full matrices, by their products with 100 unit vectors at a time."""
    size = shape[0] * shape[1]
    units = np.eye(size).reshape(size, *shape).transpose(1, 0, 2)
    parts = [
        products(np.ascontiguousarray(units[:, first : first + 100]))
        for first in range(0, size, 100)
    ]
    joined = [np.concatenate([part[i] for part in parts], axis=1) for i in range(2)]
    return [one.transpose(0, 2, 1).reshape(size, size) for one in joined]


def test_at_arc_lengths_it_is_the_derivative_of_centreline_at(tmp_path: Path) -> None:
    """At fixed arc lengths, also where the body gets longer."""
    scene = tight(scene_of("catheter", tmp_path))
    found = magmpm.sensitivities(scene, ["field", "length"])
    s = np.array([0.0, 3.3e-3, 11e-3, 20e-3])
    k = found.names.index("segment_2_length")
    h = 2e-5
    there = [
        centreline_at(magmpm.run(found.variables[k].changed(scene, sign * h)), s)
        for sign in (1, -1)
    ]
    # one difference of solves to the solver's tolerance: its error of h, at the kink, is some 1e-3
    np.testing.assert_allclose(
        found.at(s)[..., k], (there[0] - there[1]) / (2 * h), rtol=0, atol=2e-3
    )
    rows = found.result.centreline[:, 0]
    np.testing.assert_allclose(
        found.at(rows)[..., :3], found.centreline[..., :3], rtol=0, atol=1e-12
    )
    with pytest.raises(ValueError, match="s must lie between 0 and the length"):
        found.at(np.array([25e-3]))
    with pytest.raises(ValueError, match=r"gradient has shape \(2, 3\); must be \(\d+, 3\)"):
        found.adjoint(np.zeros((2, 3)))


@pytest.mark.parametrize("d", [(1, 0, 0), (0.3, -0.5, 0.2), (0, 0, 1), (0, 0, -1), (-1, 0, 0)])
def test_tangents_are_orthonormal_and_grow_azimuth_and_elevation(
    d: tuple[float, float, float],
) -> None:
    n = np.array(d) / np.linalg.norm(d)
    across, up = (np.array(t) for t in tangents(tuple(n)))
    np.testing.assert_allclose(
        np.stack([n, across, up]) @ np.stack([n, across, up]).T, np.eye(3), rtol=0, atol=1e-15
    )
    assert across[2] == 0.0
    if abs(n[2]) < 1:
        t = 1e-6
        turned = np.cos(t) * n + np.sin(t) * across
        assert n[0] * turned[1] - n[1] * turned[0] > 0  # about +z
        assert up[2] > 0


def test_what_is_refused(tmp_path: Path) -> None:
    """Kinds that are not known or that the scene lacks, and motions."""
    scene = scene_of("catheter", tmp_path)
    for of, text in (
        (
            ["speed"],
            (
                r"(?s)of: received 'speed'.*must be of magnetization, field, remanence,"
                r" shear_modulus, length, diameter, density"
            ),
        ),
        ("field", r"(?s)received 'field'.*must be a list of names.*of=\['field'\]"),
        ([], r"(?s)received \[\].*must be a list of names"),
    ):
        with pytest.raises(magmpm.InputError, match=text):
            magmpm.sensitivities(scene, of)
    bare = scene.with_magnetizations(np.zeros((3, 3)))
    with pytest.raises(magmpm.InputError, match=r"(?s)no region is magnetized.*remedy: give one"):
        magmpm.sensitivities(bare, ["magnetization"])
    with pytest.raises(magmpm.InputError, match=r"(?s)no effect of the field is named"):
        magmpm.sensitivities(scene.with_effects(magnetic_torque=None), ["field"])
    with pytest.raises(magmpm.InputError, match=r"(?s)a strip has no diameter"):
        magmpm.sensitivities(scene_of("strip", tmp_path), ["diameter"])
    with pytest.raises(magmpm.InputError, match="name `length`, or numbers of"):
        magmpm.sensitivities(scene_of("strip", tmp_path), ["body.strip.width"])
    with pytest.raises(magmpm.InputError, match=r"(?s)a body of parts has no length"):
        magmpm.sensitivities(scene_of("parts", tmp_path), ["length"])
    moving = Scene.from_si(scene.to_si() | {"solver": {"dynamic": {"duration": 1e-3}}})
    with pytest.raises(
        magmpm.InputError, match=r"(?s)solver.dynamic.*sensitivities are computed at an equilibrium"
    ):
        magmpm.sensitivities(moving)
    with pytest.raises(TypeError, match="start: received 3"):
        magmpm.sensitivities(scene, start=3)  # type: ignore[arg-type]
