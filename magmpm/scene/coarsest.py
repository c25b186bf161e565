"""Layout of a scene's cells; and the scene that is solved to compile its kernels: it calls all of them, in as little time as possible."""

from itertools import pairwise

from magmpm.bodies.grid import AT_REST, EVEN, Knots
from magmpm.errors import InputError
from magmpm.scene.scene import Scene

FAINT = 1e-3  # of the load


def coarsest(scene: Scene) -> Scene:
    """Make the scene on the coarsest grid, under a thousandth of its load: its kernels are the same, and a hard one is not solved for
    minutes.
    """
    data = {**scene.to_si(), "name": "compilation", "reference": None}
    if scene.solver.dynamic is None:
        for material in data["materials"].values():
            material["remanence"] *= FAINT
        if data["effects"]["gravity"] is not None:
            data["effects"]["gravity"]["acceleration"] = [
                FAINT * g for g in data["effects"]["gravity"]["acceleration"]
            ]
    if data["body"]["parts"] is not None:
        data["body"]["parts"]["spacing"] = None
    if scene.solver.quasi_static is not None:
        data["solver"]["quasi_static"] = {"at": scene.path_times()[:2]}
    if scene.solver.dynamic is not None:
        short = {"duration": 1e-9, "output_every": 1e-9, "time_step": None, "max_memory": None}
        data["solver"]["dynamic"] = {**data["solver"]["dynamic"], **short}
    return Scene.from_si(
        {**data, "resolution": {"cells_across": coarsest_cells(scene), "particles_per_cell": 2}}
    )


def coarsest_cells(scene: Scene) -> int:
    """Cells across of the coarsest grid that the scene can have: two, or more where its magnetization turns within a few cells."""
    most_cells_tried = 8  # cells across that are tried
    for cells in range(2, most_cells_tried):
        try:
            scene.with_cells(cells)
        except InputError:
            continue
        return cells
    return most_cells_tried


def knots_of(scene: Scene) -> Knots:
    """Layout of the cells in a body; around a tube's axis, and along the faces of parts, in statics alone."""
    at_rest = scene.static and scene.effects.self_contact is None
    if scene.body.shape.line is None:
        return AT_REST if at_rest else EVEN
    used = [scene.materials[region.material_name] for region in scene.regions()]
    moduli = [(one.shear_modulus, one.bulk_to_shear) for one in used]
    joints = tuple(k for k, (one, other) in enumerate(pairwise(moduli)) if one != other)
    return Knots(joints, scene.resolution.from_tip is True, at_rest=at_rest)
