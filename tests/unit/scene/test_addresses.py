"""Numbers of a scene by their addresses."""

import pytest
from reference.scenes import X, rod_scene

from magmpm.errors import InputError
from magmpm.scene import Scene
from magmpm.scene.addresses import changed, places, put, say, value_at, written

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


def test_the_only_one_of_a_list_needs_no_index() -> None:
    """As in a scene file, where one dipole may stand without a list; of two, the remedy names both."""
    one = {"position": [0.05, 0.0, 0.0], "moment": [1.0, 0.0, 0.0]}
    data = {**SCENE.to_si(), "field": {"dipole": one}}
    alone = Scene.from_si(data)
    assert places(alone, "field.dipole.position[2]") == [("field", "dipole", 0, "position", 2)]
    two = Scene.from_si({**data, "field": {"dipole": [one, one]}})
    with pytest.raises(InputError, match=r"did you mean field\.dipole\[\*\]\.position"):
        places(two, "field.dipole.position[2]")


def test_names_may_hold_spaces() -> None:
    name = next(iter(SCENE.materials))
    (place,) = places(SCENE, f"materials.{name}.shear_modulus")
    assert changed(SCENE, {place: "90 kPa"}).materials[name].shear_modulus == 90e3
    spaced = SCENE.with_material("soft part", shear_modulus="50 kPa", bulk_to_shear=20.0)
    assert places(spaced, "materials.soft part.shear_modulus")


@pytest.mark.parametrize(
    ("address", "told"),
    [
        ("field.unifrom[2]", "did you mean field.uniform[2]"),
        ("field.uniform[7]", "the scene says nothing there"),
        ("body.catheter.segment[0].magnetization", "body.catheter.segments[0].magnetization"),
        ("body.catheter.segments[9].magnetization", "body.catheter.segments[*].magnetization"),
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


def test_a_files_content_says_what_a_scene_does_to_the_last_bit() -> None:
    """Also what it leaves out, and what it gives in another form: by angles, or alone in place of a list."""
    magnet = {"cylinder": {"diameter": "10 mm", "length": "10 mm"}, "axis": [0, 0, 1]}
    magnet |= {"position": ["0 mm", "0 mm", "40 mm"], "remanence": "1.2 T"}
    data = SCENE.to_si()
    wanted = changed(
        Scene.from_si({**data, "field": {**data["field"], "magnet": [magnet]}}),
        {
            ("field", "uniform", 1): 1e-3 / 3.0,
            ("field", "magnet", 0, "position", 2): 0.1 / 3.0,
            ("body", "catheter", "segments", 1, "magnetization"): [1.0, 2.0, 3.0],
            ("body", "catheter", "diameter"): 0.01 / 3.0,
        },
    )
    content = {**data, "field": {"magnet": magnet}, "name": "from a file"}
    content["body"]["catheter"]["segments"][1]["magnetization"] = {"azimuth": "30 deg"}
    content["body"]["catheter"]["segments"][0]["length"] = "5 mm"
    field = [("field", "uniform", 1), ("field", "magnet", 0, "position", 2)]
    segments = ("body", "catheter", "segments")
    shape = [(*segments, 1, "magnetization", 2), (*segments, 0, "length")]
    say(content, wanted, [*field, *shape, ("body", "catheter", "diameter")])
    assert "length" not in content["body"]["catheter"]["segments"][0]  # the scene gives it none
    assert content["field"]["uniform"][0] == "0 mT"
    again = Scene.from_si(content)
    assert (again.body, again.field) == (wanted.body, wanted.field)


def test_a_value_keeps_its_words() -> None:
    content = {"field": {"uniform": ["0 mT", "1 G", "2 mT"]}}
    put(content, {("field", "uniform", 2): "3 mT"}, SCENE)
    assert content == {"field": {"uniform": ["0 mT", "1 G", "3 mT"]}}
