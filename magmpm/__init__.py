"""magmpm: simulation and computational design of magnetic soft robots with the material point method."""

from magmpm.compiled import environment

__version__ = "0.1.0"

environment.prepare()
