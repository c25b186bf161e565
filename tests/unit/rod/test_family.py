"""Derivatives of the rod: Taylor's remainder, and agreement with the rod that is solved alone."""

from dataclasses import replace

import numpy as np
import pytest
from reference.scenes import rod_scene

from magmpm.compiled.arrays import Array
from magmpm.rod.cosserat import RodModel, rod_model, solve_rod
from magmpm.rod.derivative_kernels import relax_all, softest
from magmpm.rod.family import RodFamily
from magmpm.scene import Scene

GRAVITY = 9.81


@pytest.fixture
def scene() -> Scene:
    """A catheter with a plain segment, in a field and under its weight, bent and twisted by more than a radian."""
    directions = [[1, 0, 0], [0, 1, 0.3], [0, 0, 0], [0.2, -0.7, 1], [0, 0.4, -1]]
    loads = {"field": (2e-3, 6e-3, 8e-3), "gravity": (0, 0, -GRAVITY), "remanence": 0.138}
    return rod_scene(length=60e-3, diameter=3e-3, directions=directions, **loads)


def regions(scene: Scene) -> list[int]:
    return scene.magnetized_regions()


def directions(scene: Scene) -> Array:
    return np.array([scene.regions()[i].magnetization for i in regions(scene)])[None]


class Rod:
    """The rod's positions and rotations' slopes as a function of directions, field and acceleration, with shear that matters."""

    def __init__(self, scene: Scene) -> None:
        rod = rod_model(scene, 40)
        self.rod: RodModel = replace(rod, compliance=30 * rod.compliance)
        self.family = RodFamily.of(self.rod, scene.body.shape.segment_lengths(), regions(scene))
        self.beyond = np.linalg.norm(rod.weight, axis=1) / GRAVITY
        self.groups = len(self.family.sizes)

    def __call__(self, given: Array, field: Array, acceleration: Array) -> tuple[Array, Array]:
        """Positions (n + 1, 3) and slopes (columns, 2, n + 1, 3)."""
        frames = len(self.beyond)
        q = self.family.straight(1)
        m = self.family.moments(given)
        shares = np.zeros((2, 2, frames))
        shares[0, 0], shares[1, 1] = 1.0, self.beyond
        position = np.empty((1, frames, 3))
        found = np.empty(1, dtype=bool)
        slopes = np.empty((1, 3 * (self.groups + 2), 2, frames, 3))
        B = np.tile(field, (1, frames, 1))
        W = (self.beyond[:, None] * acceleration)[None]
        rod = self.rod
        for load in (0.3, 0.6, 1.0):
            rods = rod.loaded(moment=m, field=load * B, weight=load * W)
            relax_all(q, rods, (self.family.sizes, shares), position, slopes, found)
        assert found.all()
        return position[0], slopes[0]


@pytest.mark.parametrize("column", range(18))
def test_each_column_is_a_central_difference(scene: Scene, column: int) -> None:
    """Each component of each moment, of the field and of the acceleration."""
    rod = Rod(scene)
    given = directions(scene)
    field = np.array(scene.field.uniform)
    acceleration = np.array([0.0, 0.0, -GRAVITY])
    _, slopes = rod(given, field, acceleration)
    group, j = divmod(column, 3)

    def at(amount: float) -> Array:
        moved = [given.copy(), field.copy(), acceleration.copy()]
        if group < 4:
            moved[0][0, group, j] += amount
        else:
            moved[group - 3][j] += amount * (1e-2 if group == 4 else 10.0)
        return rod(*moved)[0]

    unit = (1.0, 1e-2, 10.0)[max(group - 3, 0)]
    h = 1e-3
    difference = (at(h) - at(-h)) / (2 * h)
    # the difference's own error is h^2 times the third derivative, up to half the first
    np.testing.assert_allclose(
        unit * slopes[column, 1], difference, rtol=0, atol=2e-6 * np.abs(difference).max()
    )


