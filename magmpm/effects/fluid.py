"""fluid: a fluid around the body buoys it, resists its motion, and is carried along by it.

The law of drag is one of pieces of the surface (bodies.wetted_surface), in their velocity u against the undisturbed stream, u_n along a
piece's normal and u_t beside it; of a rod u_n is across the axis and u_t along it. Per piece of the area A (a rod's: its length times its
diameter d), each of two directions joins a law of slow and one of fast motion as Churchill and Usagi join them, with the exponent 3/2:

    F_n = (V_n^(3/2) + (rho C A u_n / 2 + rho D A sqrt(nu u_n / d))^(3/2))^(2/3) u_n
    F_t = (V_t^(3/2) + (rho/2 S sqrt(nu (1.72^2 u_n / d + 1.328^2 u_t / L)))^(3/2))^(2/3) u_t,      S: the surface of the piece, m^2

* fast motion of a rod: C = 1.1 and D = 2, so that the coefficient of drag is 1.1 + 4 Re^(-1/2): Taylor's law for smooth cylinders, as is
  his 5.4 = 1.72 pi along the axis. Where the flow is all along the axis, Blasius' 1.328 takes its place.
* fast motion of a strip: C = 1.10 + 0.02 (L/b + b/L), of plates L by b (1 < L/b < 30), D = 0. Ends and edges: C = 0.42 each.
* slow motion of rods: V_n = 4 pi mu / (ln p + 0.839 + 0.185/p + 0.233/p^2) and V_t = 2 pi mu / (ln p - 0.207 + 0.980/p - 0.133/p^2) a
  length, p = L/d; a strip is slow as a rod of the diameter (b + h)/2, the slender body of the same drag.
* parts: C = 0.55 on each face, whether it moves into the fluid or out of it; that is 1.1 for a plate or a cube, 0.55 for a ball, 0.73 for
  a short rod. Slow: the even traction 3 mu u / d on a ball of the same surface, whatever the shape.

The body carries along the fluid mass C_a rho V of its normal motion (Morison): a rod the fluid in the place of its outline, a strip the
cylinder around its width, both times 1 - 0.45 b/L, which is within 5 % of tables; parts half of what they displace, as a ball. A bore is
full of fluid, which goes with its tube across the axis and stays behind along it (Paidoussis). What is carried takes no part in weight.
The fluid's weight lifts what it surrounds, where the scene names gravity.

Limits: there is no wake, no memory of the flow, no lift along or across that is not drag of a piece, no other body's flow, no surface of
the water. Of cylinders the law is within 13 % of measured drag for 0.1 < Re < 1000.
Sources: Taylor, Proc. R. Soc. A 214 (1952) 158; Churchill, Usagi, AIChE J. 18 (1972) 1121; Tirado, Garcia de la Torre, J. Chem. Phys. 71
(1979) 2581; Batchelor, J. Fluid Mech. 44 (1970) 419 (the section's mean radius); Hoerner, Fluid-Dynamic Drag (1965), chapter 3;
Schlichting, Boundary-Layer Theory (Blasius); Morison, O'Brien, Johnson, Schaaf, J. Petr. Tech. 2 (1950) 149; DNV-RP-C205, appendix D
(added mass); Paidoussis, Fluid-Structure Interactions 1 (1998), section 3.3 (a tube full of fluid).
"""

from __future__ import annotations

import math
from typing import Annotated, Any

import numpy as np
from pydantic import Field, model_validator

from magmpm.bodies.wetted_surface import FLAT, ROUND, WettedSurface
from magmpm.compiled.arrays import Array
from magmpm.compiled.jit import compiled, compiled_elsewhere, inner
from magmpm.effects.base import Effect, Records, SceneLike, one_record
from magmpm.effects.hooks import register
from magmpm.errors import SceneError
from magmpm.inputs.settings import Quantity, fault
from magmpm.inputs.vectors import three

DTYPE = np.dtype(
    [
        ("fluid_weight", np.float64, (3,)),
        ("fluid_velocity", np.float64, (3,)),
        ("fluid_radius", np.float64),
        ("fluid_speed", np.float64),
    ]
)
_Component = Annotated[float, Quantity("speed", at_least="-100 m/s", at_most="100 m/s")]


