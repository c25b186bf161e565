"""magnetic_force: an external field that varies in space pulls hard-magnetic material.

With W = -(1/mu0) B(x) . (F Br), whose stress is magnetic_torque, the force per undeformed volume is f = -dW/dx = (1/mu0) (grad B)^T F Br,
(grad B)_ij = dB_i/dx_j. Its tangent: d2W/dx2 = -(1/mu0) grad grad (B . F Br), and d2W/dx_i dF_jL = -(1/mu0) dB_j/dx_i Br_L, which
includes the change of magnetic_torque's stress with place.
Where a material's magnetization_law is `rotates`, R Br takes the place of F Br in its particles (effects.magnetization).
The energy W is counted in magnetic_torque. Either effect alone has no energy, so it runs in motion but not in statics.
Source: Zhao et al., JMPS 124 (2019) 244-263. The center of mass accelerates by the volume mean of f over rho.
"""

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.compiled.jit import compiled
from magmpm.effects.base import Effect, Records, SceneLike
from magmpm.effects.hooks import register
from magmpm.effects.magnetization import add_stress, carried, followed, rotating
from magmpm.fields.dipole import MU0
from magmpm.fields.kernels import PLACE
from magmpm.fields.kernels import curvature as curvature_at
from magmpm.fields.kernels import gradient as gradient_at
from magmpm.fields.kernels import pull as pull_at
from magmpm.fields.schedule import records as field_records

DTYPE = np.dtype(
    [("pulls", np.int64), *PLACE]
)  # first: with the name at the end Numba would take it for a subtype of PLACE
ROTATING = np.dtype(
    [("pulls_rotating", np.int64), *PLACE]
)  # where the magnetization of some material rotates


class MagneticForce(Effect):
    """An external field that varies in space pulls the magnetized segments. No settings.

    Examples
    --------
    >>> from magmpm import MagneticForce, load_scene
    >>> scene = load_scene("data/scenes/pulled_by_magnet.yaml")
    >>> scene.effects.magnetic_force == MagneticForce()
    True
    """

    PHASE = "force"
    IN_FIELD = True

    def records(
        self, scene: SceneLike, strength: float = 1.0, times: Array | None = None
    ) -> Records:
        """Parameters for the kernels, or () where the field is uniform: it does not pull."""
        if strength == 0.0 or not scene.field.varies:
            return ()
        return (
            field_records(
                scene.field, ROTATING if rotating(scene).any() else DTYPE, times, strength
            ),
            scene.external_field().data,
        )


@compiled
def force(effect, data, magnet, rho, x, F, f):
    """f += (1/mu0) (grad B)^T F Br, N/m^3."""
    if magnet[0] == 0.0 and magnet[1] == 0.0 and magnet[2] == 0.0:
        return
    m0, m1, m2 = followed(magnet, F)
    f0, f1, f2 = pull_at(effect, data, x, m0 / MU0, m1 / MU0, m2 / MU0)
    f[0] += f0
    f[1] += f1
    f[2] += f2


@compiled
def softening(effect, data, magnet, rho, x, F, H, M):
    """H -= (1/mu0) grad grad (B . F Br), N/m^4; M[i, 3 j + L] -= (1/mu0) dB_j/dx_i Br_L, N/m^3."""
    if magnet[0] == 0.0 and magnet[1] == 0.0 and magnet[2] == 0.0:
        return
    m0, m1, m2 = followed(magnet, F)
    curvature_at(effect, data, x, m0 / MU0, m1 / MU0, m2 / MU0, -1.0, H)
    G = np.zeros((3, 3))
    gradient_at(effect, data, x, G)
    for i in range(3):
        for j in range(3):
            for k in range(3):
                M[i, 3 * j + k] -= G[j, i] * magnet[k] / MU0


@compiled
def rotating_force(effect, data, magnet, rho, x, F, f):
    """f += (1/mu0) (grad B)^T m, N/m^3, with m the magnetization by the particle's law (effects.magnetization)."""
    m0, m1, m2 = carried(magnet, F)
    f0, f1, f2 = pull_at(effect, data, x, m0 / MU0, m1 / MU0, m2 / MU0)
    f[0] += f0
    f[1] += f1
    f[2] += f2


@compiled
def rotating_softening(effect, data, magnet, rho, x, F, H, M):
    """H -= (1/mu0) grad grad (B . m), N/m^4; M[i] += the stress in the field dB/dx_i, N/m^3."""
    m0, m1, m2 = carried(magnet, F)
    curvature_at(effect, data, x, m0 / MU0, m1 / MU0, m2 / MU0, -1.0, H)
    G = np.zeros((3, 3))
    gradient_at(effect, data, x, G)
    for i in range(3):
        add_stress((G[0, i] / MU0, G[1, i] / MU0, G[2, i] / MU0), magnet, F, M[i].reshape(3, 3))


register(DTYPE, force=force, softening=softening)
register(ROTATING, force=rotating_force, softening=rotating_softening)
