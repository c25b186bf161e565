"""The front of two objectives of which one is a bound: least squares within one bound after the other.

The second objective is the greatest strength of a design's vectors (Ball). To be good in both is to be near the target within a bound of
the strength, and that is a problem for Gauss and Newton (gauss_newton.py). So a few trials go to each of a ladder of bounds: the greatest
one first, and then always the middle of a gap between two bounds, or between zero and the least one, in which there is most to find: of the
largest product of its width and the logarithm of the ratio of both distances.

Within a bound the search begins with a given design: the best that `improve` makes of all that is known, or without that the best of
those given that smaller bounds do not allow, or the best trial of the larger bounds, its vectors shortened. From the start, or from the
best trial that the bound allows if that is nearer to the target, it goes on by steps. Like the sampler it is made of, this one depends only
on the seed and the trials that are there.
"""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from optuna.trial import FrozenTrial

from magmpm.studies.search.samplers.blocks import Ball, Block
from magmpm.studies.search.samplers.gauss_newton import (
    PLAN,
    GaussNewtonSampler,
    PlanningSampler,
    cost_of,
    counted,
)

Improve = Callable[[float, Sequence[Mapping[str, float]]], list[dict[str, float]]]

BOUND = (  # in a trial's plan: the bound within which it was sought, as a share of the greatest
    "bound"
)
EACH = 4  # trials of a bound, at most: a start and its steps
# of the distance, about: a bound is left after a step that wins less, and a gap between two in
# which it changes less
LEAST_PROGRESS = 0.05
NARROWEST = 1 / 64  # of the greatest bound: gaps below are not looked into


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
        Distance (the first objective) below which differences do not matter.
    poor : float, default math.inf
        Distance above which a bound's next start is tried.
    far : float, default math.inf
        About the distance that all designs have at zero strength.
    improve : Improve, optional
        Makes, from a bound as a share of the greatest and designs of any strength, better
        designs that the bound allows, best first.
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
        improve: Improve | None = None,
    ) -> None:
        super().__init__(blocks, seed, starts)
        self._balls = [block for block in blocks if isinstance(block, Ball)]
        self._near = near
        self._poor = poor
        self._far = far
        self._improve = improve

    def plan(
        self, trials: Sequence[FrozenTrial], running: Sequence[FrozenTrial] = ()
    ) -> tuple[dict[str, float], dict[str, Any]]:
        """Parameters of the next trial, and what is kept with it."""
        busy = {_bound_of(t) for t in running}
        last = _bound_of(trials[-1]) if trials else None
        if last is not None and last not in busy:
            found = self._within(last, trials, running)
            if found is not None:
                return found
        bound = self._next_bound(trials, running)
        found = None if bound is None else self._within(bound, trials, running)
        if found is not None:
            return found
        params, kept = self._sampler(1.0).plan(
            trials, running
        )  # nothing is left between bounds: on within the greatest
        return params, {**kept, BOUND: 1.0}

    def _within(
        self, bound: float, trials: Sequence[FrozenTrial], running: Sequence[FrozenTrial]
    ) -> tuple[dict[str, float], dict[str, Any]] | None:
        """The next design within a bound; None where its trials are used up."""
        here = [t for t in trials if _bound_of(t) == bound]
        known = [t.params for t in [*trials, *running]]
        best = self._best(trials, bound)
        if len(here) >= EACH or (here and _wins_little(here[-1], trials)):
            return None
        if here:
            params, kept = self._sampler(bound).plan(self._origins_and(here, best, trials))
            if kept["from"] is not None and not _is_among(params, known):
                return params, {**kept, BOUND: bound}
            if best is not None and float(best.values[0]) <= self._poor:
                return None
        begun = here[0].number if here else math.inf
        for start in self._starts_within(bound, [t for t in trials if t.number < begun]):
            if not _is_among(start, known):
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
        return GaussNewtonSampler(blocks, self._seed, goal=self._near, poor=self._poor)

    def _strength(self, params: Mapping[str, float]) -> float:
        """The greatest strength of a design, as a share of the greatest bound."""
        return max(params[ball.strength] / ball.most for ball in self._balls)

    def _best(self, trials: Sequence[FrozenTrial], bound: float) -> FrozenTrial | None:
        """The trial nearest to the target that a bound allows."""
        allowed = [
            t for t in trials if counted(t) and self._strength(t.params) <= bound * (1 + 1e-9)
        ]
        return min(allowed, key=cost_of, default=None)

    def _starts_within(self, bound: float, trials: Sequence[FrozenTrial]) -> list[dict[str, float]]:
        """Designs to begin from within a bound, best first; trials: those before its first one, so that they stay the same."""
        bounds = {b for b in map(_bound_of, trials) if b is not None}
        best = self._best(trials, bound)
        larger = [b for b in bounds if b > bound]
        stronger = self._best(trials, min(larger)) if larger else None
        neighbors = [dict(t.params) for t in (best, stronger) if t is not None]
        if self._improve is not None:
            return self._improve(bound, [*self._starts, *neighbors])
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
        return found or [self._sampler(bound).plan([])[0]]

    def _next_bound(
        self, trials: Sequence[FrozenTrial], running: Sequence[FrozenTrial]
    ) -> float | None:
        """The middle of the gap between bounds in which there is most to find; None where there is none left."""
        known = sorted({b for b in map(_bound_of, [*trials, *running]) if b is not None})
        if not known or known[-1] < 1.0:
            return 1.0
        gaps: list[tuple[float, float]] = []  # what there is to find, middle
        for low, high in zip([0.0, *known], known, strict=False):
            change = math.log(self._distance(low, trials) / self._distance(high, trials))
            if high - low >= NARROWEST and change > LEAST_PROGRESS:
                gaps.append(((high - low) * change, (low + high) / 2))
        return max(gaps, default=(0.0, None))[1]

    def _distance(self, bound: float, trials: Sequence[FrozenTrial]) -> float:
        """The least distance within a bound, as far as it matters."""
        best = self._best(trials, bound)
        return max(self._far if best is None else float(best.values[0]), self._near, 1e-300)


def _wins_little(trial: FrozenTrial, trials: Sequence[FrozenTrial]) -> bool:
    """True if a trial is a step that was hardly better than what it began from."""
    origin = trial.system_attrs[PLAN]["from"]
    before = next((t for t in trials if t.number == origin), None)
    return before is not None and not (
        counted(trial) and trial.values[0] < (1.0 - LEAST_PROGRESS) * before.values[0]
    )


def _is_among(params: Mapping[str, float], known: Sequence[Mapping[str, Any]]) -> bool:
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
