"""Samplers: which design is tried next."""
