"""The force of contact on a point: a penalty along the normal, and Coulomb friction that holds by a spring.

Hooks add to f (9,), N but for the last: f[:3] the force; f[3:6] the grip, friction coefficient times the push along the normal; f[6] the
stiffness of what pushes, N/m. f[7], f[8] are given: the body's thickness (m) at the point, and the time (s) of a shear wave through it.

Friction has a memory: the anchor, the place (3,) m at which the obstacle holds the point. A spring as stiff as the contact pulls the point
toward it, along the obstacle. Where the spring would pull more than the grip, the point slides and draws the anchor along. So a
body sticks without creeping, within friction times the depth of contact, micrometers; friction never adds energy; and the answer does not
depend on the time step, as it does where friction may at most stop a point within a step (in a violent motion by a tenth).
A dashpot along the normal, while the point slides, keeps undamped bodies from chattering and slipping when their weight is off the
ground. It takes or adds no more than the spring pushes, so it begins at nothing where a point comes in. And what holds a point is its
lasting grip, which follows the push with a delay: m + (m - mm) / 2, where m is the mean of the push since the point touched, later over the
period of the slowest shear oscillation of a layer as thick as the body; and mm is the mean of m. (All of the trend m - mm would not lag on
a ramp, but swing past a step by 14 %, half of it by 2 %.) Where friction follows at once, bounce and shear of an elastic body feed each
other without end. But what lags while a body slides feeds its slower vibrations: so over the first micrometers of a slide the delay
shrinks to a part; a point that sticks again regains it as time goes on. A point that has left forgets in the time of its mean.
Sources: Cundall and Strack, Geotechnique 29 (1979) 47, the tangential spring with a slider; Hunt and Crossley, J. Appl. Mech. 42 (1975)
440, a dashpot that begins at nothing; Prakash and Clifton, J. Appl. Mech. 60 (1993), and Cochard and Rice, J. Geophys. Res. 105 (2000)
25891, friction that follows the push with a delay; Brown, Smoothing, Forecasting and Prediction (1963), chapter 9, the mean of a mean.
"""

import math

import numpy as np

from magmpm.compiled.jit import compiled

PARTS = 9  # numbers in f
# times that a shear wave takes through the thickness: the period of the slowest shear oscillation
# of a layer held at one face
DELAY = 4.0
# thicknesses of the body: the way after which a slide has but this part of the delay
FAR = 0.01
SHORT = 1 / 16
# numbers that friction remembers of a point: anchor (3,) m; how it touches (STICKS; -STICKS: it
# slides; 0: not at all);
HELD = 8
# the mean of its grip, N; over what time, s; the mean of that mean, N; how far it has slid since it stuck, m
TOUCHES = 3
STICKS = 1.0


@compiled
def push(depth, n0, n1, n2, leaving, mass, stiffness, layer, knee, damping, friction, f):
    """f += the push along n and its grip. n: unit normal out of the obstacle; leaving: speed along it, m/s; depth m; damping 1/s.

    The spring's stiffness over mass rises from layer (m) over thickness times stiffness (1/s^2) at the surface to all of it at the depth
    `knee` (m); a layer as thick as the body or thicker: all of it everywhere.
    """
    rigidity = mass * stiffness
    soft = layer / f[7] if layer < f[7] else 1.0
    rest = depth * depth / (2.0 * knee) if depth < knee else depth - 0.5 * knee
    elastic = rigidity * (soft * depth + (1.0 - soft) * rest)
    normal = elastic - min(max(mass * damping * leaving, -elastic), elastic)
    grip = friction * normal
    f[0] += normal * n0
    f[1] += normal * n1
    f[2] += normal * n2
    f[3] += grip * n0
    f[4] += grip * n1
    f[5] += grip * n2
    f[6] += rigidity


