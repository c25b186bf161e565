"""Influence of an effect on a scene's answer: two runs on the coarsest grid, with the effect and without it, and the distance between them.

The answer is the equilibrium, the path or the motion that the scene asks for; an effect that it does not name is tried with its usual
settings, where it has them. Runs with one cell more tell what the grid adds to a distance that may matter: of single equilibria, which
take hundredths of a second, and elsewhere where the advice depends on it.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from magmpm.dynamics.time_loop import begin
from magmpm.effects.base import Effect
from magmpm.effects.self_contact import gap
from magmpm.errors import InputError, MagmpmError, SceneError, SolveError, significant
from magmpm.model import build
from magmpm.results.measures import Frames
from magmpm.scene import Scene
from magmpm.scene.coarsest import coarsest_cells
from magmpm.solving.precompile import prepare_kernels
from magmpm.solving.several_grids import Runs

_WHERE = {
    "walls": "tube or surface",
    "viscosity": "viscosity or branches",
}  # settings of which one is needed
ONE_ENERGY = ("magnetic_torque", "magnetic_force")
Word = Literal["keep", "drop", "add", "irrelevant"]


@dataclass(frozen=True)
class Shift:
    """value: m, the farthest that any point of the axis moves in any frame; uncertainty: m."""

    value: float
    uncertainty: float


@dataclass(frozen=True)
class EffectRow:
    """One effect.

    shift_m: the farthest that any point of the body's axis moves in the scene's answer, be it an equilibrium, equilibria along time or a
    motion, with the effect against without it; None: not known. uncertainty_m: of that. cost_percent: of a step without any effect; None
    if the effect takes no part in a step or was not measured.
    """

    effect: str
    named: bool
    shift_m: float | None
    uncertainty_m: float | None
    advice: Word
    why: str
    cost_percent: float | None = None

    def __repr__(self) -> str:
        return (
            f"Influence of {self.effect}: {in_mm(self.shift_m)} mm +- {in_mm(self.uncertainty_m)}"
            f" mm; {self.advice}: {self.why}"
        )


def in_mm(way: float | None) -> str:
    """A distance (m) as a table has it."""
    return "-" if way is None else significant(1e3 * way)


class Variants(Runs):
    """A scene and others that differ from it by their effects, each run once on a coarse grid.

    error: m, that the answer may have, what the scene requests unless given; longest: s, that a motion may take about.
    """

    def __init__(self, scene: Scene, error: float | None = None, longest: float = 4.0) -> None:
        super().__init__(scene)
        self.error = error or scene.allowed_error
        self.longest = longest
        self.cells = coarsest_cells(scene)
        self.duration = scene.duration
        if scene.solver.dynamic is not None:
            self.duration *= min(1.0, longest / motion_seconds(scene.with_cells(self.cells)))

    def shift(self, scene: Scene, other: Scene) -> Shift:
        """Distance between two variants. Raises SolveError where one has no answer or takes too long, InputError where it can't be run."""
        # of a shift: its uncertainty on the coarsest grid, 0.4 % in the middle and 2.5 % at most of 40
        # (tests/benchmarks/advice.py)
        uncertain = 0.05
        small_shift = 0.5  # of the error: a smaller shift is not looked at on another grid
        # of the error: a shift that is no nearer to it is on the same side on every grid
        close_to_error = 0.2
        moved = self._distance(scene, other, 0)
        if moved < small_shift * self.error:
            return Shift(moved, moved / 2)
        if (
            self.scene.in_time
            and not self._rough(scene, other)
            and abs(moved - self.error) > close_to_error * self.error
        ):
            return Shift(moved, uncertain * moved)
        try:
            finer = self._distance(scene, other, 1)
        except SolveError:  # it takes too long, say
            return Shift(moved, moved / 2)
        return Shift(finer, abs(finer - moved) + uncertain * finer / 2)

    def frames(self, scene: Scene, finer: int = 0) -> Frames:
        """Frames of a variant, on a grid that is finer by so many cells across than the coarsest. Raises as `shift`."""
        return self.answer(scene, self.cells + finer).frames

    def _rough(self, scene: Scene, other: Scene) -> bool:
        """True if the coarsest grid resolves a shift only roughly: where the body may touch, or by blocks of its cells."""
        kinds = scene.effects.every().items()
        touching = any(
            kind.PHASE == "contact" and getattr(scene.effects, key) for key, kind in kinds
        )
        apart = scene.effects.magnetic_interaction != other.effects.magnetic_interaction
        return touching or apart

    def _distance(self, scene: Scene, other: Scene, finer: int) -> float:
        return max(self.frames(scene, finer).distances(self.frames(other, finer)).values())

    def made(self, scene: Scene, cells: int) -> Scene:
        """Make the scene of a variant that is run, on so many cells, and shortened where it would take too long.

        Raises SolveError if a finer motion would still take too long.
        """
        moments_of_path = 9  # of a path, in equal parts, at most
        time_of_finer_grid = 5.0  # times the longest, that a motion on a finer grid may take
        # as many as a motion has without output_every: with 25 the peak of a swing fell between two
        frames_of_motion = 100
        data = scene.to_si()
        if scene.solver.dynamic is not None:
            data["solver"]["dynamic"] |= {
                "duration": self.duration,
                "output_every": self.duration / frames_of_motion,
                "time_step": None,
            }
        times = scene.path_times()
        if len(times) > moments_of_path:
            data["solver"]["quasi_static"] = {
                "at": [
                    times[i]
                    for i in np.linspace(0, len(times) - 1, moments_of_path).round().astype(int)
                ]
            }
        coarse = Scene.from_si({**data, "reference": None, "advice": "off"}).with_cells(cells)
        if (
            cells > self.cells
            and coarse.solver.dynamic is not None
            and motion_seconds(coarse) > time_of_finer_grid * self.longest
        ):
            raise SolveError("a motion on a finer grid takes too long")
        return coarse


