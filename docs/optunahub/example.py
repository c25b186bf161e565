"""Kowalik's and Osborne's problem (NIST StRD MGH09): four numbers, eleven readings."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import optuna

try:
    import optunahub

    module = optunahub.load_local_module(
        "samplers/gauss_newton", registry_root=str(Path(__file__).resolve().parents[2])
    )
except ImportError:  # without optunahub, from the folder itself
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
    import gauss_newton as module

Y = np.array(
    [0.1957, 0.1947, 0.1735, 0.1600, 0.0844, 0.0627, 0.0456, 0.0342, 0.0323, 0.0235, 0.0246]
)
U = np.array([4.0, 2.0, 1.0, 0.5, 0.25, 0.167, 0.125, 0.1, 0.0833, 0.0714, 0.0625])
LOW = 0.0
HIGH = 1.0
NUMBERS = [module.Number(f"b{k}", LOW, HIGH) for k in range(1, 5)]


def objective(trial: optuna.Trial) -> float:
    """The root of the sum of squares; residuals and their derivatives go with the trial."""
    b1, b2, b3, b4 = (trial.suggest_float(number.name, LOW, HIGH) for number in NUMBERS)
    above = U**2 + U * b2
    below = U**2 + U * b3 + b4
    residuals = b1 * above / below - Y
    jacobian = np.column_stack(
        [above / below, b1 * U / below, -b1 * above * U / below**2, -b1 * above / below**2]
    )
    trial.set_user_attr("residuals", residuals.tolist())
    trial.set_user_attr(
        "jacobian", (jacobian * (HIGH - LOW)).tolist()
    )  # by the number's place between its bounds, 0 to 1
    return float(np.linalg.norm(residuals))


if __name__ == "__main__":
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = optuna.create_study(sampler=module.GaussNewtonSampler(NUMBERS, seed=1))
    study.optimize(objective, n_trials=40)
    print(
        f"sum of squares {study.best_value**2:.6e} (certified: 3.075056e-04), trial {study.best_trial.number}, {study.best_params}"
    )
