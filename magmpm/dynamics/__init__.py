"""Motion in time: explicit time stepping in two formulations over the same particles, splines and effects."""
