"""What a run leaves: results, motions, measures, files."""
