"""Held ends that move: splines that carry it, equilibria, paths and motions, refusals."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from reference.moving import resting_scene
from reference.solids import box
from reference.stopped import interrupted

from magmpm import run
from magmpm.bodies.surface_mesh import write_stl
from magmpm.dynamics.time_loop import begin, integrate
from magmpm.errors import SceneError
from magmpm.model import build
from magmpm.scene import Scene
from magmpm.statics.axis import along_axis, section_weights
from magmpm.statics.energy import Energy
from magmpm.statics.layout import static_model

L = 20e-3
W = 4e-3
T = 2e-3
RAMP = {"ramp": {"duration": 20e-3}}


def strip(clamp: str = "both", move: dict[str, Any] | None = None, **more: Any) -> Scene:
    """A strip of two segments. move: along and distance (m) by name, and over_time."""
    body = {
        "length": L,
        "width": W,
        "thickness": T,
        "material": "m",
        "clamp": clamp,
        "segments": [{"magnetization": [1, 0, 0]}],
    }
    materials = {
        "m": {"shear_modulus": 100e3, "bulk_to_shear": 20.0, "density": 1000.0, "remanence": 0.1}
    }
    return resting_scene(
        **{
            "body": {"strip": body},
            "effects": {},
            "materials": materials,
            "move": move,
            "advice": "off",
            **more,
        }
    )


def to(along: list[float], distance: float = 2e-3, **more: Any) -> dict[str, Any]:
    return {"along": along, "distance": distance} | more


def test_splines_are_those_of_a_clamp_and_carry_the_face(rng: np.random.Generator) -> None:
    """Without motion the energy is that of a clamped strip for any coefficients; the ends are where they are moved to."""
    moved = static_model(build(strip(move={"base": to([0, 0, 1]), "tip": to([1, 0, 0], 1e-3)})))
    still = static_model(build(strip()))
    energy = Energy(moved)
    grid = energy.free(1e-5 * rng.standard_normal(energy.shape))
    assert energy.at(grid).energy == pytest.approx(Energy(still).at(grid[1:]).energy, rel=1e-13)
    grid += moved.displaced(base=np.array([0.0, 0.0, 2e-3]), tip=np.array([1e-3, 0.0, 0.0]))
    ends = along_axis(moved, grid, section_weights(moved), np.array([0.0, L]))
    np.testing.assert_allclose(ends, [[0, 0, 2e-3], [L + 1e-3, 0, 0]], rtol=0, atol=1e-17)


@pytest.mark.parametrize(("clamp", "names"), [("base", ["base"]), ("both", ["base", "tip"])])
def test_a_body_moves_as_what_holds_it(clamp: str, names: list[str]) -> None:
    result = run(strip(clamp, {name: to([0, 0.6, 0.8]) for name in names}))
    way = result.particle_position - result.particle_reference
    np.testing.assert_allclose(way, np.tile([0, 1.2e-3, 1.6e-3], (len(way), 1)), atol=1e-15)
    assert result.energy < 1e-15


@pytest.mark.slow
def test_a_path_and_a_motion_end_in_the_equilibrium() -> None:
    """Stretched by a tenth in statics, along a path, and in a motion with losses."""
    rest = run(strip(move={"tip": to([1, 0, 0])}))
    moving = {"tip": to([1, 0, 0], over_time=RAMP)}
    path = run(strip(move=moving, solver={"quasi_static": {"steps": 2}}))
    np.testing.assert_allclose(path.particle_position, rest.particle_position, rtol=0, atol=1e-9)
    assert [round(step["tip"][0], 12) for step in path.steps] == [L, L + 1e-3, L + 2e-3]
    scene = strip(
        move=moving, solver={"dynamic": {"duration": 60e-3}}, effects={"damping": {"rate": 400.0}}
    )
    motion = run(scene)
    np.testing.assert_allclose(motion.particle_position, rest.particle_position, rtol=0, atol=1e-7)
    assert motion.energy == pytest.approx(rest.energy, rel=1e-6)


def test_a_motion_resumes_bit_for_bit(tmp_path: Path) -> None:
    scene = strip(
        move={"base": to([0, 0, 1], over_time={"oscillation": {"frequency": 100.0}})},
        effects={"damping": {"rate": 1.0}},
        solver={"dynamic": {"duration": 4e-3}},
    )
    whole = integrate(begin(build(scene)))
    interrupted(scene, tmp_path, 2e-3)
    resumed = integrate(begin(build(scene)), folder=tmp_path, resume=True)
    np.testing.assert_array_equal(resumed.x, whole.x)
    face = whole.motion.u.reshape(*whole.motion.model.grid.nodes, 3)[0]
    np.testing.assert_allclose(
        face, np.broadcast_to([0, 0, 2e-3 * np.sin(0.8 * np.pi)], face.shape), rtol=0, atol=1e-15
    )


def pillar(folder: Path, **more: Any) -> Scene:
    """A block between a foot and a head that are held."""
    for name, low in (("foot", 0.0), ("block", 2.0), ("head", 6.0)):
        write_stl(
            box((0, 0, low), (4, 4, {"foot": 2.0, "block": 6.0, "head": 8.0}[name])),
            folder / f"{name}.stl",
        )
    meshes = [
        {"mesh": str(folder / f"{name}.stl"), "material": "m", "clamp": name != "block"}
        for name in ("foot", "block", "head")
    ]
    data = (
        strip().to_si()
        | {"body": {"parts": {"unit": "mm", "spacing": 1e-3, "meshes": meshes}}}
        | more
    )
    return Scene.from_si(data)


def test_held_parts_move_by_name(tmp_path: Path) -> None:
    """Both together: no strain; the head alone: its particles by its way, the foot's stay, and shear between."""
    both = run(pillar(tmp_path, move={"foot": to([1, 0, 0], 1e-3), "head": to([1, 0, 0], 1e-3)}))
    np.testing.assert_allclose(
        both.particle_position - both.particle_reference,
        np.tile([1e-3, 0, 0], (both.particles, 1)),
        atol=1e-15,
    )
    result = run(pillar(tmp_path, move={"head": to([1, 0, 0], 1e-3)}))
    way = (result.particle_position - result.particle_reference)[:, 0]
    np.testing.assert_allclose(way[result.particle_segment == 0], 0.0, atol=1e-15)
    np.testing.assert_allclose(way[result.particle_segment == 2], 1e-3, rtol=1e-12)
    middle = np.abs(result.particle_reference[:, 2] - 4e-3) < 0.5e-3
    assert way[middle].mean() == pytest.approx(0.5e-3, rel=1e-3)
    scene = pillar(
        tmp_path,
        move={"head": to([1, 0, 0], 1e-3, over_time=RAMP)},
        effects={"damping": {"rate": 2000.0}},
        solver={"dynamic": {"duration": 40e-3}},
    )
    np.testing.assert_allclose(
        run(scene).particle_position, result.particle_position, rtol=0, atol=1e-7
    )


def test_parts_that_hold_one_face_move_together(tmp_path: Path) -> None:
    scene = pillar(tmp_path)
    write_stl(box((4, 0, 0), (8, 4, 2)), tmp_path / "toe.stl")
    data = scene.to_si()
    data["body"]["parts"]["meshes"].append(
        {"mesh": str(tmp_path / "toe.stl"), "material": "m", "clamp": True}
    )
    with pytest.raises(SceneError, match="hold the body at the same face"):
        build(Scene.from_si(data | {"move": {"foot": to([0, 0, 1], 1e-3)}}))


def test_nothing_moved_costs_nothing() -> None:
    """No records, neither at rest nor in motion."""
    assert static_model(build(strip())).driven == ()
    assert (
        begin(build(strip(solver={"dynamic": {"duration": 1e-3}}))).motion.ends.records(
            np.zeros(1), 1e-6
        )
        == ()
    )
