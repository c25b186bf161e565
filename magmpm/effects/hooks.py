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
                                                                f[3:9] hold (effects.contact_force; x, v and f only indexed: kernels pass
                                                                views)
``near(effect, data, x) -> float``                              above 0 where `contact` can push what is at x; else minus a distance (m)
                                                                within which nothing is pushed, -inf if that is unknown: contact is left
                                                                out until a point may have moved that far
``node(effect, data, X, u, v, free, dt)``                       changes a grid node's velocity v (3,) m/s; X its place, u displacement
                                                                (only indexed); free: whether forces move it
``push(effect, data, dt) -> float``                             seconds for which forces push in a step of dt, over dt: more than 1 where
                                                                `node` takes from their push what is lost while they act
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numba.extending import register_jitable

from magmpm.compiled.jit import FASTMATH, chosen_by_types

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
    "near",
    "node",
    "push",
)
WIDE = ("stress", "force", "rate_stress")
NO_DATA = np.zeros(0)
Find = Callable[[Any], Callable[..., Any] | None]  # a hook, by the type of a tuple of effects
_registry: dict[str, dict[tuple[str, ...], Callable[..., Any]]] = {hook: {} for hook in HOOKS}
_wide: dict[str, set[tuple[str, ...]]] = {
    hook: set() for hook in HOOKS
}  # hooks that serve eight particles at a time


def register(
    dtype: np.dtype[Any], *, wide: Sequence[str] = (), **hooks: Callable[..., Any]
) -> None:
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
            raise ValueError(
                f"wide: {name!r} must be one of the effect's hooks stress, force or rate_stress"
            )
        _wide[name].add(dtype.names)
    for name, function in hooks.items():
        _registry[name][dtype.names] = function


def has_hook(hook: str, named: tuple[Any, ...]) -> bool:
    """True if any effect of a tuple (records, data, ...) has this hook."""
    return any(records.dtype.names in _registry[hook] for records, _ in pairs(named))


def those_with(hook: str, named: tuple[Any, ...]) -> tuple[Any, ...]:
    """The part of a tuple (records, data, ...) whose effects have this hook."""
    return tuple(part for pair in pairs(named) if has_hook(hook, pair) for part in pair)


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


def any_has(*names: str, wide: bool | None = None) -> Callable[[Any], bool]:
    """Function of the type of a tuple of effects: True if one of them has one of these hooks; wide: as in _find."""
    return lambda effects: any(
        _find(name, effects[i:], wide) is not None
        for name in names
        for i in range(0, len(effects), 2)
    )


def _walk(
    name: str, arguments: str, find: Find, fold: str = "{}; {}", last: str = "None"
) -> Callable[..., Any]:
    """Function for compiled code, of (effects, arguments): calls what `find` finds of each effect, in one piece of code without a loop.

    name: of no other (magmpm.compiled.jit). find: the hook of the first of a tuple's effects, or None. fold: how the value of a call and
    that of the rest make one; last: of no effect. Numba wants arguments spelled out, so the code is a text.
    """

    def code(effects):
        names = arguments.removeprefix("step, ")
        record = "[min(step, len(effects[{0}]) - 1)]" if names != arguments else "[0]"
        space = {"np": np, "__name__": __name__}
        value = last
        for i in reversed(range(0, len(effects), 2)):
            hook = find(effects[i:])
            if hook is not None:
                space[f"hook{i}"] = hook
                value = fold.format(
                    f"hook{i}(effects[{i}]{record.format(i)}, effects[{i + 1}], {names})", value
                )
        steps = value.split("; ")
        exec(
            "\n    ".join(
                [f"def {name}(effects, {arguments}):", *steps[:-1], f"return {steps[-1]}"]
            ),
            space,
        )
        return space[name]

    space: dict[str, Any] = {"code": code}
    exec(f"def build(effects, {arguments}):\n    return code(effects)", space)
    return chosen_by_types(space["build"])


def _hook(name: str, wide: bool | None = None) -> Find:
    return lambda effects: _find(name, effects, wide)


