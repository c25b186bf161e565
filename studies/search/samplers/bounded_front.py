"""The front of two objectives of which one is a bound: least squares within one bound after the other.

The second objective is the greatest strength of a design's vectors (Ball). To be good in both is to be near the target within a bound of
the strength, and that is a problem for Gauss and Newton (gauss_newton.py). So a few trials go to each of a ladder of bounds: the greatest
one first, and then always the middle of a gap between two bounds, or between zero and the least one, in which there is most to find: of the
largest product of its width and the logarithm of the ratio of both distances.

Within a bound the search begins with a given design: the best that `model` makes of all that is known, or without that the best of
those given that smaller bounds do not allow, or the best trial of the larger bounds, its vectors shortened. From the start, or from the
best trial that the bound allows if that is nearer to the target, it goes on by steps, as long as they promise to win. Another start is
tried only where the best trial is much farther from the target than `model` foretells for it: a weak field has many designs that are as
near as each other, and a step that promises little often ends on another branch, far away. Like the sampler it is made of, this one depends
only on the seed and the trials that are there.
"""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Protocol

from optuna.trial import FrozenTrial

from magmpm.compiled.arrays import Named, NamedNumbers, Plain
from magmpm.studies.search.samplers.blocks import Array, Ball, Block
from magmpm.studies.search.samplers.gauss_newton import (
    PLAN,
    GaussNewtonSampler,
    PlanningSampler,
    cost_of,
    counted,
)
from magmpm.studies.search.samplers.optuna_ids import value_of

# a distance from the target, as it is foretold, and the design
Start = tuple[float, NamedNumbers]


class Foretells(Protocol):
    """Quick model of the problem; unloaded: distance (m) of all designs at zero strength."""

    unloaded: float

    def improved(self, share: float, designs: Sequence[Mapping[str, float]]) -> list[Start]:
        """Improve designs within a bound.

        Parameters
        ----------
        share : float
            The bound, as a share of the greatest.
        designs : sequence of Mapping[str, float]
            Of any strength.

        Returns
        -------
        list of Start
            Better ones, best first.
        """

    def residuals(self, design: Mapping[str, float]) -> Array | None:
        """Foretell the residuals of a design.

        Parameters
        ----------
        design : Mapping[str, float]
            Its parameters.

        Returns
        -------
        array (m,) or None
            The residuals; None where they can't be foretold.
        """


BOUND = (  # in a trial's plan: the bound within which it was sought, as a share of the greatest
    "bound"
)
EACH = 4  # trials of a bound, at most: a start and its steps
# of the distance, about: a bound is left after a step that wins less, or before one that promises
# less, and a gap between two in which it changes less
LEAST_PROGRESS = 0.05
NARROWEST = 1 / 64  # of a gap's end: smaller ones are not looked into


