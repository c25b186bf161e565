"""The memory that a scene needs, known before any of it is allocated: a scene far too large is refused at once."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from magmpm.errors import SceneError
from magmpm.scene import Scene

# Bytes by which a process grows for each particle of a motion and its share of the grid: 860 were measured by tests/benchmarks/resident.py.
# Most of it is needed while the scene is built; a part of that may not be given back.
BYTES_PER_PARTICLE = 850
# a lower bound of the same, for where only a lower bound of the number of particles is known
BYTES = 800


def fewest_particles(scene: Scene) -> float:
    """A lower bound of the number of the scene's particles, without making them (BodyShape.fewest_particles)."""
    return scene.body.shape.fewest_particles(
        scene.resolution.cells_across, scene.resolution.particles_per_cell, around=scene.static
    )


@contextmanager
def within(scene: Scene) -> Iterator[None]:
    """A context in which to build a scene's model.

    Raises SceneError if the model needs more than max_memory or the machine has: by a lower bound first, and if an allocation fails.
    """
    particles = fewest_particles(scene)
    needed = BYTES * particles
    dynamic = scene.solver.dynamic
    estimate = f"{_in_words(needed)} for {particles:.3g} particles"
    if dynamic is not None and dynamic.max_memory is not None and needed > dynamic.max_memory:
        raise SceneError(
            "solver.dynamic.max_memory",
            received=f"{dynamic.max_memory / 1e6:.4g} MB",
            rule=(
                "must be at least the memory of this scene's particles and grid, estimated at "
                f"least {estimate}"
            ),
            remedy="raise it, or use fewer cells_across",
        )
    if needed > machine():
        raise _too_large(
            scene,
            f"particles and grid take at least {estimate}, and this machine has"
            f" {_in_words(machine())}",
        )
    try:
        yield
    except MemoryError as error:
        raise _too_large(
            scene,
            (
                f"particles and grid take at least {estimate}, which could not be "
                f"allocated ({error})"
            ),
        ) from None


@contextmanager
def for_matrix(scene: Scene, size: float) -> Iterator[None]:
    """A context in which to make the matrix of a scene's equilibrium, of so many bytes. Raises SceneError as `within` does."""
    if size > machine():
        raise _too_large(
            scene,
            f"the matrix of its equilibrium takes {_in_words(size)}, and this machine has"
            f" {_in_words(machine())}",
        )
    try:
        yield
    except MemoryError:
        raise _too_large(
            scene,
            (
                f"the matrix of its equilibrium takes {_in_words(size)}, which could not "
                "be allocated"
            ),
        ) from None


def machine() -> float:
    """Memory of this machine, bytes; infinite where it does not say."""
    try:
        return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, OSError, ValueError):
        return np.inf


def _too_large(scene: Scene, found: str) -> SceneError:
    key, received, change = scene.body.shape.cell_setting(scene.resolution.cells_across)
    count = scene.resolution.particles_per_cell
    return SceneError(
        key,
        received=received,
        found=found,
        rule="a scene's particles and grid must fit into memory",
        remedy=f"use {change}"
        + (f", or fewer particles_per_cell ({count} now; 2 is the least)" if count > 2 else ""),
    )


def _in_words(size: float) -> str:
    return f"{size / 1e9:.3g} GB" if size >= 1e9 else f"{size / 1e6:.3g} MB"
