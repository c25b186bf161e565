"""A fluid around a body: it falls as fast as the law of its drag says, swims as resistive-force theory says, and bends in a stream.

The laws are written here once more, from their sources (effects.fluid), for bodies that move as one.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from reference.dynamics import Total
from reference.moving import moving_scene, resting_scene
from reference.parts import parts_scene
from reference.solids import ball
from scipy.optimize import brentq

from magmpm.bodies.surface_mesh import Mesh, write_stl
from magmpm.dynamics.time_loop import begin, interval
from magmpm.dynamics.total_lagrangian import TotalMotion
from magmpm.effects.fluid import stream
from magmpm.errors import SceneError
from magmpm.inputs.settings import validate
from magmpm.model import build
from magmpm.scene import Scene
from magmpm.simulate import run

WATER = {"density": 1000.0, "viscosity": 1e-3}
SYRUP = {"density": 1300.0, "viscosity": 2.0}
ROD = {"length": 20e-3, "diameter": 2e-3}
PLATE = {"length": 12e-3, "width": 6e-3, "thickness": 1e-3}
RHO = 1500.0  # kg/m^3
EARTH = 9.81  # m/s^2


def joined(slow: float, fast: float) -> float:
    """Churchill and Usagi's join of two laws, with the exponent 3/2."""
    return (slow**1.5 + fast**1.5) ** (2 / 3)


def slender(length: float, diameter: float, mu: float) -> tuple[float, float]:
    """Slow drag of a rod across and along, N s/m (Tirado and Garcia de la Torre 1979)."""
    p = length / diameter
    across = 4 * math.pi * mu * length / (math.log(p) + 0.839 + 0.185 / p + 0.233 / p**2)
    along = 2 * math.pi * mu * length / (math.log(p) - 0.207 + 0.980 / p - 0.133 / p**2)
    return across, along


def rod_drag(u: float, fluid: dict[str, float], *, across: bool) -> float:
    """Drag (N) of a rod that moves across or along its axis."""
    length, d = ROD["length"], ROD["diameter"]
    rho, mu = fluid["density"], fluid["viscosity"]
    slow = slender(length, d, mu)
    if across:
        return rod_drag_per_length(u, fluid, length, d) * length
    skin = 1.328 * math.sqrt(mu / (rho * u * length))  # Blasius
    side = joined(slow[1], rho / 2 * skin * math.pi * d * length * u) * u
    return side + 2 * 0.42 * rho / 2 * math.pi * d**2 / 4 * u**2  # and two ends


def plate_drag(u: float, fluid: dict[str, float], *, across: bool) -> float:
    """Drag (N) of a plate that moves along its normal, or along its length."""
    length, b, h = PLATE.values()
    rho, mu = fluid["density"], fluid["viscosity"]
    slow = slender(length, (b + h) / 2, mu)
    if across:  # Hoerner 1965
        coefficient = 1.10 + 0.02 * (length / b + b / length)
        return joined(slow[0], rho / 2 * coefficient * length * b * u) * u
    skin = 2 * 1.328 * math.sqrt(mu / (rho * u * length))  # on both sides
    side = joined(slow[1], rho / 2 * skin * length * b * u) * u
    return side + 2 * 0.42 * rho / 2 * b * h * u**2


def falling(body: dict[str, Any], fluid: dict[str, float], along: int, **more: Any) -> Scene:
    """A free body that falls along an axis of its own."""
    pull = [0.0, 0.0, 0.0]
    pull[along] = -EARTH
    effects = {"gravity": {"acceleration": pull}, "fluid": fluid}
    material = {"shear_modulus": 30e3, "bulk_to_shear": 10.0, "density": RHO}
    return moving_scene(body, effects, materials={"m": material}, **more)


