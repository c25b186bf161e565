"""The self-test of `magmpm doctor`: an equilibrium, a motion and a rod against stored answers; prints one JSON list.

    python -m magmpm.cli.self_test

The stored answers are those of this version's own solvers: they tell whether this machine computes what ours did. The known answer is a
finite-element solution, data/references/axial_transverse_5mT.csv: it tells whether that is right. Ten seconds, once kernels are compiled.
"""

import json
import sys
from typing import Any

TEST_LENGTH = 40e-3  # m
SCENE: dict[str, Any] = {  # data/scenes/axial_transverse.yaml
    "name": "self-test",
    "materials": {
        "silicone": {
            "shear_modulus": 120e3,
            "bulk_to_shear": 20.0,
            "density": 1882.0,
            "remanence": 0.1,
        }
    },
    "body": {
        "catheter": {
            "length": TEST_LENGTH,
            "diameter": 4e-3,
            "material": "silicone",
            "clamp": "base",
            "segments": [{"magnetization": [1.0, 0.0, 0.0]}],
        }
    },
    "field": {"uniform": [0.0, 0.0, 5e-3]},
    "effects": {"magnetic_torque": {}},
    "advice": "off",
}
# arc length and (x, z) m there, by finite elements of order 4
KNOWN_AT = 39.8e-3
KNOWN = (34.356642e-3, 18.306328e-3)
EQUILIBRIUM = (0.034462825956075444, 0.01849703241471859)  # tip (x, z) m, two cells across
MOTION = (
    0.039984602246257175,
    0.0006232223331336377,
)  # tip (x, z) m, two cells across, after 5 ms from rest


def main() -> int:
    """Run the tests and print their rows. Returns 0: a wrong number is a row, not an error."""
    import numpy as np

    from magmpm.results.measures import centreline_at

    rest = _run(2)
    fine = _run(4)
    moved = _run(
        2,
        solver={"dynamic": {"duration": 5e-3}},
        effects={"magnetic_torque": {}, "damping": {"rate": 60.0}},
    )
    place = centreline_at(fine, np.array([KNOWN_AT]))[0]
    rows = [
        _row(
            "equilibrium",
            _away(rest.tip, EQUILIBRIUM),
            1e-6,
            "within 1e-6 of the stored value: the tolerance of the solve",
            rest,
        ),
        _stability(float(rest.stability or 0.0)),
        _row(
            "finite elements",
            _away(place, KNOWN),
            1e-3,
            "within 1e-3 of finite elements: the error of 4 cells across",
            fine,
        ),
        _row(
            "motion of 5 ms",
            _away(moved.tip, MOTION),
            1e-5,
            "within 1e-5 of the stored value: rounding over hundreds of steps",
            moved,
        ),
    ]
    print(json.dumps(rows))
    return 0


def _run(cells: int, **changes: Any) -> Any:
    """The Result of the scene on so many cells across."""
    from magmpm.scene import Scene
    from magmpm.simulate import run

    return run(Scene.from_si({**SCENE, **changes, "resolution": {"cells_across": cells}}))


def _row(name: str, away: float, bound: float, rule: str, result: Any) -> dict[str, Any]:
    seconds = result.seconds
    compiled = f", and {seconds['compile']:.0f} s to compile" if seconds["compile"] > 1 else ""
    found = (
        f"{away / TEST_LENGTH:.1e} of the length away, {seconds['setup'] + seconds['solve']:.2f}"
        f" s{compiled}"
    )
    return {
        "name": name,
        "passed": away <= bound * TEST_LENGTH,
        "found": found,
        "rule": rule,
        "away_m": away,
    }


def _away(tip: Any, stored: tuple[float, float]) -> float:
    x, y, z = (float(part) for part in tip)
    return float(((x - stored[0]) ** 2 + y**2 + (z - stored[1]) ** 2) ** 0.5)


def _stability(found: float) -> dict[str, Any]:
    """The softest stiffness over that of the unloaded body, an eigenvalue: it sees the whole tangent."""
    stored = 1.2376528590218245
    away = abs(found - stored) / stored
    return {
        "name": "eigenvalue",
        "passed": away <= 1e-3,
        "found": f"{found:.6f}, {away:.1e} from the stored value",
        "rule": "within 1e-3: the tolerance of its iteration",
        "away_m": 0.0,
    }


if __name__ == "__main__":
    sys.exit(main())
