"""What to change in a scene whose run failed: named in the error, and tried on thousands of scenes by `magmpm stability --random`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from magmpm.errors import Key, LeftField, SolveError, undotted
from magmpm.scene.scene import Scene

RAMPED = {"field_steps": 40, "max_steps": 500}  # of statics: small steps, each with many iterations
FOLLOWED = 60  # equilibria along a ramp of the field
GENTLE = (0.4, 0.1)  # of the stable step
SHARE = 0.9  # of the load or the time that was reached


@dataclass(frozen=True)
class Remedy:
    """A change of a scene. words: for people; changes: by dotted key, values as `Scene.to_si` has them."""

    words: str
    changes: Mapping[str, Any]

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
        told = type(error)(f"{error.reason}; to try: {'; or '.join(remedy.words for remedy in found)}", error.state)
        told.remedies = found
        raise told from None


def remedies(scene: Scene, error: SolveError) -> tuple[Remedy, ...]:
    """Changes that may bring a failed scene to an answer, the first to try first."""
    if isinstance(error, LeftField):
        return _weaker(scene, error)
    if scene.solver.dynamic is not None:
        return _of_motion(scene, error)
    return _of_equilibria(scene)


def _of_motion(scene: Scene, error: SolveError) -> tuple[Remedy, ...]:
    assert scene.solver.dynamic is not None
    given = {"solver.dynamic.time_step": None}
    found = [
        Remedy(f"solver.dynamic.safety: {part:g}", {**given, "solver.dynamic.safety": part})
        for part in GENTLE
        if part < scene.solver.dynamic.safety
    ]
    reached = getattr(error.state, "time", 0.0)
    if reached > 0.0:
        until = float(f"{SHARE * reached:.3g}")
        more = {"solver.dynamic.duration": until, "solver.dynamic.output_every": until / 10}
        found.append(Remedy(f"solver.dynamic.duration: {until:g} s, up to which it went well", more))
    return tuple(found)


def _of_equilibria(scene: Scene) -> tuple[Remedy, ...]:
    static = Remedy(
        f"solver.static: {{field_steps: {RAMPED['field_steps']}, max_steps: {RAMPED['max_steps']}}}",
        {"solver.quasi_static": None, "solver.static": {**scene.to_si()["solver"]["static"], **RAMPED}},
    )
    if scene.solver.quasi_static is not None:
        times = scene.path_times()
        steps = {"steps": 4 * (len(times) - 1), "duration": times[-1]}
        return Remedy(f"solver.quasi_static: {{steps: {steps['steps']}}}", {"solver.quasi_static": steps}), static
    ramp = {} if scene.field.over_time is not None else {"field.over_time": {"ramp": {"duration": 1.0}}}
    followed = {"solver.quasi_static": {"steps": FOLLOWED}, "solver.static": {}, **ramp}
    words = f"solver.quasi_static: {{steps: {FOLLOWED}}}" + (" with field.over_time: {ramp: {duration: 1 s}}" if ramp else "")
    return static, Remedy(words, followed)


def _weaker(scene: Scene, error: SolveError) -> tuple[Remedy, ...]:
    """A body that is pulled into a magnet has no equilibrium before it: the load that it can bear is what can be asked for."""
    return ()


def _put(data: Any, at: Key, value: Any) -> None:
    for part in at[:-1]:
        if data[part] is None:
            data[part] = {}
        data = data[part]
    data[at[-1]] = value
