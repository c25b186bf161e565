"""A scene at hand: its numbers as sliders, and its shape as they move. `magmpm view` shows it."""

from magmpm.studies.live.changes import changed, ready, saved
from magmpm.studies.live.preview import Preview, Shape
from magmpm.studies.live.sliders import Control, checked, controls
from magmpm.studies.live.solver import Overtaken, Solved, Solver

__all__ = ["Control", "Overtaken", "Preview", "Shape", "Solved", "Solver", "changed", "checked", "controls", "ready", "saved"]
