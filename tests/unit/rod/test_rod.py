"""The Cosserat rod: derivatives, closed-form solutions, symmetry."""

from dataclasses import replace

import numpy as np
import pytest
from reference.elastica import elastica, heavy_elastica
from reference.scenes import BR, G, field_for_load, rod_scene
from reference.taylor import convergence_order
from scipy.spatial.transform import Rotation

from magmpm.fields.dipole import MU0
from magmpm.materials import poisson_ratio, young_modulus
from magmpm.rod.cosserat import RodModel, rod_model, solve_rod, solve_rod_model
from magmpm.rod.kernels import _energy, _turn, derivatives
from magmpm.scene import Scene

L = 40e-3
D = 1e-3
E = young_modulus(G, 20 * G)
AREA = np.pi / 4 * D**2
INERTIA = np.pi / 64 * D**4
MOMENT = BR * AREA / MU0  # A m^2 per meter of rod


def slender(**changes: object) -> Scene:
    return rod_scene(**{"length": L, "diameter": D, **changes})


def spatial() -> Scene:
    loads = {"field": (2e-4, 1e-3, -1.4e-3), "gravity": (1.0, -0.2, -0.5)}
    directions = [(1, 0, 0), (0.7, 0.6, 0.4), (-0.2, -0.8, 0.6)]
    return slender(
        directions=directions, shear=[G, G / 3, 2 * G], lengths=[9e-3, 18e-3, 13e-3], **loads
    )


class Chain:
    """The energy of a rod as a function of the rotations of its frames, at a bent and twisted state."""

    def __init__(self, rod: RodModel, rng: np.random.Generator) -> None:
        n = len(rod.length)
        self.rod = rod
        steps = Rotation.from_rotvec(0.3 * rng.standard_normal((n + 1, 3)))
        frames = [Rotation.identity()]
        for k in range(n):
            frames.append(frames[-1] * steps[k])
        self.q = np.array([np.roll(f.as_quat(), 1) for f in frames])  # scalar first
        self.loaded = rod.loaded()

    def at(self, d: np.ndarray) -> np.ndarray:
        out = np.empty_like(self.q)
        for k in range(len(d)):
            _turn(self.q[k], d[k], out[k])
        return out

    def energy(self, d: np.ndarray) -> float:
        return _energy(self.at(d), self.loaded)

    def derivatives(self) -> tuple[np.ndarray, np.ndarray]:
        """Gradient (n + 1, 3) and the dense Hessian."""
        n = len(self.rod.length)
        g = np.empty((n + 1, 3))
        Hd = np.empty((n + 1, 3, 3))
        Ho = np.empty((n, 3, 3))
        derivatives(self.q, self.loaded, g, Hd, Ho)
        H = np.zeros((n + 1, 3, n + 1, 3))
        for k in range(n + 1):
            H[k, :, k, :] = Hd[k]
        for k in range(n):
            H[k, :, k + 1, :], H[k + 1, :, k, :] = Ho[k], Ho[k].T
        return g, H.reshape(3 * (n + 1), -1)


@pytest.mark.parametrize("extensible", [True, False])
def test_every_entry_of_gradient_and_hessian(rng: np.random.Generator, extensible: bool) -> None:
    """Central differences along each unknown, and each pair of neighbors, at a bent, twisted state with every load: no error can be missed
    by a random direction. Compliances are a thousand times larger, so that a wrong term of stretch or shear would be visible.
    """
    rod = rod_model(spatial(), elements=6, extensible=extensible)
    chain = Chain(replace(rod, compliance=1e3 * rod.compliance, weight=30 * rod.weight), rng)
    g, H = chain.derivatives()
    np.testing.assert_allclose(H, H.T, rtol=0, atol=1e-14 * np.abs(H).max())
    n = g.size
    h = 1e-4
    unit = np.eye(n).reshape(n, *g.shape)
    plus, minus = ([chain.energy(sign * h * e) for e in unit] for sign in (1, -1))
    base = chain.energy(0 * g)
    scale = np.abs(H).max()
    found = (np.array(plus) - np.array(minus)) / (2 * h)
    np.testing.assert_allclose(
        found, g.ravel(), rtol=0, atol=1e-7 * scale
    )  # h^2 of the third derivative
    for a in range(n):
        for b in range(a, min(n, a + 6)):
            second = chain.energy(h * (unit[a] + unit[b])) - plus[a] - plus[b] + base
            second = (
                second + chain.energy(-h * (unit[a] + unit[b])) - minus[a] - minus[b] + base
            ) / (2 * h * h)
            assert second == pytest.approx(
                H[a, b], abs=1e-6 * scale
            )  # rounding error 1e-16/h^2, and h^2


