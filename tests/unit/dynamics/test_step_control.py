"""The time step follows the body, and is long again afterward; the limits of the watchdog, each tested on both sides."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from reference.in_motion import free_rod, moving
from reference.scenes import rod_scene
from reference.stopped import interrupted

from magmpm import materials
from magmpm.dynamics import step_control, watchdog
from magmpm.dynamics.energies import measure
from magmpm.dynamics.step_control import StepControl, stiffness
from magmpm.dynamics.time_loop import SimulationState, begin, integrate, interval
from magmpm.dynamics.total_lagrangian import TotalMotion
from magmpm.effects.acting import WHIP
from magmpm.errors import SolveError
from magmpm.fields.dipole import MU0
from magmpm.kernels.watch import HIGHEST
from magmpm.model import Model, build
from magmpm.scene import Scene


def crushed(*, ratio: float = 20.0, to: float = 0.2) -> SimulationState:
    """A free body at rest with det F = `to`: when released, it expands at its wave speed."""
    moved = begin(build(free_rod(length=8e-3, bulk_to_shear=ratio)))
    moved.motion.u[:] = (to ** (1 / 3) - 1) * moved.motion.packed.node_place.ravel()
    return moved


def strained(motion: TotalMotion, rng: np.random.Generator) -> None:
    """Random strains of about ten percent, different for each particle."""
    motion.u[:] = 5e-5 * rng.standard_normal(len(motion.u)) * (motion.packed.nodes.inverse_mass > 0)


def test_kernels_and_formula_agree_on_the_stiffness(rng: np.random.Generator) -> None:
    """The kernels compare step_control.stiffness of the stiffest particle with the limit."""
    motion = TotalMotion(
        build(rod_scene(length=8e-3, shear=[120e3, 60e3], directions=[(1, 0, 0)] * 2))
    )
    strained(motion, rng)
    wanted = stiffness(motion.model, motion.particles()[2]).max()
    motion.advance(1, 1e-12, ())
    assert motion.watch[HIGHEST] == pytest.approx(wanted, rel=1e-12)  # sums of about ten products


@pytest.mark.parametrize("ratio", [5.0, 20.0, 500.0])
def test_the_stiffness_is_an_upper_bound(ratio: float, rng: np.random.Generator) -> None:
    """An upper bound of the largest eigenvalue of dP/dF over the density; at rest 3 K + 6 G, where the eigenvalue is 3 K."""
    model = build(rod_scene(length=8e-3, bulk_to_shear=ratio))
    model = replace(model, modes=np.zeros((len(model.density), 0)))
    n = len(model.density)
    G = model.shear[0]
    K = ratio * G
    rho = model.density[0]
    rest = stiffness(model, np.tile(np.eye(3), (n, 1, 1)))
    np.testing.assert_allclose(rest, (3 * K + 6 * G) / rho, rtol=1e-12)
    F = np.eye(3) + 0.4 * rng.uniform(-1, 1, (n, 3, 3))
    F[np.linalg.det(F) <= 0.05] = np.eye(3)
    told = stiffness(model, F)
    for p, one in enumerate(F):
        cof = np.empty((3, 3))
        A = np.empty((9, 9))
        materials.cofactor(one, cof)
        J = materials.determinant(one)
        materials.tangent(one, cof, J, G, materials.volume_pressure(J, K), K, A)
        true = np.linalg.eigvalsh(A)[-1] / rho
        assert true <= told[p] * (1 + 1e-12)
        assert told[p] <= 6 * true, (
            "and not so far above that the bound would be looked for at every step"
        )


def test_going_back_gives_the_same_bits(rng: np.random.Generator) -> None:
    motion = TotalMotion(
        build(moving(rod_scene(length=8e-3, gravity=(0, 0, -9.81)), {"damping": {"rate": 1.0}}))
    )
    strained(motion, rng)
    motion.advance(600, 1e-6, motion.model.effects)
    kept = motion.kept()
    found = []
    for _ in range(2):
        motion.advance(600, 1e-6, motion.model.effects)
        found.append([a.tobytes() for a in (*motion.particles(), motion.stiffness)])
        motion.rewind(kept)
    assert found[0] == found[1]


def test_a_body_let_go_from_a_large_strain_takes_short_steps_and_long_ones_again() -> None:
    """Released at det F = 0.2, it would invert particles in its first steps; with damping it comes to rest with the initial steps."""
    moved = crushed()
    first = moved.control.step
    interval(moved, 4 * first)
    assert moved.control.shortest <= first / 8
    told = moved.control.warnings()
    assert len(told) == 1
    assert f"to as little as {moved.control.shortest:.3g} s: the body moves too fast" in told[0]
    calm = begin(build(moved.motion.model.scene))
    moved.motion.restore(calm.motion.state())
    for k in range(20):
        interval(moved, moved.time + (300 + k) * first)
        moved.control.at_frame()
    assert moved.control.step == first


def test_energies_are_looked_at_where_steps_were_too_long_as_well() -> None:
    """A chunk that ends at a step that was too long: what its other steps did counts. Unseen, it was held against all that came later."""
    moved = crushed(to=0.5)
    moved.control._drift = drift = step_control.Drift(loses=False)
    cut = 0
    while cut < 3:
        steps = 256
        dt = moved.control.step
        taken, now, trouble = moved.control.take((), steps, dt, moved.time)
        moved.time += taken * dt
        assert trouble is None
        if 0 < taken < steps:
            cut += 1
            total = sum(measure(moved.motion, (), now, moved.time).energies.values())
            assert drift.last == pytest.approx(total, rel=1e-12)


def test_a_stiffer_body_takes_shorter_steps_before_they_are_too_long() -> None:
    """Within the bound of the shape it has; a body that bends keeps its step."""
    bent = begin(build(moving(rod_scene(length=16e-3, field=(0.0, 0.0, 10e-3)))))
    first = bent.control.step
    interval(bent, 2e-3)
    steps = bent.steps
    np.testing.assert_array_equal(interval(bent, 2e-3).x, bent.motion.particles()[0])
    assert bent.steps == steps  # a time that is reached already
    assert bent.control.step == first, "bending makes it no stiffer"
    pulled = begin(
        build(
            moving(
                rod_scene(length=8e-3, shear=30e3, bulk_to_shear=5.0, gravity=(3e3, 0, 0)),
                {"damping": {"rate": 1e-6}},
            )
        )
    )
    first = pulled.control.step
    interval(pulled, 6e-3)
    assert pulled.control.step < first
    assert pulled.control.step <= step_control.body_step(pulled.motion)


@pytest.mark.parametrize("viscosity", [20.0, 1000.0])
def test_the_step_of_a_viscous_body_is_the_largest_stable_one(
    viscosity: float, rng: np.random.Generator
) -> None:
    """Small random velocities die away in steps just below the bound. Above it, where viscosity sets it, they grow by 1 - r dt = -1.1 a
    step; where both do, the bound is safe by up to its share of the other (M - dt C/2 - dt^2 K/4 is of no one mode)."""
    loss = {"viscosity": {"viscosity": viscosity}}
    motion = TotalMotion(build(moving(rod_scene(length=8e-3), loss)))
    start = 1e-6 * rng.standard_normal(len(motion.v)) * (motion.packed.nodes.inverse_mass > 0)
    stable = step_control.stable_step(motion)
    assert stable.largest == stable.viscous["viscosity"] < stable.body
    grown = []
    for share in (0.99, 1.05 if viscosity > 500 else 2.0):
        motion.u[:] = 0.0
        motion.v[:] = start
        before = motion.kinetic_energy()
        motion.advance(400, share * stable.largest, motion.model.effects)
        grown.append(motion.kinetic_energy() / before)
    assert grown[0] < 1.0
    assert grown[1] > 1e3


def test_a_step_of_the_scene_is_kept_or_refused() -> None:
    """It is never changed: if it is too long, the motion ends, with the key to change."""
    moved = crushed()
    scene = moved.motion.model.scene
    options = scene.solver.dynamic.model_copy(update={"time_step": moved.control.step})
    moved.control = StepControl(moved.motion, moved.stable, options)
    remedy = r"remedy: lower solver\.dynamic\.time_step, or omit it"
    with pytest.raises(
        SolveError, match=rf"(changes too much within a step|has stiffened).*{remedy}"
    ):
        interval(moved, 1e-3)


def test_shortened_steps_are_resumed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A motion that shortens and lengthens its steps, resumed from a checkpoint in between, equals an uninterrupted one bit for bit."""
    monkeypatch.setattr(
        step_control, "MOST_CHANGE_OF_STIFFNESS", 1e-5
    )  # of a calm motion; a violent one would work too, but slower
    rod = rod_scene(length=8e-3, field=(0.0, 0.0, 20e-3))
    scene = moving(rod, duration=2e-3, output_every=2e-4)
    whole = integrate(begin(build(scene)))
    assert whole.control.shortest < 0.6 * begin(build(scene)).control.step
    interrupted(scene, tmp_path, 1.1e-3)
    again = integrate(begin(build(scene)), folder=tmp_path, resume=True)
    assert again.steps == whole.steps
    assert again.control.state() == whole.control.state()
    assert again.x.tobytes() == whole.x.tobytes()
    assert again.v.tobytes() == whole.v.tobytes()
    assert again.F.tobytes() == whole.F.tobytes()


