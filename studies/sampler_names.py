"""The samplers a study may name. What makes them is in samplers.py."""

from __future__ import annotations

import difflib
from typing import Any

from magmpm.errors import InputError, NotThereYet, report
from magmpm.inputs.settings import fault

SAMPLERS = ("tpe", "gp", "cmaes", "random")
LATER_SAMPLERS = {  # names of the contract that nothing stands behind yet
    "gauss-newton": "search along the sensitivities of the shape",
    "nsga2": "evolution toward two objectives",
}
OPTUNA = "optuna:"  # optuna:NAME is a sampler of Optuna by name
OPTUNA_SAMPLERS: dict[str, str] = {}  # NAME -> class of optuna.samplers; a file never names a class itself


def known_names() -> tuple[str, ...]:
    """Every name that a study may give."""
    return (*SAMPLERS, *(OPTUNA + name for name in OPTUNA_SAMPLERS))


def known_sampler(value: Any) -> Any:
    """Validates the key `sampler`. Raises PydanticCustomError (see `fault`)."""
    names = known_names()
    if not isinstance(value, str) or value not in (*names, *LATER_SAMPLERS):
        near = difflib.get_close_matches(str(value).lower(), names, n=1, cutoff=0.5)
        remedy = f'did you mean "{near[0]}"?' if near else "write, say, `sampler: tpe`"
        raise fault(f"must be {', '.join(names[:-1])} or {names[-1]}", remedy)
    return value


def check_sampler_name(name: str, place: str) -> None:
    """Raises NotThereYet for samplers of a later version, InputError for unknown names."""
    known = f"samplers: {', '.join(known_names())}"
    if name in LATER_SAMPLERS:
        rule = f"`{name}` ({LATER_SAMPLERS[name]}) is not there yet in this version; {known}"
        raise NotThereYet(report(place, received=f'"{name}"', rule=rule, remedy="sampler: tpe"))
    if name not in known_names():
        raise InputError(report(place, received=f'"{name}"', rule=known, remedy="sampler: tpe"))
