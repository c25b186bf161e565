"""Fields, schedules, effects of motion, and less usual parts of the schema, of scenes drawn at random (hard_cases.drawn)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from magmpm.fields.dipole import MU0

Content = dict[str, Any]
STATIC = "static"
QUASI_STATIC = "quasi_static"
DYNAMIC = "dynamic"
MAGNET = 1.3  # T, remanence


def mm(value: float) -> str:
    """A length as files write it."""
    return f"{1e3 * value:.9g} mm"


def _mm(values: Any) -> list[str]:
    return [mm(x) for x in values]


def unit(rng: np.random.Generator) -> np.ndarray:
    """A direction (3,), evenly drawn."""
    v = rng.standard_normal(3)
    return np.asarray(v / np.linalg.norm(v))


def drawn_field(
    rng: np.random.Generator, sizes: Any, flux: float, kind: str, end: float, effects: list[str]
) -> tuple[Content, bool]:
    """A field of about this size (T) at the body's center, and whether it varies in space. end: s, of its schedule; effects: of motion,
    which say whether it varies, since kernels differ.
    """
    way = unit(rng)
    if rng.random() < 0.15:  # exactly along the undeformed axis, or against it
        way = np.array([rng.choice([-1.0, 1.0]), 0.0, 0.0])
    shares = [0.72, 0.17, 0.07, 0.04]
    if kind == DYNAMIC:
        shares = [1.0, 0.0, 0.0, 0.0] if "uniform" in effects else [0.0, 0.7, 0.2, 0.1]
    source = str(rng.choice(["uniform", "dipole", "magnet", "coils"], p=shares))
    found: Content = {}
    if source == "uniform" or rng.random() < 0.2:
        found["uniform"] = [f"{1e3 * flux * x:.9g} mT" for x in way]
    if source != "uniform":
        found |= _source(rng, source, sizes, flux, way)
    if kind == QUASI_STATIC or rng.random() < 0.25:
        found["over_time"] = _schedule(rng, source, found, flux, end, sizes)
    return found, source != "uniform"


def _source(
    rng: np.random.Generator, source: str, sizes: Any, flux: float, way: np.ndarray
) -> Content:
    """A dipole, magnet or coil whose field at the body's center is about `flux`, outside of the undeformed body."""
    center = sizes.box.mean(axis=0)
    half = float(np.linalg.norm(sizes.box[1] - sizes.box[0])) / 2
    toward = unit(rng)
    r = half * float(10 ** rng.uniform(0.3, 0.8)) + 2 * sizes.across
    place = center + r * toward
    if source == "dipole":
        moment = flux * r**3 * 2 * math.pi / MU0 * way
        moment *= min(1.0, 1e6 / np.abs(moment).max())  # the most a scene may have
        return {"dipole": {"position": _mm(place), "moment": [f"{m:.9g} A*m^2" for m in moment]}}
    if source == "magnet":
        side = min((2 * math.pi * r**3 * flux / MAGNET) ** (1 / 3), 0.5 * (r - half))
        shape: Content = {
            "cylinder": {"diameter": f"{1e3 * side:.9g} mm", "length": f"{1e3 * side:.9g} mm"}
        }
        if rng.random() < 0.4:
            shape = {"cuboid": {"size": _mm([side, side, 0.7 * side])}}
        return {
            "magnet": {
                **shape,
                "position": _mm(place),
                "axis": [float(x) for x in way],
                "remanence": f"{MAGNET} T",
            }
        }
    r = max(
        r, 5.0 * half
    )  # a wire next to the box that the body may reach: a table of its field, as exact as it must be, has no room
    place = center + r * toward
    radius = 0.4 * (r - 2.5 * half)
    turns = 100
    current = min(flux * 2 * (radius**2 + r**2) ** 1.5 / (MU0 * radius**2) / turns, 1e5)
    coil = {
        "position": _mm(place),
        "axis": [float(x) for x in toward],
        "diameter": f"{2e3 * radius:.9g} mm",
    }
    return {"coils": {**coil, "current": f"{current:.9g} A", "turns": turns}}