has_stress = _walk(
    "has_stress", "", _hook("stress"), "True", "False"
)  # known while compiling: what needs it is left out
has_force = _walk("has_force", "", _hook("force"), "True", "False")
has_rate_stress = _walk("has_rate_stress", "", _hook("rate_stress"), "True", "False")
has_relaxing = _walk("has_relaxing", "", _hook("relax"), "True", "False")
has_node = _walk("has_node", "", _hook("node"), "True", "False")
any_softening = _walk("any_softening", "", _hook("softening"), "True", "False")

# At one particle. step: which of an effect's records counts.
add_energy = _walk(
    "add_energy", "step, magnet, rho, x, F", _hook("energy"), "{} + ({})", "0.0"
)  # J/m^3
add_stress = _walk("add_stress", "step, magnet, rho, x, F, P", _hook("stress"))
add_force = _walk("add_force", "step, magnet, rho, x, F, f", _hook("force"))
add_tangent = _walk("add_tangent", "step, magnet, rho, x, F, A", _hook("tangent"))
add_softening = _walk("add_softening", "step, magnet, rho, x, F, H, M", _hook("softening"))

# Eight particles at a time (kernels.particle_group): first the effects whose hooks are wide, called once, then the others, lane by lane.
add_relaxing = _walk("add_relaxing", "step, dt, F, C, P", _hook("relax"))
add_wide_stress = _walk("add_wide_stress", "step, magnet, rho, x, F, P", _hook("stress", wide=True))
add_wide_force = _walk("add_wide_force", "step, magnet, rho, x, F, f", _hook("force", wide=True))
add_wide_rate_stress = _walk(
    "add_wide_rate_stress", "step, rho, F, dF, P", _hook("rate_stress", wide=True)
)
add_narrow_stress = _walk(
    "add_narrow_stress", "step, magnet, rho, x, F, P", _hook("stress", wide=False)
)
add_narrow_force = _walk(
    "add_narrow_force", "step, magnet, rho, x, F, f", _hook("force", wide=False)
)
add_narrow_rate_stress = _walk(
    "add_narrow_rate_stress", "step, rho, F, dF, P", _hook("rate_stress", wide=False)
)

# At a point of the surface, at a node, of a step.
add_contact = _walk("add_contact", "step, x, v, mass, dt, f", _hook("contact"))
add_touch = _walk("add_touch", "x, mass, f, H", _hook("touch"), "{} + ({})", "0.0")  # J
change_node = _walk("change_node", "step, X, u, v, free, dt", _hook("node"))
push_time = _walk("push_time", "step, dt", _hook("push"), "{} * ({})", "dt")  # s


def _nearest(effects: Any) -> Callable[..., Any] | None:
    """The hook `near` of an effect with contact; infinite if it has none."""
    if _find("contact", effects) is None:
        return None
    return _find("near", effects) or register_jitable(lambda effect, data, x: np.inf)


deepest = _walk("deepest", "step, x", _nearest, "max({}, {})", "-np.inf")  # the largest `near`, m


def _change(name: str) -> Find:
    """Find the hook `name`_change, or for an effect without it the difference of the hook `name`, which is exact if it is linear."""

    def find(effects: Any) -> Callable[..., Any] | None:
        own = _find(f"{name}_change", effects)
        plain = _find(name, effects)
        if own is not None or plain is None:
            return own

        def difference(effect, data, magnet, rho, dmagnet, drho, x, F, out):
            before = np.zeros(out.shape)
            changed = np.empty(len(magnet))
            for i in range(len(magnet)):
                changed[i] = magnet[i] + dmagnet[i]
            plain(effect, data, magnet, rho, x, F, before)
            plain(effect, data, changed, rho + drho, x, F, out)
            flat = out.reshape(-1)
            less = before.reshape(-1)
            for i in range(len(flat)):
                flat[i] -= less[i]

        return register_jitable(fastmath=FASTMATH)(difference)

    return find


add_stress_change = _walk(
    "add_stress_change", "step, magnet, rho, dmagnet, drho, x, F, P", _change("stress")
)
add_force_change = _walk(
    "add_force_change", "step, magnet, rho, dmagnet, drho, x, F, f", _change("force")
)
