"""Material constants from measurements: `fit(read_measured(path, scene), scene)`; docs/fitting.md."""

from studies.fitting.report import fitted_scene, residuals_table, shown, summary, text
from studies.fitting.search import Fit, Refused, fit
from studies.fitting.table import Measured, read_measured

__all__ = ["Fit", "Measured", "Refused", "fit", "fitted_scene", "read_measured", "residuals_table", "shown", "summary", "text"]
