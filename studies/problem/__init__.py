"""What a study file says: keys, defaults, checks of each value."""
