"""Numbers of a scene by their addresses."""

import pytest
from reference.scenes import X, rod_scene

from magmpm.errors import InputError
from magmpm.scene.addresses import changed, places, value_at, written

SCENE = rod_scene(directions=[X, X, X])


def test_an_address_names_what_the_file_says() -> None:
    (place,) = places(SCENE, "field.uniform[2]")
    assert place == ("field", "uniform", 2)
    assert written(place) == "field.uniform[2]"
    assert value_at(SCENE, place) == SCENE.field.uniform[2]
    found = changed(SCENE, {place: "3 mT"})
    assert value_at(found, place) == 3e-3
    assert value_at(found, place, units=True) == "3 mT"
    assert changed(SCENE, {}) is SCENE


def test_a_star_names_each_of_a_list() -> None:
    found = places(SCENE, "body.catheter.segments[*].magnetization[0]")
    assert [place[3] for place in found] == [0, 1, 2]
    assert changed(SCENE, dict.fromkeys(found, -1.0)).regions()[2].magnetization == (-1, 0, 0)


def test_names_may_hold_spaces() -> None:
    name = next(iter(SCENE.materials))
    (place,) = places(SCENE, f"materials.{name}.shear_modulus")
    assert changed(SCENE, {place: "90 kPa"}).materials[name].shear_modulus == 90e3
    spaced = SCENE.with_material("soft part", shear_modulus="50 kPa", bulk_to_shear=20.0)
    assert places(spaced, "materials.soft part.shear_modulus")


@pytest.mark.parametrize(
    ("address", "told"),
    [
        ("field.unifrom[2]", "did you mean field.uniform"),
        ("field.uniform[7]", "the scene says nothing there"),
        ("body.catheter.segment[0].magnetization", "body.catheter.segments[*].magnetization"),
        ("field..uniform", "keys with dots between them"),
        ("field.uniform[", "keys with dots between them"),
        ("", "keys with dots between them"),
        ("field.", "keys with dots between them"),
    ],
)
def test_what_is_no_address_is_refused(address: str, told: str) -> None:
    with pytest.raises(InputError, match=r".") as error:
        places(SCENE, address)
    assert told in str(error.value)


def test_a_scene_refuses_what_it_always_refuses() -> None:
    (place,) = places(SCENE, "body.catheter.diameter")
    with pytest.raises(InputError, match="diameter"):
        changed(SCENE, {place: "-1 mm"})
    with pytest.raises(InputError, match="diameter"):
        changed(SCENE, {place: "3 kPa"})
