"""Branches of viscosity that relax (Maxwell): the local step against NumPy and linear theory, and motions with them."""

import re

import numba
import numpy as np
import pytest
from reference.scenes import rod_scene
from scipy.spatial.transform import Rotation

from magmpm.compiled.simd_views import matrix, vector
from magmpm.dynamics.time_loop import begin, integrate
from magmpm.dynamics.total_lagrangian import TotalMotion
from magmpm.effects import acting
from magmpm.effects.viscosity import AT_REST, Branch, Viscosity, of_loss_factor, relax, stored
from magmpm.errors import InputError, SceneError
from magmpm.inputs.settings import validate
from magmpm.model import build
from magmpm.scene import Scene

TWO = [{"shear_modulus": 500e3, "time": 10e-3}, {"shear_modulus": 100e3, "time": 1e-3}]  # Pa, s
BRANCHES = tuple(Branch(**one) for one in TWO)
RECORD, TABLE = Viscosity(branches=BRANCHES).records(None)


@numba.njit
def follow(record, table, dt, F, C, P):  # type: ignore[no-untyped-def]
    """Stress P (steps, 72) of eight particles along F (steps, 72)."""
    for n in range(len(F)):
        relax(record[0], table, dt, matrix(F[n], 0), vector(C, 0), matrix(P[n], 0))


def lanes(values: np.ndarray) -> np.ndarray:
    """(8, k) as flat lanes."""
    return np.ascontiguousarray(values.reshape(8, -1).T).ravel()


