"""Hard cases of bodies: needles, thin tubes, stiff inclusions, parts of two cells, particles in another order."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from magmpm.bodies.surface_mesh import pack_mesh
from magmpm.errors import InputError
from magmpm.model import build
from magmpm.scene import Scene
from magmpm.simulate import run
from magmpm.statics.equilibrium import solve_static
from magmpm.statics.layout import static_model
from magmpm.studies.hard_cases.case import Case
from magmpm.studies.hard_cases.drawn import block
from magmpm.studies.hard_cases.equilibria import from_rod
from magmpm.studies.hard_cases.motions import (
    DIAMETER,
    LENGTH,
    SILICONE,
    G,
    X,
    bending_field,
    changed,
    made,
    rod,
)

BASE, ARM, WIDE, THICK = 4.0, 20.0, 4.0, 2.0  # mm, of the robot made of parts
PRECISION = np.float64  # in which particles are kept whose order is changed


def _needle() -> Scene:
    data = rod(length=200e-3, field=bending_field(5.0, length=200e-3), cells=2).to_si()
    data["body"]["catheter"]["diameter"] = 1e-3
    data["field"]["uniform"] = [b / 16 for b in data["field"]["uniform"]]  # A/I grows as 1/D^2
    return Scene.from_si(data)


def _tube(ratio: float, wall: float = 0.04e-3, field: float = 2e-3) -> Scene:
    data = rod(field=[0.0, 0.0, field], ratio=ratio, cells=2).to_si()
    data["body"]["catheter"]["inner_diameter"] = DIAMETER - 2 * wall
    return Scene.from_si(data)


def _kink_not_told(scene: Scene) -> float:
    """0 where the result warns that the tube kinks, and 1 where it does not."""
    return 0.0 if any("kinks" in warning for warning in run(scene).warnings) else 1.0


def _parts() -> Scene:
    """A held block, and an arm of 2 mm that it holds."""
    sizes = ((0.0, BASE), (BASE, BASE + ARM))
    meshes = [pack_mesh(block((a, -WIDE / 2, -THICK / 2), (b, WIDE / 2, THICK / 2))) for a, b in sizes]
    parts = [
        {"mesh": meshes[0], "name": "base", "material": "silicone", "clamp": True},
        {"mesh": meshes[1], "name": "arm", "material": "silicone", "magnetization": [1.0, 0.0, 0.0]},
    ]
    return made(
        {"parts": {"unit": "mm", "meshes": parts}}, {"silicone": {**SILICONE, "bulk_to_shear": 200.0}},
        field={"uniform": [0.0, 0.0, 4e-3]}, effects={"magnetic_torque": {}},
    )  # fmt: skip


def _against_strip(scene: Scene) -> float:
    """Distance of the arm's middle from that of a strip of its size, over its length; infinite unless parts of one cell are refused."""
    parts = scene.to_si()["body"]["parts"]
    try:
        changed(scene, body={"parts": {**parts, "spacing": 1e-3 * THICK}})
        return np.inf
    except InputError as error:
        if "spacing" not in str(error):
            return np.inf
    strip = {"length": 1e-3 * ARM, "width": 1e-3 * WIDE, "thickness": 1e-3 * THICK, "material": "silicone"}
    segments = [{"magnetization": [1.0, 0.0, 0.0]}]
    alone = run(changed(scene, body={"strip": {**strip, "segments": segments}}, solver={"static": {}}))
    middle = run(scene).segment_center[1] - [1e-3 * BASE, 0.0, 0.0]
    return float(np.linalg.norm(middle - alone.segment_center[0])) / (1e-3 * ARM)


