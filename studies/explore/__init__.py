"""What a scene does without a study: accuracy, effects, maps, the viewer."""
