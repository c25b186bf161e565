"""Uses of a scene without a study: accuracy, effects, maps, the viewer."""
