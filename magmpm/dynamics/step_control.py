"""The time step of a motion: the largest stable one that the body and each effect allow, now and as the motion goes on.

Explicit steps are stable while dt < 2 / omega of the fastest oscillation (Hairer et al., Geometric Numerical Integration, I.1.4). Bounds:

* isolated: for one particle alone on its nodes. It holds for any set of particles, since particles together do not oscillate faster than
  the fastest of them (Fried, Int. J. Solids Struct. 8 (1972)). With the sums s_a = sum over nodes of slope^2 / weight along each axis,
  omega^2 of a particle is the largest eigenvalue of S^(1/2) A S^(1/2) / rho. A is the elastic tangent at rest, and S = diag(s) acts on
  its reference side.
* wave: width of the smallest cell over the speed of pressure waves, h / c. Not a bound by itself; printed for comparison.
* body: 2 / omega of the whole body at its present deformation, by Lanczos iteration: it limits the step, up to twice `isolated`.
* viscosity: its stress is that of velocities one step old. With mass M, stiffness K and viscous matrix C no motion grows while
  M - dt C/2 - dt^2 K/4 is positive definite (the energy v M v + u K u of each step then bounds the next), so with the fastest decay r of
  M^-1 C, by Lanczos iteration as well, while (dt / body)^2 + r dt / 2 < 1.

In a field that turns or swings, or where what holds the body swings, a step is also at most 1/20 of the period (schedule). This is not for
stability: with longer steps, the sampled field would seem to change more slowly than it does, or not at all.

The bound at the start of a motion belongs to the undeformed body. Large strain makes silicone stiffer: as a particle is
crushed (J -> 0), its tangent grows without bound, as J^(-8/3). And a body released from a large strain moves by a good part of a cell
in one step, which the bound for small oscillations does not cover. So kernels check two things in every step (kernels.watch):

* the stiffness of the stiffest particle. If it exceeds the stiffness for which the step was chosen, the bound is found again for the
  present shape, and steps become shorter if they must;
* the change of stiffness in one step. If it exceeds MOST_CHANGE_OF_STIFFNESS, steps are halved until they resolve the motion. They grow
again as the
  motion calms down. The same holds for the change of F, averaged over the steps between two checks: silicone of K = 5 G keeps its stiffness
  while it swells from det F = 0.2 to 0.5.

What a step adds to the energy where springs of contact begin within it, all those of a face that lands among them, or where the body
vibrates near the limit of stability, adds up as it touches something again and again. Where loads are constant the sum of all energies is
known, so it is looked at after every chunk of steps. If it has moved by more than DRIFT of the largest kinetic energy from what it was,
the chunk is taken back, and steps are halved, up to six times. They grow again where eight chunks changed it by little.

A step given in the scene never changes. Where it is too long, the motion ends with a message.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from magmpm.compiled.arrays import Array, NamedNumbers, Plain
from magmpm.dynamics.energies import loads_conserve, loses, measure, volume_change
from magmpm.dynamics.total_lagrangian import Kinematics, TotalMotion, take
from magmpm.dynamics.watchdog import Trouble
from magmpm.effects import acting
from magmpm.effects.base import Records
from magmpm.kernels.watch import BROKEN, GOING, HIGHEST, LIMIT, QUICK, QUICKEST, SHARE, STIFF, WHY
from magmpm.materials import pressure_wave_speed
from magmpm.model import Model
from magmpm.scene.options import Dynamic

MOST_CHANGE_OF_STIFFNESS = (
    0.15  # of the largest stiffness: how much a particle's stiffness may change in one step
)
# of the largest kinetic energy: how far the sum of all energies may move (a motion promises 1 %)
DRIFT = 5e-3
RESERVE = 0.95  # of the bound: a step above it asks for a new bound


@dataclass(frozen=True)
class StableStep:
    """Bounds in s. `effects`, `viscous`: by effect; `schedule`: of the field's schedule; `largest`: the smallest bound, which counts."""

    isolated: float
    wave: float
    body: float
    effects: NamedNumbers
    viscous: NamedNumbers
    schedule: float | None = None

    @property
    def largest(self) -> float:
        """Largest stable step, s."""
        return self.largest_beside(self.body, self.viscous)

    @property
    def least(self) -> str:
        """Name of the smallest bound, which counts."""
        counting = {"body": self.body} | self.effects | self.viscous | self._of_schedule
        return min(counting, key=counting.__getitem__)

    def largest_beside(self, body: float, viscous: NamedNumbers) -> float:
        """Largest stable step, s, with other bounds for the body and its viscosity."""
        others = self.effects | viscous | self._of_schedule
        return min([body, *others.values()])

    @property
    def named(self) -> NamedNumbers:
        """Every bound by name, s."""
        return {
            "isolated": self.isolated,
            "wave": self.wave,
            "body": self.body,
            **self.effects,
            **self.viscous,
            **self._of_schedule,
        }

    @property
    def _of_schedule(self) -> NamedNumbers:
        return {} if self.schedule is None else {"schedule": self.schedule}


