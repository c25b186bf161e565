"""How kernels are compiled, vectorized, cached and threaded."""
