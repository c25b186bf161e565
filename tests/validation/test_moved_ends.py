"""Bodies whose held ends move, against theory: uniaxial tension, Euler's buckling and beyond, a base that shakes, a plate that presses."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from reference.parts import parts_scene
from reference.solids import box
from scipy.integrate import cumulative_trapezoid
from scipy.optimize import brentq, fsolve
from scipy.special import ellipe, ellipk

from magmpm.dynamics.time_loop import SimulationState, begin, integrate
from magmpm.materials import poisson_ratio, young_modulus
from magmpm.model import build
from magmpm.scene import Scene
from magmpm.solving.solve import RunOptions, solve
from magmpm.statics.equilibrium import solve_static
from magmpm.statics.layout import static_model

G = 1.4e6
RATIO = 20.0
DENSITY = 2000.0


def strip(
    length: float, width: float, thickness: float, clamp: str, move: dict[str, Any], **more: Any
) -> Scene:
    sizes = {"length": length, "width": width, "thickness": thickness}
    body = sizes | {"material": "m", "clamp": clamp, "segments": [{"magnetization": [0, 0, 0]}]}
    material = {"shear_modulus": G, "bulk_to_shear": RATIO, "density": DENSITY}
    data = {
        "name": "strip",
        "materials": {"m": material},
        "body": {"strip": body | more.pop("body", {})},
        "move": move,
        "advice": "off",
    }
    return Scene.from_si(data | {"resolution": {"cells_across": 2}} | more)


@pytest.mark.parametrize("share", [0.3, -0.02])
def test_a_long_bar_is_in_uniaxial_stress(share: float) -> None:
    """In its middle, far from the clamps: lateral stretch, and stress against the slope of the energy over the way of the tip."""
    length = 20e-3
    side = 2e-3

    def pulled(way: float) -> Any:
        along = [float(np.sign(way)), 0.0, 0.0]
        return solve_static(
            static_model(
                build(
                    strip(
                        length, side, side, "both", {"tip": {"along": along, "distance": abs(way)}}
                    )
                )
            )
        ).point

    def stress(stretch: float, across: float) -> tuple[float, float]:
        J = stretch * across**2
        I1 = stretch**2 + 2 * across**2
        both = [
            G * J ** (-2 / 3) * (one - I1 / (3 * one)) + RATIO * G * J * (J - 1) / one
            for one in (stretch, across)
        ]
        return both[0], both[1]

    point = pulled(share * length)
    model = build(strip(length, side, side, "both", {}))
    middle = np.abs(model.particles.position[:, 0] - length / 2) < 0.3e-3
    stretch = point.F[middle, 0, 0].mean()
    across = point.F[middle][:, [1, 2], [1, 2]].mean()
    (due,) = fsolve(lambda one: stress(stretch, float(one[0]))[1] / G, [stretch**-0.5])
    assert across == pytest.approx(float(due), rel=2e-5)
    step = 1e-3 * length
    force = (pulled(share * length + step).energy - pulled(share * length - step).energy) / (
        2 * step
    )
    assert force == pytest.approx(side**2 * stress(stretch, float(due))[0], rel=1e-3)


def height(length: float, thickness: float, way: float) -> float:
    """Height (m) of a strip clamped at both ends that is compressed by `way` (m): the elastica, of the length that its force leaves it."""

    def left(k: float) -> float:
        return float(length * (1 - (4 * ellipk(k * k) * thickness / length) ** 2 / 12))

    def missing(k: float) -> float:
        return length - left(k) + 2 * (1 - ellipe(k * k) / ellipk(k * k)) * left(k) - way

    k = brentq(missing, 1e-6, 0.7)
    return float(k * left(k) / ellipk(k * k))


def test_a_compressed_strip_buckles_as_euler_says() -> None:
    """Critical way 4 pi^2 I / (A L), and the height beyond it, along a path and in statics."""
    length = 120.47e-3
    thickness = 2.5e-3
    way = 0.47e-3
    sizes = length, 20e-3, thickness, "both"
    ramp = {"along": [-1, 0, 0], "distance": way, "over_time": {"ramp": {"duration": 1.0}}}
    plane = {"body": {"plane_strain": True}}
    path = solve(strip(*sizes, {"tip": ramp}, solver={"quasi_static": {"steps": 8}}, **plane))
    (jump,) = path.jumps
    assert jump["kind"] == "bifurcation"
    assert jump["time"] * way == pytest.approx(4 * np.pi**2 * thickness**2 / 12 / length, rel=0.015)
    risen = path.centreline[:, 3].max()
    assert risen == pytest.approx(height(length, thickness, way), rel=0.01)
    rest = solve(strip(*sizes, {"tip": {"along": [-1, 0, 0], "distance": way}}, **plane))
    assert rest.centreline[:, 3].max() == pytest.approx(risen, rel=1e-6)
    assert any("bifurcation" in warning for warning in rest.warnings)


def test_a_moved_plate_presses_on_a_free_cube(tmp_path: Path) -> None:
    """From a thirtieth of a cell above. What moves it does the work of contact and weight; a motion that is stopped goes on, same bits."""
    edge = 3e-3
    speed = 0.05
    mass = 1882 * 50e-9
    meshes = {
        "plate": box((-1e-3, -1e-3, edge + 0.05e-3), (4e-3, 4e-3, edge + 2.05e-3)),
        "cube": box((0.0, 0.0, 0.0), (edge, edge, edge)),
    }
    way = {
        "plate": {
            "along": [0, 0, -1],
            "distance": 4e-3 * speed,
            "over_time": {"ramp": {"duration": 4e-3}},
        }
    }
    effects = {"gravity": {}, "ground": {"point": [0.0, 0.0, 0.0]}, "self_contact": {}}
    data = parts_scene(
        tmp_path, meshes, effects, 1.5e-3, held=["plate"], duration=4e-3, move=way
    ).to_si()
    data["solver"]["dynamic"]["output_every"] = 2e-5
    scene = Scene.from_si(data)
    seen = []
    stop = -1

    def see(state: SimulationState) -> None:
        push = state.contacts.get("self_contact: plate, cube", {"force": np.zeros(3)})["force"][2]
        model = state.motion.model
        cube = model.density * model.particles.volume * ~model.held
        ground = state.contacts["ground"]["force"][2]
        seen.append(
            (
                state.time,
                sum(state.energies.values()),
                push,
                ground,
                cube @ state.v[:, 2],
                cube.sum(),
            )
        )
        if state.frame == stop:
            raise KeyboardInterrupt

    whole = integrate(begin(build(scene)), on_state=see)
    time, energy, push, ground, momentum, cube = np.array(seen).T
    work = cumulative_trapezoid(
        push * speed - mass * 9.81 * speed, time, initial=0.0
    ) + 0.5 * mass * speed**2 * (time > 0)
    np.testing.assert_allclose(energy - energy[0], work, rtol=0, atol=2e-3 * work[-1])
    gained = cumulative_trapezoid(ground - push - 9.81 * cube, time, initial=0.0)
    np.testing.assert_allclose(
        momentum - momentum[0], gained, rtol=0, atol=2e-3 * np.abs(momentum).max()
    )
    stop = 100
    with pytest.raises(KeyboardInterrupt):
        integrate(begin(build(scene)), folder=tmp_path / "run", on_state=see)
    again = integrate(begin(build(scene)), folder=tmp_path / "run", resume=True)
    assert whole.contacts["self_contact"]["count"] > 0
    np.testing.assert_array_equal(again.motion.u, whole.motion.u)
    np.testing.assert_array_equal(again.motion.v, whole.motion.v)


@pytest.mark.slow
def test_a_shaken_cantilever_follows_its_base() -> None:
    """Swing of the tip over that of the base: (cos b + cosh b) / (1 + cos b cosh b), with b^4 = rho A (w^2 - i c w) L^4 / EI."""
    length = 20e-3
    thickness = 1e-3
    rate = 30.0
    swing = 0.1e-3
    bending = (
        young_modulus(G, RATIO * G)
        / (1 - poisson_ratio(G, RATIO * G) ** 2)
        * thickness**2
        / 12
        / DENSITY
    )  # EI / rho A, plane strain
    w = 0.6 * 1.8751**2 / length**2 * np.sqrt(bending)
    b = ((w**2 - 1j * rate * w) / bending + 0j) ** 0.25 * length
    theory = abs((np.cos(b) + np.cosh(b)) / (1 + np.cos(b) * np.cosh(b)))
    period = float(2 * np.pi / w)
    shake = {
        "along": [0, 0, 1],
        "distance": swing,
        "over_time": {"oscillation": {"frequency": 1 / period}},
    }
    scene = strip(
        length,
        4e-3,
        thickness,
        "base",
        {"base": shake},
        body={"plane_strain": True},
        effects={"damping": {"rate": rate}},
        solver={"dynamic": {"duration": 6 * period, "output_every": period / 64}},
    )
    seen: list[float] = []
    solve(scene, RunOptions(on_frame=lambda time, axis, tip, _: seen.append(float(tip[2]))))
    assert np.ptp(seen[-64:]) / 2 / swing == pytest.approx(theory, rel=0.03)
