"""Scenes made of Python objects: those of files, refused in the same words."""

from collections.abc import Callable
from pathlib import Path

import pytest

import magmpm
from magmpm import (
    Catheter,
    Coil,
    Damping,
    Dipole,
    Dynamic,
    Fluid,
    Gravity,
    MagneticForce,
    MagneticTorque,
    Material,
    Scene,
    Segment,
    Static,
    Strip,
    Tube,
    UniformField,
)
from magmpm.scene import load_scene

SILICONE = {
    "silicone": Material(
        shear_modulus="120 kPa", bulk_to_shear=20, density="1882 kg/m^3", remanence="138 mT"
    )
}
IN_WORDS = {
    "shear_modulus": "120 kPa",
    "bulk_to_shear": 20,
    "density": "1882 kg/m^3",
    "remanence": "138 mT",
}


def bent(**more: object) -> Scene:
    return Scene(
        name="bent",
        materials=SILICONE,
        body=Catheter(
            length="40 mm",
            diameter=4e-3,
            material="silicone",
            segments=[Segment(magnetization=[1, 0, 0]), Segment(magnetization=[0, 0, 1])],
        ),
        **more,
    )


def in_words(**more: object) -> Scene:
    body = {
        "length": "40 mm",
        "diameter": "4 mm",
        "material": "silicone",
        "segments": [{"magnetization": [1, 0, 0]}, {"magnetization": [0, 0, 1]}],
    }
    return load_scene(
        {"name": "bent", "materials": {"silicone": IN_WORDS}, "body": {"catheter": body}, **more}
    )


def test_a_scene_of_objects_is_that_of_a_file() -> None:
    field = UniformField(uniform=["0 mT", "6 mT", 8e-3])
    fluid = Fluid(density=1e3, viscosity="1 mPa s")
    made = bent(field=field, effects=[Gravity(), fluid, MagneticTorque()], solver=Static())
    said = in_words(
        field={"uniform": ["0 mT", "6 mT", "8 mT"]},
        effects={
            "magnetic_torque": {},
            "gravity": {},
            "fluid": {"density": "1000 kg/m^3", "viscosity": "1 mPa s"},
        },
    )
    assert made == said
    assert Scene.from_si(made.to_si()) == made


def test_sources_of_a_field_add_up() -> None:
    coil = Coil(position=[0.0, 0.0, 0.1], axis=[0, 0, 1], diameter="80 mm", current="2 A", turns=50)
    dipole = Dipole(position=[0.1, 0.0, 0.0], moment=[0.0, 0.0, 0.5])
    several = bent(
        field=[
            UniformField(uniform=[0, 0, 1e-3]),
            UniformField(uniform=[2e-3, 0, 0]),
            coil,
            dipole,
        ],
        effects=[MagneticTorque(), MagneticForce()],
        solver=Dynamic(duration="0.1 s"),
    )
    assert several.field.uniform == (2e-3, 0.0, 1e-3)
    assert several.field.coils == (coil,)
    assert several.field.dipole == (dipole,)
    assert several.solver.dynamic is not None
    assert bent(field=dipole).field.dipole == (dipole,)


def test_a_tube_is_a_catheter_with_a_bore(tmp_path: Path) -> None:
    sizes = {"length": "40 mm", "diameter": "4 mm", "material": "silicone", "segments": [Segment()]}
    tube = Tube(**sizes, inner_diameter="2 mm")
    assert tube.hollow
    scene = Scene(name="tube", materials=SILICONE, body=tube)
    catheter = Catheter(**sizes, inner_diameter="2 mm")
    assert scene == Scene(name="tube", materials=SILICONE, body=catheter)
    assert load_scene(scene.save(tmp_path / "tube.yaml")) == scene


@pytest.mark.parametrize(
    ("made", "says"),
    [
        (
            lambda: Gravity(acceleration=[0, 0]),
            r"acceleration: received \[0, 0\]\n.*must be a list",
        ),
        (
            lambda: Material(shear_modulus="120", bulk_to_shear=20),
            "shear_modulus: .*\n.*needs a unit",
        ),
        (
            lambda: Gravity(9.81),  # type: ignore[call-arg]
            r"Gravity: received 9\.81\n.*by their names\n.*Gravity\(acceleration=\['0 m/s\^2', '0 m",
        ),
        (
            lambda: Damping("60 1/s"),  # type: ignore[call-arg]
            r'Damping: received "60 1/s"\n.*\n.*`Damping\(rate=\'60 1/s\'\)`',
        ),
        (lambda: MagneticTorque(5), r"write, say, `MagneticTorque\(\)`"),  # type: ignore[call-arg]
        (lambda: MagneticTorque(by=5), "MagneticTorque: by: .*\n.*known here: none"),  # type: ignore[call-arg]
        (lambda: Strip(lenght="4 mm"), 'unknown key "lenght".*\n.*did you mean "length"'),
        (lambda: Tube(length="4 cm"), "inner_diameter: received nothing"),
        (
            lambda: bent(effects=[Gravity(), {"magnetic_torque": {}}]),
            r"effects\[1\]: received .*\n.*must be an effect",
        ),
        (
            lambda: Scene(name="x", materials={"m": {"shear_modulus": "1"}}, body={}),
            r"materials\.m\.shear_modulus: received",
        ),
    ],
)
def test_what_is_wrong_is_said_as_of_a_file(made: Callable[[], object], says: str) -> None:
    with pytest.raises(magmpm.InputError, match=says):
        made()


def test_all_that_scenes_are_made_of_has_a_public_name() -> None:
    """Every effect, and tab completion finds them."""
    from magmpm.effects.acting import Effects

    public = dir(magmpm)
    for kind in Effects.every().values():
        assert kind.__name__ in public
        assert getattr(magmpm, kind.__name__) is kind
    for name in public:
        assert getattr(magmpm, name).__doc__, name