def stable_step(motion: TotalMotion) -> StableStep:
    """Find the bounds of the time step for the present state of a motion."""
    model = motion.model
    body = body_step(motion)
    viscous = viscous_step(motion, body)
    alone = acting.stable_steps(model).items()
    return StableStep(
        isolated=isolated(model.steepness(), model.shear, model.bulk, model.density),
        wave=float(model.grid.spacing.min() / speed_of_sound(model).max()),
        body=body,
        effects={key: step for key, step in alone if key not in viscous},
        viscous=viscous,
        schedule=_of_schedule(model),
    )


def stiffness(model: Model, F: Array) -> Array:
    """Estimate of the largest eigenvalue of each particle's tangent, over density, (n,) m^2/s^2; F (n, 3, 3).

    Kernels check it in every step; formulas in materials (`stiffest`).
    """
    J = np.linalg.det(F)
    cofactor = J[:, None, None] * np.linalg.inv(F).transpose(0, 2, 1)
    I1 = np.einsum("nij,nij->n", F, F)
    I2 = np.einsum("nij,nij->n", cofactor, cofactor)
    pressure = model.bulk * volume_change(model, J)
    scale = model.shear * J ** (-2.0 / 3.0)
    shape = scale * I1 / 3.0
    turned = pressure * J
    along = np.maximum(2.0 / 3.0 * shape + turned + model.bulk * J**2, 0.0)
    across = np.abs(shape - turned)
    return np.asarray((scale + (along + across) * I2 / J**2) / model.density)


def speed_of_sound(model: Model) -> Array:
    """Speed of pressure waves (n,), m/s."""
    return pressure_wave_speed(model.shear, model.bulk, model.density)


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
    scale = 1e-6 * float(motion.model.grid.spacing.min())
    rest = motion.acceleration(motion.u)

    def returning(z: Array) -> Array:
        size = scale / np.abs(z).max()
        return np.asarray((rest - motion.acceleration(motion.u + size * z)) / size)

    return float(2.0 / np.sqrt(_fastest(motion, returning)))


def viscous_step(motion: TotalMotion, body: float) -> NamedNumbers:
    """Largest stable step, s, of the body's viscosity beside its elastic stress, by the effect's key; body: their step without it, s.

    {} where there is no such stress.
    """
    named = motion.model.scene.effects.viscosity
    if named is None or named.viscosity == 0.0:
        return {}
    records = named.records(motion.model.scene)
    still = motion.slowed(np.zeros_like(motion.v), records)
    rate = _fastest(motion, lambda z: still - motion.slowed(z, records))
    quarter = rate * body / 4.0
    return {named.key(): body * (math.hypot(1.0, quarter) - quarter)}


def _energy(motion: TotalMotion, named: Records, now: Kinematics, time: float) -> float:
    """Sum of all energies, J, of a motion at a time, s."""
    return sum(measure(motion, named, now, time).energies.values())


def _fastest(motion: TotalMotion, returning: Callable[[Array], Array]) -> float:
    """Largest eigenvalue of what gives back accelerations (3 nodes,) for displacements or velocities, linearly; M times it is symmetric."""
    tight = 1e-3  # relative tolerance of the largest eigenvalue
    inverse = motion.packed.nodes.inverse_mass.reshape(-1, 3)
    mass = motion.packed.mass
    free = np.flatnonzero(inverse.ravel() > 0)

    def whole(z: Array) -> Array:
        nodal = np.zeros(inverse.size)
        nodal[free] = z
        return nodal.reshape(-1, 3)

    def product(z: Array) -> Array:
        back = returning(whole(z).ravel())
        return np.asarray(mass.momentum(back.reshape(-1, 3)).ravel()[free])

    begin = np.random.default_rng(0).standard_normal(
        len(free)
    )  # always the same: a resumed run finds the same step
    from scipy.sparse.linalg import (
        LinearOperator,
        eigsh,
    )  # 0.1 s to import: not before a motion begins

    def operator(product: Callable[[Array], Array]) -> LinearOperator:
        return LinearOperator((len(free), len(free)), matvec=product, dtype=float)

    largest = eigsh(
        operator(product),
        M=operator(lambda z: mass.momentum(whole(z)).ravel()[free]),
        Minv=operator(lambda z: mass.accelerated(whole(z), inverse).ravel()[free]),
        k=1,
        which="LA",
        v0=begin,
        tol=tight,
        ncv=min(len(free), 24),
        return_eigenvectors=False,
    )[0]
    return float(largest * (1.0 + tight))