BODIES = {
    "rod": ({"catheter": ROD | {"material": "m", "clamp": "none", "segments": [{}]}}, rod_drag),
    "plate": ({"strip": PLATE | {"material": "m", "clamp": "none", "segments": [{}]}}, plate_drag),
}
VOLUME = {
    "rod": math.pi / 4 * ROD["diameter"] ** 2 * ROD["length"],
    "plate": math.prod(PLATE.values()),
}


@pytest.mark.parametrize("fluid", [WATER, SYRUP], ids=["water", "syrup"])
@pytest.mark.parametrize("along", [2, 0], ids=["across", "along"])
@pytest.mark.parametrize("name", BODIES)
def test_a_body_falls_as_fast_as_the_law_says(
    name: str, along: int, fluid: dict[str, float]
) -> None:
    body, drag = BODIES[name]
    weight = (RHO - fluid["density"]) * EARTH * VOLUME[name]
    law = brentq(lambda u: drag(u, fluid, across=along == 2) - weight, 1e-7, 10.0)
    # from the law's own speed: what is left of a start from rest is then nothing
    scene = falling(body, fluid, along)
    state = begin(build(scene))
    state.motion.v.reshape(-1, 3)[:, along] = -law
    interval(state, 20e-3)
    v = state.motion.particles()[1]
    speed = np.average(v, axis=0, weights=state.motion.model.particles.volume)
    assert -speed[along] == pytest.approx(law, rel=3e-3)


@pytest.mark.parametrize("name", [*BODIES, "tube"])
def test_a_body_sets_off_with_the_fluid_it_carries_along(name: str) -> None:
    """(rho V + C_a rho_f V_a) a = (rho - rho_f) g V, with V_a the cylinder around a plate's width: before drag counts.

    A tube also carries all of the fluid in its bore (Paidoussis 1998, section 3.3).
    """
    bore = 0.7 * ROD["diameter"] if name == "tube" else 0.0
    body, _ = BODIES[name if name in BODIES else "rod"]
    if bore:
        body = {"catheter": body["catheter"] | {"inner_diameter": bore}}
    length, b = (PLATE["length"], PLATE["width"]) if name == "plate" else tuple(ROD.values())
    inside = math.pi / 4 * bore**2 * length
    volume = VOLUME[name if name in BODIES else "rod"] - inside
    around = (1 - 0.45 * b / length) * math.pi / 4 * b**2 * length
    mass = RHO * volume + WATER["density"] * (around + inside)
    wanted = (RHO - WATER["density"]) * EARTH * volume / mass
    state = begin(build(falling(body, WATER, 2)))
    interval(state, 1e-3)  # far longer than a wave takes through it
    v = state.motion.particles()[1]
    speed = np.average(v, axis=0, weights=state.motion.model.particles.volume)
    assert -speed[2] / 1e-3 == pytest.approx(wanted, rel=5e-3)


def test_a_ball_of_a_mesh_sinks_as_stokes_says(tmp_path: Path) -> None:
    """6 pi mu r u, and at a Reynolds number of 0.01 little else."""
    r = 1.5e-3
    write_stl(ball((0.0, 0.0, 0.0), 1.5, 24), tmp_path / "ball.stl")
    parts = {"unit": "mm", "spacing": "0.75 mm", "meshes": [{"mesh": "ball.stl", "material": "m"}]}
    fluid = {"density": "1300 kg/m^3", "viscosity": "2 Pa s"}
    data = {
        "name": "ball",
        "materials": {
            "m": {"shear_modulus": "30 kPa", "bulk_to_shear": 10, "density": "1500 kg/m^3"}
        },
        "body": {"parts": parts},
        "effects": {"gravity": {}, "fluid": fluid},
        "solver": {"dynamic": {"duration": "1 s"}},
        "resolution": {"cells_across": 4},
    }
    scene = validate(Scene, data, tmp_path / "ball.yaml")
    volume = build(scene).particles.volume.sum()
    law = (RHO - SYRUP["density"]) * EARTH * volume / (6 * math.pi * SYRUP["viscosity"] * r)
    state = begin(build(scene))
    interval(state, 20e-3)
    v = state.motion.particles()[1]
    speed = np.average(v, axis=0, weights=state.motion.model.particles.volume)
    assert -speed[2] == pytest.approx(law, rel=0.02)  # of which the polyhedron has 1 %


