"""Calls from kernels to effects: a tuple of parameter records, and hooks found by the record's dtype while compiling.

An effect's parameters are an array of records with a dtype of its own (one record, or one for every time step to come), followed by its
`data`: a table of floats, empty (NO_DATA) for most. A kernel takes one flat tuple (records, data, records, data, ...) and calls the
functions of this file once per particle or node. Each goes through the tuple at compile time and calls the hook that the effect
registered, or nothing. So an empty tuple compiles to the bare loop, a missing hook costs nothing, a new combination of effects compiles
once and then loads from the disk cache, and new values never recompile.

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
``contact(effect, data, x, v, mass, dt, f)``                    adds the force on a point of the surface of mass (kg), velocity v (m/s;
                                                                0 while friction holds it), to f[:3], N; an obstacle with friction, what
                                                                f[3:7] hold (effects.contact_force; x, v and f only indexed: kernels pass
                                                                views)
``near(effect, data, x) -> float``                              above 0 where `contact` can push what is at x; else minus a distance (m)
                                                                within which nothing is pushed, -inf if that is unknown: contact is left
                                                                out until a point may have moved that far
``node(effect, data, X, u, v, dt)``                             changes a grid node's velocity v (3,) m/s; X its place, u displacement
                                                                (only indexed)
``push(effect, data, dt) -> float``                             seconds for which forces push in a step of dt, over dt: more than 1 where
                                                                `node` takes from their push what is lost while they act
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numba.extending import overload

from magmpm.compiled.jit import FASTMATH

HOOKS = ("energy", "stress", "force", "tangent", "softening", "stress_change", "force_change", "touch", "rate_stress", "relax", "contact",
         "near", "node", "push")  # fmt: skip
WIDE = ("stress", "force", "rate_stress")
NO_DATA = np.zeros(0)
_registry: dict[str, dict[tuple[str, ...], Callable[..., Any]]] = {hook: {} for hook in HOOKS}
_wide: dict[str, set[tuple[str, ...]]] = {hook: set() for hook in HOOKS}  # hooks that serve eight particles at a time


def register(dtype: np.dtype[Any], *, wide: Sequence[str] = (), **hooks: Callable[..., Any]) -> None:
    """Register the compiled functions of the effect whose parameters have this dtype.

    wide: those of its hooks stress, force and rate_stress that are plain arithmetic (+ - * /, no branch on a particle's values, no
    array of their own): motion calls them for eight particles at a time (magmpm.compiled.simd_views), which costs a fraction.
    The results are the same.
    Raises ValueError on an unknown hook, or if another effect has the same field names: they distinguish effects.
    """
    if dtype.names is None or any(dtype.names in table for table in _registry.values()):
        raise ValueError(f"an effect's dtype needs field names of its own, got {dtype}")
    for name in hooks:
        if name not in HOOKS:
            raise ValueError(f"unknown hook {name!r}; hooks are {', '.join(HOOKS)}")
    for name in wide:
        if name not in hooks or name not in WIDE:
            raise ValueError(f"wide: {name!r} must be one of the effect's hooks stress, force or rate_stress")
        _wide[name].add(dtype.names)
    for name, function in hooks.items():
        _registry[name][dtype.names] = function


def has_hook(hook: str, named: tuple[Any, ...]) -> bool:
    """True if any effect of a tuple (records, data, ...) has this hook."""
    return any(records.dtype.names in _registry[hook] for records, _ in pairs(named))


def pairs(named: tuple[Any, ...]) -> list[tuple[Any, Any]]:
    """The records and the table of each effect of a tuple (records, data, records, data, ...)."""
    return list(zip(named[::2], named[1::2], strict=True))


def each_record(change: Callable[[Any], Any], named: tuple[Any, ...]) -> tuple[Any, ...]:
    """The tuple with every effect's records changed, and its tables as they are."""
    return tuple(part for records, data in pairs(named) for part in (change(records), data))


def _find(hook: str, effects: Any, wide: bool | None = None) -> Callable[..., Any] | None:
    """The hook of the first of a tuple's effects; wide True or False: only if it serves eight particles at a time, or does not."""
    names = tuple(effects[0].dtype.fields)
    if wide is not None and (names in _wide[hook]) != wide:
        return None
    return _registry[hook].get(names)


def any_softening(effects):
    """True if any effect has a softening: known while compiling, so that the code for it is left out. Only within compiled code."""


@overload(any_softening, jit_options={"fastmath": FASTMATH})
def _any_softening(effects):
    if len(effects) == 0:
        return lambda effects: False
    if _find("softening", effects) is not None:
        return lambda effects: True
    return lambda effects: any_softening(effects[2:])


def add_energy(effects, step, magnet, rho, x, F):
    """Sum of the effects' potential energies, J/m^3. Only within compiled code; step: which of an effect's records counts."""


def add_stress(effects, step, magnet, rho, x, F, P):
    """Adds every effect's stress to P. Only within compiled code."""


def add_force(effects, step, magnet, rho, x, F, f):
    """Adds every effect's force per volume to f. Only within compiled code."""