@pytest.fixture(scope="module")
def model() -> Model:
    return build(rod_scene(length=8e-3))


def speed_of_waves(model: Model) -> float:
    """sqrt((K + 4/3 G) / rho), m/s."""
    return float(np.sqrt((model.bulk[0] + 4 / 3 * model.shear[0]) / model.density[0]))


def test_a_particle_faster_than_waves_is_told(model: Model) -> None:
    model = replace(model, scene=model.scene.with_field([0.0, 0.0, 0.0]))
    x = model.particles.position
    v = np.zeros_like(model.particles.position)
    waves = speed_of_waves(model)
    v[7] = (
        0.99 * 2.0 * waves * np.array([0.6, 0.0, -0.8])
    )  # twice as fast where a wave comes back from a surface
    assert watchdog.check(model, x, v) is None
    v[7] *= 1.02 / 0.99
    trouble = watchdog.check(model, x, v)
    assert trouble.particle == 7
    assert f"{1.02 * 2.0 * waves:.3g} m/s, faster than waves in its material" in trouble.cause


def test_loads_may_drive_a_body_faster_than_waves(model: Model) -> None:
    """sqrt(2 WHIP g h) more under a weight g along a way h; sqrt(2 WHIP 4 M B / rho) in a field."""
    waves = speed_of_waves(model)
    density = float(model.density[0])
    still = model.scene.to_si()
    heavy = Scene.from_si(
        {**still, "field": {}, "effects": {"gravity": {"acceleration": [0.0, 0.0, -1e4]}}}
    )
    turned = Scene.from_si(
        {**still, "field": {"uniform": [0.0, 0.0, 5e-3]}, "effects": {"magnetic_torque": {}}}
    )
    moment = float(np.linalg.norm(model.remanence[0, :3])) / MU0
    x = model.particles.position + np.array([0.0, 0.0, -3e-3])
    for scene, work in ((heavy, 1e4 * 3e-3), (turned, 4 * moment * 5e-3 / density)):
        driven = np.sqrt(2 * WHIP * work)
        v = np.zeros_like(x)
        v[7, 1] = 2.0 * waves + 0.99 * driven
        assert watchdog.check(replace(model, scene=scene), x, v, 1.0) is None
        v[7, 1] = 2.0 * waves + 1.01 * driven
        assert watchdog.check(replace(model, scene=scene), x, v, 1.0) is not None


