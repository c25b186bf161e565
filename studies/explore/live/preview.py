"""The shape at once: the rod's, dressed with what the last solve added to its rod.

The rod takes milliseconds. Seen from the rod's frames, what the 3D solve adds to it is nearly the same for a neighboring scene, so that a
preview is close to the solution where a slider has moved a little. It is a preview all the same, and the page says so.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from magmpm.bodies.segments import StraightBody
from magmpm.compiled.arrays import Array
from magmpm.errors import InputError, SolveError
from magmpm.model import build
from magmpm.results.measures import region_means
from magmpm.results.result import Result
from magmpm.rod.cosserat import solve_rod
from magmpm.scene import Scene
from magmpm.statics.axis import centreline
from magmpm.statics.energy import Energy
from magmpm.statics.layout import static_model
from magmpm.statics.rod_start import from_rod, with_correction


@dataclass(frozen=True)
class Shape:
    """A deformed body. SI units.

    reference, position (n, 3) m, volume (n,) m^3, part (n,): its particles; axis (m, 3) m, deformed, or none; center (k, 3) m and
    remanence (k, 3) T: of its regions, deformed; field (3,) T at its center.
    """

    reference: Array
    position: Array
    volume: Array
    part: NDArray[np.int32]
    axis: Array
    center: Array
    remanence: Array
    field: Array

    @classmethod
    def of(cls, result: Result) -> Shape:
        """Shape of a result."""
        return cls(
            result.particle_reference, result.particle_position, result.particle_volume, result.particle_segment, result.centreline[:, 1:4],
            result.segment_center, result.segment_remanence, np.asarray(result.field),
        )  # fmt: skip


class Preview:
    """Previews of one scene's variants."""

    def __init__(self) -> None:
        self._correction = np.zeros((0, 0))

    def learn(self, result: Result) -> None:
        """Take from a solve what it added to its rod."""
        self._correction = result.grid_correction

    def shape(self, scene: Scene) -> Shape | None:
        """The shape of a scene's rod; None where there is none: the body is no rod, or its rod finds no equilibrium.

        Raises InputError for a scene whose body and field do not go together.
        """
        body = scene.body.shape
        if not isinstance(body, StraightBody) or body.clamp != "base":
            return None
        try:
            rod = solve_rod(scene)
            model = static_model(build(scene))
        except InputError:
            raise
        except SolveError:
            return None
        known = self._correction.shape == (model.layout.planes, model.layout.m)
        grid = with_correction(model, rod, self._correction) if known else from_rod(model, rod)
        point = Energy(model).at(grid)
        position, particles = point.position, model.particles
        return Shape(
            particles.position, position, particles.volume, particles.segment, centreline(model, grid)[:, 1:4],
            region_means(model, position), region_means(model, np.einsum("nij,nj->ni", point.F, model.remanence[:, :3])),
            np.asarray(rod.field[len(rod.s) // 2]),
        )  # fmt: skip