def add_tangent(effects, step, magnet, rho, x, F, A):
    """Adds every effect's tangent to A. Only within compiled code."""


def add_softening(effects, step, magnet, rho, x, F, H, M):
    """Adds every effect's derivatives with respect to place to H and M. Only within compiled code."""


def add_rate_stress(effects, step, rho, F, dF, P):
    """Adds every effect's stress of the rate dF to P. Only within compiled code."""


def add_relaxing(effects, step, dt, F, C, P):
    """Lets every effect's memory C follow F, and adds its stress to P. Only within compiled code."""


def add_contact(effects, step, x, v, mass, dt, f):
    """Adds every effect's contact force on a point to f (effects.contact_force). Only within compiled code."""


def change_node(effects, step, X, u, v, dt):
    """Lets every effect change a node's velocity v. Only within compiled code."""


@overload(add_energy, jit_options={"fastmath": FASTMATH}, strict=False)
def _add_energy(effects, step, magnet, rho, x, F):
    if len(effects) == 0:
        return lambda effects, step, magnet, rho, x, F: 0.0
    hook = _find("energy", effects)
    if hook is None:
        return lambda effects, step, magnet, rho, x, F: add_energy(effects[2:], step, magnet, rho, x, F)
    return lambda effects, step, magnet, rho, x, F: (
        hook(effects[0][min(step, len(effects[0]) - 1)], effects[1], magnet, rho, x, F)
        + add_energy(effects[2:], step, magnet, rho, x, F)
    )


# Each stub below is overloaded by the same three cases: nothing left, an effect without the hook, an effect with it. Numba wants the
# arguments spelled out, so the cases are made from a text, once for each stub.
_CASES = """
def build(effects, step, {arguments}):
    if len(effects) == 0:
        return lambda effects, step, {arguments}: None
    hook = find(name, effects, wide)
    if hook is None:
        return lambda effects, step, {arguments}: stub(effects[2:], step, {arguments})
    def both(effects, step, {arguments}):
        hook(effects[0][min(step, len(effects[0]) - 1)], effects[1], {arguments})
        stub(effects[2:], step, {arguments})
    return both
"""


def _walk(stub: Callable[..., Any], name: str, arguments: str, wide: bool | None = None) -> None:
    """Overload a stub whose hook writes into its arguments; wide: as in _find."""
    space: dict[str, Any] = {"find": _find, "name": name, "stub": stub, "wide": wide}
    exec(_CASES.format(arguments=arguments), space)
    overload(stub, jit_options={"fastmath": FASTMATH}, strict=False)(space["build"])


_walk(add_stress, "stress", "magnet, rho, x, F, P")
_walk(add_force, "force", "magnet, rho, x, F, f")
_walk(add_tangent, "tangent", "magnet, rho, x, F, A")
_walk(add_softening, "softening", "magnet, rho, x, F, H, M")
_walk(add_rate_stress, "rate_stress", "rho, F, dF, P")
_walk(add_relaxing, "relax", "dt, F, C, P")
_walk(add_contact, "contact", "x, v, mass, dt, f")
_walk(change_node, "node", "X, u, v, dt")


def add_stress_change(effects, step, magnet, rho, dmagnet, drho, x, F, P):
    """Adds the change of every effect's stress with remanence and density to P. Only within compiled code."""


def add_force_change(effects, step, magnet, rho, dmagnet, drho, x, F, f):
    """Adds the change of every effect's force with remanence and density to f. Only within compiled code."""


def _walk_change(stub: Callable[..., Any], name: str) -> None:
    """Overload a stub by the hook `name`_change, or for an effect without it by the difference of the hook `name`, exact if linear."""

    def build(effects, step, magnet, rho, dmagnet, drho, x, F, out):
        if len(effects) == 0:
            return lambda effects, step, magnet, rho, dmagnet, drho, x, F, out: None
        own, plain = _find(f"{name}_change", effects), _find(name, effects)
        if own is not None:

            def exact(effects, step, magnet, rho, dmagnet, drho, x, F, out):
                own(effects[0][min(step, len(effects[0]) - 1)], effects[1], magnet, rho, dmagnet, drho, x, F, out)
                stub(effects[2:], step, magnet, rho, dmagnet, drho, x, F, out)

            return exact
        if plain is None:
            return lambda effects, step, magnet, rho, dmagnet, drho, x, F, out: stub(
                effects[2:], step, magnet, rho, dmagnet, drho, x, F, out
            )

        def difference(effects, step, magnet, rho, dmagnet, drho, x, F, out):
            record = effects[0][min(step, len(effects[0]) - 1)]
            before, changed = np.zeros(out.shape), np.empty(len(magnet))
            for i in range(len(magnet)):
                changed[i] = magnet[i] + dmagnet[i]
            plain(record, effects[1], magnet, rho, x, F, before)
            plain(record, effects[1], changed, rho + drho, x, F, out)
            flat, less = out.reshape(-1), before.reshape(-1)
            for i in range(len(flat)):
                flat[i] -= less[i]
            stub(effects[2:], step, magnet, rho, dmagnet, drho, x, F, out)

        return difference

    overload(stub, jit_options={"fastmath": FASTMATH}, strict=False)(build)