def test_a_closed_cavity_is_refused(tmp_path: Path) -> None:
    """A hollow ball floats by what is in it, which its mesh does not say; one that another part fills is as good as full."""
    outer = ball((0.0, 0.0, 0.0), 3e-3)
    core = ball((0.0, 0.0, 0.0), 1.5e-3)
    faces = np.concatenate([outer.faces, core.faces[:, ::-1] + len(outer.vertices)])
    shell = Mesh(np.concatenate([outer.vertices, core.vertices]), faces)

    def scene(**meshes: Mesh) -> Scene:
        return parts_scene(tmp_path, meshes, {"gravity": {}, "fluid": WATER}, 0.7e-3)

    with pytest.raises(SceneError, match=r"effects.fluid: shell has a closed cavity"):
        build(scene(shell=shell))
    full = build(scene(shell=shell, core=core)).wetted.surface
    whole = build(scene(whole=outer)).wetted.surface
    assert full.size.sum() == pytest.approx(whole.size.sum(), rel=1e-9)


SHAPES = {
    "rod": {"catheter": {"length": 8e-3, "diameter": 2e-3, "material": "m", "segments": [{}]}},
    "strip": {
        "strip": {
            "length": 8e-3,
            "width": 3e-3,
            "thickness": 1e-3,
            "material": "m",
            "clamp": "none",
            "segments": [{}],
        }
    },
}


@pytest.mark.parametrize("name", SHAPES)
def test_the_kernel_is_the_plain_reference(name: str, rng: np.random.Generator) -> None:
    """Of bodies that are bent and move in all ways, in a stream; the same bits with one thread and with two."""
    fluid = {"density": 1200.0, "viscosity": 5e-3, "velocity": [0.1, -0.2, 0.3]}
    model = build(moving_scene(SHAPES[name], {"gravity": {}, "fluid": fluid}))
    reference = Total.of(model)
    c = 2e-4 * np.sin(300.0 * reference.X @ rng.standard_normal((3, 3)))
    v = 0.5 * np.cos(300.0 * reference.X @ rng.standard_normal((3, 3)))
    c[reference.fixed] = v[reference.fixed] = 0.0
    c[reference.mass == 0.0] = v[reference.mass == 0.0] = 0.0
    motion = TotalMotion(model)
    motion.restore({"u": c.ravel(), "v": v.ravel()})
    bare = Total.of(build(moving_scene(SHAPES[name], {"gravity": {}})))
    other = bare.step(c, v, 1e-6)[1]
    for _ in range(3):
        c, v = reference.step(c, v, 1e-6)
    assert motion.advance(3, 1e-6, model.effects) == (3, False)
    np.testing.assert_allclose(motion.u.reshape(-1, 3), c, rtol=0, atol=1e-13 * np.abs(c).max())
    np.testing.assert_allclose(motion.v.reshape(-1, 3), v, rtol=0, atol=1e-12 * np.abs(v).max())
    assert np.abs(other - v).max() > 1e-4 * np.abs(v).max(), "the fluid matters"


def wave(duration: float, fluid: dict[str, float]) -> Scene:
    """A free strip with one period of magnetization along it, in a field that turns: a wave runs along it."""
    strip = {
        "length": 10e-3,
        "width": 1e-3,
        "thickness": 0.5e-3,
        "material": "m",
        "clamp": "none",
        "magnetization_profile": {"harmonic": {"periods": 1, "phase": 0.0}},
    }
    material = {
        "shear_modulus": 20e3,
        "bulk_to_shear": 10.0,
        "density": RHO,
        "remanence": 50e-3,
    }
    turning = {"rotation": {"axis": [0.0, 1.0, 0.0], "frequency": 10.0}}
    return moving_scene(
        {"strip": strip},
        {"magnetic_torque": {}, "fluid": fluid},
        materials={"m": material},
        field={"uniform": [9e-3, 0.0, 0.0], "over_time": turning},
        duration=duration,
    )


