"""Cost that each effect adds to a scene, from counted operations: the same on a busy machine as on an idle one.

The hooks of an effect (effects.hooks) are run once in Python, on numbers that count what is done with them, for some of the scene's own
particles: so a wall is counted where the body is near it, and a magnet's field with all its terms. What an operation takes compared with a
whole step of a particle without effects is measured once, for hooks that serve eight particles at a time, for those that are called for
each, and for nodes: tests/benchmarks/advice.py `costs` does it again, by short runs in pairs.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from functools import cache
from types import FunctionType, SimpleNamespace
from typing import Any

import numpy as np
from numba.core.dispatcher import Dispatcher
from numba.core.extending import _Intrinsic

from magmpm.compiled.arrays import Array
from magmpm.effects import hooks
from magmpm.effects.acting import Effects
from magmpm.effects.base import BodyEffect, Effect, Records
from magmpm.effects.contact_force import KEPT, PARTS, RIGIDITY, rubbed, touches
from magmpm.effects.hooks import pairs
from magmpm.errors import MagmpmError
from magmpm.inputs.settings import validate
from magmpm.model import Model, build
from magmpm.rod.cantilever import without_motion
from magmpm.scene import Scene

# Per cent of a step of a particle without effects. Measured by tests/benchmarks/advice.py costs.
# of an operation for eight, for one, of going through eight, of a node's; of contact
WIDE = 0.27
NARROW = 0.5
LANES = 80.0
NODE = 0.6
CLEAR = 2.4  # of the surface, while nothing may touch
# Of an equilibrium: operations in a solve with one particle's share of it, and passes over the particles in one.
SOLVE = 60_000.0
PASSES = 10
SQUARE_ROOT = 6  # operations


class Counted:
    """A number that counts the operations on it, and on what comes of it."""

    done = 0

    def __init__(self, value: float) -> None:
        self.value = value

    def _with(self, value: Any, operations: int = 1) -> Counted:
        Counted.done += operations
        return Counted(value)

    def __float__(self) -> float:
        return float(self.value)

    def __int__(self) -> int:
        return int(self.value)

    __index__ = __trunc__ = __int__

    def sqrt(self) -> Counted:
        """Its root."""
        return self._with(math.sqrt(self.value), SQUARE_ROOT)

    def __neg__(self) -> Counted:
        return self._with(-self.value, 0)

    def __abs__(self) -> Counted:
        return self._with(abs(self.value), 0)

    def __hash__(self) -> int:
        return hash(self.value)


def _operators() -> None:
    """Arithmetic and comparisons of Counted, with numbers on either side."""
    for name in ("add", "sub", "mul", "truediv", "pow"):
        plain = getattr(operator, name)
        cost = {"truediv": 4, "pow": 2}.get(name, 1)
        setattr(
            Counted,
            f"__{name}__",
            lambda a, b, f=plain, n=cost: a._with(f(a.value, getattr(b, "value", b)), n),
        )
        setattr(
            Counted,
            f"__r{name}__",
            lambda a, b, f=plain, n=cost: a._with(f(getattr(b, "value", b), a.value), n),
        )
    for name in ("lt", "le", "gt", "ge", "eq", "ne"):
        plain = getattr(operator, name)
        setattr(Counted, f"__{name}__", lambda a, b, f=plain: f(a.value, getattr(b, "value", b)))


_operators()


class _Math:
    """The functions of `math` on Counted numbers."""

    def __getattr__(self, name: str) -> Callable[..., Any]:
        def call(*given: Any) -> Any:
            if name == "sqrt" and isinstance(given[0], Counted):
                return given[0].sqrt()
            found = getattr(math, name)(*(float(one) for one in given))
            return (
                given[0]._with(found, 2 * SQUARE_ROOT) if isinstance(given[0], Counted) else found
            )

        return call


# What eight numbers at a time are made of: an operation on all of them counts as one.
_LANES: dict[str, Callable[..., Any]] = {
    "splat": lambda value: Counted(0.0),
    "load": lambda array, index: Counted(0.0),
    "halves": lambda low, high: Counted(0.0),
    "folded": lambda value: tuple(value._with(0.0) for _ in range(3)),
}


@cache
def plain(function: Any) -> Callable[..., Any]:
    """A compiled function, with all that it calls, as it is written in Python."""
    source = function.py_func if isinstance(function, Dispatcher) else function
    space = dict(source.__globals__)
    for name in source.__code__.co_names:
        if isinstance(space.get(name), Dispatcher):
            space[name] = plain(space[name])
        elif isinstance(space.get(name), _Intrinsic):
            space[name] = _LANES[name]
    if space.get("math") is math:
        space["math"] = _Math()
    return FunctionType(
        source.__code__, space, source.__name__, source.__defaults__, source.__closure__
    )


def _numbers(values: Any) -> Any:
    """An array of Counted."""
    flat = np.empty(np.size(values), object)
    flat[:] = [Counted(float(value)) for value in np.ravel(values)]
    return flat.reshape(np.shape(values))


def _record(records: Any) -> SimpleNamespace:
    """A record's fields by their names."""
    return SimpleNamespace(**{name: records[0][name] for name in records.dtype.names})


