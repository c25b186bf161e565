"""The compiled code's formulas in plain NumPy: neo-Hookean energy and stress, and a banded matrix written out."""

import numpy as np
from numpy.typing import NDArray

from magmpm.compiled.arrays import Array


def neo_hookean_reference(F: np.ndarray, G: float, K: float) -> tuple[float, np.ndarray]:
    """Energy density (J/m^3) and stress P (3, 3) Pa, written as the formula stands."""
    J = np.linalg.det(F)
    I1 = np.sum(F * F)
    H = np.linalg.inv(F).T
    W = G / 2 * (J ** (-2 / 3) * I1 - 3) + K / 2 * (J - 1) ** 2
    return W, G * J ** (-2 / 3) * (F - I1 / 3 * H) + K * J * (J - 1) * H


def to_dense(panels: Array, split: int) -> NDArray[np.float64]:
    """The symmetric matrix (planes m, planes m) of unfactored panels."""
    planes = panels.shape[0] - 2
    m = panels.shape[1]
    full = np.zeros((planes, m, planes, m))
    for j in range(planes):
        step = 1 if j < split + 2 else -1
        for k in range(3):
            row = j + step * k
            if 0 <= row < planes and not (split <= j < split + 2 and row >= split + 2):
                block = panels[j, :, k * m : (k + 1) * m].T
                if k == 0:
                    block = np.tril(block) + np.tril(block, -1).T
                full[row, :, j, :] = block
                full[j, :, row, :] = block.T
    return full.reshape(planes * m, planes * m)
