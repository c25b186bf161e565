"""Static equilibrium: Newton's method on the potential energy."""
