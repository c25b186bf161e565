"""Swings of the push of a body that slides: counted in a row, by their frequency, and warned of."""

import numpy as np
import pytest
from reference.moving import block, moving_scene

from magmpm.effects import acting
from magmpm.kernels.flutter import FOUND, count_swings, flutter_warnings, no_flutter

DT = 1e-4  # s


def after(push: np.ndarray, slides: np.ndarray) -> np.ndarray:
    """What is known of the swings after steps with these pushes (N) and numbers of points that slide."""
    found = no_flutter()
    for one, sliding in zip(push, slides, strict=True):
        count_swings(found, one, sliding, DT)
    return found


def swinging(frequency: float, periods: int, least: float, most: float) -> np.ndarray:
    """A push (N) that swings between two values as a sharpened sine does."""
    t = DT * np.arange(round(periods / frequency / DT))
    return least + (most - least) * (0.5 - 0.5 * np.cos(2 * np.pi * frequency * t)) ** 2


def test_swings_from_nothing_to_twice_the_mean_are_found() -> None:
    push = swinging(80.0, 30, 0.0, 1.0)
    found = after(push, np.ones(len(push)))
    assert found[FOUND] == pytest.approx(80.0, rel=0.02)
    (told,) = flutter_warnings(found)
    assert f"{found[FOUND]:.3g} Hz" in told
    assert "loss_factor" in told


@pytest.mark.parametrize(
    ("periods", "least", "slides"),
    [(9, 0.0, 1.0), (14, 0.2, 1.0), (14, 0.0, 0.0)],
    ids=["too few", "it bears some all the time", "it sticks"],
)
def test_other_swings_are_not(periods: int, least: float, slides: float) -> None:
    push = swinging(80.0, periods, least, 1.0)
    assert not flutter_warnings(after(push, np.full(len(push), slides)))


def test_a_pause_ends_a_row() -> None:
    """Seven swings, rest for a tenth of a second, and seven more are no ten in a row."""
    row = swinging(80.0, 7, 0.0, 1.0)
    push = np.concatenate([row, np.full(1000, 0.4), row])
    assert not flutter_warnings(after(push, np.ones(len(push))))


@pytest.mark.parametrize(
    ("more", "warned"),
    [
        ({}, True),
        ({"damping": {"rate": 60.0}}, False),
        ({"viscosity": {"loss_factor": 0.1}}, False),
        ({"viscosity": {"viscosity": 0.0}}, True),
    ],
)
def test_friction_without_losses_is_warned_of(more: dict[str, object], warned: bool) -> None:
    """The warning names the number to write; slippery contact needs none."""
    for friction in (0.3, 0.0):
        ground = {"point": [0.0, 0.0, 0.0], "friction": friction}
        scene = moving_scene(block((6e-3, 6e-3, 3e-3)), {"gravity": {}, "ground": ground, **more})
        told = [text for text in acting.warnings(scene) if "without material losses" in text]
        assert len(told) == (warned and friction > 0)
        assert all("loss_factor: 0.1" in text for text in told)
