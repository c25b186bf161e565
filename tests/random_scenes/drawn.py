"""Scenes drawn at random from the whole schema, as files have them: valid by construction, from mild to absurd.

`drawn(seed, number)` is the content of one scene file. The same seed and number always give the same scene. Loads and materials are drawn
from ranges that grow with a severity between 0 and 1: at 0 a body that bends a little, at 1 a hundred times the load that bends it.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from magmpm.bodies.surface_mesh import pack_mesh
from magmpm.fields.dipole import MU0
from magmpm.materials import young_modulus
from magmpm.studies.hard_cases.motions import FIRST_ROOT, block
from random_scenes import drawn_fields as fields
from random_scenes.drawn_fields import DYNAMIC, QUASI_STATIC, STATIC, Content, mm

KINDS = {STATIC: 0.6, QUASI_STATIC: 0.18, DYNAMIC: 0.22}  # with their shares of the scenes


@dataclass
class Sizes:
    """Sizes that scale the loads, SI. across: thickness; A_over_I: area over second moment; corners of the undeformed box (2, 3) m."""

    length: float
    across: float
    A_over_I: float
    box: np.ndarray
    shear: float
    ratio: float
    density: float
    remanence: float
    free: bool = False

    @property
    def young(self) -> float:
        return float(young_modulus(self.shear, self.ratio * self.shear))

    @property
    def period(self) -> float:
        """Period of the first bending of a cantilever, s."""
        w = FIRST_ROOT**2 / self.length**2 * math.sqrt(self.young / self.density / self.A_over_I)
        return 2 * math.pi / w

    def flux(self, load: float) -> float:
        """Flux density (T) of a load M B A L^2/(E I)."""
        return load * self.young * MU0 / (self.remanence * self.A_over_I * self.length**2)


def drawn(seed: int, number: int) -> Content:
    """The content of scene file `number` of a seed."""
    rng = np.random.default_rng([seed, number])
    severity = float(rng.random())
    kind = str(rng.choice(list(KINDS), p=list(KINDS.values())))
    chosen = int(rng.integers(4)) + 4 * (
        number // 400
    )  # of combinations of effects, each compiled once: four in 400 scenes
    effects = (
        _motion_effects(np.random.default_rng([seed, 1_000_000 + chosen]))
        if kind == DYNAMIC
        else []
    )
    cells = int(rng.choice([2, 3, 4], p=[0.8, 0.17, 0.03]))
    materials = _materials(rng, severity, kind == DYNAMIC)
    body, sizes = _body(rng, severity, kind, effects, materials, cells)
    load = 10 ** rng.uniform(-1.5, 0.3 + 1.7 * severity)
    content: Content = {"name": f"drawn {seed} {number}", "materials": materials, "body": body}
    named: Content = {"magnetic_torque": {}}
    steps = (sizes.across / cells) / math.sqrt((sizes.ratio + 4 / 3) * sizes.shear / sizes.density)
    end = (
        1.0
        if kind != DYNAMIC
        else min(float(rng.uniform(0.1, 1.0)) * sizes.period, 0.4 * steps * 5000)
    )
    content["field"], varies = fields.drawn_field(
        rng, sizes, min(sizes.flux(load), 5.0), kind, end, effects
    )
    if varies:
        named["magnetic_force"] = {}
    if kind != DYNAMIC:
        if rng.random() < 0.3:
            named["gravity"] = fields.gravity(rng, severity, direction)
        if rng.random() < 0.1 and "parts" not in body and sizes.length < 20 * sizes.across:
            named["magnetic_interaction"] = {"blocks_across": int(rng.integers(1, 4))}
    else:
        named |= fields.moving_effects(rng, effects, sizes, severity, end, "catheter" in body)
    content["effects"] = named
    content["solver"] = _solver(rng, kind, end)
    content["resolution"] = {
        "cells_across": cells,
        "particles_per_cell": int(rng.choice([2, 3], p=[0.95, 0.05])),
    }
    if "parts" in body:  # wide sections: three cells across would take minutes along a path
        content["resolution"] = {"cells_across": 2}
    fields.widen(np.random.default_rng([seed, number, 1]), content, sizes, kind, end)
    return content


def _motion_effects(rng: np.random.Generator) -> list[str]:
    """Effects that the motions of one combination name, and whether their field is uniform."""
    shares = {
        "gravity": 0.4,
        "damping": 0.6,
        "viscosity": 0.3,
        "ground": 0.3,
        "walls": 0.2,
        "feed": 0.15,
        "magnetic_interaction": 0.1,
        "self_contact": 0.2,
        "uniform": 0.65,
    }
    return [name for name, share in shares.items() if rng.random() < share]


def _materials(rng: np.random.Generator, severity: float, moving: bool) -> Content:
    """One to three materials, the first magnetic."""
    shear = 10 ** rng.uniform(4.0 - 0.7 * severity, 6.0 + severity)
    found: Content = {}
    for k in range(int(rng.choice([1, 2, 3], p=[0.5, 0.4, 0.1]))):
        contrast = 1.0 if k == 0 else 10 ** rng.uniform(-1 - severity, 1 + severity)
        most = 2.0 if moving else 1.5 + 1.2 * severity
        found[f"silicone {k + 1}"] = {
            "shear_modulus": f"{1e-3 * shear * contrast:.9g} kPa",
            "bulk_to_shear": float(f"{10 ** rng.uniform(0.0, most):.6g}"),
            "density": f"{rng.uniform(900, 4000):.6g} kg/m^3",
            "remanence": (
                f"{1e3 * 10 ** rng.uniform(-1.7, -0.4):.6g} mT"
                if k == 0 or rng.random() < 0.5
                else "0 mT"
            ),
        }
    return found


def direction(rng: np.random.Generator) -> list[float]:
    """A random unit vector, one in three along an axis."""
    if rng.random() < 0.33:
        out = [0.0, 0.0, 0.0]
        out[int(rng.integers(3))] = float(rng.choice([-1.0, 1.0]))
        return out
    v = rng.standard_normal(3)
    return [float(f"{x:.9g}") for x in v / np.linalg.norm(v)]


def _body(
    rng: np.random.Generator,
    severity: float,
    kind: str,
    effects: list[str],
    materials: Content,
    cells: int,
) -> tuple[Content, Sizes]:
    first = materials["silicone 1"]
    shear, density, remanence = (
        float(first[key].split()[0]) for key in ("shear_modulus", "density", "remanence")
    )
    known = {
        "shear": 1e3 * shear,
        "ratio": first["bulk_to_shear"],
        "density": density,
        "remanence": 1e-3 * remanence,
    }
    moving = kind == DYNAMIC
    across = 10 ** rng.uniform(-3.5, -1.7)
    slender = rng.uniform(1.5, 6.0) if moving else 10 ** rng.uniform(0.2, 1.2 + 0.8 * severity)
    slender = min(slender, 60.0 if cells > 2 else 200.0)
    if "feed" in effects:
        slender = max(slender, 5.0)
    length = across * slender
    shape = (
        "catheter"
        if "feed" in effects
        else str(rng.choice(["catheter", "tube", "strip", "parts"], p=[0.42, 0.2, 0.28, 0.1]))
    )
    half = across / 2
    if shape == "parts":
        return _parts(rng, across, min(slender, 12.0), materials, known)
    body: Content = {"length": mm(length), "material": "silicone 1"}
    clamp = "none" if moving and "feed" not in effects and rng.random() < 0.15 else "base"
    segments = _segments(rng, length, across, materials)
    if shape == "strip":
        plane = bool(rng.random() < 0.3)
        width = across * 10 ** rng.uniform(-0.2, 0.9 if slender < 20 else 0.5)
        clamp = "both" if clamp == "base" and rng.random() < 0.15 else clamp
        body |= {"width": mm(width), "thickness": mm(across), "clamp": clamp, "plane_strain": plane}
        turns = (
            max(3, round(length / across * cells)) / 8
        )  # whole cells, eight of them for a turn at least
        if turns > 0.3 and rng.random() < 0.3:
            harmonic = {
                "periods": float(f"{rng.uniform(0.2, min(2.0, turns)):.6g}"),
                "phase": f"{rng.uniform(0, 360):.6g} deg",
            }
            harmonic |= {
                "plane": str(rng.choice(["xz", "xy"])),
                "turn": str(rng.choice(["ccw", "cw"])),
            }
            body["magnetization_profile"] = {"harmonic": harmonic}
        else:
            body["segments"] = segments
        box = np.array([[0.0, -width / 2, -half], [length, width / 2, half]])
        return {"strip": body}, Sizes(
            length, across, 12 / across**2, box, free=clamp == "none", **known
        )
    body |= {"diameter": mm(across), "clamp": clamp, "segments": segments}
    inner = 0.0
    if shape == "tube":
        inner = across * (1 - 10 ** rng.uniform(-1.0 - severity, -0.2))
        body["inner_diameter"] = mm(inner)
    box = np.array([[0.0, -half, -half], [length, half, half]])
    return {"catheter": body}, Sizes(
        length, across, 16 / (across**2 + inner**2), box, free=clamp == "none", **known
    )


def _segments(
    rng: np.random.Generator, length: float, across: float, materials: Content
) -> list[Content]:
    """One to eight segments, the last of which takes what is left; one at least is magnetic."""
    count = int(rng.integers(1, 9)) if rng.random() < 0.7 else 1
    shares = rng.dirichlet(np.full(count, 2.0))
    shares = np.maximum(shares, 0.02 * across / length + 1e-3)
    shares /= shares.sum()
    found = []
    for k in range(count):
        segment: Content = {
            "material": "silicone 1" if k == 0 else str(rng.choice(list(materials)))
        }
        if k == 0 or rng.random() < 0.8:
            segment["magnetization"] = direction(rng)
        if k < count - 1:
            segment["length"] = mm(float(shares[k]) * length)
        found.append(segment)
    return found


def _parts(
    rng: np.random.Generator, across: float, slender: float, materials: Content, known: Content
) -> tuple[Content, Sizes]:
    """A held block and one or two arms of one to four cells, end to end along x."""
    t = 1e3 * across
    ends = [0.0, t, t + slender * t * float(rng.uniform(0.3, 1.0))]
    if rng.random() < 0.5:
        ends.append(ends[-1] + float(rng.uniform(0.5, slender)) * t)
    width = t * float(rng.uniform(1.0, 2.0))
    meshes = []
    for k, (a, b) in enumerate(itertools.pairwise(ends)):
        part: Content = {
            "name": f"part {k + 1}",
            "mesh": pack_mesh(block((a, -width / 2, -t / 2), (b, width / 2, t / 2))),
        }
        part["material"] = "silicone 1" if k == 1 else str(rng.choice(list(materials)))
        part |= {"clamp": True} if k == 0 else {"magnetization": direction(rng)}
        meshes.append(part)
    box = 1e-3 * np.array([[0.0, -width / 2, -t / 2], [ends[-1], width / 2, t / 2]])
    return {"parts": {"unit": "mm", "meshes": meshes}}, Sizes(
        1e-3 * (ends[-1] - t), across, 12 / across**2, box, **known
    )


def _solver(rng: np.random.Generator, kind: str, end: float) -> Content:
    found: Content = {} if rng.random() < 0.95 else {"anti_locking": "none"}
    if kind == STATIC:
        return {
            **found,
            STATIC: {"field_steps": int(rng.integers(2, 12))} if rng.random() < 0.1 else {},
        }
    if kind == QUASI_STATIC:
        return {**found, QUASI_STATIC: {"steps": int(rng.integers(4, 16))}}
    moving: Content = {"duration": f"{1e3 * end:.9g} ms", "output_every": f"{1e3 * end / 8:.9g} ms"}
    return {**found, DYNAMIC: moving}