def swum(x: np.ndarray, times: np.ndarray, mu: float, b: float, h: float) -> np.ndarray:
    """Places (k, 2) m of the middle of a strip that changes its shape as x (k, n, 2) m does, by resistive-force theory: in the plane of x
    and z, at each moment the velocity and spin for which the forces of all its pieces, and their torques, sum to nothing.
    """
    length = np.linalg.norm(np.diff(x[0], axis=0), axis=1).sum()
    across, along = (one / length for one in slender(length, (b + h) / 2, mu))
    middle = x.mean(axis=1)
    shape = x - middle[:, None]
    rate = np.gradient(shape, times, axis=0)
    speed = np.empty_like(middle)
    for k, (now, u) in enumerate(zip(shape, rate, strict=True)):
        tangent = np.gradient(now, axis=0)
        size = np.linalg.norm(tangent, axis=1)
        t = tangent / size[:, None]
        R = across * np.eye(2) + (along - across) * t[:, :, None] * t[:, None, :]
        R *= size[:, None, None]
        spun = np.column_stack([now[:, 1], -now[:, 0]])  # of a unit turn about y
        moves = np.stack(
            [np.tile([1.0, 0.0], (len(now), 1)), np.tile([0.0, 1.0], (len(now), 1)), spun]
        )
        drag = np.einsum("nij,mnj->mni", R, moves)
        own = np.einsum("nij,nj->ni", R, u)
        matrix = np.einsum("lni,mni->lm", moves, drag)
        # torque of the field balances that of the spin: only the force is free of it
        force = matrix[:2, :2]
        speed[k] = np.linalg.solve(force, -np.einsum("lni,ni->l", moves[:2], own))
    return speed


def test_a_strip_swims_as_resistive_force_theory_says(tmp_path: Path) -> None:
    """The wave that runs along it is the simulation's; how far it swims by it is the theory's to say."""
    from magmpm.results.trajectory import Motion

    mu = 2.0
    scene = wave(0.2, {"density": 1000.0, "viscosity": mu})
    run(scene, folder=tmp_path)
    motion = Motion.load(tmp_path)
    on = np.argsort(motion.reference[:, 0])
    groups = np.array_split(on, 40)
    frames = [motion.position(k) for k in range(len(motion.times))]
    middle = [np.average([f[g] for f in frames], axis=1, weights=motion.volume[g]) for g in groups]
    x = np.stack(middle, axis=1)[:, :, [0, 2]]
    cycle = motion.times >= 0.1 - 1e-9  # the last one
    speed = swum(x, motion.times, mu, 1e-3, 0.5e-3)[cycle]
    theory = np.trapezoid(speed, motion.times[cycle], axis=0) / 0.1
    found = (x[-1] - x[cycle][0]).mean(axis=0) / 0.1
    assert np.linalg.norm(found) > 1e-4  # m/s
    assert found[0] == pytest.approx(theory[0], rel=0.03)
    # sideways it goes a seventh as fast, of which the start from rest, half of the time ago, is a part
    assert found[1] == pytest.approx(theory[1], abs=0.05 * theory[0])


def test_a_neutral_body_has_no_weight() -> None:
    """A catheter as dense as the fluid stays straight; a denser one bends as under the rest of its weight."""
    rod = {"catheter": ROD | {"material": "m", "segments": [{}]}}
    of = {"fluid": {"density": 1882.0, "viscosity": 1e-3}}
    straight = run(resting_scene(rod, {"gravity": {}, **of}))
    np.testing.assert_allclose(straight.tip, [ROD["length"], 0.0, 0.0], atol=1e-12)
    buoyed = run(resting_scene(rod, {"gravity": {}, "fluid": WATER}))
    light = {"acceleration": [0.0, 0.0, -EARTH * (1882.0 - 1000.0) / 1882.0]}
    same = run(resting_scene(rod, {"gravity": light}))
    np.testing.assert_allclose(buoyed.tip, same.tip, atol=1e-9)
    assert same.tip[2] < -1e-4