def test_a_particle_ten_sizes_away_is_told(model: Model) -> None:
    """The size is the diagonal of the box around the undeformed particles."""
    x = model.particles.position.copy()
    v = np.zeros_like(model.particles.position)
    size = float(np.linalg.norm(np.ptp(x, axis=0)))
    x[3] += 9.9 * size * np.array([0.0, 0.6, 0.8])
    assert watchdog.check(model, x, v) is None
    x[3] += 0.2 * size * np.array([0.0, 0.6, 0.8])
    trouble = watchdog.check(model, x, v)
    assert trouble.particle == 3
    assert "left the box" in trouble.cause
    assert "10 times the body's size" in trouble.cause


@pytest.mark.parametrize("which", ["x", "v"])
def test_what_is_no_number_is_told(model: Model, which: str) -> None:
    x = model.particles.position.copy()
    v = np.zeros_like(model.particles.position)
    (x if which == "x" else v)[5, 1] = np.nan
    trouble = watchdog.check(model, x, v)
    assert trouble.particle == 5
    assert "not finite" in trouble.cause


def test_energy_from_nothing_is_told_from_a_twentieth_of_what_moves() -> None:
    """Measured from the smallest total energy so far: a swinging body converts energy and may lose some, but gain only little."""

    def told(*sums: tuple[float, float]) -> list[bool]:
        balance = watchdog.EnergyBalance()
        return [
            balance.check({"kinetic": kinetic, "elastic": elastic}) is not None
            for kinetic, elastic in sums
        ]

    assert told((1.0, 0.0), (0.3, 0.7), (1.0, 0.049)) == [False, False, False]
    assert told((1.0, 0.0), (0.3, 0.7), (1.0, 0.06)) == [False, False, True]
    assert told((1.0, 0.0), (0.2, 0.6), (0.849, 0.0), (0.86, 0.0)) == [
        False,
        False,
        False,
        True,
    ], "0.8 J is the least"
    assert told((1.0, 0.0), (np.nan, 0.0)) == [False, True]


def test_a_body_that_was_turned_inside_out_is_told_where(model: Model) -> None:
    x = model.particles.position
    F = np.tile(np.eye(3), (len(model.density), 1, 1))
    F[11] = np.diag([1.0, 1.0, -0.1])
    trouble = watchdog.broken(model, x, 0 * x, F)
    assert trouble.particle == 11
    assert "det F fell to -0.1" in trouble.cause
