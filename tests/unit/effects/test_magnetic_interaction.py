"""Segments that act on each other: strength, laws, and equilibrium."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from reference.scenes import rod_scene
from reference.taylor import slopes

from magmpm.effects import acting as effects
from magmpm.effects import magnetic_interaction as interaction
from magmpm.effects.base import MarkedParticles
from magmpm.errors import InputError
from magmpm.fields.dipole import MU0
from magmpm.model import Model, build
from magmpm.scene import Scene
from magmpm.statics import axis
from magmpm.statics.energy import Energy
from magmpm.statics.equilibrium import solve_static
from magmpm.statics.interacting import InteractingEnergy
from magmpm.statics.layout import static_model

X, Z = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
MIXED = [X, (0.0, 1.0, 0.0), Z, (0.0, -1.0, 0.0), (1.0, 0.0, 1.0)]


def scene(directions: list[tuple[float, float, float]], *, across: int = 3, **more: object) -> Scene:
    """Segments of 4 mm diameter, 8 mm long, Br 0.1 T."""
    given = rod_scene(length=8e-3 * len(directions), directions=directions, **more)  # type: ignore[arg-type]
    return given.with_effects(magnetic_interaction={"blocks_across": across})


def acting(model: Model, x: np.ndarray, F: np.ndarray) -> tuple[np.ndarray, ...]:
    """Places, moments, volumes, segments, fields and forces of the blocks."""
    p = model.particles
    X, M, V, of = interaction.dipoles(MarkedParticles(model.remanence[:, 3], p.segment, p.volume, model.remanence[:, :3]), x, F)
    B, f = np.zeros_like(X), np.zeros_like(X)
    interaction._act(X, M, np.cbrt(V), of, B, f)
    return X, M, V, of, B, f


def at_rest(model: Model) -> tuple[np.ndarray, np.ndarray]:
    return model.particles.position, np.tile(np.eye(3), (len(model.density), 1, 1))


def bent(model: Model, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A body bent by about 40 degrees, with a small perturbation."""
    X = model.particles.position
    k = 0.7 / X[:, 0].max()
    s, c = np.sin(k * X[:, 0]), np.cos(k * X[:, 0])
    x = np.stack([s / k - X[:, 2] * s, X[:, 1], (1 - c) / k + X[:, 2] * c], axis=1)
    F = np.zeros((len(X), 3, 3))
    stretch = 1 - k * X[:, 2]
    F[:, 0, 0], F[:, 0, 2], F[:, 1, 1], F[:, 2, 0], F[:, 2, 2] = c * stretch, -s, 1, s * stretch, c
    return x, F + 0.01 * rng.standard_normal(F.shape)


@pytest.mark.parametrize(("direction", "axis", "want"), [(X, 0, 8.34e-3), (Z, 2, -4.17e-3)], ids=["axial", "transverse"])
def test_a_neighbours_mean_field(direction: tuple[float, float, float], axis: int, want: float) -> None:
    """Mean over a cylinder of the field of its neighbor: 8.34 mT axially, 4.17 mT transversely, from magpylib with a fine quadrature. The
    error of blocks of 1 mm is 0.7 %, of 2 mm 3 %."""
    for cells, bound in ((4, 0.01), (2, 0.035)):
        model = build(scene([direction, direction], cells=cells))
        _, _, V, of, B, _ = acting(model, *at_rest(model))
        mean = V[of == 1] @ B[of == 1] / V[of == 1].sum()
        assert mean[axis] == pytest.approx(want, rel=bound)
        np.testing.assert_allclose(np.delete(mean, axis), 0.0, atol=1e-9)


def test_far_away_a_segment_is_a_dipole(rng: np.random.Generator) -> None:
    """First and last of five segments, four lengths apart: the formula of dipoles, to about (length/distance)^2 = 6 %, and twice that for
    the force (one more derivative)."""
    model = build(scene([X, (0, 0, 0), (0, 0, 0), (0, 0, 0), Z]))
    _, M, _, of, B, f = acting(model, *at_rest(model))
    m = 0.1 / MU0 * np.pi * 4e-6 * 8e-3
    r = 32e-3
    np.testing.assert_allclose(M[of == 0].sum(axis=0), [m, 0, 0], rtol=1e-9, atol=1e-9 * m)
    mean = np.einsum("ki,ki->", M[of == 4], B[of == 4])
    assert abs(mean) < 1e-3 * m * 2e-7 * m / r**3, "a field along x does nothing to a moment along z"
    # the force on a moment along z in the field of one along x: 3 mu0 m^2 / (4 pi r^4) along z
    total = f[of == 4].sum(axis=0)
    assert total[2] == pytest.approx(3e-7 * m * m / r**4, rel=0.12)


