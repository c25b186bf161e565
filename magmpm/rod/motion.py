"""A rod in motion: a catheter or strip with everything that acts on it, in hundredths of a second. For estimates; not for results.

The geometrically exact rod with stretch, shear, bending and twist, in straight elements, by explicit steps (semi-implicit Euler):

    E = sum_elements l (1/2 s.S s - B.(m0 x' + m_t)) + sum_nodes 2/l z.D z,    s = R^T x' - e_1,  z = the vector of conj(q_e) q_(e+1)

with x' = (x_(e+1) - x_e) / l and the moments of magmpm.rod.cosserat. Losses in the material add a time eta / G to every strain's rate.
Ground and wall push nodes as discs of the rod's thickness. The rotary inertia of an element is raised to that of an eighth of its length
squared where it is less: that leaves the lowest motions as they are, and allows longer steps.
Sources: Simo and Vu-Quoc, Comput. Methods Appl. Mech. Eng. 58 (1986) 79-116; in elements, Gazzola, Dudte, McCormick, Mahadevan, R. Soc.
Open Sci. 5 (2018) 171628.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from magmpm.bodies.segments import StraightBody
from magmpm.compiled.arrays import Array
from magmpm.errors import SolveError
from magmpm.fields.schedule import places
from magmpm.rod.cosserat import RodModel, rod_model, segment_counts
from magmpm.rod.motion_kernels import ELEMENT, SURROUNDINGS, State, advance
from magmpm.rod.mutual import MutualField
from magmpm.scene import Scene
from magmpm.scene.coarsest import knots_of

FEWEST, MOST = 12, 40  # elements
BUDGET = 1_500_000  # elements times steps: a third of a second
SHARE = 0.45  # of the largest stable step
LOOKS = 200  # moments at which fields that vary in space, and the shape, are taken
FIRM = 0.05  # of the square of the highest frequency: the contact's


@dataclass(frozen=True)
class RodPath:
    """Places (k, n + 1, 3) m of the nodes at times (k,) s; s (n + 1,) m: arc length of the nodes; step s; steps of the whole motion."""

    times: Array
    position: Array
    s: Array
    step: float
    steps: int


def move_rod(scene: Scene, *, coarser: int = 0) -> RodPath:
    """The scene's motion by its rod, in LOOKS equal parts of its time, with as many elements as the budget allows.

    coarser: how many times these are halved; once, the guide of a feed ends at its exit, not at the nodes of the run. Raises SolveError
    where the body is no rod, or the motion needs more steps than the budget allows.
    """
    for count in range(MOST, FEWEST - 1, -4):
        parts, counts, dt = _elements(scene, count)
        steps = int(np.ceil(scene.duration / dt / LOOKS))
        if steps * LOOKS * len(parts) <= BUDGET:
            break
    else:
        raise SolveError(f"a motion of {steps * LOOKS} steps is too long to be estimated")
    if coarser:
        parts, counts, dt = _elements(scene, count // 2**coarser)
        steps = int(np.ceil(scene.duration / dt / LOOKS))
    exits = guide_ends(scene, (np.arange(LOOKS) + 0.5) * scene.duration / LOOKS, held_by_nodes=coarser != 1)
    return _follow(scene, parts, counts, scene.duration / LOOKS / steps, steps, exits)


def _elements(scene: Scene, count: int) -> tuple[NDArray[np.void], NDArray[np.int64], float]:
    """The elements, how many of each segment, and the largest step, s."""
    shape = scene.body.shape
    if not isinstance(shape, StraightBody):
        raise SolveError("a body made of parts is not a rod")
    # with moments and weight, whether the scene has an outside field turn them and gravity act on it or not
    heavy = scene.with_effects(gravity={"acceleration": [0.0, 0.0, -1.0]}, magnetic_torque={})
    rod: RodModel = rod_model(heavy, count)
    regions, counts = shape.regions(), segment_counts(shape, count)
    softest = np.repeat([scene.materials[region.material_name].shear_modulus for region in regions], counts)
    viscosity = scene.effects.viscosity
    if viscosity is not None and viscosity.branches:
        raise SolveError("a rod knows no branches of viscosity")
    out = np.zeros(len(rod.length), ELEMENT)
    mass = np.linalg.norm(rod.weight[:-1] - rod.weight[1:], axis=1)
    out["length"], out["bend"], out["stretch"], out["moment"] = rod.length, rod.twist_bend, 1.0 / rod.compliance, rod.moment
    out["mass"] = mass / 2
    out["loss"] = 0.0 if viscosity is None else viscosity.viscosity / softest
    across = rod.twist_bend[:, 1:] * rod.compliance[:, :1]  # second moments over the area, m^2
    inertia = np.maximum(across, rod.length[:, None] ** 2 / 8)
    out["inertia"] = mass[:, None] * np.column_stack([inertia.sum(axis=1), inertia])
    moves = 4.0 * out["stretch"].max(axis=1) / (rod.length * np.minimum(mass, np.roll(mass, 1)))
    turns = (out["stretch"][:, 1:].max(axis=1) * rod.length)[:, None] + 8.0 * rod.twist_bend / rod.length[:, None]
    highest = float(np.sqrt((moves + (turns / out["inertia"]).max(axis=1)).max()))
    lost = float(out["loss"].max()) * highest / 2
    return out, counts, SHARE * 2.0 * (np.sqrt(1.0 + lost**2) - lost) / highest


def _surroundings(scene: Scene, dt: float) -> tuple[NDArray[np.void], Array]:
    """Record of the clamps, guide and obstacles of the rod, and the wall's table."""
    named, out = scene.effects, np.zeros(1, SURROUNDINGS)
    clamp = scene.body.shape.clamp
    out["held_base"] = clamp in ("base", "both") and named.feed is None
    out["held_tip"] = clamp == "both" and named.feed is None
    out["damping"] = 0.0 if named.damping is None else named.damping.rate
    out["half"], out["stiffness"] = scene.thickness / 2, FIRM * (2.0 / dt) ** 2
    table = np.zeros(1)
    if named.feed is not None:
        out["fed"], out["feed_speed"], out["feed_radius"] = 1, named.feed.speed, 2 * scene.thickness
    if named.ground is not None:
        out["ground"], out["ground_point"], out["ground_normal"] = 1, named.ground.point, named.ground.normal
        out["ground_friction"] = named.ground.friction
    if named.walls is not None:
        record, table = named.walls.records(scene)
        out["walls"], out["walls_friction"] = 1, named.walls.friction
        for key in ("walls_origin", "walls_spacing", "walls_shape"):
            out[key] = record[key]
    return out, table


