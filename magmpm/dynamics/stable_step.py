"""The largest stable time step that each formulation and each effect allows.

Explicit steps are stable while dt < 2 / omega of the fastest oscillation (symplectic Euler: Hairer, Lubich, Wanner, Geometric Numerical
Integration, I.1.4). Three bounds are reported:

* isolated: for one particle alone on its nodes. In the total formulation this holds for any set of particles, since particles together
  do not oscillate faster than the fastest of them (Fried, Int. J. Solids Struct. 8 (1972)). With the sums s_a = sum over nodes of
  slope^2 / weight along each axis, omega^2 of a particle is the largest eigenvalue of S^(1/2) A S^(1/2) / rho. A is the elastic tangent
  at rest, and S = diag(s) acts on its reference side. In the updated formulation the particle may be anywhere. There s_a = 6 / h_a^2, the
  largest value, on the face of a cell (4 / h_a^2 in its middle).
* wave: width of the smallest cell over the speed of pressure waves, h / c. Not a bound by itself; printed for comparison.
* body: 2 / omega of the whole body at its present deformation, by Lanczos iteration (total formulation only). It limits the step there,
  and is up to twice the isolated bound.

In a field that turns or swings, or where what holds the body swings, a step is also at most 1/20 of the period (schedule). This is not for
stability: with longer steps, the sampled field would seem to change more slowly than it does, or not at all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from magmpm import materials
from magmpm.compiled.arrays import Array
from magmpm.dynamics.apic import UpdatedMotion
from magmpm.dynamics.energies import volume_change
from magmpm.dynamics.total_lagrangian import TotalMotion
from magmpm.effects import acting
from magmpm.model import Model

TIGHT = 1e-3  # relative tolerance of the body's largest eigenvalue
STIFFEST = 32  # particles with an exact bound, when the bound of the updated formulation is found again
A_PERIOD = 20  # least number of steps in the shortest period of the field: between two steps, a straight line is off by about 1 %


@dataclass(frozen=True)
class StableStep:
    """Bounds in s. `effects`: by effect; `schedule`: of the field's schedule; `largest`: the smallest bound, which counts."""

    isolated: float
    wave: float
    body: float | None
    effects: dict[str, float]
    schedule: float | None = None

    @property
    def of_body(self) -> float:
        """The bound from the elastic oscillations of the body, s."""
        return self.isolated if self.body is None else self.body

    @property
    def largest(self) -> float:
        """Largest stable step, s."""
        return self.largest_beside(self.of_body)

    def largest_beside(self, body: float) -> float:
        """Largest stable step, s, with another bound for the body."""
        return min([body, *self.effects.values(), *self._of_schedule.values()])

    @property
    def named(self) -> dict[str, float]:
        """Every bound by name, s."""
        body = {} if self.body is None else {"body": self.body}
        return {"isolated": self.isolated, "wave": self.wave, **body, **self.effects, **self._of_schedule}

    @property
    def _of_schedule(self) -> dict[str, float]:
        return {} if self.schedule is None else {"schedule": self.schedule}


def stable_step(motion: TotalMotion | UpdatedMotion) -> StableStep:
    """Bounds for the present state of a motion."""
    model = motion.model
    total = isinstance(motion, TotalMotion)
    h = model.grid.spacing
    if total:
        sums = model.steepness()
    else:
        sums = np.tile(6.0 / h**2, (len(model.density), 1))
    return StableStep(
        isolated=isolated(sums, model.shear, model.bulk, model.density), wave=float(h.min() / speed_of_sound(model).max()),
        body=body_step(motion) if isinstance(motion, TotalMotion) else None, effects=acting.stable_steps(model),
        schedule=_of_schedule(model),
    )  # fmt: skip


def present_bound(motion: TotalMotion | UpdatedMotion) -> float:
    """The bound from oscillations about the present shape, s: `body`, or `isolated` for the stiffest particles."""
    if isinstance(motion, TotalMotion):
        return body_step(motion)
    model = motion.model
    _, _, F = motion.particles()
    most = np.argsort(stiffness(model, F, motion.formulation))[-STIFFEST:]
    return min(_isolated_in_space(F[p], model.shear[p], model.bulk[p], model.density[p], model.grid.spacing) for p in most)


