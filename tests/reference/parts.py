"""Scenes of several STL parts, for tests of bodies that touch."""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from reference.moving import moving_scene

from magmpm.bodies.surface_mesh import Mesh, write_stl
from magmpm.dynamics.total_lagrangian import TotalMotion
from magmpm.model import Model
from magmpm.scene import Scene


def parts_scene(
    folder: Path,
    meshes: Mapping[str, Mesh],
    effects: dict[str, Any],
    cell: float,
    *,
    held: Collection[str] = (),
    **more: Any,
) -> Scene:
    """A motion of parts with these meshes (m) and cell (m); more: of moving_scene."""
    parts = []
    for name, mesh in meshes.items():
        write_stl(mesh, folder / f"{name}.stl")
        parts.append(
            {
                "mesh": str(folder / f"{name}.stl"),
                "name": name,
                "material": "m",
                "clamp": name in held,
            }
        )
    return moving_scene({"parts": {"unit": "m", "spacing": cell, "meshes": parts}}, effects, **more)


def throw_part(motion: TotalMotion, component: int, velocity: Sequence[float]) -> None:
    """Give all nodes of a component this velocity (m/s)."""
    model = motion.model
    nodes = int(np.prod(model.grid.nodes))
    on = slice(component * nodes, (component + 1) * nodes)
    free = motion.packed.nodes.inverse_mass.reshape(-1, 3)[on] > 0
    motion.v.reshape(-1, 3)[on] = np.array(velocity) * free


def momenta(motion: TotalMotion) -> np.ndarray:
    """Momentum kg m/s and angular momentum kg m^2/s of the nodes, (6,)."""
    p = motion.packed.mass.momentum(motion.v.reshape(-1, 3))
    x = motion.packed.node_place + motion.u.reshape(-1, 3)
    return np.concatenate([p.sum(axis=0), np.cross(x, p).sum(axis=0)])


def of_part(model: Model, part: int, values: np.ndarray) -> np.ndarray:
    """Mean of values (n, 3) over the mass of a part."""
    mass = model.density * model.particles.volume * (model.particles.segment == part)
    return np.asarray(mass @ values / mass.sum())
