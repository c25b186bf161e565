"""For every effect a scene in which it acts, for the contract suite of effects.

The usual scene is a short clamped catheter of two magnetized segments, and the effect with the settings of its first example. SCENES
adds what an effect needs to act: a field, or an obstacle that touches the body. An effect that does nothing in its scene fails the
contract, so a new effect that does not act in the usual scene gets an entry here.
"""

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from reference.solids import box

from magmpm.bodies.surface_mesh import write_stl
from magmpm.effects import acting as effects
from magmpm.effects import hooks
from magmpm.effects.acting import Effects
from magmpm.effects.base import Effect
from magmpm.inputs.settings import validate
from magmpm.model import Model, build
from magmpm.scene import Scene

KEYS = list(effects.Effects.every())
ROTATING = [
    "magnetic_torque rotates",
    "magnetic_force rotates",
]  # the same effects on magnetization that does not stretch
USUAL = """
name: acting
materials:
  m: {shear_modulus: 120 kPa, bulk_to_shear: 20, density: 1882 kg/m^3, remanence: 100 mT}
body:
  catheter:
    length: 8 mm
    diameter: 4 mm
    material: m
    clamp: base
    segments: [{magnetization: [1, 0, 0]}, {magnetization: [0.5, -0.4, 0.8]}]
solver: {dynamic: {duration: 1 ms}}
resolution: {cells_across: 2}
"""
NEAR_A_MAGNET = """
field:
  uniform: [1 mT, 0 mT, 2 mT]
  dipole: {position: [16 mm, 2 mm, 4 mm], moment: [0.3 A*m^2, 0.2 A*m^2, -0.4 A*m^2]}
"""
# What the scene of an effect adds to the usual one; {name} in it is a file of `box` that is written beside the scene.
SCENES = {
    "magnetic_torque": "field: {uniform: [2 mT, -3 mT, 5 mT]}",
    "magnetic_force": (
        NEAR_A_MAGNET + "effects: {magnetic_torque: {}, magnetic_force: {}}"
    ),  # which counts its energy
    # The body starts 2 to 12 um inside.
    "ground": (
        "effects: {ground: {point: [8 mm, 0 mm, -1.99 mm], normal: [-0.1, 0.05, 1], friction: 0.3}}"
    ),
    "walls": (
        "effects: {walls: {tube: {radius: 1.998 mm, path: [[-10 mm, 0 mm, 0 mm], [20 mm, 0 mm, 0"
        " mm]]}, friction: 0.2}}"
    ),
    # so viscous that its time step is the shorter one
    "viscosity": "effects: {viscosity: {viscosity: 50 Pa s}}",
    # a stream that bends it as much as its weight, less what it displaces
    "fluid": (
        """
effects:
  gravity: {}
  fluid: {density: 1000 kg/m^3, viscosity: 5 mPa s, velocity: [10 cm/s, -20 cm/s, 5 cm/s]}
"""
    ),
    "feed": (
        """
body: {catheter: {length: 8 mm, diameter: 4 mm, material: m, segments: [{}]}}
effects: {feed: {speed: 20 mm/s, exit: 5 mm}}
"""
    ),
    # Two blocks, a tenth of a cell apart.
    "self_contact": (
        """
body:
  parts:
    unit: mm
    spacing: 1 mm
    meshes: [{mesh: lower.stl, material: m}, {mesh: upper.stl, material: m}]
"""
    ),
}
MESHES = {
    "lower.stl": box((0, 0, -3), (4, 4, 0)),
    "upper.stl": box((0.3, 0, 0.1), (3.3, 3, 3)),
}  # mm


@dataclass(frozen=True)
class Acting:
    """An active effect: its settings; own: its record and data. model: of its scene; all: the records of all effects of the scene."""

    effect: Effect
    model: Model
    own: tuple[np.ndarray, ...]
    all: tuple[np.ndarray, ...]


def scene(key: str, settings: Mapping[str, Any] | None = None) -> Scene:
    """The scene in which an effect acts; given settings are added to those of the effect. After a blank: the law of magnetization."""
    key, _, law = key.partition(" ")
    data = yaml.safe_load(USUAL) | yaml.safe_load(SCENES.get(key, "{}"))
    data["materials"]["m"] |= {"magnetization_law": law} if law else {}
    named = data.setdefault("effects", {})
    named.setdefault(key, (Effects.model_fields[key].examples or [{}])[0])
    if settings:
        named[key] = {**named[key], **settings}
    with tempfile.TemporaryDirectory() as folder:
        for name, mesh in MESHES.items():
            write_stl(mesh, Path(folder) / name)
        return validate(Scene, data, Path(folder) / "acting.yaml")


@cache
def acting(key: str) -> Acting:
    """The active effect on the undeformed body, with an up-to-date table of the shape of the body."""
    model = build(scene(key))
    x = model.particles.position
    F = np.tile(np.eye(3), (len(model.density), 1, 1))
    effects.refresh(model.effects, model, x, F)
    effect = model.scene.effects.named()[key.partition(" ")[0]]
    of = effect.records(model.scene)
    names = of[0].dtype.names if of else None
    own = next(
        (
            (record, data)
            for record, data in hooks.pairs(model.effects)
            if record.dtype.names == names
        ),
        (),
    )
    return Acting(effect, model, own, model.effects)


def hook(named: tuple[np.ndarray, ...], name: str) -> Any:
    """One hook of an effect as a function of the arguments after its record and data; None if the effect lacks it."""
    function = hooks.hook_of(name, named[0]) if named else None
    return None if function is None else lambda *given: function(named[0][0], named[1], *given)


def having(*wanted: str) -> list[str]:
    """Keys of the effects that have at least one of these hooks."""
    return [
        key for key in (*KEYS, *ROTATING) if any(hook(acting(key).own, name) for name in wanted)
    ]


class Point:
    """One particle of an active effect, at a random place near its own and with a random strain."""

    def __init__(self, one: Acting, rng: np.random.Generator) -> None:
        model = one.model
        p = int(rng.choice(np.flatnonzero(model.remanence[:, :3].any(axis=1) & ~model.held)))
        self.magnet = model.remanence[p]
        self.rho = model.density[p]
        self.x = model.particles.position[p] + 3e-4 * rng.standard_normal(3)
        self.F = np.eye(3) + 0.2 * rng.standard_normal((3, 3))