def stiffness(model: Model, F: Array, formulation: str) -> Array:
    """Estimate of the largest eigenvalue of each particle's tangent, over density, (n,) m^2/s^2; F (n, 3, 3).

    Kernels check it in every step; formulas in materials. The tangent is dP/dF in the total formulation, else dP/dF F^T.
    """
    J, cofactor = np.linalg.det(F), np.linalg.det(F)[:, None, None] * np.linalg.inv(F).transpose(0, 2, 1)
    I1, I2 = np.einsum("nij,nij->n", F, F), np.einsum("nij,nij->n", cofactor, cofactor)
    total = formulation == "total"
    pressure = model.bulk * volume_change(model, J, total)
    scale = model.shear * J ** (-2.0 / 3.0)
    shape, turned = scale * I1 / 3.0, pressure * J
    along = np.maximum(2.0 / 3.0 * shape + turned + model.bulk * J**2, 0.0)
    across = np.abs(shape - turned)
    return np.asarray((scale + (along + across) * I2 / J**2 if total else shape + 3.0 * (along + across)) / model.density)


def _isolated_in_space(F: Array, shear: float, bulk: float, density: float, h: Array) -> float:
    """Largest stable step, s, of one particle alone in the updated formulation, at F (3, 3)."""
    cof, A = np.empty((3, 3)), np.empty((9, 9))
    materials.cofactor(F, cof)
    J = materials.determinant(F)
    materials.tangent(F, cof, J, shear, materials.volume_pressure(J, bulk), bulk, A)
    moved = np.kron(np.eye(3), F)  # dF = (grad u) F
    root = np.tile(np.sqrt(6.0) / h, 3)
    fastest = np.linalg.eigvalsh(root[:, None] * (moved @ A @ moved.T) * root)[-1]
    return float(2.0 / np.sqrt(fastest / density))


def speed_of_sound(model: Model) -> Array:
    """Speed of pressure waves, sqrt((K + 4/3 G) / rho), (n,) m/s."""
    return np.sqrt((model.bulk + 4.0 / 3.0 * model.shear) / model.density)


def isolated(sums: Array, shear: Array, bulk: Array, density: Array) -> float:
    """Largest stable step, s, of particles that are alone; sums (n, 3) 1/m^2: see the module's docstring."""
    kinds = np.unique(np.column_stack([sums, shear / density, bulk / density]), axis=0)
    unit = np.eye(3).ravel()
    swap = np.eye(9).reshape(3, 3, 3, 3).transpose(0, 1, 3, 2).reshape(9, 9)  # F -> F^T
    volume = np.outer(unit, unit)
    shape = np.eye(9) + swap - 2.0 / 3.0 * volume
    A = kinds[:, 3, None, None] * shape + kinds[:, 4, None, None] * volume
    root = np.sqrt(np.tile(kinds[:, :3], 3))
    fastest = np.linalg.eigvalsh(root[:, :, None] * A * root[:, None, :])[:, -1].max()
    return float(2.0 / np.sqrt(fastest))


def body_step(motion: TotalMotion) -> float:
    """2 / omega of the fastest oscillation of the body about its present shape, s."""
    inverse, mass = motion.packed.nodes.inverse_mass.reshape(-1, 3), motion.packed.mass
    free = np.flatnonzero(inverse.ravel() > 0)
    scale = 1e-6 * float(motion.model.grid.spacing.min())
    rest = motion.acceleration(motion.u)

    def whole(z: Array) -> Array:
        nodal = np.zeros(inverse.size)
        nodal[free] = z
        return nodal.reshape(-1, 3)

    def stiffness_product(z: Array) -> Array:
        size = scale / np.abs(z).max()
        change = rest - motion.acceleration(motion.u + size * whole(z).ravel())
        return np.asarray(mass.momentum(change.reshape(-1, 3)).ravel()[free] / size)

    begin = np.random.default_rng(0).standard_normal(len(free))  # always the same: a resumed run finds the same step
    from scipy.sparse.linalg import LinearOperator, eigsh  # 0.1 s to import: not before a motion begins

    def operator(product: Callable[[Array], Array]) -> LinearOperator:
        return LinearOperator((len(free), len(free)), matvec=product, dtype=float)

    largest = eigsh(
        operator(stiffness_product),
        M=operator(lambda z: mass.momentum(whole(z)).ravel()[free]),
        Minv=operator(lambda z: mass.accelerated(whole(z), inverse).ravel()[free]),
        k=1, which="LA", v0=begin, tol=TIGHT, ncv=min(len(free), 24), return_eigenvectors=False,
    )[0]  # fmt: skip
    return float(2.0 / np.sqrt(largest * (1.0 + TIGHT)))


def _of_schedule(model: Model) -> float | None:
    """Largest step that resolves a field that turns or swings, and ends that swing, s. None where neither matters to the body."""
    scene = model.scene
    overs = [move.over_time for move in (scene.move or {}).values()] + ([scene.field.over_time] if scene.effects.in_a_field else [])
    parts = [part for over in overs if over is not None for part in (over.rotation, over.oscillation) if part is not None]
    fastest = max((abs(part.frequency) for part in parts), default=0.0)
    return 1.0 / (A_PERIOD * fastest) if fastest > 0 else None
