"""Free bodies turn, and clamped rods twist and bend, with the inertia of the body."""

from pathlib import Path

import numpy as np
import pytest
from reference.in_motion import advance, angular_frequency, cantilever_mode, moving, set_off, timoshenko
from reference.moving import DENSITY, block, moving_scene
from reference.scenes import BR, G, rod_scene
from reference.solids import ball, box
from scipy.integrate import solve_ivp

from magmpm.bodies.surface_mesh import write_stl
from magmpm.dynamics.time_loop import begin
from magmpm.fields.dipole import MU0
from magmpm.materials import young_modulus
from magmpm.model import build
from magmpm.scene import Scene

E = young_modulus(G, 20.0 * G)
WEAK = 1e-3  # T: the body strains by 1e-3 at most


def turned(F: np.ndarray, volume: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) of a body that hardly strains, from the F (n, 3, 3) of its particles."""
    left, _, right = np.linalg.svd(np.average(F, axis=0, weights=volume))
    return np.asarray(left @ right)


def free_body(shape: str, cells: int, folder: Path) -> Scene:
    """A free body magnetized along x, in a weak field along z: cube and bar as straight bodies, the others as meshes."""
    field = {"uniform": [0.0, 0.0, WEAK]}
    size = {"cube": (3e-3, 3e-3, 3e-3), "bar": (9e-3, 3e-3, 3e-3)}
    if shape in size:
        body = block(size[shape], segments=[{"magnetization": [1.0, 0.0, 0.0]}])
    else:
        mesh = ball((0.0, 0.0, 0.0), 1.5) if shape == "sphere" else box((-1.5, -1.5, -1.5), (1.5, 1.5, 1.5))
        write_stl(mesh, folder / "body.stl")
        part = {"mesh": str(folder / "body.stl"), "material": "m", "magnetization": [1.0, 0.0, 0.0]}
        body = {"parts": {"unit": "mm", "meshes": [part]}}
    return moving_scene(body, {"magnetic_torque": {}}, cells=cells, field=field)


def angle_over_theory(scene: Scene, turn: float = 0.3) -> float:
    """Angle by which a body has turned about -y when a rigid body of its shape has turned by `turn` rad, over that."""
    begun = begin(build(scene))
    model, motion = begun.motion.model, begun.motion
    V, x = model.particles.volume, model.particles.position
    arm = x - V @ x / V.sum()
    second = DENSITY * (V @ (arm[:, 0] ** 2 + arm[:, 2] ** 2))
    torque = V.sum() * BR * WEAK / MU0
    rigid = solve_ivp(
        lambda _, y: [y[1], torque / second * np.cos(y[0])], (0.0, 1.0), [0.0, 0.0],
        rtol=1e-9, atol=1e-12, events=_reached(turn),
    )  # fmt: skip
    steps = int(np.ceil(rigid.t[-1] / begun.dt))
    dt = rigid.t[-1] / steps
    motion.set_off(dt, model.effects)
    advance(motion, steps, dt)
    R = turned(motion.particles()[2], V)
    return float(np.arctan2(R[2, 0], R[0, 0]) / turn)


def _reached(turn: float):  # type: ignore[no-untyped-def]
    def event(_: float, y: np.ndarray) -> float:
        return float(y[0] - turn)

    event.terminal = True  # type: ignore[attr-defined]
    return event


@pytest.mark.parametrize(("cells", "bound"), [(2, 0.02), (3, 0.01), pytest.param(4, 0.01, marks=pytest.mark.slow)])
@pytest.mark.parametrize("shape", ["cube", "bar", "sphere", "mesh of a cube"])
def test_a_free_body_turns_under_a_torque_as_a_rigid_body(shape: str, cells: int, bound: float, tmp_path: Path) -> None:
    assert angle_over_theory(free_body(shape, cells, tmp_path)) == pytest.approx(1.0, abs=bound)


def tumble() -> float:
    """Largest angle (deg) between a body of 6 x 4.5 x 3 mm that spins about its middle axis and Euler's equations, in 3 turns."""
    spin = np.array([2.0, 2.0, 200.0])  # 1/s
    size = np.array([6e-3, 3e-3, 4.5e-3])  # the middle axis is z
    scene = moving_scene(block(tuple(size), position=[0.0, 0.0, 0.0]), {}, cells=3)
    begun = begin(build(scene))
    model, motion = begun.motion.model, begun.motion
    x, V = model.particles.position, model.particles.volume
    middle = V @ x / V.sum()
    free = motion.packed.nodes.inverse_mass > 0
    motion.v[:] = np.where(free, np.cross(spin, motion.packed.node_place - middle).ravel(), 0.0)
    second = (x - middle).T @ (V[:, None] * (x - middle))
    I = np.trace(second) * np.eye(3) - second

    def rate(_: float, y: np.ndarray) -> np.ndarray:
        R, w = y[:9].reshape(3, 3), y[9:]
        turning = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
        return np.concatenate([(R @ turning).ravel(), np.linalg.solve(I, np.cross(I @ w, w))])

    times = np.linspace(0.0, 3 * 2 * np.pi / 200.0, 31)
    exact = solve_ivp(rate, (0.0, times[-1]), np.concatenate([np.eye(3).ravel(), spin]), t_eval=times, rtol=1e-9, atol=1e-9).y.T
    steps = int(np.ceil(times[1] / begun.dt))
    dt, off = times[1] / steps, []
    motion.set_off(dt, ())
    for state in exact[1:]:
        advance(motion, steps, dt)
        R = turned(motion.particles()[2], V)
        off.append(np.degrees(np.arccos(np.clip((np.trace(R.T @ state[:9].reshape(3, 3)) - 1) / 2, -1, 1))))
    return float(max(off))