def _of_schedule(model: Model) -> float | None:
    """Largest step that resolves a field that turns or swings, and ends that swing, s. None where neither matters to the body."""
    scene = model.scene
    overs = [move.over_time for move in (scene.move or {}).values()] + (
        [scene.field.over_time] if scene.effects.in_a_field else []
    )
    parts = [
        part
        for over in overs
        if over is not None
        for part in (over.rotation, over.oscillation)
        if part is not None
    ]
    fastest = max((abs(part.frequency) for part in parts), default=0.0)
    return (
        1.0 / (20 * fastest) if fastest > 0 else None
    )  # between two steps, a straight line is off by about 1 %


@dataclass
class Drift:
    """Drift of the sum of all energies, J.

    loses: whether something takes energy, so that only growth is a fault; least, most: of the sum so far; kinetic: the largest; last: the
    sum before; moved: then; finer: halvings of the step for it; calm: chunks in a row that changed the sum by little.
    """

    loses: bool
    least: float = math.inf
    most: float = -math.inf
    kinetic: float = 0.0
    last: float = math.nan
    moved: float = 0.0
    finer: int = 0
    calm: int = 0

    def passes(self, total: float, kinetic: float) -> bool:
        """Tell whether the sum may be this after a chunk. If not, nothing is noted but that steps are to be halved."""
        most_halvings = 6  # an end to it: the error falls as the square of the step
        largest = max(self.kinetic, kinetic)
        growth = total - min(self.least, total)
        loss = max(self.most, total) - total
        moved = growth if self.loses else max(growth, loss)
        if (
            moved > max(DRIFT * largest, self.moved + DRIFT / 64 * largest)
            and self.finer < most_halvings
        ):
            self.finer += 1
            self.calm = 0
            return False
        little = abs(total - self.last) < DRIFT / 32 * largest
        self.calm = self.calm + 1 if little else 0
        calm = 8  # chunks in a row: the next longer step has four times their error
        if self.calm >= calm and self.finer:
            self.finer -= 1
            self.calm = 0
        self.least, self.most = min(self.least, total), max(self.most, total)
        self.kinetic = largest
        self.last = total
        self.moved = moved
        return True


