"""Scenes for tests, built from a few SI values."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from magmpm.fields.dipole import MU0
from magmpm.materials import young_modulus
from magmpm.scene import Scene

X = (1.0, 0.0, 0.0)
# Pa, T
G = 120e3
BR = 0.1


def rod_scene(
    *,
    length: float = 40e-3,
    diameter: float = 4e-3,
    inner_diameter: float = 0.0,
    directions: Sequence[Sequence[float]] = (X,),
    lengths: Sequence[float] | None = None,
    shear: float | Sequence[float] = G,
    bulk_to_shear: float = 20.0,
    density: float = 1882.0,
    remanence: float = BR,
    law: str | Sequence[str] = "stretches",
    field: Sequence[float] | None = None,
    gravity: Sequence[float] | None = None,
    cells: int = 2,
    particles: int = 2,
    anti_locking: str = "f-bar",
    **static: Any,
) -> Scene:
    """A clamped catheter. shear: one value, or one per segment; field (3,) T, gravity (3,) m/s^2: None omits the effect."""
    moduli = np.broadcast_to(np.asarray(shear, dtype=float), (len(directions),)).tolist()
    segments: list[dict[str, Any]] = [
        {"magnetization": list(map(float, d)), "material": f"m{k}"}
        for k, d in enumerate(directions)
    ]
    for segment, part in zip(
        segments, [None] * len(segments) if lengths is None else lengths, strict=True
    ):
        if part is not None:
            segment["length"] = float(part)
    usual = {"bulk_to_shear": bulk_to_shear, "density": density, "remanence": remanence}
    laws = [law] * len(moduli) if isinstance(law, str) else law
    materials = {
        f"m{k}": {"shear_modulus": g, "magnetization_law": laws[k], **usual}
        for k, g in enumerate(moduli)
    }
    sizes = {"length": length, "diameter": diameter, "inner_diameter": inner_diameter}
    effects: dict[str, Any] = {}
    if field is not None:
        effects["magnetic_torque"] = {}
    if gravity is not None:
        effects["gravity"] = {"acceleration": list(map(float, gravity))}
    return Scene.from_si(
        {
            "name": "test",
            "materials": materials,
            "body": {
                "catheter": {**sizes, "material": "m0", "clamp": "base", "segments": segments}
            },
            "field": {"uniform": [0.0, 0.0, 0.0] if field is None else list(map(float, field))},
            "effects": effects,
            "solver": {"anti_locking": anti_locking, "static": static},
            "resolution": {"cells_across": cells, "particles_per_cell": particles},
        }
    )


def field_for_load(
    load: float, angle: float, *, length: float, diameter: float, bulk_to_shear: float = 20.0
) -> np.ndarray:
    """Field (3,) T at `angle` to +x, in the x-z plane, that gives an axially magnetized solid rod this elastica load.

    load = (Br/mu0) B A L^2 / (E I), A / I = 16 / D^2."""
    E = young_modulus(G, bulk_to_shear * G)
    size = load * E * MU0 * diameter**2 / (16 * BR * length**2)
    return size * np.array([np.cos(angle), 0.0, np.sin(angle)])
