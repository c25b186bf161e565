"""Finds out whether a motion has gone wrong: what, where, and what to change."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magmpm.compiled.arrays import Array, NamedNumbers, Plain
from magmpm.compiled.jit import compiled
from magmpm.effects.acting import driven_speed
from magmpm.effects.body_reach import FARTHEST_MOVE
from magmpm.errors import LeftField, SolveError
from magmpm.model import Model

REMEDY = "lower solver.dynamic.safety (or time_step)"
SURFACE = 2.0  # times the speed of a wave: of particles on a surface from which it comes back


@dataclass(frozen=True)
class Trouble:
    """Failure of a motion: the cause in a few words, the particle (-1: none in particular), what to change; kind: of the error."""

    cause: str
    particle: int
    remedy: str
    kind: type[SolveError] = SolveError


def broken(model: Model, x: Array, v: Array, F: Array) -> Trouble:
    """Find the failure of a step. Called after the kernel has stopped."""
    bad = ~(
        np.isfinite(x).all(axis=1) & np.isfinite(v).all(axis=1) & np.isfinite(F).all(axis=(1, 2))
    )
    if bad.any():
        return Trouble(
            "a position, velocity or deformation is not finite", int(np.flatnonzero(bad)[0]), REMEDY
        )
    J = np.linalg.det(F)
    worst = int(np.argmin(J))
    if J[worst] <= 0.0:
        remedy = (
            f"{REMEDY}, or use more cells across, or apply the load more slowly (field.over_time,"
            " damping)"
        )
        return Trouble(
            f"det F fell to {J[worst]:.3g}: a particle was turned inside out", worst, remedy
        )
    fastest = int(np.argmax(np.abs(v).max(axis=1)))
    return Trouble(
        f"a particle crosses a cell in one step, at {np.abs(v[fastest]).max():.3g} m/s",
        fastest,
        REMEDY,
    )


def check(model: Model, x: Array, v: Array, time: float = 0.0) -> Trouble | None:
    """Failure of velocities or positions at a time (s), if any.

    A wave moves particles at its own speed at most, and at a free surface, where it comes back, twice as fast (SURFACE).
    A particle may be faster than that only where loads make it so: a heavy soft body swings at several times that, without a shock.
    """
    reference = model.particles.position
    finite, fastest, ratio, furthest, way, size = _extremes(
        x, v, reference, model.shear, model.bulk, model.density
    )
    if not finite:
        return broken(model, x, v, np.tile(np.eye(3), (len(x), 1, 1)))
    speed = float(np.linalg.norm(v[fastest]))
    if ratio > SURFACE and speed > SURFACE * speed / ratio + driven_speed(model, x, time, way):
        return Trouble(
            f"a particle moves at {speed:.3g} m/s, faster than waves in its material, and faster "
            "than its load can drive it",
            fastest,
            f"{REMEDY}, or apply the load more slowly",
        )
    if way > FARTHEST_MOVE * size:
        return Trouble(
            f"a particle left the box: it is {way:.3g} m from where it started,"
            f" {FARTHEST_MOVE:g} times the "
            "body's size",
            furthest,
            "hold the body (clamp, ground, walls), or shorten solver.dynamic.duration",
        )
    return None


@compiled
def _extremes(x, v, reference, shear, bulk, density):  # type: ignore[no-untyped-def]
    """Return whether all values are finite; the fastest particle, and its speed over that of pressure waves (step_control.speed_of_sound);
    the particle farthest from its reference position, and its distance (m); size of the undeformed body (m), corner to corner.
    """
    finite = True
    fastest = 0
    furthest = 0
    most = 0.0
    way = 0.0
    low = np.full(3, np.inf)
    high = np.full(3, -np.inf)
    for p in range(len(x)):
        speed2 = 0.0
        way2 = 0.0
        for i in range(3):
            speed2 += v[p, i] ** 2
            way2 += (x[p, i] - reference[p, i]) ** 2
            low[i], high[i] = min(low[i], reference[p, i]), max(high[i], reference[p, i])
        finite = (
            finite and speed2 + way2 < np.inf
        )  # np.isfinite is always true here (magmpm.compiled.jit)
        ratio2 = speed2 * density[p] / (bulk[p] + 4.0 / 3.0 * shear[p])
        if ratio2 > most:
            fastest = p
            most = ratio2
        if way2 > way:
            furthest = p
            way = way2
    return (
        finite,
        fastest,
        np.sqrt(most),
        furthest,
        np.sqrt(way),
        np.sqrt(((high - low) ** 2).sum()),
    )


def energy_rounding(model: Model) -> float:
    """Rounding error (J) of a body's strain energy, at most: that of J^(-2/3) I1 = 3 + strain^2, from which 3 is taken.

    Four roundings of either factor, each of 3 eps/2, times G/2 and the volume. So it does not become less with the strain: of a metal
    it is more than the energy of a small motion.
    """
    return max(
        1e-15,
        6.0 * float(np.finfo(float).eps) * float(np.sum(model.shear * model.particles.volume)),
    )


def outside_domain(model: Model, x: Array, time: float) -> Trouble | None:
    """Failure of a body that has moved into a magnet, or to where the field is not known. Positions that are not finite do not count."""
    if not model.scene.effects.in_a_field:
        return None
    found = model.scene.external_field().outside_domain(x[np.isfinite(x).all(axis=1)], time)
    return None if found is None else Trouble(found[0], -1, found[2], LeftField)


@dataclass
class EnergyBalance:
    """Checks that the total energy does not grow while no load does work: the least total and the largest kinetic energy so far, J."""

    least: float = np.inf
    kinetic: float = 0.0

    def state(self) -> NamedNumbers:
        """Numbers that `restored` needs."""
        return {"balance_least": self.least, "balance_kinetic": self.kinetic}

    @classmethod
    def restored(cls, state: Plain) -> EnergyBalance:
        """Balance restored from the values of a checkpoint; an older checkpoint has none, and the balance begins there."""
        return cls(state.get("balance_least", np.inf), state.get("balance_kinetic", 0.0))

    def check(self, energies: NamedNumbers, rounding: float = 1e-15) -> Trouble | None:
        """Failure of the energies of a frame, J, if any; rounding: J, that the sum of energies may be off by (`energy_rounding`)."""
        total = sum(energies.values())
        self.kinetic = max(self.kinetic, energies["kinetic"])
        self.least = min(self.least, total)
        scale = max(self.kinetic, abs(energies["elastic"]))
        if not total - self.least <= 0.05 * scale + rounding:  # what it may grow by
            grown = (
                f"{total - self.least:.3g} J, with a kinetic energy of at most {self.kinetic:.3g} J"
            )
            return Trouble(
                f"energy is not conserved: the sum of all energies grew by {grown}", -1, REMEDY
            )
        return None