def motion_seconds(
    scene: Scene, each_step: float = 40e-6, each_particle: float = 1 / 15e6
) -> float:
    """About what the steps of a motion take on the scene's grid, s.

    each_step: s, of any body, and each_particle: s, of each of its particles in a step, of whole runs on two cores of about 2.7 GHz
    (128 to 5 120 particles: 46 to 500 us a step).
    """
    prepare_kernels(scene)
    motion = begin(build(scene))
    steps = scene.duration / motion.dt
    return steps * (each_step + each_particle * len(motion.motion.model.density))


def variants(scene: Scene, key: str) -> tuple[Scene, Scene] | str:
    """The scene with an effect and without it; or why the effect can't act in it, in words.

    At rest in a field that varies in space torque and force come and go together.
    """
    kind = scene.effects.every()[key]
    named = getattr(scene.effects, key)
    along_time = scene.solver.quasi_static is not None and kind.ALONG_TIME
    if scene.solver.dynamic is None and kind.ONLY_IN_MOTION and not along_time:
        return "it acts in motion only"
    needed = [name for name, field in kind.model_fields.items() if field.is_required()]
    if named is None and needed:
        return f"the scene does not say its {' and '.join(needed)}"
    if key in _WHERE and named is None:
        return f"the scene does not say its {_WHERE[key]}"
    try:
        both = (
            key in ONE_ENERGY and scene.static and scene.field.varies
        )  # neither has an equilibrium without the other
        if both or (key == "magnetic_force" and scene.effects.magnetic_torque is None):
            scene = scene.with_effects(
                **{one: {} for one in (ONE_ENERGY if both else ONE_ENERGY[:1])}
            )
            named = getattr(scene.effects, key)
        having = scene if named is not None else _naming(scene, key, kind)
        if key != "self_contact" and not getattr(having.effects, key).records(
            having, 1.0, np.zeros(1) if scene.in_time else None
        ):
            return "nothing here that it could act on"
        left_out = dict.fromkeys(ONE_ENERGY if both else (key,))
        return having, scene.model_copy(
            update={"effects": scene.effects.model_copy(update=left_out)}
        )
    except InputError as error:
        return reason(error)


