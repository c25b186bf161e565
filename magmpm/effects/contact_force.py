"""The forces of contact on a point: a penalty along the normal, and Coulomb's law of friction on velocities.

The push has a potential, so impact takes no energy. Friction has no spring and no memory but its last force, from which it is sought anew:
after all other forces of a step have acted, each touching point in turn takes the impulse that stops its sliding, or as much of it as
friction times the push of this step allows. That is a sweep of Gauss and Seidel over Coulomb's law for velocities; impulses carry over to
the next step, so one sweep a step, there and back, suffices (twenty change the way of a block by 0.2 %). There alone, vibrations of what
sticks grow by 1e-4 a step. What sticks does not creep, and what rolls loses nothing, as nothing is stopped from moving along the normal.
Sources: Moreau, in Nonsmooth Mechanics and Applications, CISM 302 (1988) 1, the law for velocities at the end of a step; Jean, CMAME 177
(1999) 235, its solution point by point.

Hooks add to f (PARTS,): f[:3] the push, N; f[GRIP] the friction that it allows, N; f[RIGIDITY] the stiffness of what pushes, N/m. `push`
and `own_grip` serve one point, or eight in lanes.
"""

import math

from magmpm.compiled.jit import compiled, inlined, inner
from magmpm.compiled.simd import above, larger

GRIP, RIGIDITY, PARTS = range(3, 6)
# What is kept of a touching point: the force of friction (3,) N, of which the next step begins; the unit normal (3,) of its push; and the
# largest friction that the push allows, N.
NORMAL = 3
MOST_PUSH = 6
KEPT = 7
LEAST_FRICTION = 1e-9  # of the largest friction: a point with so little less slides


@inlined
def push(depth, s0, s1, s2, rigidity, friction, f):
    """f += the push at a depth (m), its grip and rigidity: nothing where it is not above 0.

    s: slope of the distance out of the obstacle; rigidity: as of `spring`. The push is
    times the slope's size, which a table has near 1: the exact slope of the energy.
    """
    normal = rigidity * larger(depth, 0.0)
    f[0] += normal * s0
    f[1] += normal * s1
    f[2] += normal * s2
    if friction > 0.0:
        f[GRIP] += friction * normal * math.sqrt(s0 * s0 + s1 * s1 + s2 * s2)
    f[RIGIDITY] += above(depth, 0.0, rigidity, 0.0)


@compiled
def own_grip(friction, f):
    """Give f the grip of a surface whose material has a coefficient of its own; nan: it has none, and the obstacle's counts."""
    size = math.sqrt(f[0] * f[0] + f[1] * f[1] + f[2] * f[2])
    f[GRIP] = above(friction, -1.0, friction * size, f[GRIP])


@inner
def spring(depth, s0, s1, s2, rigidity, f, H):
    """Energy (J) of the push at rest: rigidity depth^2 / 2. f (3,) += its force, H (3, 3) += rigidity s s^T.

    s: slope of the distance out of the obstacle, so minus that of the depth (m); rigidity: mass times stiffness, N/m.
    """
    s = (s0, s1, s2)
    for i in range(3):
        f[i] += rigidity * depth * s[i]
        for j in range(3):
            H[i, j] += rigidity * s[i] * s[j]
    return 0.5 * rigidity * depth * depth


@inlined
def allowed(kept, at):
    """Let the friction that is kept from index `at` on be no more than its push allows, and along the surface."""
    n0 = kept[at + NORMAL]
    n1 = kept[at + NORMAL + 1]
    n2 = kept[at + NORMAL + 2]
    out = kept[at] * n0 + kept[at + 1] * n1 + kept[at + 2] * n2
    t0 = kept[at] - out * n0
    t1 = kept[at + 1] - out * n1
    t2 = kept[at + 2] - out * n2
    size = math.sqrt(t0 * t0 + t1 * t1 + t2 * t2)
    share = kept[at + MOST_PUSH] / size if size > kept[at + MOST_PUSH] else 1.0
    kept[at] = share * t0
    kept[at + 1] = share * t1
    kept[at + 2] = share * t2


@compiled
def touches(f, kept, at):
    """Keep normal and grip of a point's push f (PARTS,) from index `at` on, and add to f[:3] the friction of the step before, as far as it
    is allowed. Returns 1 where there may be friction, else 0."""
    size = math.sqrt(f[0] * f[0] + f[1] * f[1] + f[2] * f[2])
    if not size > 0.0:
        leaves(kept, at)
        return 0.0
    for i in range(3):
        kept[at + NORMAL + i] = f[i] / size
    kept[at + MOST_PUSH] = f[GRIP]
    allowed(kept, at)
    for i in range(3):
        f[i] += kept[at + i]
    return 1.0 if f[GRIP] > 0.0 else 0.0


@inlined
def slides(kept, at):
    """1 where the friction that is kept from index `at` on is the most that its push allows, else 0."""
    size = math.sqrt(kept[at] ** 2 + kept[at + 1] ** 2 + kept[at + 2] ** 2)
    return 1.0 if size > (1.0 - LEAST_FRICTION) * kept[at + MOST_PUSH] else 0.0


@inlined
def leaves(kept, at):
    """Forget a point that does not touch."""
    for i in range(KEPT):
        kept[at + i] = 0.0


@compiled
def rubbed(kept, at, v, heft):
    """Change the kept friction toward what stops a point, as far as it is allowed. Returns by how much, N.

    v (3,) m/s: velocity along the other side as all forces would leave it, changed by 1 N more in the step by 1 / heft at most (kg/s).
    """
    f0 = kept[at]
    f1 = kept[at + 1]
    f2 = kept[at + 2]
    kept[at] -= heft * v[0]
    kept[at + 1] -= heft * v[1]
    kept[at + 2] -= heft * v[2]
    allowed(kept, at)
    return kept[at] - f0, kept[at + 1] - f1, kept[at + 2] - f2
