"""Designs and paths that the rod model finds."""