def test_unloaded_rod_is_straight() -> None:
    shape = solve_rod(slender())
    np.testing.assert_allclose(shape.position, np.outer(shape.s, [1, 0, 0]), rtol=1e-15)
    assert not shape.position[:, 1:].any()
    assert not shape.curvature.any()
    assert shape.stable


def test_small_transverse_field() -> None:
    """E I theta' = m B (L - s) and shear m B/(k G A): tip z = m B (L^3/(3 E I) + L/(k G A)), k of Cowper.

    A short thick rod, where shear matters. Nonlinear terms are the square of the tip angle, 1e-8.
    """
    B = 1e-7
    length = 8e-3
    diameter = 4e-3
    area = np.pi / 4 * diameter**2
    inertia = np.pi / 64 * diameter**4
    nu = poisson_ratio(G, 20 * G)
    k = 6 * (1 + nu) / (7 + 6 * nu)
    m = BR * area / MU0
    exact = m * B * (length**3 / (3 * E * inertia) + length / (k * G * area))
    found = solve_rod(rod_scene(length=length, diameter=diameter, field=(0, 0, B))).position[-1, 2]
    assert found == pytest.approx(exact, rel=1e-5)  # second order in 180 elements
    assert length / (k * G * area) / (length**3 / (3 * E * inertia)) > 0.1, "shear counts"


def test_axial_field_stretches() -> None:
    """A field along the magnetization pulls: strain Br B/(mu0 E), all along."""
    shape = solve_rod(slender(field=(5e-3, 0, 0)))
    strain = BR * 5e-3 / (MU0 * E)
    np.testing.assert_allclose(shape.position[:, 0], shape.s * (1 + strain), rtol=1e-12)
    assert strain > 1e-3


def test_part_of_the_load() -> None:
    """The equilibrium at half the load is that of half the field and weight, including stretch."""
    half = spatial().with_field(0.5 * np.array(spatial().field.uniform))
    half = half.with_effects(gravity={"acceleration": [0.5, -0.1, -0.25]})
    one = solve_rod_model(rod_model(spatial()), np.linspace(0, 0.5, 6)[1:])
    two = solve_rod(half)
    np.testing.assert_allclose(one.position, two.position, rtol=0, atol=1e-9 * L)
    np.testing.assert_allclose(one.strain, two.strain, rtol=0, atol=1e-9)


def test_piecewise_stiffness_and_magnetisation() -> None:
    """Three unequal segments, one soft, the last unmagnetized: theta' = M(s)/(E I(s)), M(s) = m B (magnetized length beyond s)."""
    lengths = np.array([7e-3, 20e-3, 13e-3])
    moduli = np.array([G, G / 5, 3 * G])
    magnets = [1, 1, 0]
    B = 1e-7
    scene = slender(
        lengths=lengths, shear=moduli, directions=[(m, 0, 0) for m in magnets], field=(0, 0, B)
    )
    shape = solve_rod(scene, extensible=False)
    edges, ds = np.linspace(0, L, 400001, retstep=True)
    s = (edges[1:] + edges[:-1]) / 2
    of = np.searchsorted(np.cumsum(lengths), s).clip(max=2)
    beyond = np.clip(lengths[:2].sum() - s, 0, None)
    angle = np.cumsum(MOMENT * B * beyond / (E * INERTIA * (moduli / G)[of])) * ds
    assert shape.frames[-1, 2, 0] == pytest.approx(
        angle[-1], rel=1e-4
    )  # 180 elements, second order
    assert shape.position[-1, 2] == pytest.approx(angle.sum() * ds, rel=1e-4)


@pytest.mark.parametrize("weight", [1.0, 5.0, 15.0])
def test_heavy_rod(weight: float) -> None:
    """The heavy elastica, to 1e-4 of L along the whole rod; a load of 15 is a long thin catheter under gravity."""
    g = weight * E * INERTIA / (1882 * AREA * L**3)
    shape = solve_rod(slender(gravity=(0, 0, -g)), extensible=False)
    exact = heavy_elastica(weight, shape.s / L)
    np.testing.assert_allclose(shape.position[:, 0] / L, exact[:, 0], rtol=0, atol=1e-4)
    np.testing.assert_allclose(-shape.position[:, 2] / L, exact[:, 1], rtol=0, atol=1e-4)


