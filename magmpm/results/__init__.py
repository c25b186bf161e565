"""Results of a run: results, motions, measures, files."""
