"""Shapes to particles: grids, splines and exact quadrature."""