@pytest.fixture
def strained(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """F (8, 3, 3), and Cv (8, 12) of two branches, each of det 1 and far from F."""
    F = np.eye(3) + 0.3 * rng.standard_normal((8, 3, 3))
    V = np.eye(3) + 0.3 * rng.standard_normal((8, 2, 3, 3))
    F *= np.sign(np.linalg.det(F))[:, None, None]
    V = V @ V.transpose(0, 1, 3, 2)
    V /= np.cbrt(np.linalg.det(V))[..., None, None]
    return F, V[..., [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]].reshape(8, 12)


@pytest.mark.parametrize("dt", [1e-6, 1e-3, 1e3])
def test_a_step_is_the_plain_one(dt: float, strained: tuple[np.ndarray, np.ndarray]) -> None:
    """Stress of eight particles in the middle of a step of any length, and Cv of det 1 after it."""
    F, memory = strained
    C = lanes(memory)
    P = np.zeros((1, 72))
    follow(RECORD, TABLE, dt, lanes(F)[None], C, P)
    expected = stored(BRANCHES, F, memory, dt / 2)[1]
    np.testing.assert_allclose(P[0], lanes(expected), rtol=0, atol=1e-12 * 600e3)
    after = C.reshape(12, 8).T
    assert np.linalg.det(
        after.reshape(8, 2, 6)[..., [[0, 3, 4], [3, 1, 5], [4, 5, 2]]]
    ) == pytest.approx(1.0, rel=1e-13)


def test_stress_is_that_of_an_energy_and_frame_indifferent(
    strained: tuple[np.ndarray, np.ndarray],
) -> None:
    """P = dW/dF at fixed Cv; P(Q F) = Q P(F), so that it exerts no torque."""
    F, memory = strained
    W, P = stored(BRANCHES, F, memory, 0.0)
    for k in range(9):
        d = 1e-6 * np.eye(9)[k].reshape(3, 3)
        slope = (
            stored(BRANCHES, F + d, memory, 0.0)[0] - stored(BRANCHES, F - d, memory, 0.0)[0]
        ) / 2e-6
        np.testing.assert_allclose(
            slope, P.reshape(8, 9)[:, k], rtol=0, atol=1e-8 * np.abs(P).max()
        )
    Q = Rotation.from_rotvec([0.4, -1.0, 2.0]).as_matrix()
    np.testing.assert_allclose(stored(BRANCHES, Q @ F, memory, 0.0)[0], W, rtol=1e-12)
    np.testing.assert_allclose(
        stored(BRANCHES, Q @ F, memory, 0.0)[1], Q @ P, rtol=0, atol=1e-12 * np.abs(P).max()
    )
    np.testing.assert_allclose(
        P @ F.transpose(0, 2, 1), F @ P.transpose(0, 2, 1), rtol=0, atol=1e-12 * np.abs(P).max()
    )


def test_it_only_loses_energy(strained: tuple[np.ndarray, np.ndarray]) -> None:
    """At fixed F, W falls with the length of the step, from any Cv, to zero: the branch has relaxed."""
    F, memory = strained
    along = np.array(
        [stored(BRANCHES, F, memory, lag)[0] for lag in (0.0, *np.geomspace(1e-7, 1.0, 40))]
    )
    assert (np.diff(along, axis=0) <= 1e-9).all()
    assert (along >= -1e-9).all()
    np.testing.assert_allclose(along[-1], 0.0, atol=1e-6)


def sheared(strain: np.ndarray, dt: float) -> np.ndarray:
    """Shear stress (steps,) Pa along a path of small shear strains (steps,)."""
    F = np.tile(lanes(np.tile(np.eye(3), (8, 1, 1))), (len(strain), 1))
    P = np.zeros((len(strain), 72))
    F[:, 8:16] = strain[:, None]
    follow(RECORD, TABLE, dt, F, np.repeat(np.tile(AT_REST, 2), 8), P)
    return P[:, 8]


def test_stress_after_a_step_of_strain() -> None:
    """It falls as sum G exp(-t/T), to 0.2 % of the first value, over six decades of time in steps of a hundredth of the shortest T."""
    t = 1e-5 * np.arange(5000)
    expected = sum(one.shear_modulus * np.exp(-t / one.time) for one in BRANCHES)
    np.testing.assert_allclose(
        sheared(np.full(5000, 1e-5), 1e-5)[1:] / 1e-5, expected[1:], rtol=0, atol=2e-3 * 600e3
    )


@pytest.mark.parametrize("turn", [0.05, 0.3, 1.0, 3.0, 20.0])
def test_storage_and_loss(turn: float) -> None:
    """G* = sum G i w T / (1 + i w T) to 0.02 %, in steps that a motion takes; turn: w times the longer T."""
    w = turn / 10e-3
    dt = 1e-5
    period = round(2 * np.pi / w / dt)
    t = dt * np.arange(max(5 * period, 8000))
    wave = np.stack([np.sin(w * t), np.cos(w * t)], axis=1)[-period:]
    found = np.linalg.lstsq(wave, sheared(1e-4 * np.sin(w * t), dt)[-period:] / 1e-4, rcond=None)[0]
    expected = sum(
        one.shear_modulus * 1j * w * one.time / (1 + 1j * w * one.time) for one in BRANCHES
    )
    np.testing.assert_allclose(found, [expected.real, expected.imag], rtol=2e-4)


def moving(**losses: object) -> Scene:
    """A short rod that a field bends quickly; 2 ms take some 80 steps."""
    data = rod_scene(length=8e-3, field=(0, 0, 20e-3)).to_si()
    data["effects"]["viscosity"] = losses
    return Scene.from_si(data | {"solver": {"dynamic": {"duration": 4e-3, "output_every": 0.5e-3}}})


def total_energies(scene: Scene) -> np.ndarray:
    found: list[float] = []
    integrate(
        begin(build(scene)), on_state=lambda state: found.append(sum(state.energies.values()))
    )
    return np.array(found)


def test_a_motion_loses_what_its_branches_lose() -> None:
    """The sum of all energies, with what branches store, falls from frame to frame; where they take 1000 s to relax, it is conserved."""
    lost = total_energies(moving(branches=[{"shear_modulus": 240e3, "time": 2e-3}]))
    kept = total_energies(moving(branches=[{"shear_modulus": 240e3, "time": 1e3}]))
    assert (np.diff(lost) < 0).all()
    assert np.abs(kept).max() < 1e-3 * abs(lost[-1])


def test_restart_is_bit_for_bit(tmp_path) -> None:  # type: ignore[no-untyped-def]
    scene = moving(branches=TWO)
    half = Scene.from_si(
        scene.to_si() | {"solver": {"dynamic": {"duration": 2e-3, "output_every": 0.5e-3}}}
    )
    integrate(begin(build(half)), folder=tmp_path)
    one = integrate(begin(build(scene))).motion.state()
    two = integrate(begin(build(scene)), folder=tmp_path, resume=True).motion.state()
    assert one.keys() == two.keys() >= {"memory"}
    assert all(np.array_equal(one[name], two[name]) for name in one)


def test_what_is_not_named_costs_nothing() -> None:
    plain = moving(viscosity=5.0)
    assert TotalMotion(build(plain)).memory.nbytes == 0
    assert [record.dtype.names for record in build(plain).effects[::2]] == [
        ("viscosity",),
        ("field_over_mu0",),
    ][::-1]
    assert (
        Scene.from_si(plain.to_si()).hash()
        == plain.hash()
        != moving(viscosity=5.0, branches=TWO).hash()
    )


@pytest.mark.parametrize(
    ("losses", "text"),
    [
        (
            {"branches": [{"shear_modulus": "500 kPa", "time": "0 s"}]},
            r"branches\[0\]\.time(?s:.*)must be greater than 0 s",
        ),
        (
            {"branches": [{"shear_modulus": "-5 kPa", "time": "1 s"}]},
            r"branches\[0\]\.shear_modulus(?s:.*)must be greater than 0 kPa",
        ),
        ({"branches": []}, r"branches"),
        ({}, r"give `loss_factor`, or `viscosity` or `branches` or both"),
    ],
)
def test_bad_input_is_refused(losses: dict[str, object], text: str) -> None:
    with pytest.raises(InputError, match=text):
        validate(Viscosity, losses, "scene.yaml")


@pytest.mark.parametrize("loss_factor", [0.001, 0.02, 0.1, 0.3])
def test_a_loss_factor_is_nearly_constant(loss_factor: float) -> None:
    """G''/G' of its branches from 1 Hz to 1 kHz, within 7 %."""
    shares, times = of_loss_factor(loss_factor)
    x = 2j * np.pi * np.geomspace(1.0, 1e3, 301)[:, None] * times
    modulus = 1.0 + (x / (1.0 + x)) @ shares
    np.testing.assert_allclose(modulus.imag / modulus.real, loss_factor, rtol=0.07)
    assert (shares > 0).all()


def test_a_loss_factor_is_of_the_scenes_modulus() -> None:
    """Its branches are shares of the modulus of what moves, in kernels, memory and step; two moduli are refused, with what to write."""
    scene = with_effects(rod_scene(), viscosity={"loss_factor": 0.1})
    shares, times = of_loss_factor(0.1)
    (material,) = scene.materials.values()
    modulus = material.shear_modulus
    _, table = scene.effects.viscosity.records(scene)
    np.testing.assert_allclose(table, np.column_stack([shares * modulus, times]).ravel())
    assert acting.remembered(scene).size == 6 * len(times)
    assert acting.instant_modulus(scene) == pytest.approx(shares.sum() * modulus)
    with pytest.raises(SceneError, match=r"loss_factor.*120 kPa and 360 kPa\n.*one shear modulus"):
        build(
            with_effects(
                rod_scene(shear=[120e3, 360e3], directions=[(1, 0, 0)] * 2),
                viscosity={"loss_factor": 0.1},
            )
        )


@pytest.mark.parametrize("more", [{"viscosity": 5.0}, {"branches": TWO}])
def test_a_loss_factor_stands_alone(more: dict[str, object]) -> None:
    with pytest.raises(InputError, match="give `loss_factor` or the others, not both"):
        with_effects(rod_scene(), viscosity={"loss_factor": 0.1, **more})


def with_effects(scene: Scene, **effects: object) -> Scene:
    """The scene in motion with these effects alone."""
    data = scene.to_si()
    return Scene.from_si({**data, "effects": effects, "solver": {"dynamic": {"duration": 0.01}}})


def test_a_viscosity_that_makes_short_steps_tells_a_branch_that_does_not() -> None:
    """Its complex modulus is within 1 % of G of i w eta up to the frequency that is told; three digits are told, so 1.1 %."""
    scene = moving(viscosity=300.0)
    (told,) = acting.warnings(scene)
    numbers = re.search(r"modulus: ([0-9.]+) MPa, time: ([0-9.]+) µs.* below ([0-9.]+) Hz", told)
    assert numbers is not None
    modulus, time, frequency = (float(number) for number in numbers.groups())
    assert modulus * time == pytest.approx(300.0, rel=0.01)
    turn = 2 * np.pi * frequency * np.array([0.1, 1.0, 1.5])
    branch = 1e6 * modulus * 1j * turn * 1e-6 * time / (1 + 1j * turn * 1e-6 * time)
    away = np.abs(branch - 300.0j * turn) / 120e3
    assert away[1] == pytest.approx(0.01, rel=0.1)
    assert away[0] < 0.01 < away[2]
    assert not acting.warnings(moving(viscosity=5.0))
