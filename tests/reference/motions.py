"""Motions in closed form, written like those of a run, for tests of the files and pictures of a motion."""

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.results import hdf5_mark
from magmpm.results.trajectory import Instant, MotionWriter

LENGTH = 0.04
DIAMETER = 0.004
SHEAR = 120e3
DENSITY = 1882.0


def body(spacing: float = 1e-3, segments: int = 3) -> SimpleNamespace:
    """A stand-in for a catheter's model of LENGTH and DIAMETER along +x: particles with this spacing (m), magnetized along x, y, x, ..."""
    along = (np.arange(round(LENGTH / spacing)) + 0.5) * spacing
    across = (np.arange(round(DIAMETER / spacing)) + 0.5) * spacing - DIAMETER / 2
    X = np.stack(
        [grid.ravel() for grid in np.meshgrid(along, across, across, indexing="ij")], axis=1
    )
    X = X[np.hypot(X[:, 1], X[:, 2]) < DIAMETER / 2]
    segment = (X[:, 0] * segments / LENGTH).astype(np.int32)
    particles = SimpleNamespace(position=X, volume=np.full(len(X), spacing**3), segment=segment)
    return SimpleNamespace(
        particles=particles, remanence=0.138 * np.eye(3)[segment % 2], scene=None
    )


def bending(
    model: SimpleNamespace, times: Array, most: float = 60.0, period: float = 0.4
) -> Iterator[Instant]:
    """Circular bending in the x-z plane with the curvature most sin(2 pi t / period) (1/m): sections stay plane and undistorted."""
    X = model.particles.position
    V = model.particles.volume
    for time in times:
        phase = 2 * np.pi * time / period
        k = most * np.sin(phase)
        rate = most * 2 * np.pi / period * np.cos(phase)
        x, F = bent(X, k)
        ahead = bent(X, k + 1e-4)[0]
        behind = bent(X, k - 1e-4)[0]
        v = (ahead - behind) / 2e-4 * rate
        P = SHEAR * (F - np.linalg.inv(F).transpose(0, 2, 1))
        field = 8e-3 * np.array([np.cos(phase), 0.0, np.sin(phase)])
        elastic = (
            0.5
            * SHEAR
            * np.sum(V * (np.einsum("nij,nij->n", F, F) - 3 - 2 * np.log(np.linalg.det(F))))
        )
        down = max(float(-(x[:, 2] + 0.006).min()), 0.0)
        kinetic = 0.5 * DENSITY * float(V @ (v**2).sum(axis=1))
        energies = {
            "kinetic": kinetic,
            "elastic": float(elastic),
            "magnetic_torque": -1e-6 * float(np.sin(phase)),
        }
        contacts = {
            "ground": {
                "force": np.array([0.0, 0.0, 1e3 * down]),
                "count": int(1e6 * down),
                "depth": down,
            }
        }
        yield Instant(float(time), x, v, F, P, energies, contacts, field)


def bent(X: Array, curvature: float) -> tuple[Array, Array]:
    """Positions (n, 3) m and deformation gradients (n, 3, 3) of a rod along +x that is bent to a circle in the x-z plane."""
    k = curvature if abs(curvature) > 1e-9 else 1e-9
    s = X[:, 0]
    z = X[:, 2]
    sin = np.sin(k * s)
    cos = np.cos(k * s)
    x = np.stack([sin / k - z * sin, X[:, 1], (1 - cos) / k + z * cos], axis=1)
    F = np.zeros((len(X), 3, 3))
    F[:, 0, 0], F[:, 0, 2] = (1 - k * z) * cos, -sin
    F[:, 2, 0], F[:, 2, 2] = (1 - k * z) * sin, cos
    F[:, 1, 1] = 1.0
    return x, F


def write(writer: MotionWriter, moments: Iterator[Instant]) -> None:
    """Pass moments to a writer."""
    for m in moments:
        writer.frame(m)


def written(folder: Path, frames: int = 9, spacing: float = 1e-3) -> Path:
    """A whole motion in a folder: one period of bending."""
    model = body(spacing)
    write(MotionWriter(folder, model), bending(model, np.linspace(0.0, 0.4, frames)))
    return folder


def von_mises(cauchy: Array) -> Array:
    """Von Mises stress (n,) Pa of the symmetric part of stresses (n, 3, 3) Pa: sqrt(3/2 s:s), s its deviator."""
    s = 0.5 * (cauchy + cauchy.transpose(0, 2, 1))
    s = s - np.trace(s, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
    return np.asarray(np.sqrt(1.5 * np.einsum("nij,nij->n", s, s)))


def as_left_by_a_kill(whole: bytes) -> bytes:
    """An HDF5 file with the mark of a writer, as during the writing of a frame."""
    block = whole[:11] + bytes([5]) + whole[12:44]
    return block + hdf5_mark.lookup3(block).to_bytes(4, "little") + whole[48:]