class Fluid(Effect):
    """A fluid around the body: buoyancy, drag on its surface, and the mass that it carries along.

    Parameters
    ----------
    density : float or str, kg/m^3
        Density of the fluid; water has 1000 kg/m^3, blood 1060.
    viscosity : float or str, Pa s
        Dynamic viscosity; water has 1 mPa s, blood 3.5, glycerol 1400.
    velocity : sequence (3,) of float or str, m/s, optional
        Velocity of the undisturbed stream, the same everywhere: [x, y, z]; at rest
        unless given.
    mean_speed : float or str, m/s, optional
        In place of `velocity`: the mean speed of a steady flow through the tube of
        `walls`, along its path, with Poiseuille's profile; no flow outside its wall.

    Examples
    --------
    >>> from magmpm import Fluid
    >>> Fluid(density="1000 kg/m^3", viscosity="1 mPa s").viscosity  # Pa s
    0.001
    """

    PHASE = "force"
    density: Annotated[float, Quantity("density", above="0 kg/m^3", at_most="1e5 kg/m^3")] = Field(
        description="Density of the fluid; water has 1000 kg/m^3, blood 1060.",
        examples=["1000 kg/m^3"],
    )
    viscosity: Annotated[float, Quantity("viscosity", above="0 Pa s", at_most="1e4 Pa s")] = Field(
        description="Dynamic viscosity; water has 1 mPa s, blood 3.5, glycerol 1400.",
        examples=["1 mPa s"],
    )
    velocity: Annotated[
        tuple[_Component, _Component, _Component], three("[0 m/s, 0 m/s, 0 m/s]")
    ] = Field(
        default=(0.0, 0.0, 0.0),
        description=(
            "Velocity of the undisturbed stream, the same everywhere: [x, y, z]; at "
            "rest unless given."
        ),
        examples=[["10 cm/s", "0 m/s", "0 m/s"]],
    )
    mean_speed: _Component | None = Field(
        default=None,
        description=(
            "In place of `velocity`: the mean speed of a steady flow through the tube of "
            "`walls`, along its path, with Poiseuille's profile; no flow outside its wall."
        ),
        examples=["10 cm/s"],
    )

    @model_validator(mode="after")
    def _one_stream(self) -> Fluid:
        if self.mean_speed is not None and any(self.velocity):
            raise fault(
                "give `velocity` or `mean_speed`, not both",
                "leave one of them out",
                ("mean_speed",),
            )
        return self

    def records(
        self, scene: SceneLike, strength: float = 1.0, times: Array | None = None
    ) -> Records:
        """Parameters for the kernels, or () without any load; the table: points of the path of a lumen with a flow, m."""
        if strength == 0.0:
            return ()
        gravity = scene.effects.gravity
        pull = np.zeros(3) if gravity is None else np.array(gravity.acceleration)
        path = self._path(scene)
        return one_record(
            DTYPE,
            path.ravel(),
            fluid_weight=strength * self.density * pull,
            fluid_velocity=strength * np.array(self.velocity),
            fluid_radius=scene.effects.walls.tube.radius if len(path) else 0.0,
            fluid_speed=strength * (self.mean_speed or 0.0),
        )

    def _path(self, scene: SceneLike) -> Array:
        """Points (k, 3) m of the axis of the lumen that it flows through; none where it does not."""
        walls = scene.effects.walls
        flows = self.mean_speed and walls is not None and walls.tube is not None
        return np.array(walls.axis) if flows else np.zeros((0, 3))

    @property
    def flows(self) -> bool:
        """True if there is a stream."""
        return self.fastest > 0.0

    @property
    def fastest(self) -> float:
        """The largest speed (m/s) of the undisturbed stream."""
        return max(float(np.linalg.norm(self.velocity)), 2.0 * abs(self.mean_speed or 0.0))

    def stable_step(self, model: Any) -> float | None:
        """Largest stable step (s), as of viscous stress: 0.9 over the fastest decay of slow motion (effects.viscosity)."""
        rate = model.slowed(self.law(model.wetted.surface)[:, 2:4].max(axis=1))
        return 0.9 / rate if rate > 0.0 else None

    def check(self, model: Any) -> None:
        """Raises SceneError for a part with a closed cavity: whether it is full of the fluid, nothing says."""
        for name in model.scene.body.shape.hollow_parts():
            raise SceneError(
                "effects.fluid",
                found=f"{name} has a closed cavity",
                rule="a fluid lifts and carries the material, and a cavity has none",
                remedy="fill the cavity with a part of its own, or leave it out of the mesh",
            )

    def warnings(self, scene: SceneLike) -> list[str]:
        """Warn of a fluid without weight."""
        if scene.effects.gravity is not None:
            return []
        return [
            "effects.fluid: without gravity the fluid has no buoyancy; name `gravity: {}` if "
            "it matters"
        ]

    def law(self, surface: WettedSurface) -> Array:
        """Numbers (n, 7) of each piece in the law of drag: see `drag`."""
        out = np.zeros((len(surface.size), 7))
        half = self.density / 2
        nu = self.viscosity / self.density
        width = surface.width
        length = surface.length
        area = surface.size * np.where(surface.kind == ROUND, width, 1.0)
        skin = area * np.array([math.pi, 2.0, 0.0, 1.0])[surface.kind]
        plate = 1.10 + 0.02 * (length / width + width / length)
        pressure = np.choose(surface.kind, [np.full_like(width, 1.1), plate, 0.42, 0.55])
        out[:, 0] = half * pressure * area
        out[:, 1] = np.where(surface.kind == ROUND, 4.0 * half * np.sqrt(nu / width) * area, 0.0)
        across, along = self._slow(surface)
        out[:, 2] = across
        out[:, 3] = along
        out[:, 4] = (half * 1.72 * skin) ** 2 * nu / width
        out[:, 5] = (half * 1.328 * skin) ** 2 * nu / length
        out[:, 6] = surface.kind == ROUND
        return out

    def _slow(self, surface: WettedSurface) -> tuple[Array, Array]:
        """Force over velocity (n,) N s/m of slow motion along the normal, and beside it."""
        mu = self.viscosity
        round_ = surface.kind == ROUND
        size = np.where(round_, surface.size, surface.size / surface.width)  # m of length
        p = surface.length / np.where(
            round_, surface.width, (surface.width + surface.thickness) / 2
        )
        across = 4 * math.pi * mu / (np.log(p) + 0.839 + 0.185 / p + 0.233 / p**2) * size
        along = 2 * math.pi * mu / (np.log(p) - 0.207 + 0.980 / p - 0.133 / p**2) * size
        even = 3.0 * mu / surface.width * surface.size
        slender = [np.choose(surface.kind, [one, one, 0.0, even]) for one in (across, along)]
        return slender[0], slender[1]

    def carried(self, surface: WettedSurface) -> tuple[Array, Array]:
        """Mass that is carried along over the fluid's density and the material's volume (n,), along the normal of each piece, and beside
        it; of a rod's pieces along the axis, and across."""
        slender = 1.0 - 0.45 * surface.width / surface.length
        rod = (slender + 1.0 - surface.solid) / surface.solid  # around it, and in its bore
        thick = np.where(surface.kind == FLAT, surface.thickness, 1.0)
        strip = slender * math.pi / 4 * surface.width / thick
        ball = np.full_like(rod, 0.5)
        none = np.zeros_like(rod)
        along_normal = np.choose(surface.kind, [none, strip, none, ball])
        return along_normal, np.choose(surface.kind, [rod, none, none, ball])


