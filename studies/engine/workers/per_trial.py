"""A study's sampler, made anew for each trial from the study's seed and the trial's number.

So a choice depends on seed, number and the trials that are there, and not on which process makes it. Where several sessions share a study,
each trial first waits until all with smaller numbers have their parameters: storages give out numbers one by one, so this orders the
choices, and each of them knows all designs that are being solved. Without that, two that ask at the same moment would choose alike.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from optuna.samplers import BaseSampler
from optuna.trial import FrozenTrial, TrialState

from magmpm.studies.search.samplers.optuna_ids import storage_of, trial_id

if TYPE_CHECKING:
    from optuna import Study
    from optuna.distributions import BaseDistribution

SESSION = "session"  # user attribute of a trial: the session that runs it
AGAIN = "again"  # ... and the number of the trial, left behind by a session that died, whose design it has
EXCHANGED = "exchanged"  # ... and the number of the trial whose design it has, but for one direction
READY = "asked"  # ... and whether its parameters are all there
PATIENCE = 5.0  # s to wait for the parameters of a trial with a smaller number: its session may have died


class PerTrial(BaseSampler):
    """make: the sampler of the trial with a number. starts: designs of the first trials, whatever the sampler would choose."""

    def __init__(
        self, make: Callable[[int], BaseSampler], *, starts: Sequence[Mapping[str, Any]] = (), session: str | None = None,
        wait: bool = False,
    ) -> None:  # fmt: skip
        self._make, self._starts, self._session, self._wait = make, starts, session, wait
        self._inner: BaseSampler | None = None
        self._given = False

    def before_trial(self, study: Study, trial: FrozenTrial) -> None:
        """Once a trial has its number."""
        self._inner = self._make(trial.number)
        self._given = AGAIN in trial.user_attrs or EXCHANGED in trial.user_attrs
        if self._session is not None:
            storage_of(study).set_trial_user_attr(trial_id(trial), SESSION, self._session)
        if self._wait and not self._given:
            _wait_for_smaller(study, trial)
        self._inner.before_trial(study, trial)

    def infer_relative_search_space(self, study: Study, trial: FrozenTrial) -> dict[str, BaseDistribution]:
        """Search space that the sampler chooses from together; nothing where the design is given."""
        assert self._inner is not None
        return {} if self._given else self._inner.infer_relative_search_space(study, trial)

    def sample_relative(self, study: Study, trial: FrozenTrial, search_space: dict[str, BaseDistribution]) -> dict[str, Any]:
        """The design of a trial."""
        assert self._inner is not None
        if self._given:
            return {}
        found = self._inner.sample_relative(study, trial, search_space)
        if trial.number < len(self._starts):
            storage_of(study).set_trial_user_attr(trial_id(trial), "start", "rod")
            return {name: value for name, value in self._starts[trial.number].items() if name in search_space}
        return found

    def sample_independent(self, study: Study, trial: FrozenTrial, param_name: str, param_distribution: BaseDistribution) -> Any:
        """Value that the sampler chooses by itself."""
        assert self._inner is not None
        if not self._given and trial.number < len(self._starts) and param_name in self._starts[trial.number]:
            return self._starts[trial.number][param_name]
        return self._inner.sample_independent(study, trial, param_name, param_distribution)

    def after_trial(self, study: Study, trial: FrozenTrial, state: TrialState, values: Sequence[float] | None) -> None:
        """Pass a trial that has ended to the sampler, which takes notes of it."""
        self._make(trial.number).after_trial(study, trial, state, values)


def _wait_for_smaller(study: Study, trial: FrozenTrial) -> None:
    """Wait until the running trials with smaller numbers have all their parameters, or for PATIENCE."""
    until = time.monotonic() + PATIENCE
    while time.monotonic() < until:
        trials = study.get_trials(deepcopy=False, states=(TrialState.RUNNING,))
        if all(READY in t.user_attrs for t in trials if t.number < trial.number):
            return
        time.sleep(0.02)
