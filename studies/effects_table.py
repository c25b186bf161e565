"""What each effect, named or not, does to a scene, from estimates of its rest; and what it costs a step."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np

from magmpm import effects
from magmpm.basis import Array
from magmpm.errors import MagmpmError, SolveError
from magmpm.rod import rod_model, solve_rod
from magmpm.scene import Scene
from magmpm.simulate import run
from magmpm.surroundings import IN_MOTION

COARSE = 2  # cells across, of the run that stands in for a rod where the body is none


@dataclass(frozen=True)
class Row:
    """One effect. shift: m, farthest that a point of the body comes to rest from where it would without it; None: not known.

    cost_percent: of a step without any effect; None for what has no part in a step, or where it was not measured.
    """

    effect: str
    named: bool
    shift: float | None
    cost_percent: float | None
    says: str


@dataclass(frozen=True)
class Table:
    """All effects, in the order of their phases. length: the body's, m."""

    scene: str
    length: float
    rows: list[Row]

    def summary(self) -> dict[str, Any]:
        """Plain data, SI."""
        return asdict(self)

    def text(self) -> str:
        """The table for people; what the scene names is marked."""
        lines = ["  effect                shift mm   cost %  what it does here"]
        for row in self.rows:
            shift = "-" if row.shift is None else f"{1e3 * row.shift:.3g}"
            cost = "-" if row.cost_percent is None else f"{row.cost_percent:.0f}"
            mark = "*" if row.named else " "
            lines.append(f"{mark} {row.effect:21} {shift:>8} {cost:>8}  {row.says}")
        return "\n".join(
            [*lines, "* named in the scene; shift: of the body's rest, with the effect against without it"]
        )


class Estimates:
    """A scene's body, by its rod where it is straight, else by a coarse static run (magmpm.advice.Body)."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.line = scene.body.shape.line
        self._found: dict[str, Array] = {}

    def rest(self, scene: Scene) -> Array:
        """Points (m, 3) m of the body at equilibrium."""
        still = at_rest(scene)
        key = still.hash()
        if key not in self._found:
            if self.line is not None:
                self._found[key] = np.array(self.line.base) + solve_rod(still).position
            else:
                self._found[key] = run(still.with_cells(COARSE)).particle_position
        return self._found[key]

    @cached_property
    def frequency(self) -> float | None:
        """Of a clamped rod with the mean compliance and mass of this one: 3.516 sqrt(E I / (m L^4)), rad/s."""
        if self.line is None or not self.scene.body.shape.clamped:
            return None
        heavy = self.scene.with_effects(gravity={"acceleration": [0.0, 0.0, -1.0]}) if self._dense else None
        if heavy is None:
            return None
        rod = rod_model(at_rest(heavy))
        length = float(rod.length.sum())
        bending = length / float(np.sum(rod.length / rod.twist_bend[:, 1]))
        mass = float(np.linalg.norm(rod.weight[0])) / length
        return float(3.516 * np.sqrt(bending / (mass * length**4)))

    @property
    def _dense(self) -> bool:
        return all(self.scene.materials[p.material_name].density is not None for p in self.scene.pieces())

    @property
    def half(self) -> float:
        """From the axis to the surface, m."""
        return self.scene.thickness / 2 if self.line is not None else 0.0


def at_rest(scene: Scene) -> Scene:
    """The scene's equilibrium: without what only motion has."""
    data = scene.with_effects(**{}).to_si()
    data["effects"] = {key: value for key, value in data["effects"].items() if key not in IN_MOTION}
    return Scene.from_si({**data, "solver": {"static": data["solver"]["static"]}, "reference": None})


def survey(scene: Scene, *, measure: bool = True) -> Table:
    """Every effect there is, in this scene. measure: time steps with and without each (seconds); else cost_percent is None."""
    body, rows = Estimates(scene), []
    for key, module in effects.every().items():
        shift, says = None, "no estimate for this effect"
        if hasattr(module, "advice"):
            try:
                advice = module.advice(scene, body)
                shift, says = advice.shift, advice.says
            except SolveError as error:
                says = f"not known: {error.reason}"
            except MagmpmError as error:
                says = f"not known: {str(error).splitlines()[0]}"
        rows.append(Row(key, getattr(scene.effects, key) is not None, shift, None, says))
    return Table(scene.name, scene.length, rows)
