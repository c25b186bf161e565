"""Material constants from measurements: `fit(read_measured(path, scene), scene)`, or of several tables; docs/fitting.md."""

from magmpm.studies.fitting.report import (
    HeldOut,
    fitted_scene,
    predict_held_out,
    residuals_table,
    shown,
    summary,
    text,
)
from magmpm.studies.fitting.search import Fit, Refused, doubtful_fields, fit
from magmpm.studies.fitting.table import (
    Measurements,
    read_measured,
    read_split,
    read_tables,
    together,
)

__all__ = [
    "Fit",
    "HeldOut",
    "Measurements",
    "Refused",
    "doubtful_fields",
    "fit",
    "fitted_scene",
    "predict_held_out",
    "read_measured",
    "read_split",
    "read_tables",
    "residuals_table",
    "shown",
    "summary",
    "text",
    "together",
]
