"""Less usual parts of the schema, put into some of the scenes drawn at random (hard_cases.drawn): errors that are asked for, effects that
are chosen, insertion through equilibria, motions that settle, bent tubes, and other ways to write fields, schedules and directions.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from magmpm.studies.hard_cases.drawn_fields import Content, unit

STATIC, QUASI_STATIC, DYNAMIC = "static", "quasi_static", "dynamic"
MODERATE = 20.0  # length over thickness, up to which several grids are solved within a scene's time
SETTLING = (1.5, 4.0)  # of the time of a schedule: a motion that goes on


def widen(rng: np.random.Generator, content: Content, sizes: Any, kind: str, end: float) -> None:
    """Change some parts of a scene file's content. sizes: of its body; end: s, of its schedule."""
    _directions(rng, content)
    _field(rng, content["field"], sizes, end)
    if kind == DYNAMIC:
        _motion(rng, content, sizes, end)
    else:
        _equilibria(rng, content, sizes, kind, end)


def _equilibria(rng: np.random.Generator, content: Content, sizes: Any, kind: str, end: float) -> None:
    effects, solver, straight = content["effects"], content["solver"], "parts" not in content["body"]
    catheter, varies = content["body"].get("catheter"), "magnetic_force" in effects
    if kind == STATIC and rng.random() < 0.1:
        solver[STATIC]["tolerance"] = float(f"{10 ** rng.uniform(-13, -11):.3g}")
    if kind == STATIC and not varies and rng.random() < 0.06:  # weight alone
        del effects["magnetic_torque"]
        effects.setdefault("gravity", {})
    elif kind == STATIC and rng.random() < 0.05:
        content["effects"] = "auto"
    feeds = kind == QUASI_STATIC and catheter and not varies and "magnetic_interaction" not in effects
    if feeds and sizes.length > 4 * sizes.across and rng.random() < 0.5:
        effects["feed"] = _feed(rng, sizes, end)
    if kind == QUASI_STATIC and rng.random() < 0.2:
        steps = solver[QUASI_STATIC].pop("steps")
        times = [0.0, *sorted(rng.uniform(0.02, 0.98, steps - 1)), 1.0]
        solver[QUASI_STATIC]["at"] = [f"{1e3 * end * t:.9g} ms" for t in times]
    if straight and sizes.length < MODERATE * sizes.across and rng.random() < 0.12:
        asked: Content = {"error": f"{10 ** rng.uniform(-0.3, 0.5):.3g} %"}
        if rng.random() < 0.3:
            asked["of"] = "tip"
        content["resolution"] = {"seconds": "5 s"} if rng.random() < 0.15 else asked


def _motion(rng: np.random.Generator, content: Content, sizes: Any, end: float) -> None:
    effects, moving = content["effects"], content["solver"][DYNAMIC]
    if rng.random() < 0.15:
        moving["safety"] = float(f"{rng.uniform(0.3, 0.8):.3g}")
    if "feed" not in effects and rng.random() < 0.15:
        duration = end * float(rng.uniform(*SETTLING))
        moving |= {"duration": f"{1e3 * duration:.9g} ms", "output_every": f"{1e3 * duration / 8:.9g} ms"}
    if "ground" in effects and rng.random() < 0.4:
        _tilt(rng, effects["ground"], sizes)
    if "walls" in effects and rng.random() < 0.6:
        tube = effects["walls"]["tube"]
        tube["path"] = _bent(rng, sizes, 1e-3 * float(tube["radius"].split()[0]))


def _feed(rng: np.random.Generator, sizes: Any, end: float) -> Content:
    """A guide that holds a part of the catheter, and pushes out some of what it holds."""
    exit_at = float(rng.uniform(0.5, 0.9)) * sizes.length
    speed = float(rng.uniform(0.1, 0.9)) * (exit_at - 1.05 * sizes.across) / end
    return {"speed": f"{speed:.9g} m/s", "exit": f"{1e3 * exit_at:.9g} mm"}


def _tilt(rng: np.random.Generator, ground: Content, sizes: Any) -> None:
    """A ground that slopes along x and y, below the body."""
    n = np.array([rng.uniform(-0.4, 0.4), rng.uniform(-0.4, 0.4), 1.0])
    n /= np.linalg.norm(n)
    (x0, y0, z0), (x1, y1, z1) = sizes.box
    lowest = min(float(np.dot(n, (x, y, z))) for x in (x0, x1) for y in (y0, y1) for z in (z0, z1))
    lowest -= sizes.across * float(rng.uniform(0.05, 2.0))
    ground |= {"point": [f"{1e3 * x:.9g} mm" for x in lowest * n], "normal": [float(x) for x in n]}


def _bent(rng: np.random.Generator, sizes: Any, radius: float) -> list[list[str]]:
    """A tube's path: straight around the body, then turned by up to 40 degrees, in one or two bends."""
    length, around = sizes.length, rng.uniform(0, 2 * math.pi)
    points, way = [np.array([-0.5 * length, 0.0, 0.0]), np.array([1.2 * length + radius, 0.0, 0.0])], 0.0
    for _ in range(int(rng.integers(1, 3))):
        way += math.radians(float(rng.uniform(5, 20)))
        ahead = np.array([math.cos(way), math.sin(way) * math.cos(around), math.sin(way) * math.sin(around)])
        points.append(points[-1] + 0.8 * length * ahead)
    return [[f"{1e3 * x:.9g} mm" for x in point] for point in points]


def _field(rng: np.random.Generator, field: Content, sizes: Any, end: float) -> None:
    """Sources of some size, magnetized at will, and schedules that begin late, or not at zero."""
    if "dipole" in field and rng.random() < 0.3:
        field["dipole"]["diameter"] = f"{1e3 * 0.2 * sizes.length:.9g} mm"
    if "magnet" in field and rng.random() < 0.3:
        field["magnet"]["magnetization"] = unit(rng).tolist()
    over = field.get("over_time", {})
    if "ramp" in over and rng.random() < 0.4:
        begin = float(rng.uniform(0.0, 0.3)) * end
        over["ramp"] = {"start": f"{1e3 * begin:.9g} ms", "duration": f"{1e3 * (end - begin):.9g} ms"}
        over["ramp"]["begin"] = float(f"{rng.uniform(-0.5, 0.5):.3g}")
    if "oscillation" in over and rng.random() < 0.5:
        over["oscillation"] |= {"mean": float(f"{rng.uniform(-0.5, 0.5):.3g}"), "phase": f"{rng.uniform(0, 360):.6g} deg"}


def _directions(rng: np.random.Generator, content: Content) -> None:
    """Some magnetizations as angles."""
    body = content["body"]
    for segment in (body.get("catheter") or body.get("strip") or {}).get("segments", ()):
        if "magnetization" in segment and rng.random() < 0.1:
            angles = {"azimuth": f"{rng.uniform(-180, 180):.6g} deg", "elevation": f"{rng.uniform(-90, 90):.6g} deg"}
            segment["magnetization"] = angles
