"""How kernels call effects: a tuple of parameter records, and hooks found by the record's dtype while compiling.

An effect's parameters are a one-element structured array with a dtype of its own. A kernel takes a tuple of them and calls the
functions of this file once per particle; each walks the tuple at compile time and calls the hook that the effect registered,
or nothing. So an empty tuple compiles to the bare loop, a hook an effect lacks costs nothing, a new combination of effects compiles
once and then loads from the disk cache, and new values never recompile.

Hooks, all per unit of undeformed volume; magnet (3,) is the particle's remanence Br in the undeformed body (T), rho its density (kg/m^3),
u its displacement (m), F its deformation gradient:

``energy(effect, magnet, rho, u, F) -> float``        potential energy, J/m^3
``stress(effect, magnet, rho, u, F, P)``              adds dW/dF to P (3, 3), Pa
``tangent(effect, magnet, rho, u, F, A)``             adds d^2W/dF^2 to A (9, 9), Pa
``force(effect, magnet, rho, u, F, f)``               adds -dW/du to f (3,), N/m^3
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba.extending import overload

from magmpm.jit import FASTMATH

HOOKS = ("energy", "stress", "tangent", "force")
_registry: dict[str, dict[tuple[str, ...], Callable[..., Any]]] = {hook: {} for hook in HOOKS}


def register(dtype: np.dtype[Any], **hooks: Callable[..., Any]) -> None:
    """Tell the kernels which compiled functions serve the effect whose parameters have this dtype.

    Raises ValueError on an unknown hook, or if another effect has the same field names: they are what tells effects apart.
    """
    if dtype.names is None or any(dtype.names in table for table in _registry.values()):
        raise ValueError(f"an effect's dtype needs field names of its own, got {dtype}")
    for name in hooks:
        if name not in HOOKS:
            raise ValueError(f"unknown hook {name!r}; hooks are {', '.join(HOOKS)}")
    for name, function in hooks.items():
        _registry[name][dtype.names] = function


def _find(hook: str, effects: Any) -> Callable[..., Any] | None:
    return _registry[hook].get(tuple(effects[0].dtype.fields))


def add_energy(effects, magnet, rho, u, F):  # type: ignore[no-untyped-def]
    """Sum of the effects' potential energies, J/m^3. Only within compiled code."""


def add_stress(effects, magnet, rho, u, F, P):  # type: ignore[no-untyped-def]
    """Adds every effect's stress to P. Only within compiled code."""


def add_tangent(effects, magnet, rho, u, F, A):  # type: ignore[no-untyped-def]
    """Adds every effect's tangent to A. Only within compiled code."""


def add_force(effects, magnet, rho, u, F, f):  # type: ignore[no-untyped-def]
    """Adds every effect's force per volume to f. Only within compiled code."""


@overload(add_energy, jit_options={"fastmath": FASTMATH}, strict=False)
def _add_energy(effects, magnet, rho, u, F):  # type: ignore[no-untyped-def]
    if len(effects) == 0:
        return lambda effects, magnet, rho, u, F: 0.0
    hook = _find("energy", effects)
    if hook is None:
        return lambda effects, magnet, rho, u, F: add_energy(effects[1:], magnet, rho, u, F)
    return lambda effects, magnet, rho, u, F: (
        hook(effects[0][0], magnet, rho, u, F) + add_energy(effects[1:], magnet, rho, u, F)
    )


def _adding(stub: Callable[..., Any], name: str) -> None:
    """Overload a stub whose hook adds to its last argument."""

    def build(effects, magnet, rho, u, F, out):  # type: ignore[no-untyped-def]
        if len(effects) == 0:
            return lambda effects, magnet, rho, u, F, out: None
        hook = _find(name, effects)
        if hook is None:
            return lambda effects, magnet, rho, u, F, out: stub(effects[1:], magnet, rho, u, F, out)

        def both(effects, magnet, rho, u, F, out):  # type: ignore[no-untyped-def]
            hook(effects[0][0], magnet, rho, u, F, out)
            stub(effects[1:], magnet, rho, u, F, out)

        return both

    overload(stub, jit_options={"fastmath": FASTMATH}, strict=False)(build)


_adding(add_stress, "stress")
_adding(add_tangent, "tangent")
_adding(add_force, "force")