def test_a_body_tumbles_as_euler_says() -> None:
    """Three turns about the axis of the middle moment of inertia, over the flip: within 5 degrees at 3 cells; with lumped mass 36."""
    assert tumble() < 5.0


def frequency_over_theory(kind: str, cells: int = 2) -> float:
    """First frequency of a clamped rod, 4 mm thick, over that of a beam: torsion of 20 mm, bending of 40 mm."""
    length = 20e-3 if kind == "torsion" else 40e-3
    expected = np.pi / 2 / length * np.sqrt(G / DENSITY) if kind == "torsion" else timoshenko(length, 2e-3, E, G, DENSITY)

    def velocity(x: np.ndarray) -> np.ndarray:
        if kind == "torsion":
            return 0.01 * expected * np.sin(np.pi / 2 * x[:, :1] / length) * np.cross([1.0, 0.0, 0.0], x)
        return np.outer(0.005 * length * expected * cantilever_mode(x[:, 0], length), [0.0, 0.0, 1.0])

    motion, dt = set_off(moving(rod_scene(length=length, cells=cells, density=DENSITY)), velocity)
    X = motion.model.particles.position
    last = motion.model.particles.cell[:, 0] == motion.model.particles.cell[:, 0].max()
    times, looks = [], []
    every = max(1, int(2 * np.pi / expected / 60 / dt))
    for k in range(round(1.6 * 60)):
        advance(motion, every, dt)
        moved = motion.particles()[0] - X
        times.append((k + 1) * every * dt)
        twist = X[last, 1] * moved[last, 2] - X[last, 2] * moved[last, 1]
        looks.append(float(twist.sum() if kind == "torsion" else moved[last, 2].sum()))
    return angular_frequency(np.array(times), np.array(looks)) / expected


@pytest.mark.parametrize("kind", ["torsion", "bending"])
def test_a_clamped_rod_vibrates_as_a_beam(kind: str) -> None:
    """At 2 cells, within 2 %."""
    assert frequency_over_theory(kind) == pytest.approx(1.0, abs=0.02)