def _schedule(
    rng: np.random.Generator, source: str, found: Content, flux: float, end: float, sizes: Any
) -> Content:
    """Schedule of the field until `end` (s)."""
    ways = ["ramp", "ramp", "keyframes"] + (
        ["rotation", "oscillation", "uniform frames"] if source == "uniform" else ["move"]
    )
    if source == "coils":
        ways = ["ramp", "keyframes"]
    way = str(rng.choice(ways))
    ms = f"{1e3 * end:.9g} ms"
    if way == "ramp":
        return {"ramp": {"duration": ms}}
    if way == "rotation":
        turns = float(f"{rng.uniform(0.1, 1.0):.6g}")
        return {
            "rotation": {
                "axis": [float(x) for x in unit(rng)],
                "frequency": f"{turns / end:.9g} Hz",
                "turns": turns,
            }
        }
    if way == "oscillation":
        return {"oscillation": {"frequency": f"{0.75 / end:.9g} Hz", "cycles": 0.75}}
    times = [
        0.0,
        *sorted(float(x) for x in rng.uniform(0.2, 0.8, int(rng.integers(1, 4))) * end),
        end,
    ]
    if way == "keyframes":
        strengths = [0.0, *(float(f"{x:.6g}") for x in rng.uniform(-0.5, 1.0, len(times) - 2)), 1.0]
        return {
            "keyframes": [
                {"time": f"{1e3 * t:.9g} ms", "strength": s}
                for t, s in zip(times, strengths, strict=True)
            ]
        }
    if way == "move":
        away = 0.3 * sizes.across * unit(rng)
        return {
            "keyframes": [
                {"time": f"{1e3 * t:.9g} ms", "move": _mm(away * k)} for k, t in enumerate(times)
            ]
        }
    return {
        "keyframes": [
            {
                "time": f"{1e3 * t:.9g} ms",
                "uniform": [f"{1e3 * flux * x:.9g} mT" for x in unit(rng)],
            }
            for t in times
        ]
    }


def moving_effects(
    rng: np.random.Generator,
    named: list[str],
    sizes: Any,
    severity: float,
    end: float,
    catheter: bool,
) -> Content:
    """The effects of a combination, with numbers that suit the body. end: s."""
    found: Content = {}
    if "gravity" in named:
        found["gravity"] = gravity(rng, severity, unit)
    if "damping" in named:
        found["damping"] = {
            "rate": f"{min(2 * math.pi / sizes.period * 10 ** rng.uniform(-1, 0.6), 1e6):.6g} 1/s"
        }
    if "viscosity" in named:
        found["viscosity"] = {
            "viscosity": f"{sizes.shear * sizes.period * 10 ** rng.uniform(-3.5, -1.5):.6g} Pa s"
        }
    if "self_contact" in named:
        found["self_contact"] = {}
    if "magnetic_interaction" in named:
        found["magnetic_interaction"] = {"blocks_across": 2}
    (x0, y0, z0), (_, y1, z1) = sizes.box
    if "ground" in named:
        tilt = float(rng.uniform(-0.5, 0.5))
        n = np.array([math.sin(tilt), 0.0, math.cos(tilt)])
        found["ground"] = {**_ground(rng, n, sizes), "friction": float(f"{rng.uniform(0, 1):.4g}")}
    if "walls" in named:
        radius = math.hypot((y1 - y0) / 2, (z1 - z0) / 2) * float(rng.uniform(1.1, 3.0))
        length = sizes.length
        path = [_mm([x0 - 0.5 * length, 0, 0]), _mm([x0 + 2.5 * length, 0, 0])]
        found["walls"] = {
            "tube": {"radius": f"{1e3 * radius:.9g} mm", "path": path},
            "friction": float(f"{rng.uniform(0, 1):.4g}"),
        }
    if "feed" in named and catheter:
        found["feed"] = _feed(rng, sizes, end, (0.4, 0.7), 5.0)
    return found


def gravity(
    rng: np.random.Generator, severity: float, way: Callable[[np.random.Generator], Iterable[float]]
) -> Content:
    """Gravity, sometimes tenfold; way: draws its direction."""
    size = 9.81 * (10.0 if rng.random() < 0.3 * severity else 1.0)
    return {"acceleration": [f"{size * x:.6g} m/s^2" for x in way(rng)]}


def _ground(rng: np.random.Generator, normal: np.ndarray, sizes: Any) -> Content:
    """A ground with this normal, below the body."""
    (x0, y0, z0), (x1, y1, z1) = sizes.box
    corners = np.array([[x, y, z] for x in (x0, x1) for y in (y0, y1) for z in (z0, z1)])
    lowest = float((corners @ normal).min()) - sizes.across * float(rng.uniform(0.05, 2.0))
    return {"point": _mm(lowest * normal), "normal": [float(x) for x in normal]}


def widen(rng: np.random.Generator, content: Content, sizes: Any, kind: str, end: float) -> None:
    """Change some parts of a scene file's content. sizes: of its body; end: s, of its schedule."""
    _directions(rng, content)
    _field(rng, content["field"], sizes, end)
    if kind == DYNAMIC:
        _motion(rng, content, sizes, end)
    else:
        _equilibria(rng, content, sizes, kind, end)


