"""Compile, vectorize, cache and thread the kernels."""