@compiled
def own_grip(friction, f):
    """Give f the grip of a surface whose material has a coefficient of its own; nan: it has none, and the obstacle's counts."""
    if friction >= 0.0:
        for i in range(3):
            f[3 + i] = friction * f[i]


def stored(depth, rigidity, layer, thickness, knee):
    """Energy (J) of the springs of `push`; rigidity: mass times stiffness, N/m. Of one, or of arrays (n,)."""
    soft = layer / np.maximum(thickness, layer)
    below = np.minimum(depth, knee)
    above = np.maximum(depth - knee, 0.0)
    return rigidity * (
        0.5 * soft * depth**2
        + (1.0 - soft) * (below**3 / (6.0 * knee) + 0.5 * above * (above + knee))
    )


@compiled
def spring(depth, s0, s1, s2, rigidity, f, H):
    """Energy (J) of the push at rest, without friction: rigidity depth^2 / 2. f (3,) += its force, H (3, 3) += rigidity s s^T.

    s: slope of the distance out of the obstacle, so minus that of the depth (m); rigidity: mass times stiffness, N/m.
    """
    s = (s0, s1, s2)
    for i in range(3):
        f[i] += rigidity * depth * s[i]
        for j in range(3):
            H[i, j] += rigidity * s[i] * s[j]
    return 0.5 * rigidity * depth * depth


@compiled
def let_go(held, dt):
    """Forget a point that does not touch, as slowly as it was learned: one that hops is nearly the same as it lands. Returns s left."""
    held[TOUCHES], held[5] = 0.0, max(held[5] - dt, 0.0)
    for i in range(HELD):
        held[i] = held[i] if held[5] > 0.0 else 0.0
    return held[5]


@compiled
def hold(x, v, depth, held, f, dt):
    """Add the friction of f's grip to f[:3], for a point at x (3,) m of velocity v (3,) m/s at a depth (m), and a step of dt (s), and
    change what is remembered of it, held (HELD,): the anchor, whether it slides, or nothing grips it, and the delay's numbers.
    """
    grip = math.sqrt(f[3] * f[3] + f[4] * f[4] + f[5] * f[5])
    rigidity = f[6]
    new = held[TOUCHES] == 0.0
    held[TOUCHES] = -STICKS
    if not grip > 0.0:
        for i in range(3):
            held[i] = x[i]
        return
    n0 = f[3] / grip
    n1 = f[4] / grip
    n2 = f[5] / grip
    if new:
        leaving = v[0] * n0 + v[1] * n1 + v[2] * n2
        since = min(dt, depth / -leaving) if leaving < 0.0 else 0.0
        for i in range(3):
            held[i] = x[i] - since * v[i]
    s0 = x[0] - held[0]
    s1 = x[1] - held[1]
    s2 = x[2] - held[2]
    away = s0 * n0 + s1 * n1 + s2 * n2
    s0 = s0 - away * n0
    s1 = s1 - away * n1
    s2 = s2 - away * n2
    pull = rigidity * math.sqrt(s0 * s0 + s1 * s1 + s2 * s2)
    far = FAR * f[7]
    delay = DELAY * f[8] * (1.0 - (1.0 - SHORT) * held[7] / far if held[7] < far else SHORT)
    time = min(held[5] + dt, max(delay, dt))
    mean = held[4] + dt / time * (grip - held[4])
    again = held[6] + dt / time * (mean - held[6])
    most = max(mean + 0.5 * (mean - again), 0.0)
    if pull > most:
        s0 = s0 * (most / pull)
        s1 = s1 * (most / pull)
        s2 = s2 * (most / pull)
        held[7] += (pull - most) / rigidity
    else:
        held[TOUCHES], held[7] = STICKS, 0.0
    held[4], held[5], held[6] = mean, time, again
    held[0], held[1], held[2] = x[0] - s0, x[1] - s1, x[2] - s2
    f[0] -= rigidity * s0
    f[1] -= rigidity * s1
    f[2] -= rigidity * s2
