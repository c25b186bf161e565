"""The largest stable time step that the body and each effect allow.

Explicit steps are stable while dt < 2 / omega of the fastest oscillation (symplectic Euler: Hairer, Lubich, Wanner, Geometric Numerical
Integration, I.1.4). Three bounds are reported:

* isolated: for one particle alone on its nodes. It holds for any set of particles, since particles together do not oscillate faster than
  the fastest of them (Fried, Int. J. Solids Struct. 8 (1972)). With the sums s_a = sum over nodes of slope^2 / weight along each axis,
  omega^2 of a particle is the largest eigenvalue of S^(1/2) A S^(1/2) / rho. A is the elastic tangent at rest, and S = diag(s) acts on
  its reference side.
* wave: width of the smallest cell over the speed of pressure waves, h / c. Not a bound by itself; printed for comparison.
* body: 2 / omega of the whole body at its present deformation, by Lanczos iteration. It limits the step, and is up to
  twice the isolated bound.

In a field that turns or swings, or where what holds the body swings, a step is also at most 1/20 of the period (schedule). This is not for
stability: with longer steps, the sampled field would seem to change more slowly than it does, or not at all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.dynamics.energies import volume_change
from magmpm.dynamics.total_lagrangian import TotalMotion
from magmpm.effects import acting
from magmpm.model import Model

TIGHT = 1e-3  # relative tolerance of the body's largest eigenvalue


@dataclass(frozen=True)
class StableStep:
    """Bounds in s. `effects`: by effect; `schedule`: of the field's schedule; `largest`: the smallest bound, which counts."""

    isolated: float
    wave: float
    body: float
    effects: dict[str, float]
    schedule: float | None = None

    @property
    def largest(self) -> float:
        """Largest stable step, s."""
        return self.largest_beside(self.body)

    def largest_beside(self, body: float) -> float:
        """Largest stable step, s, with another bound for the body."""
        return min([body, *self.effects.values(), *self._of_schedule.values()])

    @property
    def named(self) -> dict[str, float]:
        """Every bound by name, s."""
        return {"isolated": self.isolated, "wave": self.wave, "body": self.body, **self.effects, **self._of_schedule}

    @property
    def _of_schedule(self) -> dict[str, float]:
        return {} if self.schedule is None else {"schedule": self.schedule}


def stable_step(motion: TotalMotion) -> StableStep:
    """Bounds for the present state of a motion."""
    model = motion.model
    return StableStep(
        isolated=isolated(model.steepness(), model.shear, model.bulk, model.density),
        wave=float(model.grid.spacing.min() / speed_of_sound(model).max()),
        body=body_step(motion), effects=acting.stable_steps(model), schedule=_of_schedule(model),
    )  # fmt: skip


def stiffness(model: Model, F: Array) -> Array:
    """Estimate of the largest eigenvalue of each particle's tangent, over density, (n,) m^2/s^2; F (n, 3, 3).

    Kernels check it in every step; formulas in materials (`stiffest`).
    """
    J, cofactor = np.linalg.det(F), np.linalg.det(F)[:, None, None] * np.linalg.inv(F).transpose(0, 2, 1)
    I1, I2 = np.einsum("nij,nij->n", F, F), np.einsum("nij,nij->n", cofactor, cofactor)
    pressure = model.bulk * volume_change(model, J)
    scale = model.shear * J ** (-2.0 / 3.0)
    shape, turned = scale * I1 / 3.0, pressure * J
    along = np.maximum(2.0 / 3.0 * shape + turned + model.bulk * J**2, 0.0)
    across = np.abs(shape - turned)
    return np.asarray((scale + (along + across) * I2 / J**2) / model.density)


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
    return 1.0 / (20 * fastest) if fastest > 0 else None  # between two steps, a straight line is off by about 1 %
