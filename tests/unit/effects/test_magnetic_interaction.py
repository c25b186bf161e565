"""Segments that act on each other: strength, laws, and equilibrium."""

from dataclasses import replace

import numpy as np
import pytest
from reference.motions import bent
from reference.moving import resting_scene
from reference.scenes import rod_scene
from reference.taylor import slopes

from magmpm.effects import acting as effects
from magmpm.effects import magnetic_interaction as interaction
from magmpm.effects.base import MarkedParticles
from magmpm.errors import InputError
from magmpm.model import Model, build
from magmpm.scene import Scene
from magmpm.solving.influence import variants
from magmpm.statics import axis
from magmpm.statics.energy import Energy
from magmpm.statics.equilibrium import solve_static
from magmpm.statics.interacting import InteractingEnergy
from magmpm.statics.layout import static_model

X = (1.0, 0.0, 0.0)
Z = (0.0, 0.0, 1.0)
MIXED = [X, (0.0, 1.0, 0.0), Z, (0.0, -1.0, 0.0), (1.0, 0.0, 1.0)]


def scene(
    directions: list[tuple[float, float, float]], *, across: int = 3, **more: object
) -> Scene:
    """Segments of 4 mm diameter, 8 mm long, Br 0.1 T."""
    given = rod_scene(length=8e-3 * len(directions), directions=directions, **more)  # type: ignore[arg-type]
    return given.with_effects(magnetic_interaction={"blocks_across": across})


def acting(model: Model, x: np.ndarray, F: np.ndarray) -> tuple[np.ndarray, ...]:
    """Places, moments, volumes, segments, fields and forces of the blocks."""
    p = model.particles
    X, M, V, of = interaction.dipoles(
        MarkedParticles(model.remanence[:, 3], p.segment, p.volume, model.remanence[:, :3]), x, F
    )
    B = np.zeros_like(X)
    f = np.zeros_like(X)
    interaction._act(X, M, np.cbrt(V), of, B, f)
    return X, M, V, of, B, f


def at_rest(model: Model) -> tuple[np.ndarray, np.ndarray]:
    return model.particles.position, np.tile(np.eye(3), (len(model.density), 1, 1))


@pytest.mark.parametrize(
    ("direction", "axis", "want"), [(X, 0, 8.34e-3), (Z, 2, -4.17e-3)], ids=["axial", "transverse"]
)
def test_a_neighbours_mean_field(
    direction: tuple[float, float, float], axis: int, want: float
) -> None:
    """Mean over a cylinder of its neighbor's field: 8.34 mT axial, 4.17 mT transverse, by magpylib; blocks of 1 mm 0.7 % off, 2 mm 3 %."""
    for cells, bound in ((4, 0.01), (2, 0.035)):
        model = build(scene([direction, direction], cells=cells))
        _, _, V, of, B, _ = acting(model, *at_rest(model))
        mean = V[of == 1] @ B[of == 1] / V[of == 1].sum()
        assert mean[axis] == pytest.approx(want, rel=bound)
        np.testing.assert_allclose(np.delete(mean, axis), 0.0, atol=1e-9)


def pair(r: float, moments: np.ndarray) -> tuple[float, np.ndarray]:
    """Energy (J) of two cubes of 1 mm at the distance r (m) along x, and the force (3,) N on the second."""
    places = np.array([[0.0, 0.0, 0.0], [r, 0.0, 0.0]])
    field = np.zeros((2, 3))
    force = np.zeros((2, 3))
    interaction._act(places, moments, np.full(2, 1e-3), np.arange(2), field, force)
    return -0.5 * float(np.sum(moments * field)), force[1]


def test_the_energy_of_blocks_that_overlap_is_bounded(rng: np.random.Generator) -> None:
    """Springs of contact let bodies overlap; dipoles would then fall into each other. At every distance the force is the energy's slope."""
    along = np.array([[1e-3, 0.0, 0.0]] * 2)
    touching = pair(1e-3, along)[0]
    near = [pair(r, along)[0] / touching for r in np.linspace(1e-6, 1e-3, 200)]
    assert min(near) >= 0.0
    assert max(near) < 2.0, (
        "the work of two cubes that fall together is less than that of two which meet"
    )
    moments = 1e-3 * rng.standard_normal((2, 3))
    step = 1e-7
    for r in (0.2e-3, 0.7e-3, 0.999e-3, 1.001e-3, 1.2e-3, 1.349e-3, 1.351e-3, 3e-3):
        slope = (pair(r + step, moments)[0] - pair(r - step, moments)[0]) / (2 * step)
        assert pair(r, moments)[1][0] == pytest.approx(-slope, rel=1e-6), "an error of (step / r)^2"
    at_one_place = pair(0.0, moments)
    assert at_one_place[0] == 0.0
    assert not at_one_place[1].any()


def test_momentum_and_angular_momentum_stay(rng: np.random.Generator) -> None:
    """Forces cancel, and so do torques (of forces and of fields on moments)."""
    model = static_model(build(scene(MIXED)))
    x, F = bent(
        model.particles.position, 0.7 / model.particles.position[:, 0].max()
    )  # by about 40 degrees
    places, moments, _, _, B, f = acting(model, x, F + 0.01 * rng.standard_normal(F.shape))
    np.testing.assert_allclose(f.sum(axis=0), 0.0, atol=1e-13 * np.abs(f).sum())
    torque = np.cross(places, f) + np.cross(moments, B)
    np.testing.assert_allclose(torque.sum(axis=0), 0.0, atol=1e-13 * np.abs(torque).sum())


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
    assert slopes(lambda t: shared(t) - start - t * linear, [0.4, 0.2, 0.1, 0.05])[
        -1
    ] == pytest.approx(2.0, abs=0.05)


@pytest.mark.slow  # it compiles for most of its 40 s
def test_equilibrium_is_a_stationary_point_below_where_it_began() -> None:
    """For the total energy: the residual is negligible beside forces between segments, and the energy lower than at the shape without."""
    alone = rod_scene(length=40e-3, directions=MIXED, field=(0, 1e-3, 8e-3))
    named = alone.with_effects(magnetic_interaction={})
    found, without = (solve_static(static_model(build(one))) for one in (named, alone))
    whole = InteractingEnergy(static_model(build(named)))
    assert (
        np.linalg.norm(
            axis.tip(whole.model, found.point.grid) - axis.tip(whole.model, without.point.grid)
        )
        > 1e-4
    )
    start = whole.at(without.point.grid)
    end = whole.at(found.point.grid)
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
    block = model.remanence[:, 3]
    p = model.particles
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
    assert len(pairs) == len(set(blocks.tolist())), (
        "a block and its image are cut in different ways"
    )


def test_too_many_blocks_are_refused() -> None:
    with pytest.raises(
        InputError, match=r"blocks_across: received 5; the segments make [3-9]\d\d\d blocks"
    ):
        build(scene([X] * 20, across=5, cells=5))


def test_in_plane_strain_it_is_refused() -> None:
    """Its dipoles are as wide as the strip, and what has no end along y has another field: tips would move with the width."""
    sizes = {"length": 12e-3, "width": 4e-3, "thickness": 1e-3, "material": "m"}
    segments = [{"magnetization": [0, 0, 1]}, {"magnetization": [1, 0, 0]}]
    strip = {"strip": {**sizes, "segments": segments, "plane_strain": True}}
    with pytest.raises(InputError, match="no end along y"):
        resting_scene(strip, {"magnetic_interaction": {}})
    alone = resting_scene(strip, {"gravity": {}})
    assert isinstance(variants(alone, "magnetic_interaction"), str)
