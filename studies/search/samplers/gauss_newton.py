"""Gauss-Newton for Optuna: a sampler that minimizes a sum of squares by its residuals and their Jacobian.

    sampler = GaussNewtonSampler([Direction("around", "along"), Number("length", 4.0, 12.0)], seed=1)

An objective stores two user attributes with each trial: `residuals` (m) and `jacobian` (m rows of k), the derivatives of the residuals with
respect to the coordinates of the blocks, one after the other: the three components of a direction's unit vector, the three of a vector in a
ball, and a number's place between its bounds, 0 to 1. Of a direction's derivatives only the part along the sphere counts. A trial
without these attributes has failed.

The method is Levenberg's and Marquardt's with a trust region (Nocedal and Wright, Numerical Optimization, chapter 10), in the tangent space
of the product of spheres, balls and intervals (Absil et al., Optimization Algorithms on Matrix Manifolds, chapter 8): the step p solves
min |r + J p|^2 within bounds, with |p| at most the radius (1 is a radian, a ball's radius, or an interval's length). A step that is worse,
infeasible or failed is taken back, and the radius shrinks. A descent that is stuck is left for the next start: first the given designs,
then points of a low-discrepancy sequence (Roberts' generalized golden ratio).

Every suggestion depends only on the seed and the finished trials: what a step began from is kept with its trial (the system attribute
PLAN), and the rest is read from there. So a study that is resumed, by any process, is the same study, and suggestions do not get slower.
While a trial of a descent is running, another one begins from the next start: several workers follow several descents.
This file and those it imports need Optuna, NumPy and SciPy alone; `make optunahub` makes a package of them.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import optuna
from optuna.distributions import BaseDistribution, FloatDistribution
from optuna.trial import FrozenTrial

from magmpm.studies.search.samplers.blocks import Array, Ball, Block, Direction, Number
from magmpm.studies.search.samplers.gauss_newton_steps import Coordinates, Step
from magmpm.studies.search.samplers.optuna_ids import other_trials, storage_of, trial_id, value_of

__all__ = ["PLAN", "Ball", "Direction", "GaussNewtonSampler", "Number"]

PLAN = "gauss_newton:plan"
RADIUS = 1.0  # of the first step of a descent
LEAST_RADIUS = 1e-5  # a descent with a smaller one is stuck
LEAST_GAIN = 0.02  # share of the sum of squares that a step must promise, else the descent is stuck


class PlanningSampler(optuna.samplers.BaseSampler):
    """A sampler of designs that blocks of parameters make up: it plans the next one from the seed and the trials that are there alone.

    Parameters
    ----------
    blocks : sequence of Block
        Which parameters make which coordinates.
    seed : int
        Of all that is drawn.
    starts : sequence of Mapping[str, float]
        Designs (parameters) to begin from, best first.
    """

    def __init__(
        self, blocks: Sequence[Block], seed: int, starts: Sequence[Mapping[str, float]]
    ) -> None:
        self._blocks = tuple(blocks)
        self._seed = seed
        self._starts = [dict(start) for start in starts]

    @abstractmethod
    def plan(
        self, trials: Sequence[FrozenTrial], running: Sequence[FrozenTrial] = ()
    ) -> tuple[dict[str, float], dict[str, Any]]:
        """Plan the next trial: each kind of sampler says how.

        Parameters
        ----------
        trials : sequence of FrozenTrial
            Those that have ended.
        running : sequence of FrozenTrial, default ()
            Those that have not.

        Returns
        -------
        params : dict[str, float]
            Its parameters.
        kept : dict[str, Any]
            What is kept with it.
        """

    def infer_relative_search_space(
        self, study: optuna.Study, trial: FrozenTrial
    ) -> dict[str, BaseDistribution]:
        return {
            name: kind for block in self._blocks for name, kind in block.distributions().items()
        }

    def sample_relative(
        self, study: optuna.Study, trial: FrozenTrial, search_space: dict[str, BaseDistribution]
    ) -> dict[str, Any]:
        ended, running, _ = other_trials(study, trial, search_space)
        params, kept = self.plan([t for t in ended if set(search_space) <= set(t.params)], running)
        storage_of(study).set_trial_system_attr(trial_id(trial), PLAN, kept)
        return params

    def sample_independent(
        self,
        study: optuna.Study,
        trial: FrozenTrial,
        param_name: str,
        param_distribution: BaseDistribution,
    ) -> Any:
        """The middle of the range of a parameter that no block names."""
        if not isinstance(param_distribution, FloatDistribution):
            raise ValueError(
                f"{param_name}: no block of the Gauss-Newton sampler names it, and it is not a"
                " plain number"
            )
        return (param_distribution.low + param_distribution.high) / 2


class GaussNewtonSampler(PlanningSampler):
    """Suggests starts and Gauss-Newton steps; reads `residuals` and `jacobian` from the trials' user attributes.

    Parameters
    ----------
    blocks : sequence of Block
        Which parameters make which coordinates.
    seed : int
        Of all that is drawn.
    starts : sequence of Mapping[str, float], default ()
        Designs (parameters) to begin from, best first.
    goal : float, default 0.0
        Value that is good enough: a descent above it is left once it hardly moves.
    poor : float, default math.inf
        Value above which a given design is not improved before others are tried.
    foretell : callable, optional
        Foretells a design's residuals (m,), or None. As much as it foretells them to change along a
        step, they are taken to change: a step that then leads farther away is made shorter.
    """

    def __init__(
        self,
        blocks: Sequence[Block],
        seed: int,
        *,
        starts: Sequence[Mapping[str, float]] = (),
        goal: float = 0.0,
        poor: float = math.inf,
        foretell: Callable[[Mapping[str, float]], Array | None] | None = None,
    ) -> None:
        super().__init__(blocks, seed, starts)
        self._space = Coordinates(blocks)
        self._foretell = foretell
        self._goal = goal
        self._poor = poor

    def plan(
        self, trials: Sequence[FrozenTrial], running: Sequence[FrozenTrial] = ()
    ) -> tuple[dict[str, float], dict[str, Any]]:
        """Parameters of the next trial, and what is kept with it: a step from the descent's best design so far, or a start. Descents with a
        running trial wait for it."""
        known = {t.number: t for t in trials}
        busy = {start_of(t) for t in running}
        free = [t for t in trials if start_of(t) not in busy]
        found = self._base(free, known)
        trials = [*trials, *running]
        if found is not None:
            base, radius = found
            x = self._space.read(base.params)
            residuals, jacobian = model_of(base)
            curvature = self._curvature(free[-1], known, x, jacobian)
            step = self._space.step(x, residuals, jacobian, radius, curvature)
            there = self._space.write(self._space.moved(x, step.p))
            while radius > LEAST_RADIUS and self._leads_away(base, there):
                radius = step.length / 2
                step = self._space.step(x, residuals, jacobian, radius, curvature)
                there = self._space.write(self._space.moved(x, step.p))
            stuck = self._stuck(base, step, radius, free[-1], known)
            if not stuck and not self._seen(there, trials):
                kept = {
                    "start": start_of(base),
                    "from": base.number,
                    "radius": radius,
                    "length": step.length,
                }
                return there, {**kept, "promised": step.promised}
        index = 1 + max((start_of(t) for t in trials), default=-1)
        while self._seen(params := self._start_at(index), trials):
            index += 1
        return params, {"start": index, "from": None}

    def used_up(self, trials: Sequence[FrozenTrial], running: Sequence[FrozenTrial]) -> bool:
        """Tell whether the given designs and the descents from them are used up, so that a point of the sequence comes next.

        Parameters
        ----------
        trials : sequence of FrozenTrial
            Those that have ended.
        running : sequence of FrozenTrial
            Those that have not.

        Returns
        -------
        bool
            True if they are.
        """
        return bool(self.plan(trials, running)[1]["start"] >= len(self._starts))

    def refined(self, base: FrozenTrial, trials: Sequence[FrozenTrial]) -> dict[str, float] | None:
        """Find the design a step on from the best trial's, shorter than those that were tried.

        Parameters
        ----------
        base : FrozenTrial
            The best trial.
        trials : sequence of FrozenTrial
            All of them.

        Returns
        -------
        dict[str, float] or None
            Its parameters; None where it promises little.
        """
        radius = RADIUS if counted(base) else 0.0
        while radius > LEAST_RADIUS:
            x, residuals, jacobian = self._space.read(base.params), *model_of(base)
            step = self._space.step(
                x, residuals, jacobian, radius, self._space.curvature(x, jacobian)
            )
            if step.promised < LEAST_GAIN * cost_of(base):
                break
            if not self._seen(there := self._space.write(self._space.moved(x, step.p)), trials):
                return there
            radius = step.length / 4
        return None

    def _base(
        self, trials: Sequence[FrozenTrial], known: Mapping[int, FrozenTrial]
    ) -> tuple[FrozenTrial, float] | None:
        """The design to step from and the radius, after the last trial; None: a start is due."""
        if not trials:
            return None
        last = trials[-1]
        plan = last.system_attrs.get(PLAN)
        if plan is not None and plan["from"] is not None:
            return _judged(known[plan["from"]], last, plan)
        given = [
            t
            for t in trials
            if counted(t) and t.system_attrs.get(PLAN, {"from": None})["from"] is None
        ]
        if plan is None:  # not ours: enqueued, or of another sampler
            return (min(given, key=cost_of), RADIUS) if given else None
        looked_at = min(3, len(self._starts))
        fresh = [t for t in given if t is last or 0 <= start_of(t) <= plan["start"] < looked_at]
        if not fresh or (
            value_of(best := min(fresh, key=cost_of)) > self._poor and plan["start"] + 1 < looked_at
        ):
            return None
        return best, RADIUS

    def _curvature(
        self, last: FrozenTrial, known: Mapping[int, FrozenTrial], x: Array, jacobian: Array
    ) -> float:
        """Deviation of the residuals from the linear model, over a step's length squared: as the last step showed, or a guess."""
        guess = self._space.curvature(x, jacobian)
        plan = last.system_attrs.get(PLAN)
        if plan is None or plan["from"] is None or not counted(last):
            return guess
        left = math.sqrt(max(cost_of(known[plan["from"]]) - plan["promised"], 0.0))
        seen = abs(math.sqrt(cost_of(last)) - left) / max(plan["length"], LEAST_RADIUS) ** 2
        return min(max(seen, guess / 10), 10 * guess)

    def _stuck(
        self,
        base: FrozenTrial,
        step: Step,
        radius: float,
        last: FrozenTrial,
        known: Mapping[int, FrozenTrial],
    ) -> bool:
        """True if this descent, of which `last` is the last trial, should be left."""
        residuals, jacobian = model_of(base)
        cost = float(residuals @ residuals)
        if radius < LEAST_RADIUS or step.promised <= 0.0:
            return True
        if (
            step.promised < LEAST_GAIN * cost
        ):  # because it is short, once, or because the end is near
            plan = last.system_attrs.get(PLAN) or {}
            if plan.get("promised", math.inf) < LEAST_GAIN * cost:
                return True
            x = self._space.read(base.params)
            step = self._space.step(x, residuals, jacobian, RADIUS / 4)
        if step.promised < LEAST_GAIN * cost:
            return True
        if value_of(base) <= self._goal:
            return False
        earlier: FrozenTrial | None = base
        for _ in range(5):  # accepted steps that have not brought the value below three quarters
            plan = earlier.system_attrs.get(PLAN) if earlier is not None else None
            earlier = None if plan is None or plan["from"] is None else known[plan["from"]]
        return earlier is not None and cost_of(base) > 0.75**2 * cost_of(earlier)

    def _leads_away(self, base: FrozenTrial, there: Mapping[str, float]) -> bool:
        """True if a step from a trial is foretold to lead farther away."""
        before = None if self._foretell is None else self._foretell(base.params)
        if self._foretell is None or before is None:
            return False
        after = self._foretell(there)
        if after is None:
            return True
        residuals, _ = model_of(base)
        change = after - before
        # many residuals are stored as fewer, of the same norm: then they may cancel the change
        left = (
            residuals + change
            if len(residuals) == len(change)
            else np.linalg.norm(change) - np.linalg.norm(residuals)
        )
        return bool(np.sum(left**2) > cost_of(base))

    def _start_at(self, index: int) -> dict[str, float]:
        """The given design, or after them the point of the sequence."""
        if index < len(self._starts):
            return self._starts[index]
        size = self._space.size
        ratio = 1.5
        for _ in range(60):  # the root of ratio^(size + 1) = ratio + 1
            ratio = (1.0 + ratio) ** (1.0 / (size + 1))
        shift = np.random.default_rng([self._seed]).random(size)
        return self._space.write(
            self._space.anywhere((shift + (index + 1) * ratio ** -np.arange(1.0, size + 1)) % 1.0)
        )

    def _seen(self, params: Mapping[str, float], trials: Sequence[FrozenTrial]) -> bool:
        """True if a finished trial had this design."""
        return any(all(t.params[name] == value for name, value in params.items()) for t in trials)


