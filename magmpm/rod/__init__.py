"""The Cosserat rod: fast estimates, and the start for statics."""
