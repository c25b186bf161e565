"""magnetic_torque: an external field turns hard-magnetic material.

W = -(1/mu0) B . (F Br), so P = -(1/mu0) B (x) Br. In a uniform field P is constant, with no tangent and no net force. In a
field that varies in space, B is taken at the particle's position; the derivative of W with respect to position is magnetic_force. The two
together are the derivatives of one energy, which this effect counts.
The Cauchy stress it makes is not symmetric; its skew part is the torque density (1/mu0) (F Br) x B.
Where magnetization_law is `rotates`, R Br takes the place of F Br. Source: Zhao et al., JMPS 124 (2019) 244-263, equations 8 to 12.
"""

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.compiled.jit import compiled, inner
from magmpm.compiled.simd import dot
from magmpm.effects import magnetization as turning
from magmpm.effects.base import Effect, Records, SceneLike
from magmpm.effects.hooks import NO_DATA, register
from magmpm.fields.dipole import MU0
from magmpm.fields.kernels import PLACE
from magmpm.fields.kernels import field as field_at
from magmpm.fields.schedule import places
from magmpm.fields.schedule import records as field_records

DTYPE = np.dtype([("field_over_mu0", np.float64, (3,))])
VARYING = np.dtype(
    [("turns", np.int64), *PLACE]
)  # first: with the name at the end Numba would take it for a subtype of PLACE
ROTATING = np.dtype(
    [("rotating_field_over_mu0", np.float64, (3,))]
)  # these two where the magnetization of some material rotates
VARYING_ROTATING = np.dtype([("turns_rotating", np.int64), *PLACE])


def parameters(field: Array, turns: bool = False) -> Records:
    """Parameters for the kernels. field (3,) T, or (k, 3) for k steps; turns: particles carry their law (effects.magnetization)."""
    field = np.atleast_2d(np.asarray(field, dtype=float))
    return (field / MU0).view(ROTATING if turns else DTYPE)[:, 0], NO_DATA


class MagneticTorque(Effect):
    """The external field turns the magnetized segments. No settings.

    Examples
    --------
    >>> from magmpm import MagneticTorque, load_scene
    >>> load_scene("data/scenes/five_segments.yaml").effects.magnetic_torque == MagneticTorque()
    True
    """

    PHASE = "force"
    IN_FIELD = True

    def records(
        self, scene: SceneLike, strength: float = 1.0, times: Array | None = None
    ) -> Records:
        """Parameters for the kernels, or () where there is no field."""
        if strength == 0.0 or not scene.field.acts:
            return ()
        turns = bool(turning.rotating(scene).any())
        if scene.field.varies:
            return (
                field_records(scene.field, VARYING_ROTATING if turns else VARYING, times, strength),
                scene.external_field().data,
            )
        uniform = places(scene.field, times, strength)["uniform"]
        # One set of kernels for the whole motion: a field that is zero for some steps of its schedule stays.
        changes = times is not None and scene.field.over_time is not None
        return parameters(uniform, turns) if uniform.any() or changes else ()

    def field_changes(
        self, scene: SceneLike, times: Array | None = None
    ) -> tuple[Records, Records, Records]:
        """Records of a uniform field of 1 T along x, y and z, as the schedule scales and turns it at its time."""

        def uniform(given: list[float]) -> Array:
            field = scene.field.model_copy(update={"uniform": tuple(given)})
            return np.asarray(places(field, times)["uniform"][0])

        first, *others = [uniform(given) for given in np.eye(4, 3, -1).tolist()]
        x, y, z = (
            (
                parameters(other - first, bool(turning.rotating(scene).any()))
                if (other != first).any()
                else ()
            )
            for other in others
        )
        return x, y, z


@compiled
def energy(effect, data, magnet, rho, x, F):
    """-(1/mu0) B . (F Br), J/m^3."""
    return -dot(effect.field_over_mu0, turning.followed(magnet, F))


@compiled
def stress(effect, data, magnet, rho, x, F, P):
    """P -= (1/mu0) B (x) Br, Pa."""
    h = effect.field_over_mu0
    for i in range(3):
        for j in range(3):
            P[i, j] -= h[i] * magnet[j]


@compiled
def varying_energy(effect, data, magnet, rho, x, F):
    """-(1/mu0) B(x) . (F Br), J/m^3."""
    if magnet[0] == 0.0 and magnet[1] == 0.0 and magnet[2] == 0.0:
        return 0.0
    b0, b1, b2 = field_at(effect, data, x)
    m0, m1, m2 = turning.followed(magnet, F)
    return -(b0 * m0 + b1 * m1 + b2 * m2) / MU0


@compiled
def varying_stress(effect, data, magnet, rho, x, F, P):
    """P -= (1/mu0) B(x) (x) Br, Pa."""
    if magnet[0] == 0.0 and magnet[1] == 0.0 and magnet[2] == 0.0:
        return
    b0, b1, b2 = field_at(effect, data, x)
    for j in range(3):
        m = magnet[j] / MU0
        P[0, j] -= b0 * m
        P[1, j] -= b1 * m
        P[2, j] -= b2 * m


@compiled
def rotating_energy(effect, data, magnet, rho, x, F):
    """-(1/mu0) B . m, J/m^3, with m the magnetization by the particle's law."""
    return turning.energy(effect.rotating_field_over_mu0, magnet, F)


@compiled
def rotating_stress(effect, data, magnet, rho, x, F, P):
    """P += d(-(1/mu0) B . m)/dF, Pa."""
    turning.add_stress(effect.rotating_field_over_mu0, magnet, F, P)


@compiled
def rotating_tangent(effect, data, magnet, rho, x, F, A):
    """A += d^2(-(1/mu0) B . m)/dF^2, Pa."""
    turning.add_tangent(effect.rotating_field_over_mu0, magnet, F, A)


@inner
def _h(effect, data, x):
    """B(x)/mu0, A/m."""
    b0, b1, b2 = field_at(effect, data, x)
    return b0 / MU0, b1 / MU0, b2 / MU0


@compiled
def varying_rotating_energy(effect, data, magnet, rho, x, F):
    """-(1/mu0) B(x) . m, J/m^3."""
    return turning.energy(_h(effect, data, x), magnet, F)


@compiled
def varying_rotating_stress(effect, data, magnet, rho, x, F, P):
    """P += d(-(1/mu0) B(x) . m)/dF, Pa."""
    turning.add_stress(_h(effect, data, x), magnet, F, P)


@compiled
def varying_rotating_tangent(effect, data, magnet, rho, x, F, A):
    """A += d^2(-(1/mu0) B(x) . m)/dF^2, Pa."""
    turning.add_tangent(_h(effect, data, x), magnet, F, A)


register(DTYPE, wide=True, energy=energy, stress=stress)
register(VARYING, energy=varying_energy, stress=varying_stress)
register(
    ROTATING,
    wide=True,
    energy=rotating_energy,
    stress=rotating_stress,
    tangent=rotating_tangent,
)
register(
    VARYING_ROTATING,
    energy=varying_rotating_energy,
    stress=varying_rotating_stress,
    tangent=varying_rotating_tangent,
)