def operations(records: Any, data: Array, hook: str, *arguments: Any) -> int:
    """Operations of one call of an effect's hook; 0 if it has none."""
    function = hooks.hook_of(hook, records)
    if function is None:
        return 0
    Counted.done = 0
    plain(function)(_record(records), data, *arguments)
    if hook == "contact":
        if not arguments[-1][RIGIDITY].value > 0.0:
            return 0  # it is left out until it may touch
        kept = _numbers(np.zeros(KEPT))  # the friction that goes with it
        plain(touches)(arguments[-1], kept, 0)
        plain(rubbed)(kept, 0, _numbers(np.full(3, 1e-3)), 1.0)
    return Counted.done


def counted(scene: Scene) -> dict[str, float]:
    """Per cent that each effect by itself adds to the cost of a scene: of a motion's steps, or of an equilibrium's solve.

    At the settings that the scene has, or else at its key's example. An effect that takes no part in it is left out.
    """
    model = _modeled(without_motion(scene))
    found = {}
    for key, kind in Effects.every().items():
        try:
            records = _records(scene, key)
        except MagmpmError:
            continue
        if not records:
            continue
        found[key] = (
            _step(model, records)
            if scene.solver.dynamic is not None
            else _solve(model, records, kind)
        )
    return found


def _modeled(scene: Scene) -> Model:
    """The scene's model, with its segments in blocks that act on each other where they can be."""
    try:
        return build(scene.with_effects(magnetic_interaction={}))
    except MagmpmError:  # too many blocks, say: a scene that names none may have them
        return build(scene)


def _records(scene: Scene, key: str) -> Records:
    """Parameters that kernels would take of one effect."""
    named = getattr(scene.effects, key)
    if named is None:
        named = getattr(
            validate(Effects, {key: (Effects.model_fields[key].examples or [{}])[0]}, "example"),
            key,
        )
    alone = scene.model_copy(update={"effects": Effects(**{key: named})})
    return tuple(named.records(alone, 1.0, np.zeros(1)))


def _sampled(model: Model) -> Any:
    return np.linspace(0, len(model.density) - 1, min(16, len(model.density))).astype(int)


def _step(model: Model, named: Records) -> float:
    """Per cent of a motion's step: hooks on particles, and on nodes."""
    # of having any effect
    chosen = _sampled(model)
    total = 1.5
    nodes = float(np.prod([cells + 2 for cells in model.grid.cells])) / len(model.density)
    for records, data in pairs(named):
        names = records.dtype.names
        called = False
        for hook in ("stress", "force", "rate_stress", "contact", "node"):
            if hooks.hook_of(hook, records) is None:
                continue
            each = [operations(records, data, hook, *_given(model, p, hook)) for p in chosen]
            mean = sum(each) / len(chosen)
            if hook == "node":
                total += NODE * mean * nodes
            elif hook == "contact":
                # of points of the surface, as many as one layer of a cell's particles; 117 operations find where one is that may touch
                touching = sum(count > 0 for count in each) / len(chosen)
                each_cell = model.scene.resolution.particles_per_cell
                total += CLEAR + NARROW * (mean + 117 * touching) / each_cell
            elif hooks.is_wide(names):
                total += WIDE * mean
            else:
                total += NARROW * mean
                called = called or bool(each)
        total += LANES if called else 0.0
    return total


def _given(model: Model, p: int, hook: str) -> tuple[Any, ...]:
    """Arguments of a hook for a particle at rest."""
    x = _numbers(model.particles.position[p])
    F = _numbers(np.eye(3))
    magnet = _numbers(model.remanence[p])
    rho = Counted(float(model.density[p]))
    if hook in ("stress", "force"):
        return magnet, rho, x, F, _numbers(np.zeros((3, 3) if hook == "stress" else 3))
    if hook == "rate_stress":
        return rho, F, _numbers(np.zeros((3, 3))), _numbers(np.zeros((3, 3)))
    if hook == "node":
        return x, _numbers(np.zeros(3)), _numbers(np.zeros(3)), True, 1e-5
    if hook == "contact":
        return x, Counted(1e-9), _numbers(np.zeros(PARTS))
    if hook == "energy":
        return magnet, rho, x, F
    raise ValueError(f"no arguments for {hook}")


def _solve(model: Model, named: Records, kind: type[Effect]) -> float:
    """Per cent of an equilibrium's solve; of an effect between all particles, with the steps that it adds."""
    chosen = _sampled(model)
    total = 0.0
    for records, data in pairs(named):
        for hook in ("energy", "stress", "force"):
            each = [operations(records, data, hook, *_given(model, p, hook)) for p in chosen]
            total += 100 * PASSES * sum(each) / len(chosen) / SOLVE
    if issubclass(kind, BodyEffect):
        blocks = float(model.remanence[:, -1].max() + 1) if model.remanence.shape[1] > 3 else 0.0
        # 30 gradients more (statics.interacting), of 60 operations for each pair of blocks
        total += 100 * 30 * (60 * blocks**2 / len(model.density) + SOLVE / 60) / SOLVE
    return total
