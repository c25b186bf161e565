"""The Cosserat rod: fast estimates, and where statics begins."""
