"""Scenes of the hard cases, in SI."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from magmpm.fields.dipole import MU0
from magmpm.materials import young_modulus
from magmpm.scene import Scene

G, RATIO, DENSITY, REMANENCE = 120e3, 20.0, 1882.0, 0.1  # Pa, K/G, kg/m^3, T
LENGTH, DIAMETER = 40e-3, 4e-3  # m
X = (1.0, 0.0, 0.0)


def rod(
    *,
    length: float = LENGTH,
    directions: Sequence[Sequence[float]] = (X,),
    shear: Sequence[float] | None = None,
    ratio: float = RATIO,
    field: Sequence[float] | None = None,
    cells: int = 2,
    clamp: str = "base",
    effects: Mapping[str, Any] | None = None,
    dynamic: Mapping[str, Any] | None = None,
) -> Scene:
    """A catheter 4 mm thick of equal segments with these magnetizations. field (3,) T; shear: Pa, one a segment."""
    moduli = [G] * len(directions) if shear is None else list(shear)
    kinds = {
        f"material {k}": {"shear_modulus": g, "bulk_to_shear": ratio, "density": DENSITY, "remanence": REMANENCE}
        for k, g in enumerate(moduli)
    }
    segments = [{"magnetization": list(d), "material": name} for d, name in zip(directions, kinds, strict=True)]
    catheter = {"length": length, "diameter": DIAMETER, "material": "material 0", "clamp": clamp, "segments": segments}
    return Scene.from_si(
        {
            "name": "hard case",
            "materials": kinds,
            "body": {"catheter": catheter},
            "field": {"uniform": [0.0, 0.0, 0.0] if field is None else [float(b) for b in field]},
            "effects": {**({} if field is None else {"magnetic_torque": {}}), **(effects or {})},
            "solver": {"static": {}} if dynamic is None else {"dynamic": {"duration": 1.0, **dynamic}},
            "resolution": {"cells_across": cells},
        }
    )


def bending_field(load: float, angle: float = np.pi / 2, length: float = LENGTH) -> list[float]:
    """Field (3,) T at an angle to +x in the x-z plane, for a load M B A L^2/(E I) on a rod magnetized along its axis.

    Source: Wang et al., JMPS 142 (2020) 104045; A/I = 16/D^2.
    """
    E = young_modulus(G, RATIO * G)
    size = load * E * MU0 * DIAMETER**2 / (16 * REMANENCE * length**2)
    return [float(size * np.cos(angle)), 0.0, float(size * np.sin(angle))]


def twisting_field(load: float) -> list[float]:
    """Field (3,) T along z, for a load M B A L^2/(G J) on a rod magnetized along y; A/J = 8/D^2."""
    return [0.0, 0.0, load * G * MU0 * DIAMETER**2 / (8 * REMANENCE * LENGTH**2)]


def opening_strip() -> Scene:
    """The strip of `folding_strip`, thinner and in plane strain, folded in 50 ms, held for 200 ms and let open."""
    data = folding_strip().to_si()
    data["materials"]["silicone"]["shear_modulus"] = 30e3
    data["body"]["strip"] |= {"length": 12e-3, "thickness": 0.5e-3, "plane_strain": True}
    for segment, along in zip(data["body"]["strip"]["segments"], (-1.0, 1.0), strict=True):
        segment["magnetization"] = [along, 0.0, -0.36]
    frames = [{"time": t, "strength": s} for t, s in ((0.0, 0.0), (0.05, 1.0), (0.25, 1.0), (0.29, 0.0))]
    data["field"] = {"uniform": [0.0, 0.0, 20e-3], "over_time": {"keyframes": frames}}
    data["effects"]["damping"] = {"rate": 100.0}
    data["solver"]["dynamic"] = {"duration": 0.45, "output_every": 0.05}
    return Scene.from_si(data)


def folding_strip() -> Scene:
    """A free strip of two halves magnetized against each other, folded by three times the field that this takes."""
    silicone = {"shear_modulus": G, "bulk_to_shear": RATIO, "density": DENSITY, "remanence": REMANENCE}
    halves = [{"magnetization": [1.0, 0.0, 0.0]}, {"magnetization": [-1.0, 0.0, 0.0]}]
    strip = {"length": 20e-3, "width": 2e-3, "thickness": 1e-3, "material": "silicone", "clamp": "none", "segments": halves}
    return Scene.from_si(
        {
            "name": "hard case",
            "materials": {"silicone": silicone},
            "body": {"strip": strip},
            "field": {"uniform": [0.0, 0.0, 150e-3]},
            "effects": {"magnetic_torque": {}, "self_contact": {}, "damping": {"rate": 60.0}},
            "solver": {"dynamic": {"duration": 0.03}},
            "resolution": {"cells_across": 2},
        }
    )