@compiled
def energy(effect, data, magnet, rho, x, F):
    """W = rho_f g . x, J/m^3: the fluid that would be there is lifted less."""
    g = effect.fluid_weight
    return g[0] * x[0] + g[1] * x[1] + g[2] * x[2]


@compiled
def force(effect, data, magnet, rho, x, F, f):
    """f -= rho_f g, N/m^3."""
    for i in range(3):
        f[i] -= effect.fluid_weight[i]


@compiled
def stream(effect, path, x):
    """Velocity (m/s) of the undisturbed stream at x, a triple; path (3 k,) m: the axis of a lumen, or nothing."""
    v = (effect.fluid_velocity[0], effect.fluid_velocity[1], effect.fluid_velocity[2])
    nearest = effect.fluid_radius**2
    for k in range(len(path) // 3 - 1):
        size = 0.0
        along = 0.0
        for i in range(3):
            step = path[3 * k + 3 + i] - path[3 * k + i]
            size += step * step
            along += step * (x[i] - path[3 * k + i])
        share = min(max(along / size, 0.0), 1.0)
        away = 0.0
        for i in range(3):
            step = path[3 * k + 3 + i] - path[3 * k + i]
            away += (x[i] - path[3 * k + i] - share * step) ** 2
        if away < nearest:
            nearest = away
            fast = 2.0 * effect.fluid_speed * (1.0 - away / effect.fluid_radius**2)
            fast /= math.sqrt(size)
            v = (
                fast * (path[3 * k + 3] - path[3 * k]),
                fast * (path[3 * k + 4] - path[3 * k + 1]),
                fast * (path[3 * k + 5] - path[3 * k + 2]),
            )
    return v


@inner
def _joined(slow, fast):
    """The two laws joined: (slow^(3/2) + fast^(3/2))^(2/3)."""
    root = np.cbrt(slow * math.sqrt(slow) + fast * math.sqrt(fast))
    return root * root


@compiled
def drag(effect, data, law, x, n, v, f):
    """f += the drag (N) on a piece at x (3,) m with the velocity v (3,) m/s.

    n (3,): the normal of a piece, or the axis of a rod's, by its length the size of the piece over that at rest. law (7,): pressure
    (N s^2/m^2) and boundary layer (N (s/m)^(3/2)) of the motion along the normal; slow motion along the normal and beside it (N s/m); the
    skin's (N (s/m)^(3/2))^2 by u_n and by u_t; 1 of a rod, else 0.
    """
    size = math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    s0, s1, s2 = stream(effect, data, x)
    u0 = v[0] - s0
    u1 = v[1] - s1
    u2 = v[2] - s2
    out = (u0 * n[0] + u1 * n[1] + u2 * n[2]) / size
    n0 = n[0] * out / size  # the part of u along n
    n1 = n[1] * out / size
    n2 = n[2] * out / size
    along = math.fabs(out)
    beside = math.sqrt((u0 - n0) ** 2 + (u1 - n1) ** 2 + (u2 - n2) ** 2)
    u_n, u_t = (beside, along) if law[6] > 0.0 else (along, beside)
    normal = size * _joined(law[2], law[0] * u_n + law[1] * math.sqrt(u_n))
    skin = size * _joined(law[3], math.sqrt(law[4] * u_n + law[5] * u_t))
    of_n, of_rest = (skin, normal) if law[6] > 0.0 else (normal, skin)
    f[0] -= of_n * n0 + of_rest * (u0 - n0)
    f[1] -= of_n * n1 + of_rest * (u1 - n1)
    f[2] -= of_n * n2 + of_rest * (u2 - n2)


@compiled_elsewhere
def _drag_at_rest(records, path, law, x, n, f):
    """Write to f (k, 3) N the drag on pieces at rest at x (k, 3) m, with their directions n (k, 3)."""
    v = np.zeros(3)
    for k in range(len(x)):
        f[k] = 0.0
        drag(records[0], path, law[k], x[k], n[k], v, f[k])


def forces(scene: SceneLike, surface: WettedSurface, place: Array, tangents: Array) -> Array:
    """Drag (k, 3) N on pieces that rest at places (k, 3) m in the stream; tangents (k, 2, 3): theirs, as the body has deformed them."""
    fluid = scene.effects.fluid
    records, path = fluid.records(scene)
    n = np.cross(tangents[:, 0], tangents[:, 1])
    n[surface.kind == ROUND] = tangents[surface.kind == ROUND, 0]
    f = np.empty_like(place)
    _drag_at_rest(records, path, fluid.law(surface), np.ascontiguousarray(place), n, f)
    return f


register(DTYPE, wide=True, energy=energy, force=force, drag=drag)