def test_momentum_and_angular_momentum_stay(rng: np.random.Generator) -> None:
    """Forces cancel, and so do torques (of forces and of fields on moments): for the blocks, and in what the hooks add."""
    model = static_model(build(scene(MIXED)))
    x, F = bent(model, rng)
    places, moments, _, _, B, f = acting(model, x, F)
    np.testing.assert_allclose(f.sum(axis=0), 0.0, atol=1e-13 * np.abs(f).sum())
    torque = np.cross(places, f) + np.cross(moments, B)
    np.testing.assert_allclose(torque.sum(axis=0), 0.0, atol=1e-13 * np.abs(torque).sum())

    named = effects.collect(model.scene)
    effects.refresh(named, model, x, F)
    (record, data), V = named, model.particles.volume
    force, spin = np.zeros((len(V), 3)), np.zeros((len(V), 3))
    for p in range(len(V)):
        P = np.zeros((3, 3))
        interaction.force(record[0], data, model.remanence[p], 0.0, x[p], F[p], force[p])
        interaction.stress(record[0], data, model.remanence[p], 0.0, x[p], F[p], P)
        tau = -P @ F[p].T  # its skew part is the torque density, see magnetic_torque
        spin[p] = [tau[2, 1] - tau[1, 2], tau[0, 2] - tau[2, 0], tau[1, 0] - tau[0, 1]]
    total = V[:, None] * (np.cross(x, force) + spin)
    np.testing.assert_allclose(V @ force, 0.0, atol=1e-13 * (V @ np.abs(force)).sum())
    np.testing.assert_allclose(total.sum(axis=0), 0.0, atol=1e-12 * np.abs(total).sum())


@pytest.mark.parametrize("share", [1.0, 0.3])
def test_loads_are_the_derivatives_of_the_energy(rng: np.random.Generator, share: float) -> None:
    """The whole model with blocks that touch: the residual is the gradient of the energy, computed for every shape; share: of the load."""
    model = static_model(build(scene(MIXED[:3])))
    whole = InteractingEnergy(model, share)
    c, v = 2e-5 * rng.standard_normal((2, *whole.alone.shape))
    point = whole.at(c)
    bare = Energy(replace(model, effects=())).residual(point)
    gradient = whole.residual(point)
    assert np.abs(gradient - bare).max() > 1e-3 * np.abs(gradient).max(), "the segments act"
    # without the elastic energy, which would hide an error of a percent: the interaction energy alone
    linear = float(np.sum((gradient - bare) * v))
    shared = lambda t: whole.at(c + t * v).energy - whole.alone.at(c + t * v).energy  # noqa: E731
    start = shared(0.0)
    assert slopes(lambda t: shared(t) - start - t * linear, [0.4, 0.2, 0.1, 0.05])[-1] == pytest.approx(2.0, abs=0.05)


@pytest.mark.slow  # it compiles for most of its 40 s
def test_equilibrium_is_a_stationary_point_below_where_it_began() -> None:
    """For the total energy: the residual is negligible compared with the forces between segments, and the energy is lower than at the shape
    without the effect, which is different."""
    alone = rod_scene(length=40e-3, directions=MIXED, field=(0, 1e-3, 8e-3))
    named = alone.with_effects(magnetic_interaction={})
    found, without = (solve_static(static_model(build(one))) for one in (named, alone))
    whole = InteractingEnergy(static_model(build(named)))
    assert np.linalg.norm(axis.tip(whole.model, found.point.grid) - axis.tip(whole.model, without.point.grid)) > 1e-4
    start, end = whole.at(without.point.grid), whole.at(found.point.grid)
    loads = np.abs(whole.residual(start)).max()
    assert end.energy < start.energy
    assert end.energy == pytest.approx(found.point.energy, rel=1e-9)
    # the energy decrement was 1e-11 of the energy, so the residual is some 1e-5 of the loads at the start
    assert np.abs(whole.residual(end)).max() < 1e-3 * loads


def test_one_magnetised_segment_is_alone() -> None:
    lonely = scene([X, (0, 0, 0)])
    assert effects.collect(lonely) == ()
    assert not effects.feels_itself(lonely)


def test_blocks_are_whole_cells_of_one_segment() -> None:
    """Every magnetized particle has one; a block is no larger than a segment, and no longer than two of its own widths."""
    model = build(scene([X, (0, 0, 0), Z], cells=4, across=2))
    block, p = model.remanence[:, 3], model.particles
    assert np.all((block >= 0) == model.remanence[:, :3].any(axis=1))
    for k in np.unique(block[block >= 0]):
        own = block == k
        assert len(np.unique(p.segment[own])) == 1
        cells = p.cell[own]
        assert np.ptp(cells, axis=0).max() <= 1, "two cells a side: 4 cells across, 2 blocks"


@pytest.mark.parametrize("cells", [2, 3, 4, 5, 6, 7])
@pytest.mark.parametrize("across", [1, 2, 3])
def test_blocks_are_their_own_mirror_image(cells: int, across: int) -> None:
    """Particles that share a block still do when y is turned into -y: otherwise a scene and its mirror image would differ."""
    scene = rod_scene(length=8e-3, cells=cells)
    particles = build(scene).particles
    remanence = np.ones((len(particles.position), 3))
    blocks = interaction.MagneticInteraction(blocks_across=across).marks(particles, remanence)
    assert blocks.min() >= 0
    key = np.round(particles.position / 1e-9).astype(int)
    place = {tuple(at): k for k, at in enumerate(key.tolist())}
    image = np.array([place[x, -y, z] for x, y, z in key.tolist()])
    pairs = set(zip(blocks.tolist(), blocks[image].tolist(), strict=True))
    assert len(pairs) == len(set(blocks.tolist())), "a block and its image are cut in different ways"


def test_too_many_blocks_are_refused() -> None:
    with pytest.raises(InputError, match=r"blocks_across: received 5; the segments make [3-9]\d\d\d blocks"):
        build(scene([X] * 20, across=5, cells=5))
