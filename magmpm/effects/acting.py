"""Effects: one file each. What a scene does not name is not simulated and costs nothing.

To add an effect: one file with its dtype, its hooks (effects.hooks says which there are), its `PHASE` and its `of_scene`; and one line,
its key in `parts.Effects`, by which it is found. CONTRIBUTING.md has a worked example.
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magmpm.compiled.arrays import Array
from magmpm.scene import Scene
from magmpm.scene.options import Effects

PHASES = ("force", "damping", "contact", "constraint")  # the order in which hooks of a kind are called


def module_of(name: str) -> ModuleType:
    """The file of the effect with this key."""
    return import_module(f"{__package__}.{name}")


def every() -> dict[str, ModuleType]:
    """All effects there are, by key, in the order of their phases; within a phase in the order of their keys in `parts.Effects`."""
    return dict(_modules(tuple(Effects.model_fields)))


@cache
def _modules(names: tuple[str, ...]) -> dict[str, ModuleType]:
    modules = {name: module_of(name) for name in names}
    return dict(sorted(modules.items(), key=lambda item: PHASES.index(item[1].PHASE)))


def collect(
    scene: Scene, strength: float = 1.0, times: NDArray[np.float64] | None = None
) -> tuple[NDArray[Any], ...]:
    """Parameter records and data, in turn, of the effects the scene names, by phase, never by their order in the file.

    strength scales every load, 0 to 1: a solve that ramps the load from zero asks for the steps between. times (k,) s: of the steps to
    come, where fields change in time; None for statics. An effect at zero strength is left out: the kernels without it give the same
    numbers bit for bit, those that add its zeros need not (sums are reassociated).
    """
    named: list[NDArray[Any]] = []
    for key, module in every().items():
        if getattr(scene.effects, key) is not None:
            named += module.of_scene(scene, strength, times)
    return tuple(named)


def check(model: Any) -> None:
    """Raises InputError where an effect the model's scene names can't begin: a body that starts inside a wall, say."""
    for key, module in every().items():
        if getattr(model.scene.effects, key) is not None and hasattr(module, "check"):
            named = module.of_scene(model.scene, 1.0, None)
            if named:
                module.check(*named, model)


def warnings(scene: Scene) -> list[str]:
    """What the effects a scene names have to say of it: ground that is too far away to be touched, say."""
    named = [module for key, module in every().items() if getattr(scene.effects, key) is not None]
    return [text for module in named if hasattr(module, "warnings") for text in module.warnings(scene)]


def marked(scene: Scene, particles: Any, magnet: Array) -> Array:
    """Remanence (n, 3) T of bodies.Particles, with one more column where an effect tells particles apart (magnetic_interaction)."""
    for key, module in every().items():
        if getattr(scene.effects, key) is not None and hasattr(module, "marks"):
            return np.column_stack([magnet, module.marks(scene, particles, magnet)])
    return magnet


def refresh(named: tuple[NDArray[Any], ...], body: Any, x: Array, F: Array) -> None:
    """Bring tables that depend on the body's shape up to date, in place. body: a Model; x (n, 3) m, F (n, 3, 3) of its particles."""
    for module, data in _refreshed(named):
        module.refresh(data, *_particles(body), x, F)


def shared_energy(named: tuple[NDArray[Any], ...], body: Any, x: Array, F: Array) -> float:
    """Energy of effects in which every particle feels all others, J; their energy hooks count loads that stand still instead."""
    return sum(module.shared_energy(*_particles(body), x, F) for module, _ in _refreshed(named))


def _refreshed(named: tuple[NDArray[Any], ...]) -> list[tuple[ModuleType, Array]]:
    """Effects whose table depends on the body's shape, and the table."""
    modules = [module for module in every().values() if hasattr(module, "refresh")]
    pairs = zip(named[::2], named[1::2], strict=True)
    return [(module, data) for record, data in pairs for module in modules if record.dtype == module.DTYPE]


def _particles(body: Any) -> tuple[Array, NDArray[np.int32], Array, Array]:
    """Mark, segment, volume m^3 and remanence T of a model's particles."""
    return body.magnet[:, -1], body.particles.segment, body.particles.volume, body.magnet[:, :3]


def feels_itself(scene: Scene) -> bool:
    """Whether an effect depends on the shape of the whole body, so that equilibrium takes several solves."""
    return any(
        getattr(scene.effects, key) is not None and hasattr(module, "refresh") and module.of_scene(scene, 1.0, None)
        for key, module in every().items()
    )