class StepControl:
    """The time step of a motion, and when to change it.

    step s: longest next step; shortest s: shortest step so far; why: what shortened it last, in a few words, or "".
    """

    def __init__(self, motion: TotalMotion, stable: StableStep, options: Dynamic) -> None:
        self._motion = motion
        self._stable = stable
        self._options = options
        self._bound = stable.body
        self._viscous = stable.viscous
        self._stiffness = float(stiffness(motion.model, motion.particles()[2]).max())
        self._longest = options.time_step or options.safety * stable.largest
        self._halvings = 0
        self.step = self.shortest = self._longest
        self.why = ""
        self._before: Kinematics | None = None  # at the last check
        self._drift: Drift | None = None
        touches = motion.own or motion.model.surface
        if touches and options.time_step is None and loads_conserve(motion.model):
            self._drift = Drift(loses(motion.model))
        self._set_watch()

    def state(self) -> Plain:
        """Plain numbers and text that `restore` needs."""
        drift = (
            {}
            if self._drift is None
            else {f"drift_{name}": value for name, value in vars(self._drift).items()}
        )
        return drift | {
            "bound": self._bound,
            "viscous": self._viscous,
            "stiffness": self._stiffness,
            "halvings": self._halvings,
            "step": self.step,
            "shortest": self.shortest,
            "why": self.why,
        }

    def restore(self, state: Plain) -> None:
        """Go back to a `state`."""
        self._bound = state["bound"]
        self._viscous = state.get("viscous", self._viscous)
        self._stiffness = state["stiffness"]
        self._halvings = int(state["halvings"])
        self.step = state["step"]
        self.shortest = state["shortest"]
        self.why = state.get("why", "as before")
        self._before = None
        if self._drift is not None and "drift_least" in state:
            self._drift = Drift(**{name: state[f"drift_{name}"] for name in vars(self._drift)})
        self._set_watch()

    def warnings(self) -> list[str]:
        """One sentence if steps had to be much shorter than at the start, else none."""
        if self.shortest > 0.5 * self._longest:
            return []
        return [
            f"steps were shortened from {self._longest:.3g} s to as little as {self.shortest:.3g}"
            f" s: {self.why}"
        ]

    def take(
        self, named: Records, steps: int, dt: float, time: float
    ) -> tuple[int, Kinematics, Trouble | None]:
        """Take up to `steps` steps of dt (s) from a time (s), fewer if the next must be shorter.

        Returns their number, the kinematics then, and what is wrong.
        """
        motion = self._motion
        watch = self._motion.watch
        watch[QUICKEST] = 0.0
        kept = motion.kept()
        before = self._before or motion.kinematics()
        if self._drift is not None and math.isnan(self._drift.last):
            self._drift.passes(_energy(motion, named, before, time), before.kinetic)
        taken, _ = take(motion, named, steps, dt)
        now = motion.kinematics() if watch[WHY] == GOING else None
        changed = 0.0 if now is None else float(np.abs(now.F - before.F).max()) / max(taken, 1)
        trouble = None
        if watch[WHY] in (QUICK, BROKEN) or changed > MOST_CHANGE_OF_STIFFNESS:
            trouble = self._halve(changed)
            if trouble is None:  # the last step was too long, or all were: take it back
                taken = 0 if changed > MOST_CHANGE_OF_STIFFNESS else max(taken - 1, 0)
                motion.rewind(kept)
                take(motion, named, taken, dt)
                now = None
        elif watch[WHY] == STIFF:
            trouble = self._find_bound()
        elif (
            self._halvings and watch[QUICKEST] < 0.25 * MOST_CHANGE_OF_STIFFNESS
        ):  # calm: steps grow again
            self._halvings -= 1
            self._choose()
        now = now or motion.kinematics()
        if self._drift is not None and taken and trouble is None:
            finer = self._drift.finer
            total = _energy(motion, named, now, time + taken * dt)
            if not self._drift.passes(total, now.kinetic):
                taken = 0
                motion.rewind(kept)
                now = motion.kinematics()
                self.why = "where the body touches something longer steps would change its energy"
            if self._drift.finer != finer:
                self._choose()
        self._before = now
        return taken, now, trouble

    def at_frame(self) -> None:
        """Find the bound again if the body is softer than when the steps were shortened."""
        highest = self._motion.watch[HIGHEST]
        if (
            self._bound < self._stable.body and 0.0 < highest < 0.7 * self._stiffness
        ):  # which shortened the steps
            self._find_bound()
        self._motion.watch[HIGHEST] = 0.0

    def _halve(self, changed: float) -> Trouble | None:
        """Halve the step as often as needed, from how far the last one was too long; changed: F in a step."""
        broke = self._motion.watch[WHY] == BROKEN
        given = self._options.time_step is not None
        over = (
            16.0 if broke else max(self._motion.watch[QUICKEST], changed) / MOST_CHANGE_OF_STIFFNESS
        )
        halvings = self._halvings + min(max(1, math.ceil(math.log2(over))), 6)
        if given or 0.5**halvings < 1e-4:  # even a step of 1e-4 of the first one is too long
            return (
                None
                if broke
                else self._trouble(
                    f"the motion changes too much within {'a' if given else 'any'} step"
                )
            )
        self._halvings = halvings
        self.why = "the body moves too fast for longer steps"
        self._choose()
        return None

    def _find_bound(self) -> Trouble | None:
        """Find the bound for the present shape of the body."""
        self._bound = body_step(self._motion)
        self._viscous = viscous_step(self._motion, self._bound)
        self._stiffness = float(self._motion.watch[HIGHEST])
        largest = self._stable.largest_beside(self._bound, self._viscous)
        if self._options.time_step is not None and self.step > largest:
            return self._trouble(
                f"the stable time step has dropped to {largest:.3g} s (the body has stiffened)"
            )
        if self.step > RESERVE * largest:
            self.why = "the body has stiffened"
        self._choose()
        return None

    def _choose(self) -> None:
        """Choose the step from the present bound and number of halvings."""
        if self._options.time_step is None:
            largest = self._stable.largest_beside(self._bound, self._viscous)
            allowed = (
                self._longest
                if self._longest <= RESERVE * largest
                else self._options.safety * largest
            )
            finer = 0 if self._drift is None else self._drift.finer
            self.step = min(allowed, self._longest / 2.0**self._halvings) / 2.0**finer
            self.shortest = min(self.shortest, self.step)
        self._set_watch()

    def _set_watch(self) -> None:
        reserve = RESERVE if self._options.time_step is None else 1.0
        growth = [(reserve * self._bound / self.step) ** 2]
        growth += [reserve * step / self.step for step in self._viscous.values()]
        self._motion.watch[LIMIT] = self._stiffness * max(min(growth), 1.01)
        self._motion.watch[SHARE] = MOST_CHANGE_OF_STIFFNESS

    def _trouble(self, cause: str) -> Trouble:
        stiffest = int(np.argmax(stiffness(self._motion.model, self._motion.particles()[2])))
        given = self._options.time_step is not None
        remedy = (
            "lower solver.dynamic.time_step, or omit it: a stable step is then chosen"
            if given
            else "apply the load more slowly (field.over_time, damping), or use more cells across"
        )
        return Trouble(cause, stiffest, remedy)
