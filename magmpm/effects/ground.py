"""ground: contact with a plane that the body may press on, stick to and slide over, with Coulomb friction.

The body touches by points of its surface. For force, friction and stiffness see effects.contact_law.
"""

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, field_validator

from magmpm.compiled.arrays import Array
from magmpm.compiled.jit import compiled, inlined
from magmpm.effects.base import Point, Records, SceneLike
from magmpm.effects.body_reach import body_reach, unreached
from magmpm.effects.contact_force import push, spring
from magmpm.effects.contact_law import (
    Friction,
    Obstacle,
    Stiffness,
    obstacle_dtype,
    obstacle_record,
)
from magmpm.effects.hooks import register
from magmpm.inputs.settings import fault
from magmpm.inputs.vectors import Direction, Vector

DTYPE = obstacle_dtype("ground", ("point", np.float64, (3,)), ("normal", np.float64, (3,)))


def parameters(*, point: ArrayLike, normal: ArrayLike, **pushing: float) -> Records:
    """Parameters for the kernels. point (3,) m on the plane; normal (3,) into the free side, any length; others: as in `push`."""
    n = np.asarray(normal, dtype=float)
    return obstacle_record(DTYPE, point=point, normal=n / np.linalg.norm(n), **pushing)


class Ground(Obstacle):
    """A plane the body may press on, stick to and slide over.

    Parameters
    ----------
    point : sequence (3,) of float or str, m
        A point of the plane: [x, y, z].
    normal : Angles, dict or sequence (3,), no unit, optional
        Away from the ground, toward the body; +z unless given.
    friction : float, no unit, optional
        Coulomb's coefficient of friction; 0, slippery, unless given.
    stiffness : float, no unit, optional
        Factor on the usual contact stiffness, at which the body sinks in by
        micrometers; 1 unless given. Above 1 the contact may require a smaller time step
        than the body.

    Examples
    --------
    >>> from magmpm import Ground
    >>> Ground(point=["0 mm", "0 mm", "-2 mm"], friction=0.4).point  # m
    (0.0, 0.0, -0.002)
    """

    WORDS = "the ground"
    CLEAR = "move the plane's `point` away from the body"
    point: Point = Field(
        description="A point of the plane: [x, y, z].", examples=[["0 mm", "0 mm", "-2 mm"]]
    )
    normal: Direction = Field(
        default=(0.0, 0.0, 1.0),
        description="Away from the ground, toward the body; +z unless given.",
        examples=[[0, 0, 1]],
    )
    friction: Friction = 0.0
    stiffness: Stiffness = 1.0

    @field_validator("normal")
    @classmethod
    def _has_a_direction(cls, normal: Vector) -> Vector:
        if not any(normal):
            raise fault("a plane's normal must have a direction", "write, say, `normal: [0, 0, 1]`")
        return normal

    def records(
        self, scene: SceneLike, strength: float = 1.0, times: Array | None = None
    ) -> Records:
        """Parameters for the kernels."""
        return parameters(
            point=self.point,
            normal=self.normal,
            friction=self.friction,
            stiffness=self.stiffness_in(scene),
        )

    def height(self, points: Array) -> Array:
        """Distance (n,) m of points (n, 3) m above the plane."""
        return np.asarray((points - np.array(self.point)) @ np.array(self.normal))

    def warnings(self, scene: SceneLike) -> list[str]:
        """Warn of a plane that is too far away to be touched."""
        limits = body_reach(scene)
        return unreached("ground", self.WORDS, limits, self.height(limits.base))


@inlined
def depth(effect, x):
    """Depth (m) of a point x below the plane; negative above it."""
    p = effect.ground_point
    n = effect.ground_normal
    return -((x[0] - p[0]) * n[0] + (x[1] - p[1]) * n[1] + (x[2] - p[2]) * n[2])


@inlined
def contact(effect, data, x, mass, f):
    """f += the plane's push and grip (contact_force). Returns the depth, m."""
    below = depth(effect, x)
    n = effect.ground_normal
    push(below, n[0], n[1], n[2], mass * effect.ground_stiffness, effect.ground_friction, f)
    return below


@compiled
def touch(effect, data, x, mass, f, H):
    """Energy (J) of a point at rest on the plane, its force and its tangent (contact_force.spring)."""
    below = depth(effect, x)
    if not below > 0.0:
        return 0.0
    n = effect.ground_normal
    return spring(below, n[0], n[1], n[2], mass * effect.ground_stiffness, f, H)


register(DTYPE, contact=contact, touch=touch)