def test_a_family_has_the_shapes_of_its_rods(scene: Scene, rng: np.random.Generator) -> None:
    """Several directions and fields at once, as each alone: the plain segment and the weight are the scene's."""
    several = rng.normal(size=(3, len(regions(scene)), 3))
    several /= np.linalg.norm(several, axis=2, keepdims=True)
    fields = 4e-3 * rng.normal(size=(3, 3))
    rod = rod_model(scene, 60)
    family = RodFamily.of(
        replace(rod, field=np.zeros_like(rod.field)),
        scene.body.shape.segment_lengths(),
        regions(scene),
    )
    q = family.straight(3)
    for share in np.linspace(0.1, 1, 10):
        position, slopes, found = family.relaxed(q, several, fields, share=share)
    assert found.all()
    assert slopes.shape == (3, 61, 3, 15)
    for k in range(3):
        every = np.zeros((5, 3))
        every[regions(scene)] = several[k]
        alone = solve_rod(scene.with_magnetizations(every).with_field(fields[k]), 60)
        # both stop when their energy decrement is 1e-14 of the bending energy of a radian: turns of 1e-7
        np.testing.assert_allclose(position[k], alone.position, rtol=0, atol=1e-6 * scene.length)


def test_a_rod_past_its_critical_load_is_not_found_stable(scene: Scene) -> None:
    """Magnetized against the field, straight is an equilibrium, but no minimum: slopes there would mean nothing.

    A field of 0.2 nT across the rod, far below what moves it, says in which plane it bends: where that is free, the bent rod is no minimum
    either, or by rounding alone.
    """
    against = (
        scene.with_effects(gravity=None)
        .with_magnetizations(np.tile([1.0, 0, 0], (5, 1)))
        .with_field([-20e-3, 0, 2e-10])
    )
    rod = rod_model(against, 40)
    family = RodFamily.of(rod, against.body.shape.segment_lengths(), regions(against))
    q = family.straight(1)
    position = np.empty((1, 41, 3))
    slopes = np.zeros((1, 3, 2, 41, 3))
    found = np.ones(1, dtype=bool)
    rods = rod.loaded(
        moment=family.moments(directions(against)), field=rod.field[None], weight=rod.weight[None]
    )
    relax_all(q, rods, (family.sizes[:1], np.zeros((0, 2, 41))), position, slopes, found)
    assert found[0], "it leaves the straight shape and finds the bent one"
    assert np.abs(position[0, :, 2]).max() > 0.1 * against.length


def test_stability_of_a_rod_is_that_of_its_small_vibrations(scene: Scene) -> None:
    """Unloaded: 1, and the eigenvalue is (1.8751 / L)^4 E I for 1 kg/m (the clamped beam). It falls to 0 at the critical load.

    A rod magnetized toward its tip in a field B against it: E I theta'' + m B theta = 0, m B = E I (pi / 2L)^2 at the critical load.
    """
    bare = (
        scene.with_effects(gravity=None)
        .with_magnetizations(np.tile([1.0, 0, 0], (5, 1)))
        .with_field([0.0, 0, 0])
    )
    rod = replace(rod_model(bare, 120), compliance=np.zeros((120, 3)))
    family = RodFamily.of(rod, bare.body.shape.segment_lengths(), range(5))
    toward = np.tile([1.0, 0, 0], (5, 1))
    q = family.straight(1)[0]
    assert family.stability(q, toward, np.zeros(3)) == pytest.approx(1, rel=1e-12)
    bending = rod.twist_bend[0, 1]
    length = rod.length.sum()
    value = softest(q, rod.loaded())
    assert value == pytest.approx(
        bending * (1.87510407 / length) ** 4, rel=5e-4
    )  # of second order in 120 elements, and 1e-4 of iteration
    critical = bending * (np.pi / 2 / length) ** 2 / np.linalg.norm(rod.moment[0])
    near = [
        family.stability(q, toward, np.array([-share * critical, 0, 0]))
        for share in (0.5, 0.9, 0.99)
    ]
    assert near[2] == pytest.approx(
        0.01, rel=0.15
    )  # in proportion to what is left of the load, near the end
    assert near[0] > near[1] > near[2] > 0
    assert family.stability(q, toward, np.array([-1.01 * critical, 0, 0])) == 0
