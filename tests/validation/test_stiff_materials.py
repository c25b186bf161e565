"""Metals and magnets, a million times as stiff as silicone: against beam theory, and against the motion of what is soft."""

import numpy as np
import pytest
import yaml

import magmpm
from magmpm.errors import quantity
from magmpm.fields.dipole import MU0
from magmpm.inputs.settings import validate
from magmpm.materials import young_modulus
from magmpm.scene import Scene
from magmpm.simulate import simulated
from magmpm.solving.solve import RunOptions

LENGTH = 0.1
DIAMETER = 1e-3
DENSITY = 6450.0
AREA = np.pi * DIAMETER**2 / 4
SECOND_MOMENT = np.pi * DIAMETER**4 / 64
STEEL = {"bulk_to_shear": 2.17, "density": "6450 kg/m^3"}


def scene_of(modulus: str, **more: object) -> Scene:
    """A wire of this shear modulus, held at its base."""
    data = {
        "name": "stiff wire",
        "materials": {"metal": {"shear_modulus": modulus, **STEEL}},
        "body": {
            "catheter": {
                "length": "100 mm",
                "diameter": "1 mm",
                "material": "metal",
                "segments": [{}],
            }
        },
        "resolution": {"cells_across": 2},
    }
    return validate(Scene, data | more)


def bending_stiffness(modulus: float) -> float:
    """E I, N m^2, of a shear modulus, Pa."""
    return young_modulus(modulus, 2.17 * modulus) * SECOND_MOMENT


@pytest.mark.parametrize("gigapascals", [18.8, 80.0, 500.0])
def test_a_wire_bends_under_its_weight_as_a_beam_does(gigapascals: float) -> None:
    """Nitinol, steel, carbide. Within 0.1 %: at 2 cells the section's second moment and the clamp leave 0.09 %."""
    tip = magmpm.run(scene_of(f"{gigapascals} GPa", effects={"gravity": {}})).tip[2]
    expected = -DENSITY * 9.81 * AREA * LENGTH**4 / (8 * bending_stiffness(1e9 * gigapascals))
    assert tip == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("gigapascals", [18.8, 150.0])
def test_a_magnet_in_its_tip_bends_it(gigapascals: float) -> None:
    """A couple, spread evenly over the magnet at the end of a wire. Within 0.1 %, as above."""
    stiff = f"{gigapascals} GPa"
    magnet = {
        "shear_modulus": stiff,
        "bulk_to_shear": 2.17,
        "density": "7500 kg/m^3",
        "remanence": "1.2 T",
    }
    scene = scene_of(
        stiff,
        materials={"metal": {"shear_modulus": stiff, **STEEL}, "magnet": magnet},
        body={
            "catheter": {
                "length": "100 mm",
                "diameter": "1 mm",
                "material": "metal",
                "segments": [
                    {"length": "95 mm"},
                    {"length": "5 mm", "material": "magnet", "magnetization": [1, 0, 0]},
                ],
            }
        },
        field={"uniform": ["0 mT", "0 mT", "100 mT"]},
        effects={"magnetic_torque": {}},
    )
    free = 0.095
    long = 5e-3
    couple = 1.2 * AREA * long / MU0 * 0.1
    # The moment is the whole couple up to the magnet, and falls evenly to none at the tip: E I w'' = M, twice integrated.
    deflection = free**2 / 2 + free * long + long**2 / 3
    expected = couple * deflection / bending_stiffness(1e9 * gigapascals)
    assert magmpm.run(scene).tip[2] == pytest.approx(expected, rel=1e-3)


@pytest.mark.slow
def test_it_moves_as_a_soft_one_does_but_sooner() -> None:
    """A beam k times as stiff sags by 1/k, root k times as soon.

    Deflections are small: the soft beam turns by 1e-3, so they are linear to 1e-6.
    """
    ratio = 1e6
    soft, stiff = (
        moving(f"{modulus} kPa", duration)
        for modulus, duration in ((120.0, 2e-3), (120.0 * ratio, 2e-6))
    )
    one = magmpm.run(soft)
    other = magmpm.run(stiff)
    assert other.iterations == pytest.approx(
        one.iterations, abs=2
    )  # the same number of steps, to how they end with frames
    sag = one.tip[2]
    assert sag < -1e-6
    # their steps differ by rounding and by how they fit into frames: 1e-4 of the motion
    assert ratio * other.tip[2] == pytest.approx(sag, rel=1e-3)


def moving(modulus: str, duration: float) -> Scene:
    return validate(
        Scene,
        {
            "name": "short beam",
            "materials": {
                "elastic": {
                    "shear_modulus": modulus,
                    "bulk_to_shear": 2.17,
                    "density": "1000 kg/m^3",
                }
            },
            "body": {
                "catheter": {
                    "length": "8 mm",
                    "diameter": "2 mm",
                    "material": "elastic",
                    "segments": [{}],
                }
            },
            "effects": {"gravity": {}},
            "solver": {"dynamic": {"duration": duration}},
            "resolution": {"cells_across": 2},
        },
    )


def test_a_motion_says_its_steps_and_what_bounds_them() -> None:
    """Those that it then takes; the metal's stiffness, or what else allows no longer ones."""
    moves = {"duration": "2 us", "output_every": "0.9 us"}
    begun = {
        "of metal (shear modulus 18.8 GPa)": {},
        "`viscosity` allows": {"effects": {"gravity": {}, "viscosity": {"viscosity": "1 MPa s"}}},
        "as `time_step` says": {"solver": {"dynamic": {**moves, "time_step": "10 ns"}}},
    }
    for said, other in begun.items():
        usual = {"effects": {"gravity": {}}, "solver": {"dynamic": moves}}
        notes: list[str] = []
        result = simulated(
            scene_of("18.8 GPa", **(usual | other)), RunOptions(on_note=notes.append)
        )
        (note,) = notes
        assert note.startswith("time steps of ")
        assert f", {result.iterations} for 2.00 µs of motion: " in note
        assert said in note
    assert f"time steps of {quantity(result.time_step, 's')}, " in note


def test_what_no_material_has_is_refused() -> None:
    with pytest.raises(
        magmpm.InputError, match=r"(?s)shear_modulus: received .600 GPa.*must be at most 500 GPa"
    ):
        scene_of("600 GPa")


def test_in_a_file_it_is_accepted(tmp_path) -> None:  # type: ignore[no-untyped-def]
    """As users write it, with units."""
    file = tmp_path / "wire.yaml"
    data = {
        "name": "wire",
        "materials": {
            "steel": {"shear_modulus": "79 GPa", "bulk_to_shear": 2.1, "density": "7800 kg/m^3"}
        },
        "body": {
            "catheter": {
                "length": "50 mm",
                "diameter": "1 mm",
                "material": "steel",
                "segments": [{}],
            }
        },
        "effects": {"gravity": {}},
    }
    file.write_text(yaml.safe_dump(data))
    assert magmpm.load_scene(file).materials["steel"].shear_modulus == 79e9
