"""What the gallery's scenes are about, in numbers, from the results in runs/gallery.

    python docs/gallery/measure.py [--results FOLDER] NAME ...

`build.py` puts the same rows on each scene's page; tests hold them to their bounds.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from magmpm.basis import Array
from magmpm.motion import Motion
from magmpm.results import Result
from magmpm.scene import Scene
from magmpm.simulate import run
from magmpm.surroundings import IN_MOTION

ROOT = Path(__file__).resolve().parents[2]
Rows = list[tuple[str, str]]


def equilibrium_of(scene: Scene) -> Result:
    """The static answer to a scene of motion, without the effects that only motion has."""
    data = scene.to_si()
    data["solver"]["dynamic"] = None
    data["effects"].update(dict.fromkeys(IN_MOTION))
    return run(Scene.from_si(data))


def distance_from(moved: Result, still: Result) -> tuple[float, float]:
    """Largest distance of the axis from another's, and that of the tip, over the length."""
    gap = np.linalg.norm(moved.centreline[:, 1:] - still.centreline[:, 1:], axis=1)
    length = float(moved.centreline[-1, 0])
    return float(gap.max()) / length, float(np.linalg.norm(moved.tip - still.tip)) / length


def mass_centre(motion: Motion, number: int, piece: int | None = None) -> Array:
    """Mean position (3,) m, by volume, of the body or of one of its pieces in a frame."""
    mine = np.ones(len(motion.part), bool) if piece is None else motion.part == piece
    position, volume = motion.position(number)[mine].astype(float), motion.volume[mine]
    return np.asarray(volume @ position / volume.sum())


def steps_along_x(motion: Motion, period: float) -> Array:
    """How far (m) the body's centre gets along x in each whole period (s)."""
    count = int(motion.times[-1] / period * (1 + 1e-9))
    at = [mass_centre(motion, motion.nearest(k * period))[0] for k in range(count + 1)]
    return np.diff(at)


def turned(motion: Motion, number: int, piece: int) -> float:
    """Angle in degrees by which a piece has turned since the first frame: of the rotation that fits its particles best."""
    mine = motion.part == piece
    before, now = motion.reference[mine].astype(float), motion.position(number)[mine].astype(float)
    u, _, vt = np.linalg.svd((before - before.mean(0)).T @ (now - now.mean(0)))
    rotation = vt.T @ np.diag([1.0, 1.0, np.linalg.det(vt.T @ u.T)]) @ u.T
    return float(np.degrees(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1.0, 1.0))))


def tentacle(folder: Path) -> Rows:
    """Where it settles, against statics."""
    moved = Result.load(folder)
    axis, tip = distance_from(moved, equilibrium_of(Scene.from_si(moved.scene)))
    return [
        ("distance from the static equilibrium, largest along the axis", f"{100 * axis:.3f} % of the length"),
        ("distance from the static equilibrium, tip", f"{100 * tip:.4f} % of the length"),
    ]


PERIOD = 0.1  # s, of the walking field


def walk(folder: Path) -> Rows:
    """How far it walks a cycle, against itself without friction and in the mirrored field."""
    steps = 1e3 * steps_along_x(Motion.load(folder), PERIOD)
    text = ", ".join(f"{step:.3f}" for step in steps)
    spread = np.ptp(steps[1:]) / abs(steps[1:].mean())
    return [
        ("distance walked in each cycle (mm)", text),
        (
            "mean of the cycles after the first",
            f"{steps[1:].mean():.3f} mm; they differ by {100 * spread:.1f} %",
        ),
    ]


MEASURES: dict[str, Callable[[Path], Rows]] = {
    "tentacle_hook": tentacle,
    "tentacle_spiral": tentacle,
    "walking_strip": walk,
}


def rows(name: str, folder: Path) -> Rows:
    """What a scene shows, in numbers: name and value; nothing for scenes that are not in MEASURES."""
    return MEASURES[name](folder) if name in MEASURES else []


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; returns its exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", metavar="NAME", nargs="+", help=", ".join(MEASURES))
    parser.add_argument(
        "--results", type=Path, default=ROOT / "runs/gallery", metavar="FOLDER", help="[runs/gallery]"
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
