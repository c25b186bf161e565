"""The numbers that the scenes of the gallery demonstrate, from the results in runs/gallery.

    python docs/gallery/measure.py [--results FOLDER] NAME ...

`build.py` writes the same rows on the page of each scene; tests check their bounds.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.effects import self_contact
from magmpm.effects.acting import NO_LOADS
from magmpm.fields.dipole import MU0
from magmpm.results.result import Result
from magmpm.results.trajectory import Motion
from magmpm.scene import Scene
from magmpm.simulate import run

ROOT = Path(__file__).resolve().parents[2]
Rows = list[tuple[str, str]]


def equilibrium_of(scene: Scene) -> Result:
    """The static equilibrium of a dynamic scene, without the effects that act only in motion."""
    data = scene.to_si()
    data["solver"]["dynamic"] = None
    data["effects"].update(dict.fromkeys(NO_LOADS))
    return run(Scene.from_si(data))


def distance_from(moved: Result, still: Result) -> tuple[float, float]:
    """Largest distance between two deformed axes, and the distance between their tips, both over the length."""
    gap = np.linalg.norm(moved.centreline[:, 1:] - still.centreline[:, 1:], axis=1)
    length = float(moved.centreline[-1, 0])
    return float(gap.max()) / length, float(np.linalg.norm(moved.tip - still.tip)) / length


def mass_center(motion: Motion, number: int, part: int | None = None) -> Array:
    """Volume average (3,) m of the position of the body, or of one of its parts, in a frame."""
    mine = np.ones(len(motion.part), bool) if part is None else motion.part == part
    position = motion.position(number)[mine].astype(float)
    volume = motion.volume[mine]
    return np.asarray(volume @ position / volume.sum())


def steps_along_x(motion: Motion, period: float) -> Array:
    """Displacement (m) of the center of the body along x in each whole period (s)."""
    count = int(motion.times[-1] / period * (1 + 1e-9))
    at = [mass_center(motion, motion.nearest(k * period))[0] for k in range(count + 1)]
    return np.diff(at)


def turned(motion: Motion, number: int, part: int) -> float:
    """Angle (degrees) by which a part has rotated since the first frame: the rotation that fits its particles best."""
    mine = motion.part == part
    before = motion.reference[mine].astype(float)
    now = motion.position(number)[mine].astype(float)
    u, _, vt = np.linalg.svd((before - before.mean(0)).T @ (now - now.mean(0)))
    rotation = vt.T @ np.diag([1.0, 1.0, np.linalg.det(vt.T @ u.T)]) @ u.T
    return float(np.degrees(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1.0, 1.0))))


def tentacle(folder: Path) -> Rows:
    """Settled position, against statics."""
    moved = Result.load(folder)
    axis, tip = distance_from(moved, equilibrium_of(Scene.from_si(moved.scene)))
    return [
        (
            "distance from the static equilibrium, largest along the axis",
            f"{100 * axis:.3f} % of the length",
        ),
        ("distance from the static equilibrium, tip", f"{100 * tip:.4f} % of the length"),
    ]


PERIOD = 0.1  # s, of the walking field


def walk(folder: Path) -> Rows:
    """Distance walked in each cycle."""
    steps = 1e3 * steps_along_x(Motion.load(folder), PERIOD)
    text = ", ".join(f"{step:.3f}" for step in steps)
    spread = np.ptp(steps[1:]) / abs(steps[1:].mean())
    return [
        ("distance walked in each cycle (mm)", text),
        (
            "mean of the cycles after the first",
            f"{steps[1:].mean():.3f} mm; spread {100 * spread:.1f} %",
        ),
    ]


def rod_pulled(scene: Scene, move: Array, points: int = 2000) -> Array:
    """Tip (x, z) m of pulled_catheter.yaml by another model, with its magnet moved by `move` (3,) m: an inextensible elastica, whose
    magnetic segment feels force and torque of a point dipole with the moment of the magnet.

    M' = -(n_z cos a - n_x sin a + m_x B_z - m_z B_x), n' = -grad (m . B), a' = M / (E I), all per length of the deformed axis,
    n = M = 0 at the tip and a = 0 at the base; solved by iteration from the straight rod.
    """
    catheter = scene.body.catheter
    magnets = scene.field.magnet
    assert catheter is not None
    assert magnets is not None
    assert magnets[0].cylinder is not None
    magnet = magnets[0]
    solid = magnets[0].cylinder
    G = scene.region_material(0).shear_modulus
    ratio = scene.region_material(0).bulk_to_shear
    stiffness = 9 * ratio * G / (3 * ratio + 1) * math.pi * catheter.diameter**4 / 64
    moment = (
        magnet.remanence
        / MU0
        * math.pi
        / 4
        * solid.diameter**2
        * solid.length
        * np.array(magnet.axis)
    )
    at = (np.array(magnet.position) + move)[:, None]
    ds = catheter.length / points
    s = (np.arange(points) + 0.5) * ds
    area = math.pi * catheter.diameter**2 / 4
    strength = (
        np.where(s > catheter.segment_lengths()[0], scene.region_remanence()[1, 0], 0.0)
        / MU0
        * area
    )  # A m

    def flux(p: Array) -> Array:
        away = p - at
        distance = np.linalg.norm(away, axis=0)
        unit = away / distance
        return np.asarray(1e-7 * (3 * unit * (moment @ unit) - moment[:, None]) / distance**3)

    def beyond(load: Array) -> Array:
        """The integral from each point to the tip."""
        return np.asarray((np.cumsum(load[::-1])[::-1] - 0.5 * load) * ds)

    angle = np.zeros(points)
    for _ in range(500):
        c = np.cos(angle)
        w = np.sin(angle)
        p = np.stack([(np.cumsum(c) - 0.5 * c) * ds, 0 * s, (np.cumsum(w) - 0.5 * w) * ds])
        m = strength * np.stack([c, 0 * s, w])
        x = np.array([[1e-6], [0], [0]])
        z = np.array([[0], [0], [1e-6]])
        B = flux(p)
        nx = beyond((m * (flux(p + x) - flux(p - x))).sum(0) / 2e-6)
        nz = beyond((m * (flux(p + z) - flux(p - z))).sum(0) / 2e-6)
        bend = beyond(c * nz - w * nx + m[0] * B[2] - m[2] * B[0]) / stiffness
        found = (np.cumsum(bend) - 0.5 * bend) * ds
        if np.abs(found - angle).max() < 1e-10:
            return np.array([c.sum(), w.sum()]) * ds
        angle += 0.5 * (found - angle)
    raise ValueError("the elastica did not converge: the magnet is too near for this iteration")


def pull(folder: Path) -> Rows:
    """Final position of the tip, against statics and against a rod and a dipole."""
    moved = Result.load(folder)
    scene = Scene.from_si(moved.scene)
    assert scene.field.over_time is not None
    still = equilibrium_of(scene)
    rod = rod_pulled(scene, np.array(scene.field.over_time.frames[-1].move))
    axis, tip = distance_from(moved, still)
    return [
        ("tip at the end (mm): motion", f"{1e3 * moved.tip[0]:.3f}, {1e3 * moved.tip[2]:.3f}"),
        ("tip at the end (mm): statics", f"{1e3 * still.tip[0]:.3f}, {1e3 * still.tip[2]:.3f}"),
        (
            "tip at the end (mm): elastica and point dipole",
            f"{1e3 * rod[0]:.3f}, {1e3 * rod[1]:.3f}",
        ),
        (
            "distance of the motion from statics, largest along the axis",
            f"{100 * axis:.3f} % of the length; tip {100 * tip:.3f} %",
        ),
    ]


# parts of gripper.yaml; ARMS: the outer halves
HUB = 0
BALL = 1
ARMS = range(3, 15, 2)


def grip(folder: Path) -> Rows:
    """Rotation of the arms, height of the ball and load on the ground, at moments of the schedule."""
    motion = Motion.load(folder)
    rest = mass_center(motion, 0, BALL)[2]
    weight = 9.81 * 1000.0 * motion.volume[motion.part == BALL].sum()
    found = []
    for name, time in (("closed", 0.1), ("released, at the end", motion.times[-1])):
        k = motion.nearest(time)
        angles = [turned(motion, k, arm) for arm in ARMS]
        height = 1e3 * (mass_center(motion, k, BALL)[2] - rest)
        carried = motion.contacts["ground"]["Fz"][k] if "ground" in motion.contacts else 0.0
        found += [
            (
                f"{name}: rotation of the outer halves of the arms",
                f"{min(angles):.1f} to {max(angles):.1f} degrees",
            ),
            (f"{name}: height of the ball above its initial position", f"{height:.3f} mm"),
            (
                f"{name}: force of the ground",
                f"{1e3 * carried:.3f} mN; the ball weighs {1e3 * weight:.3f} mN",
            ),
        ]
    return found


def smallest_gap(motion: Motion, scene: Scene) -> tuple[float, float]:
    """Smallest gap over all frames, in cells, between folds of a strip that are not neighbors along it, and its time (s)."""
    h = scene.thickness / scene.resolution.cells_across
    reference = motion.reference.astype(float)
    size = h / scene.resolution.particles_per_cell
    apart = scene.thickness + 4 * h
    gaps = [
        self_contact.gap(motion.position(k).astype(float), reference, size, apart, 3 * h) / h
        for k in range(len(motion))
    ]
    return float(min(gaps)), float(motion.times[int(np.argmin(gaps))])


def farthest(motion: Motion, number: int) -> float:
    """Largest displacement (m) of a particle in a frame."""
    away = motion.position(number).astype(float) - motion.reference
    return float(np.linalg.norm(away, axis=1).max())


def fold(folder: Path) -> Rows:
    """Smallest gap between the halves, and how completely the strip opens."""
    motion = Motion.load(folder)
    scene = Scene.from_si(motion.scene)
    gap, when = smallest_gap(motion, scene)
    most = max(farthest(motion, k) for k in range(len(motion)))
    return [
        ("smallest gap between the halves", f"{gap:.2f} cells, at {when:.3g} s"),
        (
            "largest displacement during the motion",
            f"{100 * most / scene.length:.1f} % of the length",
        ),
        (
            "largest displacement at the end",
            f"{100 * farthest(motion, -1) / scene.length:.2f} % of the length",
        ),
    ]


SWEPT = (
    7.0,
    10.0,
    15.0,
    25.0,
    40.0,
)  # mT: the fields of data/references/zhao_beam.json above the buckling threshold


def end_of(motion: Motion, number: int) -> Array:
    """Center (3,) m of the free end of a strip in a frame: extrapolated to the end from the last two columns of particles."""
    position = motion.position(number).astype(float)
    along = motion.reference[:, 0].astype(float)
    column = np.unique(along.round(9))
    end, before = (
        position[np.isclose(along, x, rtol=0, atol=1e-8)].mean(axis=0) for x in column[[-1, -2]]
    )
    length = float((motion.scene or {})["body"]["strip"]["length"])
    return np.asarray(end + (end - before) * (length - column[-1]) / (column[-1] - column[-2]))


def deflection(motion: Motion, number: int) -> float:
    """Transverse deflection of the free end of a strip, over its length."""
    return float(end_of(motion, number)[2]) / float((motion.scene or {})["body"]["strip"]["length"])


def frame_at(motion: Motion, field: float) -> int:
    """The last frame in which the field along -x has this strength (mT), to 0.1 %."""
    return int(np.flatnonzero(np.isclose(-1e3 * motion.fields[:, 0], field, rtol=1e-3))[-1])


def words(motion: Motion, number: int) -> str:
    """Caption of Zhao's beam in a picture: which variant, in what field, and its deflection."""
    plane = (motion.scene or {})["body"]["strip"]["plane_strain"]
    strength = 1e3 * float(np.linalg.norm(motion.fields[number]))
    return f"{'plane strain' if plane else '5 mm wide'}, {strength:.1f} mT: {deflection(motion, number):.3f} L"