def _naming(scene: Scene, key: str, kind: type[Effect]) -> Scene:
    """The scene with an effect named by its usual settings. Raises InputError where it lacks what the effect needs: a density, say.

    Without the other rules of scenes, which take a millisecond and which the scene has passed.
    """
    if key == "magnetic_interaction":  # which has rules of its own
        return scene.with_effects(magnetic_interaction={})
    if key == "gravity" and not has_densities(scene):
        raise SceneError(
            "materials",
            found="a material has no density",
            rule="gravity needs one",
            remedy="add it",
        )
    return scene.model_copy(update={"effects": scene.effects.model_copy(update={key: kind()})})


def has_densities(scene: Scene) -> bool:
    """True if all materials of the body name their densities."""
    return all(
        scene.materials[region.material_name].density is not None for region in scene.regions()
    )


def advise(scene: Scene, key: str, runs: Variants) -> EffectRow:
    """Evaluate one effect, whether the scene names it or not, and say what to do."""
    named = getattr(scene.effects, key) is not None
    both = variants(scene, key)
    if isinstance(both, str):
        return EffectRow(key, named, 0.0, 0.0, "drop" if named else "irrelevant", both)
    try:
        overlap = key == "self_contact" and scene.body.shape.line is not None
        found = verdict(
            scene,
            key,
            _overlap(runs.frames(both[1]), scene.thickness) if overlap else runs.shift(*both),
            runs.error,
        )
    except SolveError as failure:
        return unknown(key, named, failure.reason)
    except MagmpmError as failure:
        return unknown(key, named, reason(failure))
    if runs.duration == scene.duration:
        return found
    # more than that is not run: the whole may be moved farther
    within = f"{found.why}, within its first {runs.duration:.2g} s"
    if found.advice in ("keep", "add"):
        return replace(found, shift_m=None, uncertainty_m=None, why=within)
    return unknown(key, named, f"a whole run takes too long, and {within}")


def verdict(scene: Scene, key: str, moved: Shift, error: float) -> EffectRow:
    """The advice that follows from a shift."""
    named = getattr(scene.effects, key) is not None
    matters = moved.value > error
    word: Word = ("keep" if matters else "drop") if named else ("add" if matters else "irrelevant")
    near = (
        " (close: within what the estimate is uncertain by)"
        if abs(moved.value - error) < moved.uncertainty
        else ""
    )
    why = (
        f"it moves the answer by {in_lengths(moved.value, scene)}, {'more' if matters else 'less'}"
        f" than {in_lengths(error, scene)}{near}"
    )
    return EffectRow(key, named, moved.value, moved.uncertainty, word, why)


def in_lengths(way: float, scene: Scene) -> str:
    """A distance (m) as a fraction of the body's length: "42 % of its length"."""
    percent = 100 * way / scene.length
    return f"{percent:.0f} % of its length" if percent >= 99.5 else f"{percent:.2g} % of its length"


def unknown(key: str, named: bool, why: str) -> EffectRow:
    """Advice where no estimate can be had: a named effect stays."""
    return EffectRow(
        key, named, None, None, "keep" if named else "irrelevant", f"not estimated: {why}"
    )


def _overlap(frames: Frames, thickness: float) -> Shift:
    """Depth (m) to which the body goes through itself without contact; 0 where it does not."""
    neighbors = 2.5  # thicknesses along the axis: points nearer than that are neighbors
    depth = 0.0
    for axis in frames.points:
        s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(axis, axis=0), axis=1))])
        straight = np.column_stack([s, 0 * s, 0 * s])
        depth = max(depth, -gap(axis, straight, thickness, neighbors * thickness, thickness))
    return Shift(depth, 0.1 * thickness if depth > 0 else 0.0)


def reason(error: MagmpmError) -> str:
    """The reason in one line of whole words: what was found, or else the rule that was broken; received values may be cut."""
    if isinstance(error, SceneError) and error.found is not None:
        return f"{error.key}: {error.found}"
    lines = str(error).splitlines()
    return next(
        (line.strip().removeprefix("rule: ") for line in lines if line.startswith("  rule: ")),
        lines[0],
    )
