"""Runs of a scene: on its own grid, on several, and the kernels that they need."""
