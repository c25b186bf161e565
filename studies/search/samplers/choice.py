"""Choice of the next trial, made so that a study can be interrupted anywhere and still be the same study.

A sampler is created anew for every trial, seeded by the study's seed and the number of finished trials. It reads earlier trials from the
storage, so nothing depends on which process ran which trial.
"""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from magmpm.compiled.arrays import Plain
from magmpm.errors import InputError, require
from magmpm.scene.variables import variables
from magmpm.studies.problem.sampler_names import (
    HEED_NO_CONSTRAINTS,
    ONE_OBJECTIVE,
    PREFIX,
    TAKE_CHOICES,
    check_sampler_name,
)
from magmpm.studies.search.search_space import SearchSpace

if TYPE_CHECKING:
    from optuna.samplers import BaseSampler

    from magmpm.studies.problem.study import Study
    from magmpm.studies.search.samplers.bounded_front import Foretells

POOR = (
    0.04  # of the length: a rod's design whose body is farther from the target is on another branch
)
ALIKE_ON_FRONT = (
    0.01  # of the length: designs of a front that are nearer are about as good as each other
)
MOST_WORKERS = 256  # processes of one session
POPULATION = 20  # of the genetic samplers; Optuna's 50 would be more trials than most studies have

# of samplers that are Optuna's own, besides the seed
_GENETIC: Plain = {"population_size": POPULATION}
_OPTIONS = {
    "NSGAIISampler": _GENETIC,
    "NSGAIIISampler": _GENETIC,
    "GPSampler": {"deterministic_objective": True},
}
# package, and the extra of magmpm that brings it
_TORCH = ("torch", "gp")
_CMAES = ("cmaes", "design")
_EXTRAS = {"cmaes": _CMAES, "optuna:GPSampler": _TORCH, "optuna:CmaEsSampler": _CMAES}


def check_available(name: str) -> None:
    """Refuse a sampler that needs a package that is not installed, before any trial has run.

    Parameters
    ----------
    name : str
        Of the sampler.

    Raises
    ------
    MissingPackage
        Names the package, and what to install.
    """
    if name in _EXTRAS:
        package, extra = _EXTRAS[name]
        require(
            package,
            extra,
            key="sampler",
            use=f"studies by {name}",
            instead="write sampler: tpe",
        )


def check_suits(study: Study) -> None:
    """Refuse a study, as the command line has changed it, that requests what its sampler can't do.

    Parameters
    ----------
    study : Study
        The study.

    Raises
    ------
    InputError
        Says what, and which sampler can.
    """
    if (found := _unsuited(study)) is not None:
        rule, remedy = found
        raise InputError(f"{study.path}: sampler", received=study.sampler, rule=rule, remedy=remedy)
    if len(study.minimize) > 1 and study.robust is not None:
        raise InputError(
            f"{study.path}: minimize",
            received=str(list(study.minimize)),
            rule="`robust` judges a design by one objective",
            remedy="remove `robust` or `minimize`",
        )


def _unsuited(study: Study) -> tuple[str, str] | None:
    """Rule and remedy where a study requests what its sampler can't do."""
    name = study.sampler
    if name == "gauss-newton" and not study.scene.static:
        rule = "gauss-newton differentiates equilibria, and the scene is a motion"
        return rule, "sampler: tpe, or leave `dynamic` out of the scene's solver"
    space = SearchSpace.of(study)
    if name == "gauss-newton" and study.vary.numbers and space.sensitivities:
        try:
            variables(space.scene_at(space.middle), space.sensitivities)
        except InputError as error:
            at, rule, *_ = str(error).splitlines()
            said = f"{at.partition(': ')[2]}: {rule.strip().removeprefix('rule: ')}"
            return f"gauss-newton needs derivatives, and {said}", "sampler: tpe"
    if study.margin is not None and name in HEED_NO_CONSTRAINTS:
        rule = f"{name} would learn from designs that `stability` refuses as from others"
        return rule, "sampler: tpe or gauss-newton, or remove `stability`"
    if len(study.minimize) > 1 and name in ONE_OBJECTIVE and not within_bounds(study):
        rule = (
            f"{name} looks for the least of one objective, and `minimize` names"
            f" {len(study.minimize)}"
        )
        return rule, "sampler: nsga2, or remove `minimize`"
    if space.choices and name not in TAKE_CHOICES:
        what = (
            "an order of segments"
            if space.order
            else f"among values of {next(iter(space.choices))}"
        )
        return f"{name} can't choose {what}", f"sampler: {TAKE_CHOICES[0]}"
    return None


def within_bounds(study: Study) -> bool:
    """Tell whether a study's objectives are the distance and a bound, and its sampler goes through a ladder of bounds.

    Parameters
    ----------
    study : Study
        The study.

    Returns
    -------
    bool
        True if so.
    """
    return study.sampler == "gauss-newton" and study.minimize[1:] == ("largest_field",)


def best_suited(study: Study) -> Study:
    """Give a study the sampler that suits what it requests: gauss-newton, or tpe where there is no derivative.

    Parameters
    ----------
    study : Study
        The study.

    Returns
    -------
    Study
        The study with the sampler, and the reason.
    """
    newton = study.changed(sampler="gauss-newton")
    found = _unsuited(newton)
    if found is None:
        why = "the file names none, and the shape has derivatives by all that varies"
        if within_bounds(newton):
            why += "; within each of a ladder of bounds of the field, the rms alone is minimized"
        return dataclasses.replace(newton, why_sampler=why)
    return dataclasses.replace(
        study.changed(sampler="tpe"), why_sampler=f"the file names none, and {found[0]}"
    )


