"""Speed of motion: particle-steps per second, and the cost of the mechanism of effects.

The body is the five-segment catheter at 8 cells across (38 400 particles), in its field; frames and checks of the motion are not counted.
"""

import statistics
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numba
import numpy as np

from magmpm.dynamics.time_loop import begin
from magmpm.dynamics.total_lagrangian import TotalMotion
from magmpm.kernels.watch import unlimited
from magmpm.model import Model, build
from magmpm.scene import Scene, load_scene
from magmpm.studies.explore.effects_costs import added_percent, costs, stepping

SCENE = Path(__file__).resolve().parents[2] / "data/scenes/five_segments.yaml"
# steps of one measurement; number of measurements, and of pairs of them
SECONDS = 0.25
REPEATS = 9
PAIRS = 5
PAIRED = 60  # pairs of short runs for the cost of an effect
STEPS = 5  # of each of these
SETTLING = 2000  # steps until the body is bent and moves


def scene(cells: int = 8) -> Scene:
    """The catheter in motion."""
    data = load_scene(SCENE).with_cells(cells).to_si()
    data["solver"]["dynamic"] = {"duration": 1.0}
    return Scene.from_si(data)


def advance(motion: TotalMotion, steps: int, dt: float, effects: tuple[Any, ...]) -> None:
    """Take a number of steps."""
    done = 0
    while done < steps:
        taken, broken = motion.advance(steps - done, dt, effects)
        done += taken
        if broken:
            raise RuntimeError("the benchmark's motion broke")


def rate(model: Model, motion: TotalMotion, dt: float) -> float:
    """Particle-steps per second: median over REPEATS."""
    particles = len(model.density)
    steps = max(3, int(SECONDS * 25e6 / particles))
    advance(motion, 3, dt, model.effects)
    found = []
    for _ in range(REPEATS):
        begun = time.perf_counter()
        advance(motion, steps, dt, model.effects)
        found.append(particles * steps / (time.perf_counter() - begun))
    return statistics.median(found)


def started(**options: Any) -> tuple[Model, TotalMotion, float]:
    """A model, its motion, and its time step."""
    model = build(scene(**options))
    moved = begin(model)
    return model, moved.motion, moved.dt


def all_threads() -> float:
    """Particle-steps per second, all threads."""
    return rate(*started())


def mechanism_percent() -> float:
    """Extra time of a step without effects, compared with a kernel without the mechanism of effects, percent."""
    import plain_total

    model, motion, dt = started()
    advance(motion, SETTLING, dt, model.effects)  # bent and moving: at rest every number is zero
    u = motion.u.copy()
    v = motion.v.copy()
    motion.model = replace(model, effects=())
    steps = int(SECONDS * 50e6 / len(model.density))

    def again() -> None:
        """Both start from the same state."""
        motion.u[:], motion.v[:] = u, v
        motion.watch[:] = unlimited()

    def plain() -> float:
        again()
        begun = time.perf_counter()
        taken = plain_total.steps_of(motion, steps, dt, motion.u, motion.v)
        seconds = time.perf_counter() - begun
        assert taken == steps
        return seconds

    def ours() -> float:
        again()
        begun = time.perf_counter()
        motion.advance(steps, dt, ())
        return time.perf_counter() - begun

    plain(), ours()
    ratios = []
    for k in range(4 * PAIRS + 1):
        one, other = (plain, ours) if k % 2 else (ours, plain)
        times = {one: one(), other: other()}
        ratios.append(times[ours] / times[plain])
    return 100 * (statistics.median(ratios) - 1)


def effect_costs() -> dict[str, float]:
    """Time that each effect alone adds to a step, in percent, measured.

    Contact is also measured for a body that touches: with the ground through the body, so that a quarter of its particles is in contact,
    and in a tube narrower than the body, so that its whole surface is in contact."""
    lying = scene()
    found = costs(lying)
    radius = lying.thickness / 2
    bare = build(lying)  # scenes whose bodies begin inside the ground or a wall are refused
    touching = {
        "ground": {"point": [0.0, 0.0, -0.4 * radius]},
        "walls": {
            "tube": {
                "radius": 0.9 * radius,
                "path": [[-lying.length, 0.0, 0.0], [2 * lying.length, 0.0, 0.0]],
            }
        },
    }
    for effect, settings in touching.items():
        touches = lying.with_effects(**{effect: settings})
        share = touching_share(touches, effect)
        if not share > 0.0:
            raise RuntimeError(f"the benchmark's body does not touch its {effect}")
        found[f"{effect}, {100 * share:.0f} % touching"] = measured(touches, effect, bare)
    return found


def touching_share(touches: Scene, effect: str) -> float:
    """Share of the points of the undeformed body's surface that are in contact."""
    from magmpm.effects.contact_law import at_rest, contact_of

    named = touches.effects.named()[effect].records(touches)
    model = build(touches.with_effects(**{effect: None}))
    x = touches.body.shape.surface(model.grid, base=not model.clamped_face).position
    return float(contact_of(named, at_rest(x))["count"]) / len(x)


def measured(scene: Scene, key: str, model: Model) -> float:
    """Percent that an effect of the scene adds to a bare step; model: of a scene with the same body that the effect does not refuse."""
    records = tuple(scene.effects.named()[key].records(scene, 1.0, np.zeros(1)))
    ours = stepping(replace(model, effects=records))
    plain = stepping(replace(model, effects=()))
    numba.set_num_threads(1)
    return added_percent(lambda: ours(STEPS), lambda: plain(STEPS), pairs=PAIRED)
