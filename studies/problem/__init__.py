"""Study files: keys, defaults, checks of each value."""
