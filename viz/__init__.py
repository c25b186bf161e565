"""Pictures, plots and movies. Nothing heavy is imported here: drawing happens in a process of its own."""
