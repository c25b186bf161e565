"""The names by which a study file and `--sampler` ask for a sampler, and what is said about names that are none.

Samplers of Optuna are requested as `optuna:NAME`. The names are written out here, with what each of them needs; nothing that a file says is
ever imported.
"""

from __future__ import annotations

import difflib
from typing import Any

from magmpm.errors import InputError
from magmpm.inputs.settings import fault

SAMPLERS = ("tpe", "gp", "cmaes", "nsga2", "random", "gauss-newton")

PREFIX = "optuna:"
OPTUNA = (
    "TPESampler",
    "RandomSampler",
    "CmaEsSampler",
    "GPSampler",
    "QMCSampler",
    "NSGAIISampler",
    "NSGAIIISampler",
)
SENSELESS = {  # Optuna's other samplers, and why a study can't use them
    "BruteForceSampler": "tries every value, and angles and lengths are continuous",
    "GridSampler": "needs a grid of values, which a study file has no place for",
    "PartialFixedSampler": (
        "holds parameters at values; a study does that by what `vary` leaves out"
    ),
    "BaseGASampler": "is not a sampler, but what genetic ones derive from",
    "BaseSampler": "is not a sampler, but what samplers derive from",
}
NAMES = (*SAMPLERS, *(PREFIX + name for name in OPTUNA))

ONE_OBJECTIVE = frozenset(
    {"gp", "cmaes", "gauss-newton", "optuna:CmaEsSampler"}
)  # samplers that can't weigh two objectives
HEED_NO_CONSTRAINTS = frozenset(
    {"cmaes", "optuna:CmaEsSampler"}
)  # samplers that learn from refused designs as from others
# samplers that also choose among things without an order or a distance
TAKE_CHOICES = (
    "tpe",
    "random",
    "nsga2",
    "optuna:TPESampler",
    "optuna:RandomSampler",
    "optuna:NSGAIISampler",
    "optuna:NSGAIIISampler",
)


def wrong_name(name: Any) -> tuple[str, str] | None:
    """Find what is wrong with the name of a sampler.

    Parameters
    ----------
    name : object
        What a file or a command says.

    Returns
    -------
    tuple[str, str] or None
        Rule and remedy; None for the name of a sampler.
    """
    if isinstance(name, str) and name in NAMES:
        return None
    if isinstance(name, str) and name.lower().startswith(PREFIX):
        return _wrong_optuna(name[len(PREFIX) :])
    if name in OPTUNA:
        return (
            f"samplers of Optuna are named with `{PREFIX}` before them",
            f'write "{PREFIX}{name}"',
        )
    near = difflib.get_close_matches(str(name).lower(), SAMPLERS, n=1, cutoff=0.5)
    rule = f"must be {', '.join(SAMPLERS)}, or {PREFIX}NAME for a sampler of Optuna"
    return rule, f'did you mean "{near[0]}"?' if near else "write, say, `sampler: tpe`"


def _wrong_optuna(requested: str) -> tuple[str, str]:
    """Rule and remedy for a NAME of `optuna:NAME` that is not on the list."""
    small = requested.strip().lower().replace("-", "").replace("_", "")
    for name, why in SENSELESS.items():
        if small in (name.lower(), name.lower().removesuffix("sampler")) and small:
            return f"Optuna's {name} {why}", f"write, say, `sampler: {PREFIX}QMCSampler`"
    short = {name.lower().removesuffix("sampler"): name for name in OPTUNA} | {
        "nsga2": "NSGAIISampler",
        "nsga3": "NSGAIIISampler",
    }
    near = difflib.get_close_matches(small.removesuffix("sampler"), short, n=1, cutoff=0.5)
    rule = f"NAME of {PREFIX}NAME must be {', '.join(OPTUNA[:-1])} or {OPTUNA[-1]}"
    return (
        rule,
        (
            f'did you mean "{PREFIX}{short[near[0]]}"?'
            if near
            else f"write, say, `sampler: {PREFIX}TPESampler`"
        ),
    )


def known_sampler(value: Any) -> Any:
    """Check the name of a sampler, as a validator of study files.

    Parameters
    ----------
    value : object
        What the file says.

    Returns
    -------
    object
        The same name.

    Raises
    ------
    ValueError
        For a name that is no sampler's, with rule and remedy (see `fault`).
    """
    found = wrong_name(value)
    if found is not None:
        raise fault(*found)
    return value


def check_sampler_name(name: str, place: str) -> None:
    """Refuse unknown names of samplers.

    Parameters
    ----------
    name : str
        What is said.
    place : str
        Where it is said.

    Raises
    ------
    InputError
        For a name that is no sampler's.
    """
    found = wrong_name(name)
    if found is not None:
        raise InputError(place, received=f'"{name}"', rule=found[0], remedy=found[1])
