"""Particles to grid, grid update, grid to particles: the compiled steps of a motion, and those of statics."""