def guide_ends(scene: Scene, times: Array, *, held_by_nodes: bool) -> Array:
    """End of the guide of a feed on the x axis at times (k,) s, m; infinite without one.

    held_by_nodes: at the last plane of nodes that it holds in the run (effects.feed), up to half a cell from its exit; at the exit itself
    otherwise, and where the cells are not chosen yet.
    """
    feed, shape = scene.effects.feed, scene.body.shape
    if feed is None or not held_by_nodes or scene.resolution.asked or not isinstance(shape, StraightBody):
        return np.full(len(times), np.inf if feed is None else feed.exit)
    x = shape.grid(scene.resolution.cells_across, knots_of(scene)).node_coordinates(0) + feed.speed * times[:, None]
    return np.asarray(np.where(x < feed.exit + scene.cell / 2, x, -np.inf).max(axis=1))


def _follow(scene: Scene, elements: NDArray[np.void], counts: NDArray[np.int64], dt: float, steps: int, exits: Array) -> RodPath:
    line = scene.body.shape.line
    assert line is not None  # only straight bodies are rods
    n = len(elements)
    s = np.concatenate([[0.0], np.cumsum(elements["length"])])
    quaternions = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
    x = np.array(line.base) + s[:, None] * [1.0, 0.0, 0.0]
    state = State(x, np.zeros((n + 1, 3)), quaternions, np.zeros((n, 3)), np.zeros((n + 2, 6)), x.copy())
    around, table = _surroundings(scene, dt)
    outside = _Outside(scene, elements, counts)
    times = np.linspace(0.0, LOOKS * steps * dt, LOOKS + 1)
    position = np.empty((LOOKS + 1, n + 1, 3))
    position[0] = state.x
    field, load = outside.at(state, times[0])
    for k in range(LOOKS):
        after, next_load = outside.at(state, times[k + 1])
        around["feed_exit"] = exits[k]
        advance(state, elements, np.stack([field, after]), load, around, table, dt, steps)
        if not np.isfinite(state.x).all():
            raise SolveError(f"the rod's motion is unstable at {times[k + 1]:.3g} s")
        position[k + 1], field, load = state.x, after, next_load
    return RodPath(times, position, s, dt, LOOKS * steps)


