"""TPE for directions: the tree-structured Parzen estimator with kernels on the sphere.

TPE draws candidates from a density l of the good trials so far and takes the one with the largest l/g, g being the density of the others
(Bergstra et al., NeurIPS 2011). Optuna's TPESampler builds both of Gaussians in each angle, which know neither that -180 and 180 degrees
are the same, nor what a pole is, and are wide with few trials. Here a design is a list of unit vectors (and of plain numbers, such as the
field's strength), and a trial's kernel is a product of von Mises-Fisher densities exp(K d.m) K / (4 pi sinh K). docs/design.md has
targets and counts.

The first four trials magnetize all segments alike, in the directions of a regular tetrahedron in a random orientation. Each gives one
bend, and together they show where the target lies.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import optuna
from optuna.distributions import BaseDistribution, FloatDistribution
from optuna.trial import FrozenTrial, TrialState

from magmpm.compiled.arrays import Array, Plain
from magmpm.studies.search.objectives import ranked
from magmpm.studies.search.parameters import TETRAHEDRON, corner_of
from magmpm.studies.search.samplers.blocks import unit
from magmpm.studies.search.samplers.optuna_ids import other_trials
from magmpm.studies.search.search_space import SearchSpace


@dataclass(frozen=True)
class TpeSettings:
    """Settings of the sampler tpe.

    Attributes
    ----------
    good : float
        Share of trials that count as good.
    candidates : int
        How many are drawn from the density of good ones.
    concentration : float
        K of one good trial's kernel: a spread of 1/sqrt(K) rad in each of two directions, 18
        degrees.
    width : float
        Standard deviation of plain numbers, of their range.
    prior : float
        Weight of the uniform density; a trial's is 1.
    """

    good: float = 0.05
    candidates: int = 512
    concentration: float = 10.0
    width: float = 0.15
    prior: float = 0.1


@dataclass(frozen=True)
class Designs:
    """Several designs, n of them.

    Attributes
    ----------
    directions : array (n, k, 3), no unit
        Unit vectors.
    numbers : array (n, q), no unit
        From 0 to 1, of their range.
    """

    directions: Array
    numbers: Array

    def __len__(self) -> int:
        return len(self.directions)

    def __getitem__(self, index: Any) -> Designs:
        return Designs(self.directions[index], self.numbers[index])


PRIOR_OF_CHOICES = 1.0  # weight of any choice next to the good trials'


class DirectionTPE(optuna.samplers.BaseSampler):
    """Chooses the trial after a number of finished ones by TPE with kernels on the sphere.

    The choice depends on the study's seed, and on the finished and the running trials alone:
    running ones count as bad.

    Parameters
    ----------
    space : SearchSpace
        The search space.
    seed : int
        Of the study.
    finished : int
        How many trials are finished.
    settings : TpeSettings, optional
        Those of the sampler; the usual ones unless given.
    """

    def __init__(
        self, space: SearchSpace, seed: int, finished: int, settings: TpeSettings | None = None
    ) -> None:
        self._space = space
        self._settings = settings or TpeSettings()
        self._seed = seed
        self._rng = np.random.default_rng([seed, finished])

    def infer_relative_search_space(
        self, study: optuna.Study, trial: FrozenTrial
    ) -> dict[str, BaseDistribution]:
        return self._space.distributions()

    def sample_relative(
        self, study: optuna.Study, trial: FrozenTrial, search_space: dict[str, BaseDistribution]
    ) -> Plain:
        ended, running, before = other_trials(study, trial, search_space)
        trials = [t for t in ended if t.state == TrialState.COMPLETE]
        if len(trials) + before < len(TETRAHEDRON):
            return self._with_choices(
                self._space.parameters(*self._alike(len(trials) + before)), trials
            )
        if not trials:
            anywhere = (
                unit(self._rng.normal(size=(self._space.count, 3))),
                self._rng.random(self._space.numbers),
            )
            return self._with_choices(self._space.parameters(*anywhere), trials)
        designs = self._read(trials)
        # trials that violate a constraint are worse than all others, by how far (as in Optuna's TPE)
        order = sorted(
            ranked(trials),
            key=lambda i: sum(max(value, 0.0) for value in trials[i].constraints.values()),
        )
        count = math.ceil(self._settings.good * len(trials))
        others = designs[order[count:]]
        if running:  # as if they had turned out badly: a constant liar (Ginsbourger et al. 2010)
            more = self._read(running)
            pairs = (others.directions, more.directions), (others.numbers, more.numbers)
            others = Designs(*(np.concatenate(pair) for pair in pairs))
        chosen = self.choose(designs[order[:count]], others)
        return self._with_choices(
            self._space.parameters(chosen.directions[0], chosen.numbers[0]),
            [trials[i] for i in order],
        )

    def _with_choices(self, parameters: Plain, ordered: Sequence[FrozenTrial]) -> Plain:
        """The parameters with a value of each choice: that of a good trial, or any.

        Any has the weight PRIOR_OF_CHOICES next to the good trials' weight of 1 each; `ordered`: the trials, best first. A choice has no
        neighbors, so there is nothing to learn from trials of another.
        """
        for name, values in self._space.choices.items():
            good = max(math.ceil(len(ordered) / 4), 1) if len(ordered) >= len(TETRAHEDRON) else 0
            known = [trial.params[name] for trial in ordered[:good]]
            if self._rng.random() < PRIOR_OF_CHOICES / (PRIOR_OF_CHOICES + good):
                known = list(values)
            parameters[name] = known[int(self._rng.integers(len(known)))]
        return parameters

    def sample_independent(
        self,
        study: optuna.Study,
        trial: FrozenTrial,
        param_name: str,
        param_distribution: BaseDistribution,
    ) -> float:
        """A value of a parameter that is not of the search space; a study has none."""
        assert isinstance(param_distribution, FloatDistribution)
        return float(self._rng.uniform(param_distribution.low, param_distribution.high))

    def choose(self, good: Designs, others: Designs) -> Designs:
        """Choose one design, where good designs are dense and the others are not.

        Parameters
        ----------
        good : Designs
            Good designs.
        others : Designs
            The other ones.

        Returns
        -------
        Designs
            The chosen one.
        """
        k = good.directions.shape[1]
        q = good.numbers.shape[1]
        narrower = len(good) ** (
            1 / (2 * k + q + 4)
        )  # Scott's rule: kernels of n points in d dimensions
        candidates = self._draw(good, narrower)
        ratio = self._density(candidates, good, narrower) - self._density(
            candidates, others, narrower
        )
        best = int(np.argmax(ratio))
        return candidates[best : best + 1]

    def _alike(self, corner: int) -> tuple[Array, Array]:
        """All segments in the direction of one corner of the study's tetrahedron; any field."""
        segments = len(self._space.segments)
        directions = np.tile(corner_of(self._seed, corner), (segments, 1))
        field = unit(self._rng.normal(size=(self._space.count - segments, 3)))
        return np.vstack([directions, field]), self._rng.random(self._space.numbers)

    def _read(self, trials: Sequence[FrozenTrial]) -> Designs:
        read = [self._space.design(trial.params) for trial in trials]
        return Designs(np.array([d for d, _ in read]), np.array([x for _, x in read]))

    def _draw(self, good: Designs, narrower: float) -> Designs:
        """Candidates from the density of good designs."""
        rng = self._rng
        settings = self._settings
        n = settings.candidates
        around = good[rng.integers(len(good), size=n)]
        directions = _near(rng, around.directions, settings.concentration * narrower**2)
        numbers = around.numbers + settings.width / narrower * rng.normal(size=around.numbers.shape)
        numbers = 1 - np.abs(1 - np.abs(numbers) % 2)  # reflected into 0 to 1
        anywhere = rng.random(n) < settings.prior / (settings.prior + len(good))
        directions[anywhere] = unit(rng.normal(size=directions[anywhere].shape))
        numbers[anywhere] = rng.random(numbers[anywhere].shape)
        return Designs(directions, numbers)

    def _density(self, at: Designs, of: Designs, narrower: float) -> Array:
        """Logarithm of the density of designs `of` at designs `at`, to a constant: relative to the uniform one."""
        K = self._settings.concentration * narrower**2
        cosines = np.einsum("nkx,mkx->nm", at.directions, of.directions)
        k = at.directions.shape[1]
        q = at.numbers.shape[1]
        log = K * (cosines - k) + k * math.log(2 * K / -math.expm1(-2 * K))
        if q:
            width = self._settings.width / narrower
            squares = np.sum((at.numbers[:, None] - of.numbers) ** 2, axis=2)
            log += -0.5 * squares / width**2 - q * math.log(width * math.sqrt(2 * math.pi))
        log = np.column_stack([log, np.full(len(at), math.log(self._settings.prior))])
        largest = log.max(axis=1)
        total = np.exp(np.maximum(log - largest[:, None], -700.0)).sum(axis=1)
        return np.asarray(largest + np.log(total) - math.log(len(of) + self._settings.prior))


def _near(rng: np.random.Generator, means: Array, K: float) -> Array:
    """A direction from the von Mises-Fisher density about each of the means (..., 3).

    Source: Ulrich, J. R. Stat. Soc. C 33 (1984) 158; in three dimensions the cosine's distribution has a closed inverse.
    """
    u = rng.random(means.shape[:-1])
    cosine = np.clip(1 + np.log(u + (1 - u) * math.exp(-2 * K)) / K, -1, 1)[..., None]
    across = rng.normal(size=means.shape)
    across = unit(across - np.sum(across * means, axis=-1, keepdims=True) * means)
    return unit(cosine * means + np.sqrt(1 - cosine**2) * across)
