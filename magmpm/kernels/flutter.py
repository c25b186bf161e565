"""Flutter: the push of a body that slides swings between nothing and more than twice its mean, again and again.

Coulomb's law has no unique answer where bounce and shear of an elastic body feed each other without losses, so how far such a body slides
depends on cells and losses (Martins, Oden, Simoes, Int. J. Eng. Sci. 28 (1990) 29). Kernels count the swings in every step.

`flutter` (NUMBERS,) float64 is both input and output.
"""

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.compiled.jit import compiled

# TIME s, of all steps; IMPULSE N s, of the push since the swings in a row BEGUN (s); LOW: 1 after the push was next to nothing; SLID: 1
# if something has slid since the last swing; SWINGS in a row, the FIRST and the LAST of them (s); FOUND 1/s: frequency of the longest row
# of at least PERIODS_OF_FLUTTER, 0 for none.
TIME, IMPULSE, BEGUN, LOW, SLID, SWINGS, FIRST, LAST, FOUND, NUMBERS = range(10)
NO_PUSH = 0.05  # of the mean push: next to nothing
PERIODS_OF_FLUTTER = 10
QUIET = 5.0  # periods without a swing end a row


def no_flutter() -> Array:
    """Numbers of a motion that begins."""
    return np.zeros(NUMBERS)


@compiled
def count_swings(flutter, push, slides, dt):
    """Count the swings of the push (N, the sum of all points' with friction) in a step of dt (s). slides: number of points that slide."""
    flutter[TIME] += dt
    now = flutter[TIME]
    swings = flutter[SWINGS]
    period = (flutter[LAST] - flutter[FIRST]) / (swings - 1.0) if swings > 1.0 else np.inf
    if now - flutter[LAST] > QUIET * period:
        swings = 0.0
        flutter[IMPULSE] = 0.0
        flutter[BEGUN] = now - dt
    flutter[IMPULSE] += push * dt
    mean = flutter[IMPULSE] / (now - flutter[BEGUN])
    if slides > 0.0:
        flutter[SLID] = 1.0
    if push < NO_PUSH * mean:
        flutter[LOW] = 1.0
    elif flutter[LOW] > 0.0 and push > 2.0 * mean:
        swings = swings + 1.0 if flutter[SLID] > 0.0 else 0.0
        if swings <= 1.0:
            flutter[FIRST] = now
        flutter[LAST] = now
        flutter[LOW] = 0.0
        flutter[SLID] = 0.0
        if swings >= PERIODS_OF_FLUTTER:
            flutter[FOUND] = (swings - 1.0) / (now - flutter[FIRST])
    flutter[SWINGS] = swings


def flutter_warnings(flutter: Array) -> list[str]:
    """One sentence if a motion fluttered, else none."""
    if not flutter[FOUND] > 0.0:
        return []
    return [
        f"the body flutters while it slides: its contact force oscillates at {flutter[FOUND]:.3g} "
        "Hz between zero and more than twice its mean. The sliding distance then depends on "
        "material losses and on the cell size: name losses (`viscosity: {loss_factor: 0.1}`) "
        "or increase them, and compare with another number of cells_across"
    ]
