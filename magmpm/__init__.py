"""magmpm: simulation and computational design of magnetic soft robots with the material point method.

result = magmpm.run("scene.yaml")              # or a Scene: magmpm.load_scene("scene.yaml").with_field("8 mT")
print(result, result.tip)                      # everything in SI; names in __all__ are loaded when they are first used

Scenes are also made of objects (Scene, Material, Catheter, Gravity, ...). They take text with a unit or a number in SI, are refused with
key, rule and remedy, and stand wherever a scene takes a dict.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from magmpm.compiled import environment

if TYPE_CHECKING:
    from magmpm.bodies.assembly import MeshPart, Parts
    from magmpm.bodies.catheter import Catheter, Tube
    from magmpm.bodies.segments import Segment
    from magmpm.bodies.strip import Strip
    from magmpm.effects.damping import Damping
    from magmpm.effects.feed import Feed
    from magmpm.effects.fluid import Fluid
    from magmpm.effects.gravity import Gravity
    from magmpm.effects.ground import Ground
    from magmpm.effects.magnetic_force import MagneticForce
    from magmpm.effects.magnetic_interaction import MagneticInteraction
    from magmpm.effects.magnetic_torque import MagneticTorque
    from magmpm.effects.self_contact import SelfContact
    from magmpm.effects.viscosity import Viscosity
    from magmpm.effects.walls import Walls
    from magmpm.errors import (
        BudgetError,
        InputError,
        MagmpmError,
        SceneError,
        SolveError,
    )
    from magmpm.fields.sources import (
        Coil,
        Cuboid,
        Cylinder,
        Dipole,
        FieldSource,
        Magnet,
        UniformField,
    )
    from magmpm.results.notices import MagmpmWarning
    from magmpm.results.result import Result
    from magmpm.results.trajectory import Motion
    from magmpm.runs import compare, error
    from magmpm.scene import Scene, load_scene
    from magmpm.scene.options import Dynamic, Material, QuasiStatic, Resolution, Static
    from magmpm.simulate import run, sensitivities
    from magmpm.studies.in_python import design, fit, influence, sweep

__version__ = "0.1.0"
__all__ = [
    "BudgetError",
    "Catheter",
    "Coil",
    "Cuboid",
    "Cylinder",
    "Damping",
    "Dipole",
    "Dynamic",
    "Feed",
    "FieldSource",
    "Fluid",
    "Gravity",
    "Ground",
    "InputError",
    "MagmpmError",
    "MagmpmWarning",
    "Magnet",
    "MagneticForce",
    "MagneticInteraction",
    "MagneticTorque",
    "Material",
    "MeshPart",
    "Motion",
    "Parts",
    "QuasiStatic",
    "Resolution",
    "Result",
    "Scene",
    "SceneError",
    "Segment",
    "SelfContact",
    "SolveError",
    "Static",
    "Strip",
    "Tube",
    "UniformField",
    "Viscosity",
    "Walls",
    "compare",
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
    **dict.fromkeys(("compare", "error"), "runs"),
    "load_scene": "scene",
    **dict.fromkeys(("design", "fit", "influence"), "studies.in_python"),
    "sweep": "studies.goals.sweep",
}
_HOMES |= {
    "Segment": "bodies.segments",
    "Strip": "bodies.strip",
    "Damping": "effects.damping",
    "Feed": "effects.feed",
    "Fluid": "effects.fluid",
    "Gravity": "effects.gravity",
    "Ground": "effects.ground",
    "MagneticForce": "effects.magnetic_force",
    "MagneticInteraction": "effects.magnetic_interaction",
    "MagneticTorque": "effects.magnetic_torque",
    "SelfContact": "effects.self_contact",
    "Viscosity": "effects.viscosity",
    "Walls": "effects.walls",
    **dict.fromkeys(("MeshPart", "Parts"), "bodies.assembly"),
    **dict.fromkeys(("Catheter", "Tube"), "bodies.catheter"),
    **dict.fromkeys(
        ("Coil", "Cuboid", "Cylinder", "Dipole", "FieldSource", "Magnet", "UniformField"),
        "fields.sources",
    ),
    **dict.fromkeys(
        ("Dynamic", "Material", "QuasiStatic", "Resolution", "Static"), "scene.options"
    ),
}
environment.prepare()  # before anything imports Numba


def __getattr__(name: str) -> Any:
    """A name of the public face, from the module that defines it. Raises AttributeError."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES.get(name, 'errors')}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