@pytest.mark.parametrize("load", [0.5, 3.0, 10.0])
def test_twist_is_a_pendulum(load: float) -> None:
    """Magnetized along +y, field along +z: G J theta'' = -m B cos(theta), the equation of the elastica at 90 degrees, without bending."""
    B = load * 2 * G * INERTIA / (MOMENT * L**2)
    shape = solve_rod(slender(directions=[(0, 1, 0)], field=(0, 0, B)))
    twist = np.arctan2(shape.frames[:, 2, 1], shape.frames[:, 1, 1])
    exact = elastica(load, np.pi / 2)
    np.testing.assert_allclose(twist, exact.curve(shape.s / L)[:, 2], rtol=0, atol=1e-4)
    np.testing.assert_allclose(shape.position, np.outer(shape.s, [1, 0, 0]), rtol=0, atol=1e-12 * L)


def test_second_order_in_the_elements() -> None:
    """Against the elastica at load 5: the error falls as the square of the element length, to 1e-4 of L at 180 elements."""
    exact = elastica(5.0, np.pi / 2)
    counts = [20, 40, 80, 160]
    scene = slender(field=field_for_load(5.0, np.pi / 2, length=L, diameter=D))
    errors = []
    for n in counts:
        x, _, z = solve_rod(scene, n, extensible=False).position[-1] / L
        errors.append(np.hypot(x - exact.axial, z - exact.deflection))
    assert convergence_order(1 / np.array(counts), errors) == pytest.approx(2.0, abs=0.05)
    assert errors[-1] < 1e-4


@pytest.mark.parametrize("angle", [37.0, 90.0, 200.0])
def test_turned_about_its_axis(angle: float) -> None:
    """If magnetization, field and gravity rotate about x by any angle, the shape rotates with them, because the section is round."""
    R = Rotation.from_euler("x", angle, degrees=True).as_matrix()
    model = rod_model(spatial())
    turned = replace(
        model, moment=model.moment @ R.T, field=model.field @ R.T, weight=model.weight @ R.T
    )
    one = solve_rod_model(model)
    two = solve_rod_model(turned)
    np.testing.assert_allclose(two.position, one.position @ R.T, rtol=0, atol=1e-9 * L)
    assert np.linalg.norm(one.position[-1] - [L, 0, 0]) > 0.3 * L


def test_frames_are_rotations_and_carry_the_axis() -> None:
    shape = solve_rod(spatial())
    eye = np.broadcast_to(np.eye(3), shape.frames.shape)
    np.testing.assert_allclose(
        shape.frames @ shape.frames.transpose(0, 2, 1), eye, rtol=0, atol=1e-14
    )
    assert np.array_equal(shape.frames[0], np.eye(3)), "the clamp"
    # the axis follows R v: chord against the mean of both ends, second order in the element length
    ends = np.einsum("nij,nj->ni", shape.frames, shape.strain)
    chord = np.diff(shape.position, axis=0) / np.diff(shape.s)[:, None]
    np.testing.assert_allclose(chord, (ends[1:] + ends[:-1]) / 2, rtol=0, atol=1e-3)


def test_elements_end_where_segments_do() -> None:
    model = rod_model(spatial())
    ends = np.cumsum(model.length)
    for end in (9e-3, 27e-3, 40e-3):
        assert np.abs(ends - end).min() < 1e-12
    tiny = rod_model(slender(lengths=[0.05e-3, 39.95e-3], directions=[(1, 0, 0), (0, 1, 0)]))
    assert (tiny.length < 0.03e-3).sum() >= 2, "a short segment has elements of its own"


def test_position_between_frames() -> None:
    shape = solve_rod(spatial())
    middle = (shape.s[3] + shape.s[4]) / 2
    np.testing.assert_allclose(
        shape.at(np.array([middle]))[0], shape.position[3:5].mean(axis=0), rtol=1e-12
    )


def test_buckles_at_the_critical_load() -> None:
    """Field against the magnetization: straight at 0.995 of pi^2/4 and bent at 1.005, toward +z, as the elastica says."""
    critical = np.pi**2 / 4
    for part, bent in ((0.995, False), (1.005, True)):
        field = field_for_load(part * critical, np.pi, length=L, diameter=D) * [1, 0, 0]
        shape = solve_rod(slender(field=field), extensible=False)
        assert shape.stable
        if bent:
            # deflection grows as the square root of the excess load: 1e-4 of the load changes it by 1 % here
            expected = elastica(part * critical, np.pi).deflection
            assert shape.position[-1, 2] / L == pytest.approx(expected, rel=0.02)
        else:
            assert np.abs(shape.position[-1, 1:]).max() < 1e-9 * L