class _Outside:
    """Loads along the rod: the outside field, what it pulls, weight, and the segments on each other."""

    def __init__(self, scene: Scene, elements: NDArray[np.void], counts: NDArray[np.int64]) -> None:
        self.scene, self.elements = scene, elements
        named = scene.effects
        weight = np.zeros(3) if named.gravity is None else np.array(named.gravity.acceleration)
        mass = np.zeros(len(elements) + 1)
        mass[:-1] += elements["mass"]
        mass[1:] += elements["mass"]
        self.weight = mass[:, None] * weight
        self.acts = scene.effects.in_a_field and scene.field.acts
        self.source = scene.outside_field() if self.acts and scene.field.varies else None
        several = named.magnetic_interaction is not None and len(scene.magnetized_regions()) > 1
        self.mutual = MutualField(scene, counts, elements["length"]) if several else None

    def at(self, state: State, time: float) -> tuple[Array, Array]:
        """Field (n, 3) T on the elements; force (n + 1, 3) N on the nodes, and below it couple (n, 3) N m on the elements."""
        named, middle = self.scene.effects, (state.x[1:] + state.x[:-1]) / 2
        field, pull = np.zeros_like(middle), np.zeros_like(middle)  # pull: N/m
        couple = np.zeros_like(middle)  # N
        if self.acts and named.magnetic_torque is not None:
            uniform = places(self.scene.field, np.array([time]))[0]["uniform"]
            field = field + (uniform if self.source is None else self.source.at(middle, time))
        if self.source is not None and named.magnetic_force is not None:
            pull = np.einsum("kji,kj->ki", self.source.gradient(middle, time), self._moments(state))
        if self.mutual is not None:
            own, force, couple = self.mutual.at(middle, frames_of(state.q), self.elements["moment"])
            field, pull = field + own, pull + force
        load = np.concatenate([self.weight, couple * self.elements["length"][:, None]])
        half = pull * self.elements["length"][:, None] / 2
        n = len(half)
        load[:n] += half
        load[1 : n + 1] += half
        return field, load

    def _moments(self, state: State) -> Array:
        """Moment per length (n, 3) A m of the turned elements."""
        return np.einsum("kij,kj->ki", frames_of(state.q), self.elements["moment"])


def frames_of(q: Array) -> Array:
    """Rotation matrices (n, 3, 3) of unit quaternions (n, 4), scalar first."""
    a, b, c, d = q.T
    rows = [
        [1 - 2 * (c * c + d * d), 2 * (b * c - a * d), 2 * (b * d + a * c)],
        [2 * (b * c + a * d), 1 - 2 * (b * b + d * d), 2 * (c * d - a * b)],
        [2 * (b * d - a * c), 2 * (c * d + a * b), 1 - 2 * (b * b + c * c)],
    ]
    return np.array(rows).transpose(2, 0, 1)
