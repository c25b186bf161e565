"""Models of equilibria that follow each other share what loads do not change, and nothing else."""

from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magmpm import load_scene
from magmpm.errors import InputError
from magmpm.model import build
from magmpm.scene import Scene
from magmpm.scene.addresses import changed, places
from magmpm.statics.layout import model_at_rest, static_model

DATA = Path(__file__).resolve().parents[3] / "data"
SCENES = ["scenes/five_segments", "scenes/hollow", "scenes/magnetic_and_plain"]
SCENES += ["scenes/zhao_plane_strain", "goals/scenes/tweezers"]


def coarse(name: str) -> Scene:
    return load_scene(DATA / f"{name}.yaml").with_cells(4)


def same(one: Any, other: Any) -> bool:
    """True if two values are the same to the last bit."""
    if is_dataclass(one) and not isinstance(one, type):
        return type(one) is type(other) and all(
            same(getattr(one, f.name), getattr(other, f.name)) for f in fields(one)
        )
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and one.tobytes() == other.tobytes()
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    return bool(one == other)


def with_loads(scene: Scene) -> list[Scene]:
    """A scene under other loads, one kind at a time."""
    found = [scene.with_field([1e-3, -2e-3, 3e-3])]
    if scene.body.kind != "strip":  # a profile has no directions
        directions = np.roll(np.eye(3), 1, axis=0)[np.arange(len(scene.regions())) % 3]
        found.append(scene.with_magnetizations(directions))
    for name in scene.materials:
        settings = {("materials", name, "remanence"): 0.09, ("materials", name, "density"): 1500.0}
        found.append(changed(scene, settings))
    return found


@pytest.mark.parametrize("name", SCENES)
def test_other_loads_change_loads_alone(name: str) -> None:
    """To the last bit as a model made anew; cells, splines and unknowns are the same objects."""
    scene = coarse(name)
    first = model_at_rest(scene)
    for other in with_loads(scene):
        found = model_at_rest(other)
        assert found.layout is first.layout
        assert found.weights is first.weights
        assert same(found, static_model(build(other)))


@pytest.mark.parametrize(
    "change",
    [
        {"materials.magnetic silicone.shear_modulus": 1e5},
        {"body.catheter.length": 0.041},
        {"resolution.cells_across": 5},
        {"effects.gravity": {}},
    ],
    ids=str,
)
def test_another_body_is_made_anew(change: dict[str, Any]) -> None:
    scene = coarse("scenes/five_segments")
    first = model_at_rest(scene)
    other = changed(scene, {places(scene, at)[0]: value for at, value in change.items()})
    found = model_at_rest(other)
    assert found.layout is not first.layout
    assert same(found, static_model(build(other)))


@pytest.mark.parametrize("name", ["field", "name", "density", "magnetization"])
def test_a_material_may_have_any_name(name: str) -> None:
    """Also that of a load: its stiffness is not left out."""
    data = coarse("scenes/five_segments").to_si()
    (material,) = data["materials"].values()
    data["body"]["catheter"]["material"] = name
    for shear in (6e4, 24e4):
        found = model_at_rest(
            Scene.from_si({**data, "materials": {name: {**material, "shear_modulus": shear}}})
        )
        assert (found.shear == shear).all()


def test_parts_that_change_names_are_made_anew() -> None:
    """What is said of a part by its name is of another one then."""
    scene = coarse("goals/scenes/tweezers")
    first = model_at_rest(scene)
    meshes = places(scene, "body.parts.meshes[*].name")[1:3]
    swapped = dict(zip(meshes, [scene.regions()[k].name for k in (2, 1)], strict=True))
    other = changed(scene, swapped)
    found = model_at_rest(other)
    assert found.layout is not first.layout
    assert same(found, static_model(build(other)))


def test_a_field_that_is_not_known_at_the_body_is_refused_as_ever() -> None:
    """Also where the model before had one that was."""
    scene = load_scene(DATA / "scenes/pulled_by_magnet.yaml").with_cells(2)
    model_at_rest(scene)
    within = changed(scene, {places(scene, "field.magnet.position")[0]: [0.01, 0.0, 0.0]})
    told = []
    for make in (model_at_rest, lambda one: static_model(build(one))):
        with pytest.raises(InputError) as error:
            make(within)
        told.append(str(error.value))
    assert told[0] == told[1]
