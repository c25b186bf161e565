"""Hard cases of shape and place: large strains and rotations, bodies anywhere on the grid, bodies that touch each other."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from magmpm.bodies.surface_mesh import Mesh, pack_mesh
from magmpm.dynamics.step_control import speed_of_sound
from magmpm.dynamics.time_loop import begin, integrate, interval, move
from magmpm.model import build
from magmpm.scene import Scene
from magmpm.studies.hard_cases.case import Case
from magmpm.studies.hard_cases.motions import (
    DENSITY,
    SILICONE,
    G,
    advance,
    at_rest,
    bending_field,
    block,
    energy,
    last_cells,
    made,
    rod,
    stretch,
    throw,
)

TURN = 5.0  # 1/s: centrifugal strains are 1e-6
FREE_BODY_LENGTH = 8e-3  # m, of free bodies
GAINED = 0.02  # of the energy, that may appear
# mm, of blocks
SIDE = 2.0
CELL = 0.5
GAP_BETWEEN_PARTS = 0.02


def _offsets(count: int) -> Case:
    def measure(scene: Scene) -> float:
        """Largest distance between any two settled tips, over L."""
        places = np.random.default_rng(5).uniform(0.02, 0.98, (count, 2))
        tips = []
        for place in places.tolist():
            catheter = scene.body.catheter
            assert catheter is not None  # made by `rod`, below
            at = scene.resolution
            model = build(
                scene,
                catheter.discretize(
                    at.cells_across, at.particles_per_cell, shift=(place[0], place[1])
                ),
            )
            tips.append(last_cells(model) @ (move(model).x - model.particles.position))
        spread = np.array(tips)[:, None] - np.array(tips)[None]
        return float(np.linalg.norm(spread, axis=2).max()) / scene.length

    return Case(
        f"{count} offsets of body against grid",
        lambda: rod(
            length=20e-3,
            field=bending_field(1.0, length=20e-3),
            cells=4,
            effects={"damping": {"rate": 240.0}},
            dynamic={"duration": 0.06, "output_every": 0.03},
        ),
        "loses slivers of cells, or bends by another amount at every place",
        "spread of settled tips, over L",
        measure,
        0.005,
        "the grid is not part of the physics",
        slow=count > 8,
    )


def _turn(scene: Scene) -> float:
    """Largest entry of F^T F - 1 and of det F - 1 over a turn by 360 degrees; infinite if the body does not return to its place."""
    motion, dt, _ = at_rest(scene)
    middle = motion.model.particles.position.mean(axis=0)
    throw(motion, lambda x: np.cross([0.0, TURN, 0.0], x - middle))
    steps = round(2 * math.pi / TURN / dt)
    worst = 0.0
    for part in np.diff(np.linspace(0, steps, 37).round().astype(int)):
        advance(motion, int(part), dt)
        _, _, F = motion.particles()
        worst = max(worst, float(np.abs(F.transpose(0, 2, 1) @ F - np.eye(3)).max()))
    x, _, F = motion.particles()
    back = np.abs(x - motion.model.particles.position).max() < 0.01 * scene.length
    return worst if back else math.inf


def _squeezed(scene: Scene) -> float:
    """Energy lost or gained by a body released at det F = 0.2 and run as by `magmpm run`, over its first energy; infinite if it stays
    small. For ten passages of a pressure wave through it."""
    moved = begin(build(scene))
    motion = moved.motion
    stretch(motion, 0.2 ** (1 / 3))
    begun = energy(motion)
    found = 0.0
    largest = 0.0
    passes = FREE_BODY_LENGTH / float(speed_of_sound(motion.model).max())
    for time in np.linspace(0.0, 10.0 * passes, 101)[1:]:
        interval(moved, time)
        moved.control.at_frame()
        change = energy(motion) / begun - 1
        largest = max(largest, float(np.median(np.linalg.det(motion.particles()[2]))))
        found = max(found, abs(change))
        if change > GAINED:
            return math.inf
    return found if largest > 1.0 else math.inf


def _opened(scene: Scene) -> float:
    """Largest distance of particles from the undeformed shape, fitted to them, over L; infinite if the body never folded."""
    model = build(scene)
    widest: list[float] = []
    X = model.particles.position
    first = X[:, 0] < 0.5e-3
    last = X[:, 0] > X[:, 0].max() - 0.5e-3
    moved = begin(model)

    def look(*_: object) -> None:
        x = moved.motion.particles()[0]
        widest.append(float(np.linalg.norm(x[first].mean(axis=0) - x[last].mean(axis=0))))

    integrate(moved, on_progress=look)
    if min(widest) > 0.3 * scene.length:
        return math.inf
    rest = X - X.mean(axis=0)
    x = moved.x - moved.x.mean(axis=0)
    return (
        float(np.linalg.norm(x - Rotation.align_vectors(x, rest)[0].apply(rest), axis=1).max())
        / scene.length
    )


def _opening_strip() -> Scene:
    """The strip of `_folding_strip`, thinner and in plane strain, folded in 50 ms, held for 200 ms and let open."""
    data = _folding_strip().to_si()
    data["materials"]["silicone"]["shear_modulus"] = 30e3
    data["body"]["strip"] |= {"length": 12e-3, "thickness": 0.5e-3, "plane_strain": True}
    for segment, along in zip(data["body"]["strip"]["segments"], (-1.0, 1.0), strict=True):
        segment["magnetization"] = [along, 0.0, -0.36]
    frames = [
        {"time": t, "strength": s} for t, s in ((0.0, 0.0), (0.05, 1.0), (0.25, 1.0), (0.29, 0.0))
    ]
    data["field"] = {"uniform": [0.0, 0.0, 20e-3], "over_time": {"keyframes": frames}}
    data["effects"]["damping"] = {"rate": 100.0}
    data["solver"]["dynamic"] = {"duration": 0.45, "output_every": 0.05}
    return Scene.from_si(data)


def _folding_strip() -> Scene:
    """A free strip of two halves magnetized against each other, folded by three times the field that this takes."""
    halves = [{"magnetization": [1.0, 0.0, 0.0]}, {"magnetization": [-1.0, 0.0, 0.0]}]
    strip = {
        "length": 20e-3,
        "width": 2e-3,
        "thickness": 1e-3,
        "material": "silicone",
        "clamp": "none",
        "segments": halves,
    }
    return made(
        {"strip": strip},
        {"silicone": SILICONE},
        field={"uniform": [0.0, 0.0, 150e-3]},
        effects={"magnetic_torque": {}, "self_contact": {}, "damping": {"rate": 60.0}},
        solver={"dynamic": {"duration": 0.03}},
    )


def _free(**more: object) -> Scene:
    return rod(length=FREE_BODY_LENGTH, clamp="none", dynamic={}, **more)  # type: ignore[arg-type]


def _bodies(meshes: Sequence[Mesh], moduli: Sequence[float] = (), **effects: object) -> Scene:
    """Free bodies with these meshes, mm, the lowest one first, and with these shear moduli, Pa."""
    parts = [
        {"mesh": pack_mesh(mesh), "name": f"body {k}", "material": f"material {k if moduli else 0}"}
        for k, mesh in enumerate(meshes)
    ]
    kinds = {
        f"material {k}": {**SILICONE, "shear_modulus": g, "remanence": 0.0}
        for k, g in enumerate(moduli or [G])
    }
    return made(
        {"parts": {"unit": "mm", "spacing": 1e-3 * CELL, "meshes": parts}},
        kinds,
        cells=None,
        field={"uniform": [0.0, 0.0, 0.0]},
        effects={"self_contact": {}, **effects},
        solver={"dynamic": {"duration": 0.05}},
    )


def _block(
    size: Sequence[float] = (SIDE, SIDE, SIDE), turn: Rotation | None = None, rise: float = 0.0
) -> Mesh:
    """A block around a place at this height, mm, turned."""
    half = np.array(size) / 2
    mesh = block(tuple(-half), tuple(half))
    return Mesh(
        (mesh.vertices if turn is None else turn.apply(mesh.vertices)) + np.array([0.0, 0.0, rise]),
        mesh.faces,
    )


def _over(low: Mesh, high: Mesh) -> Scene:
    """One body just above the other, a little aside."""
    rise = low.vertices[:, 2].max() - high.vertices[:, 2].min() + GAP_BETWEEN_PARTS
    return _bodies([low, Mesh(high.vertices + np.array([0.11, 0.07, rise]), high.faces)])


def _hit(scene: Scene) -> float:
    """Energy lost or gained, over that at first, as the last body falls on the other or the ground; infinite if they do not part."""
    fast = 2.0  # m/s: a twentieth of the speed of sound
    moved = begin(build(scene))
    motion = moved.motion
    model = moved.motion.model
    last = int(model.component.max())
    falls = np.arange(len(motion.packed.node_place)) >= last * int(np.prod(model.grid.nodes))
    throw(motion, lambda x: np.where(falls[:, None], [0.0, 0.0, -fast], 0.0))
    begun = energy(motion)
    interval(moved, 2e-3)  # until the bodies have parted
    x, v, _ = motion.particles()
    mass = model.density * model.particles.volume
    high = model.component == last
    up, distance = (
        np.subtract(*(mass[on] @ z[on, 2] / (mass[on].sum() or 1.0) for on in (high, ~high)))
        for z in (v, x)
    )
    return abs(energy(motion) / begun - 1) if up > 0.1 * fast and distance > 0.0 else math.inf


def _stacked(scene: Scene) -> float:
    """Depth in cells of the contacts of a stack that has settled; infinite if a block is not on the one below it, to 0.02 cells."""
    moved = move(build(scene))
    model = moved.motion.model
    height = [
        float(moved.x[model.component == k, 2].mean()) for k in range(model.component.max() + 1)
    ]
    deepest = max(contact["depth"] for contact in moved.contacts.values())
    return (
        deepest / (1e-3 * CELL)
        if abs(np.diff(height) - 0.5e-3 * SIDE).max() < 0.02e-3 * CELL
        else math.inf
    )


def _stack() -> Scene:
    """Five blocks on the ground, every other one a hundred times as stiff."""
    blocks = [
        _block((SIDE, SIDE, SIDE / 2), rise=k * (SIDE / 2 + GAP_BETWEEN_PARTS)) for k in range(5)
    ]
    moduli = [G, 100 * G, G, 100 * G, G]
    return _bodies(
        blocks,
        moduli,
        gravity={},
        ground={"point": [0.0, 0.0, -0.25e-3 * SIDE]},
        damping={"rate": 500.0},
    )


def _folded(scene: Scene) -> float:
    """Largest depth of a fold in itself, in cells, in any frame; infinite if it never touches itself."""
    depths: list[float] = []
    move(
        build(scene),
        on_state=lambda state: depths.append(
            max((c["depth"] for c in state.contacts.values()), default=0.0)
        ),
    )
    return max(depths) / scene.cell or math.inf


def _impact(name: str, scene: Callable[[], Scene]) -> Case:
    return Case(
        name,
        scene,
        "passes through, sticks, or bounces with more energy",
        "energy lost or gained, over that at first",
        _hit,
        0.02,
        "two elastic bodies without friction keep their energy",
    )


CASES = (
    _offsets(8),
    _offsets(64),
    Case(
        "rotation by 360 degrees",
        _free,
        "is strained by rotating, or does not come back",
        "largest strain F^T F - 1 on the way",
        _turn,
        1e-5,
        "rigid motion: no strain but the centrifugal one, rho (w L)^2/(8 E) ="
        f" {DENSITY * (TURN * FREE_BODY_LENGTH) ** 2 / 8 / (3 * G):.0e}",
    ),
    *(
        Case(
            f"det F down to 0.2, K = {ratio:g} G",
            partial(_free, ratio=ratio),
            "turns particles inside out, or gains energy while it swells",
            "energy lost or gained, over that at first",
            _squeezed,
            0.02,
            f"nothing does work, and no more than {100 * GAINED:g} % may be gained",
        )
        for ratio in (5.0, 20.0)
    ),
    Case(
        "folded, held and let open",
        _opening_strip,
        "keeps a bend, though nothing in it is plastic, or slowly tears while it is held",
        "distance of particles from the undeformed shape, over L",
        _opened,
        0.002,
        "a hyperelastic body without load is as it was made; damping leaves exp(-8)",
        slow=True,
    ),
    _impact(
        "a block hits the ground at 2 m/s",
        lambda: _bodies([_block()], ground={"point": [0.0, 0.0, -0.51e-3 * SIDE]}),
    ),
    _impact("blocks collide at 2 m/s", lambda: _over(_block(), _block())),
    _impact(
        "a corner hits a face at 2 m/s",
        lambda: _over(
            _block((2 * SIDE, 2 * SIDE, SIDE)),
            _block(turn=Rotation.align_vectors([[0, 0, 1]], [[1, 1, 1]])[0]),
        ),
    ),
    _impact(
        "edges cross at 2 m/s",
        lambda: _over(
            _block((2 * SIDE, SIDE, SIDE), Rotation.from_euler("x", 45, degrees=True)),
            _block((SIDE, 2 * SIDE, SIDE), Rotation.from_euler("y", 45, degrees=True)),
        ),
    ),
    _impact(
        "a block hits a sheet of two cells",
        lambda: _over(_block((3 * SIDE, 3 * SIDE, 2 * CELL)), _block()),
    ),
    Case(
        "stack of five, stiffness 1:100",
        _stack,
        "sinks in, or creeps through",
        "deepest contact, in cells",
        _stacked,
        0.02,
        "weight over the stiffness of a layer: a thousandth of a cell",
        slow=True,
    ),
    Case(
        "a block sticks on a steep slope",
        lambda: _bodies(
            [_block((SIDE, SIDE, SIDE / 2))],
            gravity={"acceleration": [0.99 * 0.45 * 9.0, 0.0, -9.0]},
            ground={"point": [0.0, 0.0, -0.25e-3 * SIDE], "friction": 0.45},
            viscosity={"viscosity": 20.0},
        ),
        "flutters as bounce and shear feed each other, and slides",
        "displacement, in cells",
        lambda scene: (
            float((move(build(scene)).x - build(scene).particles.position).mean(axis=0)[0])
            / (1e-3 * CELL)
        ),
        0.02,
        "0.99 of friction's cone, with losses: by the exact law it stays",
    ),
    Case(
        "folding onto itself, in three times the field",
        _folding_strip,
        "passes through itself",
        "deepest contact, in cells",
        _folded,
        0.2,
        "pressure of the field over the stiffness of a layer",
    ),
)
