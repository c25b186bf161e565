"""Loads that change have the value of their step; those by which a body acts on itself are held while they change little."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from reference.dynamics import Total, elastic_stress
from reference.in_motion import free_rod, moving
from reference.moving import moving_scene
from reference.scenes import rod_scene
from reference.stopped import interrupted

from magmpm.dynamics import own_loads, step_control
from magmpm.dynamics.own_loads import OwnLoads
from magmpm.dynamics.time_loop import SimulationState, begin, integrate, interval
from magmpm.effects import acting
from magmpm.errors import SolveError
from magmpm.fields.dipole import MU0
from magmpm.model import Model, build
from magmpm.results.trajectory import Motion
from magmpm.scene import Scene
from magmpm.simulate import run

# of the largest value: about ten steps, in which the load of another step would have an error of a
# tenth
ROUNDING = 1e-9


def ramped(duration: float) -> Scene:
    """A short clamped catheter in a field that rises from zero in `duration` (s)."""
    data = moving(rod_scene(length=8e-3, field=(0, 0, 20e-3))).to_si()
    return Scene.from_si(
        {**data, "field": {"uniform": (0, 0, 20e-3), "over_time": {"ramp": {"duration": duration}}}}
    )


def test_a_schedule_goes_on_within_a_chunk_of_steps() -> None:
    """A dozen steps, far fewer than a chunk, while the field rises from zero: the body is at rest then, and half a step earlier."""
    model = build(ramped(1e-3))
    moved = begin(model)
    interval(moved, 12 * moved.control.step)
    named = acting.collect(model.scene, times=moved.dt * np.arange(moved.steps, dtype=float))
    assert moved.steps == 12
    total = Total.of(replace(model, effects=named))
    c, v = np.zeros((2, *total.X.shape))
    for step in range(moved.steps):
        c, v = total.step(c, v, moved.dt, step)
    assert np.abs(c).max() > 1e-9  # m
    np.testing.assert_allclose(
        moved.motion.u.reshape(-1, 3), c, rtol=0, atol=ROUNDING * np.abs(c).max() + 1e-16
    )


def segments_that_turn() -> Model:
    """Two segments that turn each other."""
    body: dict[str, Any] = {"length": 8e-3, "directions": [(0.3, 0.2, 1.0), (-1.0, 0.4, 0.0)]}
    return build(free_rod({"magnetic_interaction": {}}, **body))


def by_hand(model: Model, dt: float, held: int) -> np.ndarray:
    """Displacement of the nodes (nodes, 3) m after 8 steps of dt (s), with loads held for some steps each, for the middle of these."""
    total = Total.of(model)
    c, v = np.zeros((2, *total.X.shape))
    before: list[np.ndarray] = []
    for step in range(8):
        if step % held == 0:
            acting.refresh(
                model.effects,
                model,
                model.particles.position + total.N @ c,
                np.eye(3) + total.gradient(c),
            )
            tables = acting.own_tables(model.effects)
            now = [table.copy() for table in tables]
            for table, old in zip(tables, before, strict=bool(before)):
                table += (table - old) * (held - 1) / 2 / held
            before = now
        if step == 0:
            v = -total.step(c, v, dt / 2)[
                1
            ]  # a load from the first step on: velocities are those of half a step before
        c, v = total.step(c, v, dt)
    return np.asarray(c)


@pytest.mark.parametrize(("single", "held"), [(own_loads.SINGLE, 1), (0, 2)])
def test_what_segments_do_to_each_other_follows_the_shape(
    monkeypatch: pytest.MonkeyPatch, single: int, held: int
) -> None:
    """A load acts at the shape for which it was computed: of one step at its start, where leapfrog pushes; of two in their middle."""
    for module, name, value in [
        (own_loads, "SINGLE", single),
        (own_loads, "MOST_STEPS_HELD", held),
        (own_loads, "MOST_CHANGE_OF_HELD_LOAD", 1e9),
        (own_loads, "ADDED", 1e9),
        (step_control, "DRIFT", 1e9),  # eight steps from rest add more to so little kinetic energy
    ]:
        monkeypatch.setattr(module, name, value)
    model = segments_that_turn()
    moved = begin(model)
    interval(moved, 8 * moved.control.step)
    assert moved.steps == 8
    found = by_hand(model, moved.dt, held)
    other = by_hand(model, moved.dt, 4)
    size = np.abs(found).max()
    np.testing.assert_allclose(moved.motion.u.reshape(-1, 3), found, rtol=0, atol=ROUNDING * size)
    assert np.abs(other - found).max() > 1e2 * ROUNDING * size, "other loads would be seen"


class Spring:
    """A stand-in for a motion: a node of 1 kg, pulled toward the origin by a load on itself, -stiffness u N/m, in steps of leapfrog."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, stiffness: float, dt: float) -> None:
        self.stiffness = stiffness
        self.dt = dt
        self.lag = dt / 2
        self.u = np.array([1.0, 0.0, 0.0])
        self.table = np.zeros(3)
        self.v = 0.5 * dt * stiffness * self.u
        self.packed = SimpleNamespace(mass=SimpleNamespace(lumped=np.ones(1)))
        monkeypatch.setattr(acting, "refresh", self.refresh)
        monkeypatch.setattr(acting, "own_tables", lambda named: [self.table])
        monkeypatch.setattr(acting, "coordinates", lambda named, model, x, F: [x])

    def refresh(self, named: Any, model: Any, x: np.ndarray, F: np.ndarray) -> float:
        self.table[:] = -self.stiffness * x
        return 0.5 * self.stiffness * float(x @ x)

    def shape(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return u, u

    def energy(self) -> float:
        now = self.v - 0.5 * self.dt * self.stiffness * self.u
        return 0.5 * float(now @ now) + 0.5 * self.stiffness * float(self.u @ self.u)

    def swing(self, own: OwnLoads, periods: float) -> tuple[list[int], float]:
        """For how many steps each load was held, and the part by which the energy has changed after so many periods."""
        held: list[int] = []
        start = self.energy()
        while sum(held) * self.dt * np.sqrt(self.stiffness) < 2 * np.pi * periods:
            held.append(own.renew((), self))
            for _ in range(held[-1]):
                self.v = self.v + self.dt * self.table
                self.u = self.u + self.dt * self.v
            own.passed(held[-1])
        return held, self.energy() / start - 1.0


# of the energy: (omega dt)^2 / 8 of a period of 50 steps, by which the energy of leapfrog goes up
# and down
LEAPFROG = 2e-3


def test_loads_that_change_slowly_are_held(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten periods of 5000 steps each. What the held loads have added is known: it is what the energy has changed by.

    Of the first two hundred, in half a period, each is held for some steps; at its zero, where it changes most for its
    size, for one or two.
    """
    own = OwnLoads(None)  # type: ignore[arg-type]
    held, changed = Spring(monkeypatch, 1.0, 2 * np.pi / 5000).swing(own, 10)
    assert np.mean(held[:200]) > 4
    assert own.added < 1.1 * own_loads.ADDED * own.scale
    assert own.added / 0.5 == pytest.approx(
        changed, abs=0.01 * own_loads.ADDED
    )  # of the half J that it has in all


def test_loads_of_a_vibration_are_computed_at_each_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """A thousand periods of 50 steps: held at will they add energy without end; what they may add is used up, and then none is held."""
    stiffness = 1.0
    dt = 2 * np.pi / 50
    own = OwnLoads(None)  # type: ignore[arg-type]
    held, changed = Spring(monkeypatch, stiffness, dt).swing(own, 200)
    assert abs(changed) < own_loads.ADDED + LEAPFROG
    assert np.mean(held) < 1.5
    for name, value in {
        "MOST_CHANGE_OF_HELD_LOAD": 1e9,
        "ADDED": 1e9,
        "MOST_STEPS_HELD": 8,
    }.items():
        monkeypatch.setattr(own_loads, name, value)
    _, changed = Spring(monkeypatch, stiffness, dt).swing(OwnLoads(None), 200)  # type: ignore[arg-type]
    assert abs(changed) > 1.0


@pytest.mark.parametrize("added", [-2.0, 2.0])
def test_where_nothing_is_left_no_load_is_held(
    monkeypatch: pytest.MonkeyPatch, added: float
) -> None:
    """Twice of what held loads may add to the half J of the spring is used up already: of five periods every load is of one step."""
    own = OwnLoads(None)  # type: ignore[arg-type]
    own.added = added * own_loads.ADDED * 0.5
    held, _ = Spring(monkeypatch, 1.0, 2 * np.pi / 50).swing(own, 5)
    assert set(held) == {1}


def test_what_loads_added_is_known_after_a_restart(monkeypatch: pytest.MonkeyPatch) -> None:
    """A motion that goes on from a frame holds its loads as one that was not interrupted there."""
    own = OwnLoads(None)  # type: ignore[arg-type]
    spring = Spring(monkeypatch, 1.0, 2 * np.pi / 50)
    spring.swing(own, 5)
    own.begin()
    other = OwnLoads(None)  # type: ignore[arg-type]
    other.restore(own.state())
    u, v = spring.u, spring.v
    held, _ = spring.swing(own, 5)
    spring.u, spring.v = u, v
    assert spring.swing(other, 5)[0] == held


def test_a_motion_whose_own_loads_add_energy_is_stopped(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The sum of all energies is watched where the body acts on itself: here loads that are five times those of their energy."""
    compute = acting.refresh

    def too_much(named: Any, *rest: Any) -> float:
        energy = compute(named, *rest)
        for table in acting.own_tables(named):
            table *= 5.0
        return energy

    monkeypatch.setattr(acting, "refresh", too_much)
    scene = segments_that_turn().scene.to_si()
    scene["solver"]["dynamic"].update(duration=5e-3, output_every=5e-4)
    with pytest.raises(SolveError, match="energy is not conserved"):
        integrate(begin(build(Scene.from_si(scene))))


def test_a_motion_with_interaction_resumes_to_the_bit(tmp_path: Path) -> None:
    """Loads begin anew at each frame, and what they have added goes on."""
    data = segments_that_turn().scene.to_si()
    data["solver"]["dynamic"].update(duration=2e-3, output_every=2.5e-4)
    scene = Scene.from_si(data)
    interrupted(scene, tmp_path, 0.8e-3)
    again = integrate(begin(build(scene)), folder=tmp_path, resume=True)
    whole = integrate(begin(build(scene)))
    assert again.x.tobytes() == whole.x.tobytes()
    assert again.energies == whole.energies
    assert again.motion.own is not None
    assert again.motion.own.state() == whole.motion.own.state()


@pytest.mark.slow
def test_a_motion_with_interaction_does_not_depend_on_the_time_step() -> None:
    """Two segments that turn in a field, without frames in between: half the step changes the tip by 0.2 % of what it moves.

    Loads that are held for 256 steps, as computed, change it by 21 %."""

    def scene(safety: float) -> Scene:
        segments = [
            {"magnetization": [0.0, 0.3, 1.0], "length": 6e-3},
            {"magnetization": [0.0, -1.0, 0.3]},
        ]
        body = {
            "catheter": {"length": 12e-3, "diameter": 2e-3, "material": "m", "segments": segments}
        }
        effects = {"magnetic_interaction": {"blocks_across": 2}, "magnetic_torque": {}}
        data = moving_scene(
            body, effects, shear=1e4, duration=0.02, field={"uniform": [0.02, 0.02, 0.0]}
        ).to_si()
        data["solver"]["dynamic"].update(safety=safety, output_every=0.02)
        return Scene.from_si(data)

    one = run(scene(0.8))
    other = run(scene(0.4))
    moved = np.linalg.norm(one.tip - [12e-3, 0.0, 0.0])
    assert moved > 0.01
    assert np.linalg.norm(one.tip - other.tip) < 5e-3 * moved


# T, s: twice as long as the motion
FIELD = np.array([0.0, 5e-3, 20e-3])
RISE = 2e-3


def scene() -> Scene:
    """A short clamped catheter in a field that rises throughout the motion."""
    data = moving(rod_scene(length=8e-3, field=FIELD), duration=1e-3, output_every=5e-4).to_si()
    return Scene.from_si(
        {**data, "field": {"uniform": FIELD.tolist(), "over_time": {"ramp": {"duration": RISE}}}}
    )


def energies(model: Model, moved: SimulationState) -> dict[str, float]:
    """Elastic and magnetic energy, J: sum V (G/2 (J^(-2/3) I1 - 3) + K/2 (J - 1)^2), (J - 1)^2 by F-bar, and -sum V B . F Br / mu0."""
    F = moved.F
    V = model.particles.volume
    J = np.linalg.det(F)
    I1 = np.einsum("nij,nij->n", F, F)
    first = model.particles.cell_first
    moments = np.add.reduceat(model.modes * (V * (J - 1))[:, None], first[:-1], axis=0)
    volume = float(np.sum(model.bulk[first[:-1]] * (moments**2).sum(axis=1))) / 2
    shape = float(V @ (model.shear * (J ** (-2 / 3) * I1 - 3))) / 2
    B = FIELD * moved.time / RISE
    magnetic = -float(V @ np.einsum("i,nij,nj->n", B, F, model.remanence)) / MU0
    return {"elastic": shape + volume, "magnetic_torque": magnetic}


def test_stress_field_and_energies_are_those_of_the_moment(tmp_path: Path) -> None:
    """The stress of a frame includes the law and the field of that moment, not of the start, zero. A result's energy is potential."""
    model = build(scene())
    moved = integrate(begin(model), folder=tmp_path)
    result = run(scene())
    assert moved.time == 1e-3
    B = FIELD * moved.time / RISE
    magnetic = -np.einsum("i,nj->nij", B, model.remanence) / MU0
    elastic = elastic_stress(model, moved.F)
    np.testing.assert_allclose(
        moved.P, elastic + magnetic, rtol=0, atol=1e-10 * np.abs(elastic).max()
    )  # sums of about ten products
    assert np.abs(magnetic).max() > 0.05 * np.abs(elastic).max(), "to leave it out would be seen"
    wanted = energies(model, moved)
    for name, value in wanted.items():
        assert moved.energies[name] == pytest.approx(
            value, rel=1e-6
        )  # of J^(-2/3) I1 - 3, a difference of 1e-4 of its parts
    np.testing.assert_allclose(
        Motion.load(tmp_path).fields, np.outer([0.0, 0.25, 0.5], FIELD), rtol=0, atol=1e-9
    )
    assert result.energy == pytest.approx(sum(wanted.values()), rel=1e-6)
    assert result.kinetic_energy == moved.energies["kinetic"] > 1e-3 * abs(result.energy), (
        "to add it would be seen"
    )
