"""Scenes drawn at random for tests/benchmarks/promised_error.py: catheters, tubes and strips, none of which set any constant."""

from __future__ import annotations

from typing import Any

import numpy as np

from magmpm.fields.dipole import MU0
from magmpm.materials import young_modulus
from magmpm.scene import Scene

REMANENCE, DENSITY = 0.12, 1900.0  # T, kg/m^3
STRONGEST = 5.0  # M B A L^2/(E I): at 5 a catheter across the field points along it


def drawn(seed: int) -> Scene:
    """The scene of a seed: L/D 3 to 80, K/G 5 to 500, one to six segments, a uniform field or that of a magnet, with or without gravity."""
    draw = np.random.default_rng([20260, seed])

    def between(low: float, high: float) -> float:
        return float(np.exp(draw.uniform(np.log(low), np.log(high))))

    kind = ("catheter", "tube", "strip")[int(draw.integers(3))]
    thickness, slenderness, ratio, shear = between(0.5e-3, 4e-3), between(3, 80), between(5, 500), between(50e3, 1e6)
    length, wide, bore = slenderness * thickness, between(1, 6), float(draw.uniform(0.2, 0.8))
    width = min(wide, max(slenderness / 2, 1.0)) * thickness
    second = thickness**4 / 12 * (width / thickness) if kind == "strip" else np.pi / 64 * thickness**4 * (1 - bore**4 * (kind == "tube"))
    area = width * thickness if kind == "strip" else np.pi / 4 * thickness**2 * (1 - bore**2 * (kind == "tube"))
    bending = young_modulus(shear, ratio * shear) * second
    load = between(0.1, STRONGEST)
    field = _direction(draw) * load * bending * MU0 / (REMANENCE * area * length**2)
    materials = {"magnetic": {"shear_modulus": shear, "bulk_to_shear": ratio, "density": DENSITY, "remanence": REMANENCE}}
    segments: list[dict[str, Any]] = [{"magnetization": _direction(draw).tolist()} for _ in range(int(draw.integers(1, 7)))]
    if len(segments) > 2 and draw.random() < 0.25:  # one stiffer, plain
        materials["plain"] = {**materials["magnetic"], "shear_modulus": shear * between(1, 5), "remanence": 0.0}
        segments[int(draw.integers(len(segments)))] = {"magnetization": [0.0, 0.0, 0.0], "material": "plain"}
    segments = [{**segment, "length": length / len(segments)} for segment in segments]
    effects: dict[str, Any] = {"magnetic_torque": {}}
    if draw.random() < 0.4:  # weight that bends as much as a field could, at most
        pull = between(0.1, STRONGEST) * bending / (DENSITY * area * length**3)
        effects["gravity"] = {"acceleration": (min(pull, 9.81) * _direction(draw)).tolist()}
    body: dict[str, Any] = {"length": length, "material": "magnetic", "segments": segments}
    if kind == "strip":
        body |= {"width": width, "thickness": thickness}
    else:
        body |= {"diameter": thickness, "inner_diameter": bore * thickness if kind == "tube" else 0.0}
    content = {
        "name": f"drawn {seed} ({kind})",
        "materials": materials,
        "body": {"strip" if kind == "strip" else "catheter": body},
        "field": {"uniform": field.tolist()},
        "effects": effects,
    }
    return Scene.from_si(content)


def _direction(draw: np.random.Generator) -> Any:
    """A direction, all alike likely: (3,)."""
    found = draw.normal(size=3)
    return found / np.linalg.norm(found)
