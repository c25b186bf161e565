"""Numbers of a scene by their addresses: the keys of its file, dots between them, [i] for the i-th of a list, [*] for each of them.

`field.uniform[2]`, `materials.magnetic silicone.remanence`, `body.catheter.segments[*].length`. Values are what a file would say, text with
units, or numbers in SI.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from difflib import get_close_matches
from typing import Any

from magmpm.compiled.arrays import Plain
from magmpm.errors import InputError
from magmpm.inputs.settings import validate
from magmpm.scene.scene import Scene

Place = tuple[str | int, ...]
Placed = dict[Place, Any]  # values by place: in SI, or as a file has them
_PART = re.compile(r"([^.\[\]]+)((?:\[(?:\d+|\*)\])*)")


def written(place: Place) -> str:
    """Write a place as an address.

    Parameters
    ----------
    place : Place
        Keys and indices.

    Returns
    -------
    str
        The address, such as field.uniform[2].
    """
    text = ""
    for part in place:
        text += f"[{part}]" if isinstance(part, int) else f".{part}"
    return text.removeprefix(".")


def places(scene: Scene, address: str) -> list[Place]:
    """Find the places that an address names, one for each of [*].

    Parameters
    ----------
    scene : Scene
        The scene.
    address : str
        Such as `field.coils[*].current`.

    Returns
    -------
    list of Place
        The places.

    Raises
    ------
    InputError
        Where the scene has nothing there.
    """
    found = list(_expanded(scene.to_si(), _parts(address), ()))
    if not found:
        index = re.compile(r"\[\d+\]")
        known = {
            name if index.findall(name) == index.findall(address) else index.sub("[*]", name)
            for name in map(written, _leaves(scene.to_si()))
        }
        near = get_close_matches(address, sorted(known), cutoff=0.5)
        raise InputError(
            address,
            received="an address",
            rule="the scene says nothing there",
            remedy=(
                f"did you mean {' or '.join(near)}?"
                if near
                else "write the keys of the scene's file, dots between them, [i] or [*] for lists"
            ),
        )
    return found


def check_apart(named: Iterable[tuple[str, Iterable[Place]]], at: str) -> None:
    """Refuse a place that is varied twice, or as a part of another.

    Parameters
    ----------
    named : iterable of (name, places)
        What varies each place.
    at : str
        Where that is said, for the message.

    Raises
    ------
    InputError
        Where two places are the same, or one is a part of the other.
    """
    seen: dict[Place, str] = {}
    for name, each in named:
        for place in each:
            for other, before in seen.items():
                shared = min(len(place), len(other))
                if place[:shared] == other[:shared]:
                    raise InputError(
                        at,
                        received=written(place),
                        rule=f"is varied twice, by {before} as well",
                        remedy="leave one of them out",
                    )
            seen[place] = name


def value_at(scene: Scene, place: Place, *, units: bool = False) -> Any:
    """Find the value that a scene has at a place.

    Parameters
    ----------
    scene : Scene
        The scene.
    place : Place
        Keys and indices.
    units : bool, default False
        As text with units, as files have it; else in SI.

    Returns
    -------
    object
        The value.
    """
    found: Any = scene.model_dump(mode="json", context={"units": units})
    for part in place:
        found = found[part]
    return found


def changed(scene: Scene, values: Mapping[Place, Any], *, units: bool = False) -> Scene:
    """Put other values into a scene.

    Parameters
    ----------
    scene : Scene
        The scene.
    values : mapping of place to value
        The values: text with units, or numbers in SI.
    units : bool, default False
        Whether quantities must have units, as in files.

    Returns
    -------
    Scene
        The other scene.

    Raises
    ------
    InputError
        Where it breaks a rule.
    """
    if not values:
        return scene
    data = scene.model_dump(mode="json", context={"units": units})
    data["reference"] = None  # it is that of another scene
    put(data, values, scene)
    return validate(Scene, data, units=units)


def put(data: Plain, values: Mapping[Place, Any], scene: Scene) -> None:
    """Write values into a scene's plain data in place: in SI, or with units into the content of its file.

    A vector that a file leaves out, or gives in another form, is first written as `scene` has it.

    Parameters
    ----------
    data : dict[str, Any]
        The data, or the content.
    values : Mapping[Place, Any]
        By place, as the data have them.
    scene : Scene
        The scene.
    """
    for place, value in values.items():
        holder = _holder(data, place)
        if isinstance(place[-1], int) and not isinstance(holder, list):
            holder = value_at(scene, place[:-1], units=True)
            _holder(data, place[:-1])[place[-2]] = holder
        holder[place[-1]] = value


def say(content: Plain, scene: Scene, places: Iterable[Place]) -> None:
    """Make the content of a file say what a scene says, with units; read again, they are equal to the last bit.

    Parameters
    ----------
    content : dict[str, Any]
        Of the file, changed in place.
    scene : Scene
        The scene.
    places : iterable of Place
        Where.
    """
    for place in places:
        value = value_at(scene, place, units=True)
        put(content, {place: value}, scene)
        if value is None:  # the scene leaves it out
            del _holder(content, place)[place[-1]]


def _holder(data: Any, place: Place) -> Any:
    """Holder of a place in a scene's data. A file may leave out keys, and the list around one item."""
    for part in place[:-1]:
        if isinstance(part, str) and data.get(part) is None:
            data[part] = {}
        if isinstance(part, str) or isinstance(data, list):
            data = data[part]
    return data


def _parts(address: str) -> list[str | int | None]:
    """Keys, indices, and None for [*]. Raises InputError for what is no address."""
    out: list[str | int | None] = []
    at = 0
    while at < len(address):
        match = _PART.match(address, at)
        if match is None or (match.end() < len(address) and address[match.end()] != "."):
            break
        out.append(match[1].strip())
        out += [None if k == "*" else int(k) for k in re.findall(r"\[(\d+|\*)\]", match[2])]
        at = match.end() + 1
    if not out or at <= len(address):
        raise InputError(
            address,
            received="an address",
            rule="an address is keys with dots between them, and [i] or [*] for lists",
            remedy="write, say, `field.uniform[2]`",
        )
    return out


def _expanded(data: Any, parts: list[str | int | None], before: Place) -> Iterator[Place]:
    """The places that parts of an address name below data."""
    if not parts:
        yield before
        return
    part, rest = parts[0], parts[1:]
    if part is None and isinstance(data, list):
        for k, each in enumerate(data):
            yield from _expanded(each, rest, (*before, k))
    elif part is not None and _has(data, part):
        yield from _expanded(data[part], rest, (*before, part))
    elif isinstance(part, str) and isinstance(data, list) and len(data) == 1:
        yield from _expanded(
            data[0], parts, (*before, 0)
        )  # the only magnet may stand without a list


def _has(data: Any, part: str | int) -> bool:
    """True if data has this key or index."""
    if isinstance(part, int):
        return isinstance(data, list) and part < len(data)
    return isinstance(data, Mapping) and part in data


def _leaves(data: Any, before: Place = ()) -> Iterator[Place]:
    """The places of everything that is said, and of what holds it."""
    if before:
        yield before
    if isinstance(data, Mapping):
        for key, value in data.items():
            if value is not None:
                yield from _leaves(value, (*before, str(key)))
    elif isinstance(data, list):
        for k, value in enumerate(data):
            yield from _leaves(value, (*before, k))
