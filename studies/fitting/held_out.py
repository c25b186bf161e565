"""Readings that a fit did not see: what its constants predict for them, how exactly, and how far off that is."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.studies.fitting.prediction import Prediction
from magmpm.studies.fitting.search import Fit
from magmpm.studies.fitting.table import Measured


@dataclass(frozen=True)
class HeldOut:
    """`found`: the fit with the held-out readings in place of its own. of_constants (n,): standard errors of the prediction, m or rad, that
    come from the constants' errors; half (n,): half the interval, at the fit's level, in which a reading is expected.
    """

    found: Fit
    of_constants: Array
    half: Array

    @property
    def inside(self) -> float:
        """Share of the readings that lie in their intervals."""
        return float(np.mean(np.abs(self.found.residuals) <= self.half))

    def summary(self) -> dict[str, Any]:
        """Everything as plain data, SI."""
        rows = zip(self.found.labels, self.found.residuals.tolist(), self.half.tolist(), strict=True)
        return {
            "rms_m": self.found.rms_m, "rms_rad": self.found.rms_rad, "inside": self.inside, "numbers": len(self.found.residuals),
            "readings": [
                {"table": label.table, "line": label.line, "what": label.what, "unit": "rad" if label.angle else "m",
                 "measured": label.measured, "predicted": label.simulated, "residual": residual, "half_interval": half}
                for label, residual, half in rows
            ],
        }  # fmt: skip

    def text(self) -> str:
        """One line for people."""
        angles = any(label.angle for label in self.found.labels)
        sizes = [f"{1e3 * self.found.rms_m:.3g} mm"] * (not self.found.measured.angles_alone)
        sizes += [f"{math.degrees(self.found.rms_rad):.3g} deg"] * angles
        numbers = len(self.found.residuals)
        return (
            f"  held out         {numbers} number{'s' * (numbers != 1)}, predicted with rms {' and '.join(sizes)}; "
            f"{100 * self.inside:.0f} % of them in their {100 * self.found.level:g} % intervals"
        )


def predict_held_out(found: Fit, measured: Measured) -> HeldOut:
    """Predict readings that the fit did not see. To first order in the constants' errors; a reading has the fit's noise as well.

    Raises SolveError where no equilibrium is found.
    """
    from scipy.special import ndtri, stdtrit  # what scipy.stats calls, without its half second

    prediction = Prediction(found.scene, measured, tuple(one.constant for one in found.constants))
    residuals, slopes = prediction.at(found.x)
    ratios = found.ratios if len(found.ratios) == len(measured.each) else (1.0,) * len(measured.each)
    there = replace(found, measured=measured, residuals=residuals, labels=tuple(prediction.labels), ratios=ratios)
    errors = np.array([one.error / abs(one.constant.slope(x)) for one, x in zip(found.constants, found.x.tolist(), strict=True)])
    of_constants = np.sqrt(np.einsum("ni,ij,nj->n", slopes * errors, found.correlation, slopes * errors))
    tail = 0.5 + found.level / 2
    quantile = float(ndtri(tail) if found.noise == "given" else stdtrit(found.degrees, tail))
    return HeldOut(there, of_constants, quantile * np.hypot(of_constants, [there.sigma_of(label) for label in there.labels]))
