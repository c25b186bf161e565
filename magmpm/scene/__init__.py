"""Scenes: `load_scene(path)` and the classes of which a Scene is made."""

from magmpm.bodies.body import Body
from magmpm.bodies.body_shape import Region
from magmpm.bodies.catheter import Catheter
from magmpm.bodies.segments import Segment
from magmpm.bodies.strip import Strip
from magmpm.effects.acting import Effects
from magmpm.effects.gravity import Gravity
from magmpm.effects.magnetic_torque import MagneticTorque
from magmpm.fields.sources import FieldSource
from magmpm.inputs.vectors import Angles
from magmpm.inputs.yaml_document import of_file
from magmpm.scene.options import Material, Resolution, Solver, Static
from magmpm.scene.scene import Reference, Scene, load_scene

__all__ = [
    "Angles",
    "Body",
    "Catheter",
    "Effects",
    "FieldSource",
    "Gravity",
    "MagneticTorque",
    "Material",
    "Reference",
    "Region",
    "Resolution",
    "Scene",
    "Segment",
    "Solver",
    "Static",
    "Strip",
    "load_scene",
    "of_file",
]
