"""Hard cases of bodies that touch each other: fast impacts of faces, edges, corners and thin sheets; hard blocks on soft ones; folds."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from magmpm.bodies.surface_mesh import Mesh, pack_mesh
from magmpm.dynamics.time_loop import begin, interval, move
from magmpm.model import build
from magmpm.scene import Scene
from magmpm.studies.hard_cases.case import Case
from magmpm.studies.hard_cases.drawn import block
from magmpm.studies.hard_cases.motions import energy, throw
from magmpm.studies.hard_cases.scenes import DENSITY, RATIO, G, folding_strip

FAST = 2.0  # m/s: a twentieth of the speed of sound
SIDE, CELL, GAP = 2.0, 0.5, 0.02  # mm
BOUNCE = 2e-3  # s: of an impact, until the bodies have parted
SETTLE = 0.05  # s: of a stack


def _bodies(meshes: Sequence[Mesh], moduli: Sequence[float] = (), **effects: object) -> Scene:
    """Free bodies with these meshes, mm, the lowest one first, and with these shear moduli, Pa."""
    parts = [
        {"mesh": pack_mesh(mesh), "name": f"body {k}", "material": f"material {k if moduli else 0}"} for k, mesh in enumerate(meshes)
    ]
    kinds = {f"material {k}": {"shear_modulus": g, "bulk_to_shear": RATIO, "density": DENSITY} for k, g in enumerate(moduli or [G])}
    return Scene.from_si(
        {
            "name": "hard case",
            "materials": kinds,
            "body": {"parts": {"unit": "mm", "spacing": 1e-3 * CELL, "meshes": parts}},
            "field": {"uniform": [0.0, 0.0, 0.0]},
            "effects": {"self_contact": {}, **effects},
            "solver": {"dynamic": {"duration": SETTLE}},
        }
    )


def _block(size: Sequence[float] = (SIDE, SIDE, SIDE), turn: Rotation | None = None, rise: float = 0.0) -> Mesh:
    """A block around a place at this height, mm, turned."""
    half = np.array(size) / 2
    mesh = block(tuple(-half), tuple(half))
    return Mesh((mesh.vertices if turn is None else turn.apply(mesh.vertices)) + np.array([0.0, 0.0, rise]), mesh.faces)


def _over(low: Mesh, high: Mesh, aside: tuple[float, float] = (0.11, 0.07)) -> Scene:
    """One body just above the other, a little aside."""
    rise = low.vertices[:, 2].max() - high.vertices[:, 2].min() + GAP
    return _bodies([low, Mesh(high.vertices + np.array([*aside, rise]), high.faces)])


def _corner() -> Scene:
    """A cube that stands on its corner, over a face."""
    return _over(_block((2 * SIDE, 2 * SIDE, SIDE)), _block(turn=Rotation.align_vectors([[0, 0, 1]], [[1, 1, 1]])[0]))


def _edges() -> Scene:
    """Two bars whose edges cross."""
    return _over(
        _block((2 * SIDE, SIDE, SIDE), Rotation.from_euler("x", 45, degrees=True)),
        _block((SIDE, 2 * SIDE, SIDE), Rotation.from_euler("y", 45, degrees=True)),
    )


def _hit(scene: Scene) -> float:
    """Energy lost or gained, over that at first, as the last body falls on the other or the ground; infinite if they do not part."""
    moved = begin(build(scene))
    motion, model = moved.motion, moved.motion.model
    last = int(model.component.max())
    falls = np.arange(len(motion.packed.node_place)) >= last * int(np.prod(model.grid.nodes))
    throw(motion, lambda x: np.where(falls[:, None], [0.0, 0.0, -FAST], 0.0))
    begun = energy(motion)
    interval(moved, BOUNCE)
    x, v, _ = motion.particles()
    mass, high = model.density * model.particles.volume, model.component == last
    up, apart = (np.subtract(*(mass[on] @ z[on, 2] / (mass[on].sum() or 1.0) for on in (high, ~high))) for z in (v, x))
    return abs(energy(motion) / begun - 1) if up > 0.1 * FAST and apart > 0.0 else math.inf


def _stacked(scene: Scene) -> float:
    """Depth in cells of the contacts of a stack that has settled; infinite if a block sinks through another."""
    moved = move(build(scene))
    model = moved.motion.model
    height = [float(moved.x[model.component == k, 2].mean()) for k in range(model.component.max() + 1)]
    deepest = max(contact["depth"] for contact in moved.contacts.values())
    return deepest / (1e-3 * CELL) if np.diff(height).min() > 0.5e-3 * SIDE else math.inf


def _stack() -> Scene:
    """Five blocks on the ground, every other one a hundred times as stiff."""
    blocks, moduli = [_block((SIDE, SIDE, SIDE / 2), rise=k * (SIDE / 2 + GAP)) for k in range(5)], [G, 100 * G, G, 100 * G, G]
    return _bodies(blocks, moduli, gravity={}, ground={"point": [0.0, 0.0, -0.25e-3 * SIDE]}, damping={"rate": 500.0})


def _folded(scene: Scene) -> float:
    """Largest depth of a fold in itself, in cells, in any frame; infinite if it never touches itself."""
    depths: list[float] = []
    move(build(scene), on_state=lambda state: depths.append(max((c["depth"] for c in state.contacts.values()), default=0.0)))
    return max(depths) / scene.cell or math.inf


def _impact(name: str, scene: Callable[[], Scene]) -> Case:
    return Case(
        name, scene, "passes through, sticks, or bounces with more energy", "energy lost or gained, over that at first", _hit, 0.02,
        "two elastic bodies without friction keep their energy",
    )  # fmt: skip


CASES = (
    _impact("a block hits the ground at 2 m/s", lambda: _bodies([_block()], ground={"point": [0.0, 0.0, -0.51e-3 * SIDE]})),
    _impact("blocks collide at 2 m/s", lambda: _over(_block(), _block())),
    _impact("a corner hits a face at 2 m/s", _corner),
    _impact("edges cross at 2 m/s", _edges),
    _impact("a block hits a sheet of two cells", lambda: _over(_block((3 * SIDE, 3 * SIDE, 2 * CELL)), _block())),
    Case(
        "stack of five, stiffness 1:100", _stack, "sinks in, or creeps through", "deepest contact, in cells", _stacked, 0.02,
        "weight over the stiffness of a layer: a thousandth of a cell", slow=True,
    ),
    Case(
        "folding onto itself, in three times the field", folding_strip, "passes through itself", "deepest contact, in cells", _folded, 0.2,
        "pressure of the field over the stiffness of a layer",
    ),
)  # fmt: skip
