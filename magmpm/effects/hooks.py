"""Hooks of effects: what an effect does to particles, to points of the surface and to nodes, as compiled functions.

An effect's parameters are an array of records with a dtype of its own (one record, or one for every time step to come), followed by its
`data`: a table of floats, empty (NO_DATA) for most. What acts is one flat tuple (records, data, records, data, ...). Its effects are told
apart by the field names of their dtypes, for which each has registered its hooks. Kernels get their addresses (effects.calls), so they are
compiled once, for whatever acts; a hook is compiled once, when an effect that has it acts for the first time; what is absent is not called.

Hooks, per unit of undeformed volume unless said. `effect` is the record of the step, `data` (k,) the table; magnet (3,) is the particle's
remanence Br in the undeformed body (T; with a fourth number where an effect marks particles, acting.marked), rho its density (kg/m^3),
x (3,) its deformed position (m), F (3, 3) its deformation gradient:

``energy(effect, data, magnet, rho, x, F) -> float``            potential energy W, J/m^3
``stress(effect, data, magnet, rho, x, F, P)``                  adds dW/dF to P (3, 3), Pa
``force(effect, data, magnet, rho, x, F, f)``                   adds -dW/dx to f (3,), N/m^3
``tangent(effect, data, magnet, rho, x, F, A)``                 adds d^2W/dF^2 to A (9, 9), Pa; row 3 i + J
``softening(effect, data, magnet, rho, x, F, H, M)``            adds d^2W/dx^2 to H (3, 3) and d^2W/dx dF to M (3, 9), for effects with a
                                                                force that varies with place or with F
``stress_change(effect, data, magnet, rho, dmagnet, drho, x, F, P)``  adds the change of its stress with a change of the particle's
                                                                remanence and density, to first order, to P (3, 3), Pa
``force_change(effect, data, magnet, rho, dmagnet, drho, x, F, f)``  the same of its force, to f (3,), N/m^3
                                                                (sensitivities; these two are only needed where stress or force is not
                                                                linear in magnet, or in rho)
``touch(effect, data, x, mass, f, H) -> float``                 energy (J) of a point of the surface at equilibrium, for obstacles; adds its
                                                                force to f (3,), N, and its second derivative to H (3, 3), N/m
In motion only:
``rate_stress(effect, data, rho, F, dF, P)``                    adds the stress of a deformation rate dF = dF/dt (1/s) to P (3, 3), Pa
``relax(effect, data, dt, F, C, P)``                            lets what the material remembers, C (6 k,), follow F for dt, and adds its
                                                                stress to P (3, 3), Pa; for eight particles at a time
``contact(effect, data, x, mass, f) -> float``                  depth (m) of a point of the surface of mass (kg) in an obstacle. Above 0,
                                                                its push is added to f[:3], N, with friction and stiffness
                                                                (effects.contact_force; x and f only indexed), for eight points at a time:
                                                                plain arithmetic, and what compiled.simd has for both. Else
                                                                minus a distance (m) within which nothing is pushed, -inf if that is
                                                                unknown: contact is left out until a point may have moved that far
``drag(effect, data, law, x, n, v, f)``                          adds the force of a fluid on a piece of the surface to f (3,), N: law, its
                                                                numbers (effects.fluid); n (3,) its direction in the present shape, v (3,)
                                                                its velocity, m/s
``node(effect, data, X, u, v, free, dt)``                       changes a grid node's velocity v (3,) m/s; X its place, u displacement
                                                                (only indexed); free: whether forces move it
``push(effect, data, dt) -> float``                             seconds for which forces push in a step of dt, over dt: more than 1 where
                                                                `node` takes from their push what is lost while they act
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from magmpm.compiled.arrays import Plain

HOOKS = (
    "energy",
    "stress",
    "force",
    "tangent",
    "softening",
    "stress_change",
    "force_change",
    "touch",
    "rate_stress",
    "relax",
    "contact",
    "drag",
    "node",
    "push",
)
NO_DATA = np.zeros(0)
_registry: dict[str, dict[tuple[str, ...], Callable[..., Any]]] = {hook: {} for hook in HOOKS}
_dtypes: dict[tuple[str, ...], np.dtype[Any]] = {}
_wide: set[tuple[str, ...]] = set()


def register(dtype: np.dtype[Any], *, wide: bool = False, **hooks: Callable[..., Any]) -> None:
    """Register the compiled functions of the effect whose parameters have this dtype.

    wide: its hooks stress, force and rate_stress are plain arithmetic (+ - * /, no branch on a particle's values, no array of their own):
    motion calls them for eight particles at a time (magmpm.compiled.simd_views), which costs a fraction. The results are the same.
    Raises ValueError on an unknown hook, or if another effect has the same field names: they distinguish effects.
    """
    if dtype.names is None or any(dtype.names in table for table in _registry.values()):
        raise ValueError(f"an effect's dtype needs field names of its own, got {dtype}")
    for name in hooks:
        if name not in HOOKS:
            raise ValueError(f"unknown hook {name!r}; hooks are {', '.join(HOOKS)}")
    if wide:
        _wide.add(dtype.names)
    _dtypes[dtype.names] = dtype
    for name, function in hooks.items():
        _registry[name][dtype.names] = function


def hook_of(hook: str, records: Any) -> Callable[..., Any] | None:
    """The compiled function that the effect with these records has registered for a hook."""
    return _registry[hook].get(records.dtype.names)


def hooks_of(names: tuple[str, ...], hooks: Sequence[str]) -> Plain:
    """Those of some hooks that the effect whose records have these fields has registered."""
    return {hook: _registry[hook][names] for hook in hooks if names in _registry[hook]}


def module_of(names: tuple[str, ...], hooks: Sequence[str]) -> str | None:
    """The module of those hooks, None if there are none."""
    found = list(hooks_of(names, hooks).values())
    return str(found[0].py_func.__module__) if found else None


def dtype_of(names: tuple[str, ...]) -> np.dtype[Any]:
    """The dtype of the records of the effect whose records have these fields."""
    return _dtypes[names]


def is_wide(names: tuple[str, ...]) -> bool:
    """True if the hooks of particles of the effect whose records have these fields serve eight particles at a time."""
    return names in _wide


def has_hook(hook: str, named: tuple[Any, ...]) -> bool:
    """True if any effect of a tuple (records, data, ...) has this hook."""
    return any(hook_of(hook, records) is not None for records, _ in pairs(named))


def pairs(named: tuple[Any, ...]) -> list[tuple[Any, Any]]:
    """The records and the table of each effect of a tuple (records, data, records, data, ...)."""
    return list(zip(named[::2], named[1::2], strict=True))


def each_record(change: Callable[[Any], Any], named: tuple[Any, ...]) -> tuple[Any, ...]:
    """The tuple with every effect's records changed, and its tables as they are."""
    return tuple(part for records, data in pairs(named) for part in (change(records), data))
