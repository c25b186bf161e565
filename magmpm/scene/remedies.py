"""Changes to a scene whose run failed: named in the error, and tried on thousands of scenes by `make stability RANDOM=300`."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from magmpm.compiled.arrays import Named, Plain
from magmpm.errors import BudgetError, Collapsed, Key, LeftField, SolveError, TimeOver, undotted
from magmpm.fields.over_time import Ramp
from magmpm.fields.schedule import end_time
from magmpm.scene.scene import Scene

RAMPED = {"field_steps": 40, "max_steps": 150}  # of statics: small steps, each with many iterations
SHARE_OF_REACHED = 0.9  # of the load or the time that was reached
WEAKER = (0.5, 0.1)  # of the load, where it is not known how much was borne
ENERGY = (  # how the reason of a motion begins whose steps are too long
    "energy is not conserved"
)


@dataclass(frozen=True)
class Remedy:
    """A change of a scene. words: for people; changes: by dotted key, values as `Scene.to_si` has them."""

    words: str
    changes: Named

    def applied(self, scene: Scene) -> Scene:
        """The changed scene. Raises InputError where it is not valid."""
        data = scene.to_si()
        for key, value in self.changes.items():
            _put(data, undotted(key), value)
        return Scene.from_si(data)


@contextmanager
def named(scene: Scene) -> Iterator[None]:
    """A context that adds remedies to the SolveError that leaves it, and names them in its reason."""
    try:
        yield
    except SolveError as error:
        found = remedies(scene, error)
        if not found:
            raise
        failed = type(error)(
            f"{error.reason}; to try: {'; or '.join(remedy.words for remedy in found)}", error.state
        )
        failed.remedies = found
        raise failed from None


def remedies(scene: Scene, error: SolveError) -> tuple[Remedy, ...]:
    """Changes that may bring a failed scene to an answer, the first to try first."""
    if isinstance(error, LeftField):  # smaller steps would go the same way
        return _shorter_or_weaker(scene, error)
    if isinstance(
        error, Collapsed
    ):  # of segments that attract each other, which no external field holds at a distance
        return _until(scene, error) if scene.in_time else ()
    if isinstance(error, TimeOver):  # smaller steps would take longer
        borne = 0.0 < getattr(error.state, "load_share", 0.0) < 1.0
        return (_until(scene, error) if scene.in_time else ()) or (
            _weaker(scene, error) if borne else ()
        )
    if isinstance(error, BudgetError):  # it says itself what to raise, and nothing else is wrong
        return ()
    if scene.solver.dynamic is not None:
        return _of_motion(scene, error)
    return _of_equilibria(scene, error)


def _of_motion(scene: Scene, error: SolveError) -> tuple[Remedy, ...]:
    assert scene.solver.dynamic is not None
    given = {"solver.dynamic.time_step": None}
    gentler = [
        Remedy(f"solver.dynamic.safety: {part:g}", {**given, "solver.dynamic.safety": part})
        for part in (0.4, 0.1)  # of the stable step
        if part < scene.solver.dynamic.safety
    ]
    # What flies away does so at shorter steps too (7 of 7 random scenes); energy from nothing is the steps' own.
    least = _shorter_or_weaker(scene, error)
    return (*gentler, *least) if ENERGY in error.reason else (*least, *gentler)


def _begun(error: SolveError) -> bool:
    """True if a run along time has begun; a state with part of a load is left by a path whose first equilibrium was not found."""
    return bool(getattr(error.state, "load_share", 1.0) == 1.0)


def _until(scene: Scene, error: SolveError) -> tuple[Remedy, ...]:
    """Remedy that ends what happens along time before the moment at which it went wrong."""
    reached = getattr(error.state, "time", 0.0) if _begun(error) else 0.0
    until = float(f"{SHARE_OF_REACHED * reached:.3g}")
    if not until > 0.0:
        return ()
    if scene.solver.dynamic is not None:
        more: Plain = {
            "solver.dynamic.duration": until,
            "solver.dynamic.output_every": until / 10,
        }
        return (
            Remedy(f"solver.dynamic.duration: {until:g} s, up to which the run succeeded", more),
        )
    times = scene.path_times()
    # out of time: as many steps as it took so far, for more would take longer; otherwise finer ones
    steps = sum(times[0] < t <= until for t in times) if isinstance(error, TimeOver) else len(times)
    shorter = {"steps": max(1, steps), "duration": until}
    words = (
        f"solver.quasi_static: {{steps: {shorter['steps']}, duration: {until:g} s}}, up to which "
        "the run succeeded"
    )
    return (Remedy(words, {"solver.quasi_static": shorter}),)


def _shorter_or_weaker(scene: Scene, error: SolveError) -> tuple[Remedy, ...]:
    """Remedy that ends before it went wrong, where that was not at the first step; else a weaker load."""
    return (_until(scene, error) if scene.in_time else ()) or _weaker(scene, error)


def _of_equilibria(scene: Scene, error: SolveError) -> tuple[Remedy, ...]:
    path_steps_advised = 60  # equilibria along a ramp of the field
    static = Remedy(
        f"solver.static: {{field_steps: {RAMPED['field_steps']}, max_steps:"
        f" {RAMPED['max_steps']}}}",
        {
            "solver.quasi_static": None,
            "solver.static": {**scene.to_si()["solver"]["static"], **RAMPED},
        },
    )
    if scene.solver.quasi_static is not None:
        times = scene.path_times()
        steps = {"steps": 4 * (len(times) - 1), "duration": times[-1]}
        finer = Remedy(
            f"solver.quasi_static: {{steps: {steps['steps']}}}", {"solver.quasi_static": steps}
        )
        # More equilibria helped none of 14 random paths: what falls at one of them finds no rest from nearer either.
        return *(_until(scene, error) or _weaker(scene, error)), *(
            (finer,) if _begun(error) else ()
        )
    ramp = (
        {}
        if scene.field.over_time is not None
        else {"field.over_time": {"ramp": {"duration": 1.0}}}
    )
    followed = {"solver.quasi_static": {"steps": path_steps_advised}, "solver.static": {}, **ramp}
    words = f"solver.quasi_static: {{steps: {path_steps_advised}}}" + (
        " with field.over_time: {ramp: {duration: 1 s}}" if ramp else ""
    )
    # Of 38 random scenes a ramp in small steps brought 5 to an answer, a weaker load 32, and equilibria along time none.
    return (static, *_weaker(scene, error), Remedy(words, followed))


def _weaker(scene: Scene, error: SolveError) -> tuple[Remedy, ...]:
    """A weaker field and weight, where there is no rest under the whole load: as much as was borne, or parts where that is not known."""
    share = getattr(error.state, "load_share", 1.0)
    borne = tuple(float(f"{part * share:.3g}") for part in (SHARE_OF_REACHED, WEAKER[0]))
    parts = WEAKER if share >= 1.0 else borne if share > 0.0 else (WEAKER[-1], 2e-3)
    over = scene.field.over_time
    weight = scene.effects.gravity
    ramp = (
        Ramp(duration=end_time(scene.field) or 1.0, begin=1.0)
        if over is None or over.ramp is None
        else over.ramp
    )
    found = []
    if not scene.effects.in_a_field and weight is None:  # what is moved or fed has no weaker load
        return ()
    for part in parts:
        scaled = {**ramp.model_dump(), "begin": part * ramp.begin, "end": part * ramp.end}
        changes: Plain = {"field.over_time.ramp": scaled}
        text = ", ".join(
            f"{key}: {scaled[key]:g}{' s' if key == 'duration' else ''}"
            for key in ("duration", "begin", "end")
        )
        words = f"a weaker field, field.over_time: {{ramp: {{{text}}}}}"
        if weight is not None:
            changes["effects.gravity.acceleration"] = [
                part * component for component in weight.acceleration
            ]
            words += f", and effects.gravity.acceleration times {part:g}"
        found.append(Remedy(words, changes))
    return tuple(found)


def _put(data: Any, at: Key, value: Any) -> None:
    for part in at[:-1]:
        if data[part] is None:
            data[part] = {}
        data = data[part]
    data[at[-1]] = value
