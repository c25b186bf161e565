"""Names that Optuna 5 keeps private: a study's storage, and the numbers by which storages know studies and trials.

Trials that another process left running are put back, ended or copied by the storage's own calls with these numbers; so are a sampler's
notes on the requested trial, of which it gets a copy without methods. All private names of Optuna stand here.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import optuna
from optuna.trial import FrozenTrial, TrialState

if TYPE_CHECKING:
    from optuna.storages import BaseStorage


def storage_of(study: optuna.Study) -> BaseStorage:
    """Find the storage that a study uses.

    Parameters
    ----------
    study : optuna.Study
        The study.

    Returns
    -------
    BaseStorage
        The storage.
    """
    return study._storage


def study_id(study: optuna.Study) -> int:
    """Find the study's number in its storage.

    Parameters
    ----------
    study : optuna.Study
        The study.

    Returns
    -------
    int
        The number.
    """
    return study._study_id


def trial_id(trial: optuna.Trial | FrozenTrial) -> int:
    """Find the trial's number in its storage: another one than its number in its study.

    Parameters
    ----------
    trial : optuna.Trial or FrozenTrial
        The trial.

    Returns
    -------
    int
        The number.
    """
    return trial._trial_id


def other_trials(
    study: optuna.Study, trial: FrozenTrial, names: Iterable[str]
) -> tuple[list[FrozenTrial], list[FrozenTrial], int]:
    """Find the other trials of a study.

    Parameters
    ----------
    study : optuna.Study
        The study.
    trial : FrozenTrial
        The trial that is to be chosen.
    names : iterable of str
        Parameters that a trial must have to be known.

    Returns
    -------
    ended : list of FrozenTrial
        Those that have ended.
    running : list of FrozenTrial
        Those that run and whose designs are known.
    before : int
        How many that run have smaller numbers.
    """
    # at once: one that ends between two readings would be in neither
    trials = study.get_trials(deepcopy=False)
    requested = set(names)
    running = [t for t in trials if t.state == TrialState.RUNNING and t.number != trial.number]
    known = [t for t in running if requested <= set(t.params)]
    return (
        [t for t in trials if t.state.is_finished()],
        known,
        sum(t.number < trial.number for t in running),
    )