def check_workers(workers: int | None, time_limit: float | None = None) -> None:
    """Refuse a number of workers, or a time limit of their solves, that can't be.

    Parameters
    ----------
    workers : int or None
        Their number, or None.
    time_limit : float, s, optional
        The limit.

    Raises
    ------
    InputError
        For numbers that can't be.
    """
    if workers is not None and not 1 <= workers <= MOST_WORKERS:
        raise InputError(
            "--workers",
            received=str(workers),
            rule=f"must be from 1 to {MOST_WORKERS}",
            remedy="--workers 2, or as many as there are cores",
        )
    if time_limit is None:
        return
    if workers is None:
        raise InputError(
            "--time-limit",
            received=f"{time_limit:g}",
            rule="ends worker processes; without --workers there is none",
            remedy="--workers 1 as well",
        )
    if not 0.0 < time_limit < math.inf:
        raise InputError(
            "--time-limit",
            received=f"{time_limit:g}",
            rule="must be a number of seconds above 0",
            remedy="--time-limit 600",
        )


def settings(name: str) -> Plain:
    """Find a sampler's settings. They belong to the study's definition, because other settings give other trials.

    Parameters
    ----------
    name : str
        Of the sampler.

    Returns
    -------
    dict[str, Any]
        Its settings by name.
    """
    if name == "tpe":
        from magmpm.studies.search.samplers.tpe import TpeSettings

        return dataclasses.asdict(TpeSettings())
    if name in ("nsga2", "optuna:NSGAIISampler", "optuna:NSGAIIISampler"):
        return {"population": POPULATION}
    if name == "gp":
        from magmpm.studies.search.samplers import gp

        return dataclasses.asdict(gp.GpSettings())
    return {}


def whole_definition(study: Study, parameters: Iterable[str]) -> Plain:
    """Collect all that decides which trials are made: the study's definition, with its parameters and its sampler's settings.

    Parameters
    ----------
    study : Study
        The study.
    parameters : iterable of str
        Their names.

    Returns
    -------
    dict[str, Any]
        Plain data.
    """
    return {
        **study.definition(),
        "search": {"parameters": list(parameters), **settings(study.sampler)},
    }


def make_sampler(
    name: str,
    space: SearchSpace,
    seed: int,
    finished: int,
    *,
    starts: Sequence[Mapping[str, float]] = (),
    goal: float = 0.0,
    front: bool = False,
    model: Foretells | None = None,
) -> BaseSampler:
    """Make the sampler that chooses the trial after a number of finished trials.

    Parameters
    ----------
    name : str
        Of the sampler.
    space : SearchSpace
        The search space.
    seed : int
        Of the study.
    finished : int
        How many trials are finished.
    starts : sequence of Mapping[str, float], default ()
        Designs that gauss-newton begins from.
    goal : float, m, default 0.0
        The value that gauss-newton need not go below.
    front : bool, default False
        Whether its trials are to spread over a ladder of bounds of the field
        (bounded_front.BoundedFront).
    model : Foretells, optional
        Makes the designs with which each of these bounds begins, and foretells steps.

    Returns
    -------
    BaseSampler
        The sampler.

    Raises
    ------
    InputError
        For an unknown name.
    """
    check_sampler_name(name, "sampler")
    number = int(
        np.random.SeedSequence([seed, finished]).generate_state(1)[0]
    )  # a seed of 32 bits for one trial
    with warnings.catch_warnings():
        # Optuna calls samplers experimental, or announces changes of defaults, on every construction
        warnings.simplefilter("ignore")
        if name == "gauss-newton" and front:
            from magmpm.studies.search.samplers.bounded_front import BoundedFront

            length = space.scene.length
            near = goal or ALIKE_ON_FRONT * length
            poor = POOR * length
            return BoundedFront(
                space.blocks, seed, starts=starts, near=near, poor=poor, far=length, model=model
            )
        if name == "gauss-newton":
            from magmpm.studies.search.samplers.gauss_newton import GaussNewtonSampler

            return GaussNewtonSampler(
                space.blocks, seed, starts=starts, goal=goal, poor=POOR * space.scene.length
            )
        if name == "tpe":
            from magmpm.studies.search.samplers.tpe import DirectionTPE

            return DirectionTPE(space, seed, finished)
        if name == "gp":
            from magmpm.studies.search.samplers.gp import ShapeSampler

            return ShapeSampler(space, seed, finished)
        from magmpm.studies.search.samplers import optuna_own

        if name in ("cmaes", "optuna:CmaEsSampler"):
            return optuna_own.DataOnlyCmaEsSampler(seed=number, warn_independent_sampling=False)
        if name == "optuna:QMCSampler":
            return optuna_own.SobolSampler(space, seed, finished)
        import optuna

        kind = {"nsga2": "NSGAIISampler", "random": "RandomSampler"}.get(
            name, name.removeprefix(PREFIX)
        )
        found: BaseSampler = getattr(optuna.samplers, kind)(seed=number, **_OPTIONS.get(kind, {}))
        return found
