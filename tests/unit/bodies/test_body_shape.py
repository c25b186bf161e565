"""The contract of bodies: what scenes, models, effects and solvers may expect of every kind (bodies.body_shape)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from reference.solids import box

from magmpm.bodies.body import Body
from magmpm.bodies.body_shape import BodyShape, Discretization
from magmpm.bodies.segments import StraightBody
from magmpm.bodies.surface_mesh import pack_mesh

SEGMENTS = [{"magnetization": [1, 0, 0]}, {"magnetization": [0, 0, 0]}, {"magnetization": [0, 0.6, 0.8]}]
PLATE = {"length": 8e-3, "width": 4e-3, "thickness": 1e-3, "material": "soft"}
BODIES: dict[str, dict[str, Any]] = {
    "tube": {"catheter": {"length": 8e-3, "diameter": 2e-3, "inner_diameter": 0.8e-3, "material": "soft", "segments": SEGMENTS}},
    "strip": {"strip": {**PLATE, "position": [1e-3, 2e-3, 3e-3], "clamp": "both", "segments": SEGMENTS}},
    "sheet": {"strip": {**PLATE, "plane_strain": True, "magnetization_profile": {"harmonic": {"periods": 1.0}}}},
    "parts": {
        "parts": {
            "unit": "mm",
            "meshes": [
                {"mesh": pack_mesh(box((0, 0, 0), (1, 1, 1))), "material": "soft", "clamp": True},
                {"mesh": pack_mesh(box((1, 0, 0), (4, 1, 1))), "material": "soft", "magnetization": [0, 0, 1]},
                {"mesh": pack_mesh(box((0, 3, 0), (4, 4, 1))), "material": "soft"},
            ],
        }
    },
}
ACROSS, COUNT = 3, 2


@pytest.fixture(params=BODIES)
def shape(request: pytest.FixtureRequest) -> BodyShape:
    return Body(**BODIES[request.param]).shape


@pytest.fixture
def made(shape: BodyShape) -> Discretization:
    return shape.discretize(ACROSS, COUNT)


def test_the_grid_is_that_of_the_particles(shape: BodyShape, made: Discretization) -> None:
    """One grid a body; every particle is in the cell it names, and cells are about as wide as asked for through the thickness."""
    grid = shape.grid(ACROSS)
    assert (grid.origin.tobytes(), grid.spacing.tobytes(), grid.cells) == (
        made.grid.origin.tobytes(), made.grid.spacing.tobytes(), made.grid.cells,
    )  # fmt: skip
    made.grid.locate(made.particles.position, made.particles.cell)
    assert made.grid.spacing[2] == pytest.approx(shape.cell_size(ACROSS), rel=1e-9)  # every body here is a whole number of cells high


def test_particles_fill_the_body(shape: BodyShape, made: Discretization) -> None:
    """They lie in its box, reach all of its regions, and are no fewer than it says. Quadrature is exact: errors are rounding."""
    low, high = (np.array(corner) for corner in shape.box())
    assert np.all((made.particles.position > low) & (made.particles.position < high))
    assert np.unique(made.particles.segment).tolist() == list(range(len(shape.regions())))
    assert shape.fewest_particles(ACROSS, COUNT) <= len(made.particles.volume) * (1 + 1e-12)
    assert max(made.errors.values()) < 1e-9  # sums over hundreds of particles


def test_magnetization_has_length_one_or_none(shape: BodyShape, made: Discretization) -> None:
    """And is that of each region, where a region has one."""
    found = np.linalg.norm(shape.magnetization(made.particles), axis=1)
    wanted = np.array([np.linalg.norm(region.magnetization) for region in shape.regions()])[made.particles.segment]
    np.testing.assert_allclose(found, wanted, atol=1e-12)


def test_components_and_parts(shape: BodyShape, made: Discretization) -> None:
    """Parts that touch are one component, the part apart from them is another; bodies of one piece are one component and one part."""
    component, part = shape.components(made.particles), shape.part_of(made.particles)
    several = not isinstance(shape, StraightBody)
    assert [len(np.unique(component)), len(np.unique(part))] == ([2, 3] if several else [1, 1])
    assert (shape.line is None) == several


def test_a_kind_must_answer_everything() -> None:
    """A class that leaves a question of the interface open can't be made."""

    class Blob(BodyShape):
        pass

    with pytest.raises(TypeError, match="abstract"):
        Blob()  # type: ignore[abstract]
