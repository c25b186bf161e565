"""Knowledge for a sampler of the trials that are being solved while it chooses another one."""

from __future__ import annotations

from collections.abc import Iterable

import optuna
from optuna.trial import FrozenTrial, TrialState


def others_running(study: optuna.Study, trial: FrozenTrial, names: Iterable[str]) -> tuple[list[FrozenTrial], int]:
    """The running trials whose designs are known, and how many of all running ones have a smaller number than this one.

    With one worker there are none.
    """
    running = [t for t in study.get_trials(deepcopy=False, states=(TrialState.RUNNING,)) if t.number != trial.number]
    asked = set(names)
    return [t for t in running if asked <= set(t.params)], sum(t.number < trial.number for t in running)
