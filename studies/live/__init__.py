"""A scene at hand: its numbers as sliders, and its shape as they move. `magmpm view` shows it."""

from studies.live.begin import ready
from studies.live.changes import changed, saved
from studies.live.preview import Preview, Shape
from studies.live.sliders import Control, checked, controls
from studies.live.solver import Overtaken, Solved, Solver

__all__ = ["Control", "Overtaken", "Preview", "Shape", "Solved", "Solver", "changed", "checked", "controls", "ready", "saved"]