_walk_change(add_stress_change, "stress")
_walk_change(add_force_change, "force")


def deepest(effects, step, x):
    """The largest `near` of the effects' contacts at x, m: infinite where one acts everywhere. Only within compiled code."""


@overload(deepest, jit_options={"fastmath": FASTMATH}, strict=False)
def _deepest(effects, step, x):
    if len(effects) == 0:
        return lambda effects, step, x: -np.inf
    hook = _find("near", effects)
    if _find("contact", effects) is None:
        return lambda effects, step, x: deepest(effects[2:], step, x)
    if hook is None:
        return lambda effects, step, x: np.inf
    return lambda effects, step, x: max(hook(effects[0][min(step, len(effects[0]) - 1)], effects[1], x), deepest(effects[2:], step, x))


def add_touch(effects, x, mass, f, H):
    """Sum of the obstacles' energies (J) at a point of the surface; adds their force to f and its slope to H. Only within compiled code."""


@overload(add_touch, jit_options={"fastmath": FASTMATH}, strict=False)
def _add_touch(effects, x, mass, f, H):
    if len(effects) == 0:
        return lambda effects, x, mass, f, H: 0.0
    hook = _find("touch", effects)
    if hook is None:
        return lambda effects, x, mass, f, H: add_touch(effects[2:], x, mass, f, H)
    return lambda effects, x, mass, f, H: hook(effects[0][0], effects[1], x, mass, f, H) + add_touch(effects[2:], x, mass, f, H)


def push_time(effects, step, dt):
    """Seconds for which forces push in a step of dt (s). Only within compiled code."""


@overload(push_time, jit_options={"fastmath": FASTMATH}, strict=False)
def _push_time(effects, step, dt):
    if len(effects) == 0:
        return lambda effects, step, dt: dt
    hook = _find("push", effects)
    if hook is None:
        return lambda effects, step, dt: push_time(effects[2:], step, dt)
    return lambda effects, step, dt: (hook(effects[0][min(step, len(effects[0]) - 1)], effects[1], dt) * push_time(effects[2:], step, dt))


# Eight particles at a time (kernels.particle_group): first the effects whose hooks are wide, called once, then the others, lane by lane.


def add_wide_stress(effects, step, magnet, rho, x, F, P):
    """add_stress of the wide hooks, on views of eight particles. Only within compiled code."""


def add_wide_force(effects, step, magnet, rho, x, F, f):
    """add_force of the wide hooks, on views of eight particles. Only within compiled code."""


def add_wide_rate_stress(effects, step, rho, F, dF, P):
    """add_rate_stress of the wide hooks, on views of eight particles. Only within compiled code."""


def add_narrow_stress(effects, step, magnet, rho, x, F, P):
    """add_stress of the other hooks. Only within compiled code."""


def add_narrow_force(effects, step, magnet, rho, x, F, f):
    """add_force of the other hooks. Only within compiled code."""


def add_narrow_rate_stress(effects, step, rho, F, dF, P):
    """add_rate_stress of the other hooks. Only within compiled code."""


_walk(add_wide_stress, "stress", "magnet, rho, x, F, P", wide=True)
_walk(add_wide_force, "force", "magnet, rho, x, F, f", wide=True)
_walk(add_wide_rate_stress, "rate_stress", "rho, F, dF, P", wide=True)
_walk(add_narrow_stress, "stress", "magnet, rho, x, F, P", wide=False)
_walk(add_narrow_force, "force", "magnet, rho, x, F, f", wide=False)
_walk(add_narrow_rate_stress, "rate_stress", "rho, F, dF, P", wide=False)


# Whether any effect has a hook, known while compiling: a kernel gathers velocities, say, only where an effect requests them.


def has_stress(effects):
    """True if any effect adds stress. Only within compiled code."""


def has_force(effects):
    """True if any effect adds a force. Only within compiled code."""


def has_rate_stress(effects):
    """True if any effect adds a stress of the rate of deformation. Only within compiled code."""


def has_relaxing(effects):
    """True if any effect has a memory. Only within compiled code."""


def has_contact(effects):
    """True if any effect adds a contact force. Only within compiled code."""


def has_node(effects):
    """True if any effect changes nodes. Only within compiled code."""


def has_narrow(effects):
    """True if any effect's stress or force has to be called lane by lane. Only within compiled code."""


def _answer(stub: Callable[..., Any], names: Sequence[str], wide: bool | None = None) -> None:
    def build(effects):
        rest = [effects[i:] for i in range(0, len(effects), 2)]
        if any(_find(name, part, wide) is not None for name in names for part in rest):
            return lambda effects: True
        return lambda effects: False

    overload(stub, strict=False)(build)


_answer(has_stress, ["stress"])
_answer(has_force, ["force"])
_answer(has_rate_stress, ["rate_stress"])
_answer(has_relaxing, ["relax"])
_answer(has_contact, ["contact"])
_answer(has_node, ["node"])
_answer(has_narrow, ["stress", "force", "rate_stress"], wide=False)
