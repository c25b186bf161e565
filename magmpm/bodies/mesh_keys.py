"""A scene's keys that name a mesh: read when the scene is, and kept in it as text, so that a scene stands without its files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pydantic import ValidationInfo

from magmpm.bodies.surface_mesh import PREFIX, MeshError, pack_mesh, read_stl, unpack_mesh
from magmpm.inputs.settings import fault, folder_of


def read_mesh(value: Any, info: ValidationInfo) -> Any:
    """The mesh a path names, as the text a scene keeps; such a text is taken as it is."""
    if not isinstance(value, (str, Path)):
        raise fault("must be the path of an STL file", "write, say, `mesh: meshes/base.stl`")
    try:
        if isinstance(value, str) and value.startswith(PREFIX):
            unpack_mesh(value)
            return value
        return pack_mesh(read_stl(folder_of(info) / value))
    except MeshError as error:
        raise fault(error.rule, error.remedy) from None
