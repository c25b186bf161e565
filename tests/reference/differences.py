"""Central differences of converged equilibria: what sensitivities are compared with.

The solver's last step leaves an error of some 1e-7 of the displacement, and a difference divides it by the step. So each solution is
refined to rounding first, by Newton's steps of `Linearized`, and differences are those of three steps, whose leading errors cancel.
"""

import numpy as np

from magmpm.scene import Scene
from magmpm.scene.variables import Variable
from magmpm.solving import solve
from magmpm.statics import axis
from magmpm.statics.linearized import Linearized

STEPS = {
    "magnetization": 2e-3,
    "field": 2e-5,
    "remanence": 3e-4,
    "shear_modulus": 200.0,
    "length": 2e-6,
    "diameter": 2e-6,
    "density": 10.0,
}


def tight(scene: Scene) -> Scene:
    """The scene with the tightest tolerance there is; a path of equilibria has none to set."""
    if scene.in_time or (scene.solver.static and scene.solver.static.max_steps == 500):
        return scene
    data = scene.to_si()
    data["solver"]["static"] |= {"tolerance": 1e-14, "max_steps": 500}
    return Scene.from_si(data)


def solution(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Axis (rows, 3) m and tip (3,) m of the equilibrium, or of a path's last one, refined."""
    _, found = (
        solve.end_of_path(scene) if scene.in_time else solve.at_rest(tight(scene), None, None)
    )
    for _ in range(2):
        near = Linearized(found, ())
        found.point = near._point
    model = near.model
    grid = found.point.grid
    if model.line is not None:
        return axis.centreline(model, grid)[:, 1:], axis.tip(model, grid)
    last = model.particles.segment == len(model.scene.regions()) - 1
    volume = model.particles.volume[last]
    return np.zeros((0, 3)), volume @ found.point.position[last] / volume.sum()


def differences(
    scene: Scene, variable: Variable, share: float = 1.0, h: float | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of axis (rows, 3) and tip (3,) by 3 D(h) - 3 D(2 h) + D(3 h), without errors of h, h^2; share: h over its usual size."""
    h = share * STEPS[variable.kind] if h is None else h
    scene = tight(scene)
    sides = [
        [
            solution(variable.changed(scene, sign * k * h).on_field_nodes_of(scene))
            for sign in (1, -1)
        ]
        for k in (1, 2, 3)
    ]
    slopes = [
        [(ahead[i] - behind[i]) / (2 * k * h) for k, (ahead, behind) in enumerate(sides, start=1)]
        for i in range(2)
    ]
    rows, tip = (3 * one - 3 * two + three for one, two, three in slopes)
    return rows, tip