def _ringing(scene: Scene) -> float:
    """Pressure that alternates from cell to cell along the outermost row of cells, over G, as root mean square away from the clamp."""
    result = run(scene)
    model = build(scene)
    cell, volume = model.particles.cell, model.particles.volume
    row = (cell[:, 1:] == cell[:, 1:].max(axis=0) // 2).all(axis=1)
    row &= cell[:, 0] > cell[:, 0].max() // 4
    along = cell[row, 0]
    count = np.bincount(along, volume[row])
    mean = (np.bincount(along, volume[row] * (result.particle_det_F[row] - 1)) / np.where(count > 0, count, 1))[along.min() : along.max()]
    pressure = scene.materials["material 0"].bulk_to_shear * mean  # of G
    alternating = pressure[1:-1] - 0.5 * (pressure[:-2] + pressure[2:])
    return float(np.sqrt(np.mean(alternating**2)))


def _permuted(scene: Scene) -> float:
    """Distance of tips over L, where the particles within each cell stand in another order."""
    made = scene.body.shape.discretize(scene.resolution.cells_across, scene.resolution.particles_per_cell)
    p, noise = made.particles, np.random.default_rng(1)
    first = p.cell_first
    order = np.concatenate([a + noise.permutation(b - a) for a, b in itertools.pairwise(first)])
    position = p.position[order].astype(PRECISION).astype(np.float64)
    mixed = replace(p, position=position, volume=p.volume[order], segment=p.segment[order], cell=p.cell[order])
    last = p.position[:, 0] > 0.98 * scene.length
    tips = []
    for particles in (p, mixed):
        found = solve_static(static_model(build(scene, replace(made, particles=particles))))
        moved = found.point.position if particles is p else found.point.position[np.argsort(order)]
        tips.append(moved[last].mean(axis=0))
    return float(np.linalg.norm(tips[1] - tips[0])) / scene.length


CASES = (
    Case(
        "parts of two cells", _parts, "locks or tears where parts are as thin as a cell or two",
        "middle of a thin part from that of a strip, over L; parts of one cell are refused", _against_strip, 0.002,
        "the same body as a strip on the same cells; a tenth of the error of two cells across, 1 to 2 % of L",
    ),
    Case(
        "stiff inclusion", lambda: rod(directions=(X, (0.0, 0.0, 1.0), X), shear=[G, 1000 * G, G], field=[0.0, 0.0, 20e-3], cells=3),
        "takes hundreds of steps, or stops where the stiff part turns", "tip from the rod's, over L", from_rod, 0.03,
        "Cosserat rod; stiff neighbors restrain soft ends, 1 to 2 % of L (tests/stability)",
    ),
    Case(
        "needle, L/D 200", _needle, "is too stiff, or stops: bending is 1e-9 as stiff as the stiffest mode", "tip from the rod's, over L",
        from_rod, 0.003, "Cosserat rod; at two cells across F-bar bends 0.6 % too easily, 0.2 % of L here (tests/stability)",
    ),
    *(
        Case(
            f"thin tube, K/G = {ratio:g}",
            lambda ratio=ratio: _tube(ratio),  # type: ignore[misc]
            "locks: the wall is a fiftieth of a cell",
            "tip from the rod's, over L",
            from_rod,
            0.002,
            "Cosserat rod, bent far less than for kinking (Brazier); tubes at K/G 20 are within 0.2 % of L (tests/stability)",
        )
        for ratio in (100.0, 500.0)
    ),
    Case(
        "thin tube bent until it kinks", lambda: _tube(20.0, 0.1e-3, 7e-3),
        "gives the shape of a tube that stays round: at two cells across, or as a rod, nothing flattens",
        "1 where the result does not tell that the tube kinks", _kink_not_told, 0.5,
        "bent to half of Brazier's radius; finer grids soften (1.6 % of L at 6 cells near the limit), and find no equilibrium there",
    ),
    Case(
        "stress without ringing", lambda: rod(field=bending_field(2.0), ratio=500.0, cells=4),
        "has pressures that alternate from cell to cell, a checkerboard", "alternating pressure along the body, over G", _ringing, 5e-5,
        "pressure of a bent rod is smooth along it, and 0.1 G at most: a two-thousandth of that; a grid that locks has 9e-5",
    ),
    Case(
        "permuted particles", lambda: rod(directions=((1.0, 0.0, 0.0), (0.0, 0.6, 0.8)), field=bending_field(4.0), length=LENGTH, cells=3),
        "depends on the order of sums, or on a number's last bit", "distance of tips, over L", _permuted, 1e-8,
        "the same sums in another order: rounding of 1e-16, times the condition of bending, 1e7",
    ),
)
