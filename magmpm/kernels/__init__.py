"""Particles to grid, grid update, grid to particles: the compiled steps of each formulation."""
