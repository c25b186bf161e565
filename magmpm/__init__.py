"""magmpm: simulation and computational design of magnetic soft robots with the material point method.

result = magmpm.run("scene.yaml")              # or a Scene: magmpm.load_scene("scene.yaml").with_field("8 mT")
print(result, result.tip)                      # everything in SI; names in __all__ are loaded when they are first used
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from magmpm.compiled import environment

if TYPE_CHECKING:
    from magmpm.compare import error
    from magmpm.errors import (
        BudgetError,
        InputError,
        MagmpmError,
        NotThereYet,
        SceneError,
        SolveError,
    )
    from magmpm.results.notices import MagmpmWarning
    from magmpm.results.result import Result
    from magmpm.results.trajectory import Motion
    from magmpm.scene import Scene, load_scene
    from magmpm.simulate import run, sensitivities
    from magmpm.studies.in_python import design, fit, influence, sweep

__version__ = "0.1.0"
__all__ = [
    "BudgetError",
    "InputError",
    "MagmpmError",
    "MagmpmWarning",
    "Motion",
    "NotThereYet",
    "Result",
    "Scene",
    "SceneError",
    "SolveError",
    "design",
    "error",
    "fit",
    "influence",
    "load_scene",
    "run",
    "sensitivities",
    "sweep",
]
_HOMES = {
    "Motion": "results.trajectory",
    "Result": "results.result",
    "run": "simulate",
    "sensitivities": "simulate",
    "Scene": "scene",
}
_HOMES |= {"MagmpmWarning": "results.notices"}
_HOMES |= {
    "error": "compare",
    "load_scene": "scene",
    **dict.fromkeys(("design", "fit", "influence", "sweep"), "studies.in_python"),
}
environment.prepare()  # before anything imports Numba


def __getattr__(name: str) -> Any:
    """A name of the public face, from the module that defines it. Raises AttributeError."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES.get(name, 'errors')}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