STREAM = {"density": 1000.0, "viscosity": 1e-3, "velocity": [0.0, 0.5, 0.0]}


def test_a_stream_bends_a_catheter_as_its_motion_comes_to_rest() -> None:
    """At rest and in motion drag is that of one law; a weak one bends by q L^4 / (8 E I)."""
    rod = {"catheter": {"length": 20e-3, "diameter": 2e-3, "material": "m", "segments": [{}]}}
    rest = run(resting_scene(rod, {"fluid": STREAM}))
    state = begin(build(moving_scene(rod, {"fluid": STREAM, "damping": {"rate": 120.0}})))
    interval(state, 0.6)
    x = state.motion.particles()[0]
    body = state.motion.model.particles
    moved = x[body.position[:, 0] > 18e-3].mean(axis=0)
    still = rest.particle_position[rest.particle_reference[:, 0] > 18e-3].mean(axis=0)
    np.testing.assert_allclose(moved, still, atol=2e-4 * 20e-3)
    assert rest.tip[1] > 5e-3
    slow = {**STREAM, "velocity": [0.0, 0.04, 0.0]}
    weak = run(resting_scene(rod, {"fluid": slow}))
    E, inertia = 2.951 * 120e3, math.pi * 2e-3**4 / 64
    q = rod_drag_per_length(0.04, slow, 20e-3, 2e-3)
    assert weak.tip[1] == pytest.approx(q * 0.02**4 / (8 * E * inertia), rel=0.02)


def rod_drag_per_length(u: float, fluid: dict[str, Any], length: float, d: float) -> float:
    """Drag (N/m) of a rod across its axis; in fast motion of Taylor 1952."""
    rho, mu = fluid["density"], fluid["viscosity"]
    slow = slender(length, d, mu)[0] / length
    coefficient = 1.1 + 4.0 * math.sqrt(mu / (rho * u * d))
    return joined(slow, rho / 2 * coefficient * d * u) * u


def test_the_flow_through_a_lumen_is_poiseuilles() -> None:
    """Twice the mean speed on the axis of the tube, a parabola beside it, and nothing beyond the wall, along a path that bends."""
    path = [[-10e-3, 0.0, 0.0], [20e-3, 0.0, 0.0], [40e-3, 8e-3, 0.0]]
    rod = {"catheter": ROD | {"material": "m", "segments": [{}]}}
    walls = {"tube": {"radius": 3e-3, "path": path}}
    flow = {"density": 1060.0, "viscosity": 3.5e-3, "mean_speed": 0.1}
    scene = moving_scene(rod, {"walls": walls, "fluid": flow})
    records, table = scene.effects.fluid.records(scene)
    axis = table.reshape(-1, 3)
    spline = scene.effects.walls.axis
    np.testing.assert_array_equal(axis, spline)
    for k in (2, len(axis) // 2, len(axis) - 3):
        along = axis[k + 1] - axis[k]
        along /= np.linalg.norm(along)
        across = np.cross(along, [0.0, 0.0, 1.0])
        for r in (0.0, 1e-3, 2.5e-3, 3.5e-3):
            x = (axis[k] + axis[k + 1]) / 2 + r * across
            v = stream(records[0], table, x)
            wanted = 0.2 * max(0.0, 1.0 - (r / 3e-3) ** 2) * along
            # beside a bend the next piece of the axis may be nearer, and turned by a degree
            np.testing.assert_allclose(v, wanted, atol=0.02 * 0.2)
