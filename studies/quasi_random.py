"""Optuna's QMCSampler, whose point depends on the number of finished trials alone.

Optuna counts the points it gave in the study's storage, and counts one too many when a process is killed between the count and the trial it
belongs to: a study that is interrupted there would go on with other points than one that is not.
"""

from __future__ import annotations

from optuna import Study
from optuna.distributions import BaseDistribution
from optuna.samplers import QMCSampler
from optuna.trial import FrozenTrial

from magmpm.studies.search_space import SearchSpace


class SobolSampler(QMCSampler):
    """Scrambled Sobol points: the scrambling is the study's seed, the place in the sequence the number of finished trials."""

    def __init__(self, space: SearchSpace, seed: int, finished: int) -> None:
        super().__init__(seed=seed, scramble=True, warn_independent_sampling=False)
        self._space, self._finished = space, finished

    def infer_relative_search_space(self, study: Study, trial: FrozenTrial) -> dict[str, BaseDistribution]:
        return self._space.distributions()  # of the first trial too, which Optuna draws at random

    def _find_sample_id(self, study: Study, search_space: dict[str, BaseDistribution]) -> int:
        return self._finished
