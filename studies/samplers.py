"""How the next trial is chosen, so that a study can be interrupted anywhere and still be the same study.

A sampler is made afresh for every trial, seeded by the study's seed and the number of finished trials; what it
knows of earlier trials it reads from the storage. So nothing depends on which process ran which trial.
"""

from __future__ import annotations

import importlib.util
import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from magmpm.errors import InputError

if TYPE_CHECKING:
    from optuna.samplers import BaseSampler

# Part of a study's definition: another setting gives other trials. Measured: docs/design.md, "Choosing trials".
STARTUP = 5  # random trials before a model of the objective is asked
TPE_CANDIDATES = 128  # points drawn from TPE's good density, of which the best ratio wins
SETTINGS: dict[str, dict[str, Any]] = {
    "tpe": {"startup": STARTUP, "candidates": TPE_CANDIDATES},
    "gp": {"startup": STARTUP},
    "cmaes": {"startup": 1},
    "random": {},
}

_EXTRAS = {"gp": ("torch", "gp"), "cmaes": ("cmaes", "cmaes")}


def check_available(name: str) -> None:
    """Raises InputError when a sampler needs a package that is not installed, before any trial has run."""
    module, extra = _EXTRAS.get(name, (None, None))
    if module is not None and importlib.util.find_spec(module) is None:
        raise InputError(
            f"sampler: received {name}\n  rule: the sampler {name} needs the package {module}, which is not installed\n"
            f"  remedy: pip install 'magmpm[{extra}]', or sampler: tpe"
        )


def make_sampler(name: str, seed: int, finished: int) -> BaseSampler:
    """The sampler that chooses the trial after `finished` trials. Raises InputError for an unknown name."""
    if name not in _MAKERS:
        raise InputError(
            f"sampler: received {name}\n  rule: must be one of {', '.join(_MAKERS)}\n  remedy: tpe"
        )
    number = int(np.random.SeedSequence([seed, finished]).generate_state(1)[0])
    with warnings.catch_warnings():
        # Optuna calls samplers experimental, or announces changes of defaults, on every construction
        warnings.simplefilter("ignore")
        return _MAKERS[name](number)


def _tpe(seed: int) -> BaseSampler:
    from optuna.samplers import TPESampler

    # constant_liar is for trials that run at the same time; here there is one at a time
    return TPESampler(
        seed=seed, n_startup_trials=STARTUP, n_ei_candidates=TPE_CANDIDATES, constant_liar=False
    )


def _gp(seed: int) -> BaseSampler:
    from optuna.samplers import GPSampler

    return GPSampler(seed=seed, n_startup_trials=STARTUP, deterministic_objective=True)


def _cmaes(seed: int) -> BaseSampler:
    from optuna.samplers import CmaEsSampler

    return CmaEsSampler(seed=seed, warn_independent_sampling=False)


def _random(seed: int) -> BaseSampler:
    from optuna.samplers import RandomSampler

    return RandomSampler(seed=seed)


_MAKERS: dict[str, Callable[[int], BaseSampler]] = {
    "tpe": _tpe,
    "gp": _gp,
    "cmaes": _cmaes,
    "random": _random,
}
