"""View of a study in optuna-dashboard."""