def against_finite_elements(motion: Motion) -> Array:
    """Deflection over the length at the fields of SWEPT: in the sweep, and by finite elements; (2, 5)."""
    known = json.loads((ROOT / "data/references/zhao_beam.json").read_text(encoding="utf-8"))
    plane = (motion.scene or {})["body"]["strip"]["plane_strain"]
    fem = known["finite_elements"]["plane_strain" if plane else "width_5mm"]["deflection"]
    wanted = dict(zip(known["field_mT"], fem, strict=True))
    return np.array(
        [[deflection(motion, frame_at(motion, B)) for B in SWEPT], [wanted[B] for B in SWEPT]]
    )


def sweep(folder: Path) -> Rows:
    """Deflection of the beam in each field of the sweep, against finite elements and statics."""
    motion = Motion.load(folder)
    moved = Result.load(folder)
    found, fem = against_finite_elements(motion)
    rows = [
        (f"deflection / length at {B:g} mT (finite elements)", f"{d:.4f} ({known:.4f})")
        for B, d, known in zip(SWEPT, found, fem, strict=True)
    ]
    _, tip = distance_from(moved, equilibrium_of(Scene.from_si(moved.scene)))
    return [
        *rows,
        (
            "largest difference from finite elements",
            f"{100 * np.abs(found - fem).max():.2f} % of the length",
        ),
        (
            "distance of the final tip from static equilibrium on the same grid",
            f"{100 * tip:.3f} % of the length",
        ),
    ]


MEASURES: dict[str, Callable[[Path], Rows]] = {
    "tentacle_hook": tentacle,
    "tentacle_spiral": tentacle,
    "walking_strip": walk,
    "gripper": grip,
    "pulled_catheter": pull,
    "folding_strip": fold,
    "zhao_beam": sweep,
    "zhao_beam_5mm": sweep,
}


def rows(name: str, folder: Path) -> Rows:
    """The numbers that a scene demonstrates (name, value); empty for scenes that are not in MEASURES."""
    return MEASURES[name](folder) if name in MEASURES else []


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; returns its exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", metavar="NAME", nargs="+", help=", ".join(MEASURES))
    parser.add_argument(
        "--results",
        type=Path,
        default=ROOT / "runs/gallery",
        metavar="FOLDER",
        help="[runs/gallery]",
    )
    options = parser.parse_args(arguments)
    for name in options.names:
        if name not in MEASURES:
            print(f"no such scene: {name}; there are {', '.join(MEASURES)}", file=sys.stderr)
            return 2
        for what, value in rows(name, options.results / name):
            print(f"{name}: {what}: {value}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