class BoundedFront(PlanningSampler):
    """Suggests starts and Gauss-Newton steps within one bound after the other.

    Parameters
    ----------
    blocks : sequence of Block
        As of GaussNewtonSampler, one Ball at least.
    seed : int
        Of all that is drawn.
    starts : sequence of Mapping[str, float], default ()
        Designs to begin from, best first, of any strength.
    near : float, default 0.0
        Distance (the first objective) below which differences do not matter as long as others
        are left.
    poor : float, default math.inf
        By how much a bound's best trial is farther than a start is foretold to be, where that
        start is tried.
    far : float, default math.inf
        About the distance that all designs have at zero strength, where no model knows it.
    model : Foretells, optional
        Improves the designs that a bound begins with, and foretells where a step leads.
    """

    def __init__(
        self,
        blocks: Sequence[Block],
        seed: int,
        *,
        starts: Sequence[Mapping[str, float]] = (),
        near: float = 0.0,
        poor: float = math.inf,
        far: float = math.inf,
        model: Foretells | None = None,
    ) -> None:
        super().__init__(blocks, seed, starts)
        self._balls = [block for block in blocks if isinstance(block, Ball)]
        self._near = near
        self._poor = poor
        self._far = far if model is None else model.unloaded
        self._model = model

    def plan(
        self, trials: Sequence[FrozenTrial], running: Sequence[FrozenTrial] = ()
    ) -> tuple[NamedNumbers, Plain]:
        """Parameters of the next trial, and what is kept with it."""
        busy = {_bound_of(t) for t in running}
        last = _bound_of(trials[-1]) if trials else None
        going_on = [] if last is None or last in busy else [last]
        for near in (self._near, 0.0):
            for bound in [*going_on, *self._next_bounds(trials, running, near)]:
                found = self._within(bound, trials, running, near)
                if found is not None:
                    return found
        params, kept = self._sampler(1.0).plan(
            trials, running
        )  # nothing is left between bounds: on within the greatest
        return params, {**kept, BOUND: 1.0}

    def _within(
        self,
        bound: float,
        trials: Sequence[FrozenTrial],
        running: Sequence[FrozenTrial],
        near: float,
    ) -> tuple[NamedNumbers, Plain] | None:
        """The next design within a bound; None where its trials are used up, or its best is near enough."""
        here = [t for t in trials if _bound_of(t) == bound]
        known = [t.params for t in [*trials, *running]]
        best = self._best(trials, bound)
        nearest = math.inf if best is None else value_of(best)
        if len(here) >= EACH or (here and _wins_little(here[-1], trials)):
            return None
        if bound < 1.0 and nearest <= near:
            return None
        if here:
            params, kept = self._sampler(bound).plan(self._origins_and(here, best, trials))
            if (
                kept["from"] is not None
                and _promises(kept, trials)
                and not _is_among(params, known)
            ):
                return params, {**kept, BOUND: bound}
        begun = here[0].number if here else math.inf
        for foretold, start in self._starts_within(bound, [t for t in trials if t.number < begun]):
            if not _is_among(start, known) and (not here or nearest > foretold + self._poor):
                return start, {"start": len(here), "from": None, BOUND: bound}
        return None

    def _origins_and(
        self, here: list[FrozenTrial], best: FrozenTrial | None, trials: Sequence[FrozenTrial]
    ) -> list[FrozenTrial]:
        """The trials of a bound and the designs that they began from; last the best one, where another bound's is better than the start."""
        origins = {t.system_attrs[PLAN]["from"] for t in here} - {t.number for t in here}
        own = [*(_given(t) for t in trials if t.number in origins), *here]
        from_best = best is not None and len(here) == 1 and best.number != here[0].number
        return [*own, _given(best)] if from_best and best is not None else own

    def _sampler(self, bound: float) -> GaussNewtonSampler:
        """The sampler of one bound's steps."""
        blocks = [
            dataclasses.replace(b, most=bound * b.most) if isinstance(b, Ball) else b
            for b in self._blocks
        ]
        foretell = None if self._model is None else self._model.residuals
        return GaussNewtonSampler(
            blocks, self._seed, goal=self._near, poor=self._poor, foretell=foretell
        )

    def _strength(self, params: Mapping[str, float]) -> float:
        """The greatest strength of a design, as a share of the greatest bound."""
        return max(params[ball.strength] / ball.most for ball in self._balls)

    def _best(self, trials: Sequence[FrozenTrial], bound: float) -> FrozenTrial | None:
        """The trial nearest to the target that a bound allows."""
        allowed = [
            t for t in trials if counted(t) and self._strength(t.params) <= bound * (1 + 1e-9)
        ]
        return min(allowed, key=cost_of, default=None)

    def _starts_within(self, bound: float, trials: Sequence[FrozenTrial]) -> list[Start]:
        """Designs to begin from within a bound, best first; trials: those before its first one, so that they stay the same."""
        bounds = {b for b in map(_bound_of, trials) if b is not None}
        best = self._best(trials, bound)
        larger = [b for b in bounds if b > bound]
        stronger = self._best(trials, min(larger)) if larger else None
        neighbors = [dict(t.params) for t in (best, stronger) if t is not None]
        if self._model is not None:
            return self._model.improved(bound, [*self._starts, *neighbors])
        below = max((b for b in bounds if b < bound), default=0.0)
        found = [
            start
            for start in self._starts
            if below * (1 + 1e-9) < self._strength(start) <= bound * (1 + 1e-9)
        ]
        if stronger is not None:
            shortened = dict(stronger.params)
            for ball in self._balls:
                shortened[ball.strength] = min(shortened[ball.strength], bound * ball.most)
            found.append(shortened)
        return [(0.0, start) for start in found or [self._sampler(bound).plan([])[0]]]

    def _next_bounds(
        self, trials: Sequence[FrozenTrial], running: Sequence[FrozenTrial], near: float
    ) -> list[float]:
        """The middles of the gaps between bounds, that in which there is most to find first.

        A gap ends at the strength of the best design within its larger bound.
        """
        known = sorted({b for b in map(_bound_of, [*trials, *running]) if b is not None})
        if not known or known[-1] < 1.0:
            return [1.0]
        gaps: list[tuple[float, float]] = []  # what there is to find, middle
        for low, bound in zip([0.0, *known], known, strict=False):
            best = self._best(trials, bound)
            high = bound if best is None else self._strength(best.params)
            farther = max(self._distance(low, trials), near)
            change = math.log(farther / max(self._distance(bound, trials), near))
            if high - low >= NARROWEST * high and change > LEAST_PROGRESS:
                gaps.append(((high - low) * change, (low + high) / 2))
        return [middle for _, middle in sorted(gaps, reverse=True)]

    def _distance(self, bound: float, trials: Sequence[FrozenTrial]) -> float:
        """The least distance within a bound."""
        best = self._best(trials, bound)
        return self._far if best is None else max(value_of(best), 1e-300)


def _wins_little(trial: FrozenTrial, trials: Sequence[FrozenTrial]) -> bool:
    """True if a trial is a step that was better than what it began from, but hardly."""
    plan = trial.system_attrs[PLAN]
    before = next((t for t in trials if t.number == plan["from"]), None)
    if before is None or not counted(trial):
        return False
    return bool(1.0 - LEAST_PROGRESS < value_of(trial) / value_of(before) <= 1.0)


def _promises(kept: Named, trials: Sequence[FrozenTrial]) -> bool:
    """True if a step is worth a trial by what it promises."""
    cost = next(cost_of(t) for t in trials if t.number == kept["from"])
    return bool(kept["promised"] > (1.0 - (1.0 - LEAST_PROGRESS) ** 2) * cost)


def _is_among(params: Mapping[str, float], known: Sequence[Named]) -> bool:
    """True if a design is one of those known."""
    return any(all(other[name] == value for name, value in params.items()) for other in known)


def _given(trial: FrozenTrial) -> FrozenTrial:
    """A trial as a design from elsewhere, without its plan."""
    found = copy.copy(trial)
    found.system_attrs = {}
    return found


def _bound_of(trial: FrozenTrial) -> float | None:
    """The bound within which a trial was sought; None for one that was not ours."""
    found = trial.system_attrs.get(PLAN, {}).get(BOUND)
    return None if found is None else float(found)