def _equilibria(
    rng: np.random.Generator, content: Content, sizes: Any, kind: str, end: float
) -> None:
    effects = content["effects"]
    solver = content["solver"]
    straight = "parts" not in content["body"]
    catheter = content["body"].get("catheter")
    varies = "magnetic_force" in effects
    if kind == STATIC and rng.random() < 0.1:
        solver[STATIC]["tolerance"] = float(f"{10 ** rng.uniform(-13, -11):.3g}")
    if kind == STATIC and not varies and rng.random() < 0.06:  # weight alone
        del effects["magnetic_torque"]
        effects.setdefault("gravity", {})
    elif kind == STATIC and rng.random() < 0.05:
        content["effects"] = "auto"
    feeds = (
        kind == QUASI_STATIC and catheter and not varies and "magnetic_interaction" not in effects
    )
    if feeds and sizes.length > 4 * sizes.across and rng.random() < 0.5:
        effects["feed"] = _feed(rng, sizes, end, (0.5, 0.9), math.inf)
    if kind == QUASI_STATIC and rng.random() < 0.2:
        steps = solver[QUASI_STATIC].pop("steps")
        times = [0.0, *sorted(rng.uniform(0.02, 0.98, steps - 1)), 1.0]
        solver[QUASI_STATIC]["at"] = [f"{1e3 * end * t:.9g} ms" for t in times]
    if straight and sizes.length < 20 * sizes.across and rng.random() < 0.12:
        requested: Content = {"error": f"{10 ** rng.uniform(-0.3, 0.5):.3g} %"}
        if rng.random() < 0.3:
            requested["of"] = "tip"
        content["resolution"] = {"seconds": "5 s"} if rng.random() < 0.15 else requested


def _motion(rng: np.random.Generator, content: Content, sizes: Any, end: float) -> None:
    effects = content["effects"]
    moving = content["solver"][DYNAMIC]
    if rng.random() < 0.15:
        moving["safety"] = float(f"{rng.uniform(0.3, 0.8):.3g}")
    if "feed" not in effects and rng.random() < 0.15:
        duration = end * float(rng.uniform(1.5, 4.0))
        moving |= {
            "duration": f"{1e3 * duration:.9g} ms",
            "output_every": f"{1e3 * duration / 8:.9g} ms",
        }
    if "ground" in effects and rng.random() < 0.4:
        n = np.array([rng.uniform(-0.4, 0.4), rng.uniform(-0.4, 0.4), 1.0])
        effects["ground"] |= _ground(rng, n / np.linalg.norm(n), sizes)  # slopes along x and y
    if "walls" in effects and rng.random() < 0.6:
        tube = effects["walls"]["tube"]
        tube["path"] = _bent(rng, sizes, 1e-3 * float(tube["radius"].split()[0]))


def _feed(
    rng: np.random.Generator, sizes: Any, end: float, held: tuple[float, float], fastest: float
) -> Content:
    """A guide that holds a part of the catheter, within these shares, and pushes out some of what it holds, at most so fast, m/s."""
    exit_at = float(rng.uniform(*held)) * sizes.length
    speed = min(float(rng.uniform(0.1, 0.9)) * (exit_at - 1.05 * sizes.across) / end, fastest)
    return {"speed": f"{speed:.9g} m/s", "exit": f"{1e3 * exit_at:.9g} mm"}


def _bent(rng: np.random.Generator, sizes: Any, radius: float) -> list[list[str]]:
    """A tube's path: straight around the body, then turned by up to 40 degrees, in one or two bends."""
    length = sizes.length
    around = rng.uniform(0, 2 * math.pi)
    points = [np.array([-0.5 * length, 0.0, 0.0]), np.array([1.2 * length + radius, 0.0, 0.0])]
    way = 0.0
    for _ in range(int(rng.integers(1, 3))):
        way += math.radians(float(rng.uniform(5, 20)))
        ahead = np.array(
            [math.cos(way), math.sin(way) * math.cos(around), math.sin(way) * math.sin(around)]
        )
        points.append(points[-1] + 0.8 * length * ahead)
    return [[mm(x) for x in point] for point in points]


def _field(rng: np.random.Generator, field: Content, sizes: Any, end: float) -> None:
    """Sources of some size, magnetized at will, and schedules that begin late, or not at zero."""
    if "dipole" in field and rng.random() < 0.3:
        field["dipole"]["diameter"] = f"{1e3 * 0.2 * sizes.length:.9g} mm"
    if "magnet" in field and rng.random() < 0.3:
        field["magnet"]["magnetization"] = unit(rng).tolist()
    over = field.get("over_time", {})
    if "ramp" in over and rng.random() < 0.4:
        begin = float(rng.uniform(0.0, 0.3)) * end
        over["ramp"] = {
            "start": f"{1e3 * begin:.9g} ms",
            "duration": f"{1e3 * (end - begin):.9g} ms",
        }
        over["ramp"]["begin"] = float(f"{rng.uniform(-0.5, 0.5):.3g}")
    if "oscillation" in over and rng.random() < 0.5:
        over["oscillation"] |= {
            "mean": float(f"{rng.uniform(-0.5, 0.5):.3g}"),
            "phase": f"{rng.uniform(0, 360):.6g} deg",
        }


def _directions(rng: np.random.Generator, content: Content) -> None:
    """Some magnetizations as angles."""
    body = content["body"]
    for segment in (body.get("catheter") or body.get("strip") or {}).get("segments", ()):
        if "magnetization" in segment and rng.random() < 0.1:
            angles = {
                "azimuth": f"{rng.uniform(-180, 180):.6g} deg",
                "elevation": f"{rng.uniform(-90, 90):.6g} deg",
            }
            segment["magnetization"] = angles