def _judged(
    before: FrozenTrial, last: FrozenTrial, plan: Mapping[str, Any]
) -> tuple[FrozenTrial, float]:
    """The better of the two designs, and the next radius, from how well the linear model foresaw the last one."""
    length = plan["length"]
    if not counted(last):
        return before, length / 4
    gain = cost_of(before) - cost_of(last)
    share = gain / plan["promised"]
    if share < 0.25:
        # the parabola through both sums of squares, with the slope that belongs to the promise
        shrunk = length * min(0.5, max(0.1, 1.0 / (2.0 - share)))
        return (last if gain > 0.0 else before), shrunk
    return last, max(plan["radius"], 2.0 * length) if share > 0.75 else plan["radius"]


def counted(trial: FrozenTrial) -> bool:
    """Tell whether a trial counts: solved, with derivatives, and no constraint violated.

    Parameters
    ----------
    trial : FrozenTrial
        The trial.

    Returns
    -------
    bool
        True if it does.
    """
    attrs = trial.user_attrs
    return (
        "residuals" in attrs
        and "jacobian" in attrs
        and not any(c > 0.0 for c in trial.constraints.values())
    )


def model_of(trial: FrozenTrial) -> tuple[Array, Array]:
    """Find the linear model that a trial has stored.

    Parameters
    ----------
    trial : FrozenTrial
        The trial.

    Returns
    -------
    residuals : array (m,)
        Its residuals.
    jacobian : array (m, k)
        Their derivatives by the k coordinates.
    """
    residuals = np.array(trial.user_attrs["residuals"], dtype=float)
    return residuals, np.array(trial.user_attrs["jacobian"], dtype=float).reshape(
        len(residuals), -1
    )


def cost_of(trial: FrozenTrial) -> float:
    """Find the sum of squares of a trial's residuals.

    Parameters
    ----------
    trial : FrozenTrial
        The trial.

    Returns
    -------
    float
        The sum.
    """
    residuals = np.array(trial.user_attrs["residuals"], dtype=float)
    return float(residuals @ residuals)


def start_of(trial: FrozenTrial) -> int:
    """Find the start whose descent a trial belongs to.

    Parameters
    ----------
    trial : FrozenTrial
        The trial.

    Returns
    -------
    int
        Number of the start; -1 for a trial that was not ours.
    """
    return int(trial.system_attrs.get(PLAN, {"start": -1})["start"])
