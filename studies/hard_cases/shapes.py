"""Hard cases of shape and place: large strains and rotations, bodies anywhere on the grid."""

from __future__ import annotations

import math

import numpy as np

from magmpm.dynamics.stable_step import speed_of_sound
from magmpm.dynamics.time_loop import SimulationState, begin, integrate, interval, move
from magmpm.model import build
from magmpm.scene import Scene
from magmpm.studies.hard_cases.case import Case
from magmpm.studies.hard_cases.motions import advance, at_rest, energy, last_cells, stretch, throw
from magmpm.studies.hard_cases.scenes import DENSITY, G, bending_field, opening_strip, rod

SHORT = 20e-3  # m
TURN = 5.0  # 1/s: centrifugal strains are 1e-6
SQUEEZED = 0.2  # det F
LENGTH = 8e-3  # m, of free bodies
GAINED = 0.02  # of the energy, that may appear


def _offsets(count: int) -> Case:
    def measure(scene: Scene) -> float:
        """Largest distance between any two settled tips, over L."""
        places = np.random.default_rng(5).uniform(0.02, 0.98, (count, 2))
        tips = []
        for place in places.tolist():
            catheter = scene.body.catheter
            assert catheter is not None  # made by `rod`, below
            at = scene.resolution
            model = build(scene, catheter.discretize(at.cells_across, at.particles_per_cell, shift=(place[0], place[1])))
            moved = move(model)
            tips.append(last_cells(model) @ (moved.x - model.particles.position))
        spread = np.array(tips)[:, None] - np.array(tips)[None]
        return float(np.linalg.norm(spread, axis=2).max()) / scene.length

    return Case(
        f"{count} offsets of body against grid",
        lambda: rod(
            length=SHORT,
            field=bending_field(1.0, length=SHORT),
            cells=4,
            effects={"damping": {"rate": 240.0}},
            dynamic={"duration": 0.06, "output_every": 0.03},
        ),
        "loses slivers of cells, or bends by another amount at every place",
        "spread of settled tips, over L",
        measure,
        0.005,
        "the grid is not part of the physics",
        slow=count > 8,
    )


def _turn(scene: Scene) -> float:
    """Largest entry of F^T F - 1 and of det F - 1 over a turn by 360 degrees; infinite if the body does not return to its place."""
    motion, dt, _ = at_rest(scene)
    middle = motion.model.particles.position.mean(axis=0)
    throw(motion, lambda x: np.cross([0.0, TURN, 0.0], x - middle))
    steps, worst = round(2 * math.pi / TURN / dt), 0.0
    for part in np.diff(np.linspace(0, steps, 37).round().astype(int)):
        advance(motion, int(part), dt)
        _, _, F = motion.particles()
        worst = max(worst, float(np.abs(F.transpose(0, 2, 1) @ F - np.eye(3)).max()))
    x, _, F = motion.particles()
    back = np.abs(x - motion.model.particles.position).max() < 0.01 * scene.length
    return worst if back else math.inf


def _squeezed(scene: Scene) -> float:
    """Energy lost or gained by a body released at det F = 0.2 and run as by `magmpm run`, over its first energy; infinite if it stays
    small. For ten passages of a pressure wave through it."""
    moved = begin(build(scene))
    motion = moved.motion
    stretch(motion, SQUEEZED ** (1 / 3))
    begun, found, largest = energy(motion), 0.0, 0.0
    passes = LENGTH / float(speed_of_sound(motion.model).max())
    for time in np.linspace(0.0, 10.0 * passes, 101)[1:]:
        interval(moved, time)
        moved.control.at_frame()
        change = energy(motion) / begun - 1
        largest = max(largest, float(np.median(np.linalg.det(motion.particles()[2]))))
        found = max(found, abs(change))
        if change > GAINED:
            return math.inf
    return found if largest > 1.0 else math.inf


def _opened(scene: Scene) -> float:
    """Largest distance of particles from the undeformed shape, fitted to them, over L; infinite if the body never folded."""
    model = build(scene)
    widest: list[float] = []
    from scipy.spatial.transform import Rotation  # 0.2 s to import, for this case alone

    X = model.particles.position
    first, last = X[:, 0] < 0.5e-3, X[:, 0] > X[:, 0].max() - 0.5e-3
    moved = begin(model)
    integrate(moved, on_progress=lambda *_: widest.append(float(np.linalg.norm(np.subtract(*_ends(moved, first, last))))))
    if min(widest) > 0.3 * scene.length:
        return math.inf
    rest, x = X - X.mean(axis=0), moved.x - moved.x.mean(axis=0)
    turn = Rotation.align_vectors(x, rest)[0]
    return float(np.linalg.norm(x - turn.apply(rest), axis=1).max()) / scene.length


def _ends(moved: SimulationState, first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    x = moved.motion.particles()[0]
    return x[first].mean(axis=0), x[last].mean(axis=0)


def _free(**more: object) -> Scene:
    return rod(length=LENGTH, clamp="none", dynamic={}, **more)  # type: ignore[arg-type]


CASES = (
    _offsets(8),
    _offsets(64),
    Case(
        "rotation by 360 degrees",
        _free,
        "is strained by rotating, or does not come back",
        "largest strain F^T F - 1 on the way",
        _turn,
        1e-5,
        f"rigid motion: no strain but the centrifugal one, rho (w L)^2/(8 E) = {DENSITY * (TURN * LENGTH) ** 2 / 8 / (3 * G):.0e}",
    ),
    *(
        Case(
            f"det F down to 0.2, K = {ratio:g} G",
            lambda ratio=ratio: _free(ratio=ratio),  # type: ignore[misc]
            "turns particles inside out, or gains energy while it swells",
            "energy lost or gained, over that at first",
            _squeezed,
            0.02,
            f"nothing does work, and no more than {100 * GAINED:g} % may be gained",
        )
        for ratio in (5.0, 20.0)
    ),
    Case(
        "folded, held and let open",
        opening_strip,
        "keeps a bend, though nothing in it is plastic, or slowly tears while it is held",
        "distance of particles from the undeformed shape, over L",
        _opened,
        0.002,
        "a hyperelastic body without load is as it was made; damping leaves exp(-8)",
        slow=True,
    ),
)
