"""Obstacles are drawn where the solver has them."""

from typing import Any

import numpy as np
import pytest
from reference import drawn
from reference.drawn import MAGNET

from magmpm.bodies.surface_mesh import Mesh, pack_mesh
from magmpm.fields.magnets import frame_of
from magmpm.fields.schedule import places
from magmpm.fields.sources import FieldSource
from magmpm.scene import Scene
from magmpm.viz import obstacles, style
from magmpm.viz.meshes import tube
from magmpm.viz.snapshot import DrawnSolid


def sources_of(field: dict[str, Any], time: float = 0.0) -> list[DrawnSolid]:
    return obstacles.sources(Scene.from_si(drawn.scene(field=field)), time)


@pytest.mark.parametrize(
    ("magnet", "north"),
    [
        (MAGNET, [0, 0, 1]),
        ({**MAGNET, "magnetization": [0, 0, -1]}, [0, 0, -1]),
        ({**MAGNET, "magnetization": [1, 0, 0]}, [1, 0, 0]),
        (
            {
                "cuboid": {"size": [0.03, 0.02, 0.01]},
                "position": [0.05, 0.0, 0.02],
                "axis": [0, 0, 1],
                "remanence": 1.3,
            },
            [0, 0, 1],
        ),
    ],
)
def test_red_is_north(magnet: dict[str, Any], north: list[float]) -> None:
    middle = {
        p.color: p.points[p.triangles].mean(axis=(0, 1)) for p in sources_of({"magnet": magnet})
    }
    away = middle[style.NORTH] - middle[style.SOUTH]
    # A facet that lies across the border is on one side of it.
    np.testing.assert_allclose(away / np.linalg.norm(away), north, atol=0.01)


def test_a_block_has_its_edges_where_the_scene_says() -> None:
    magnet = {
        "cuboid": {"size": [0.03, 0.02, 0.01]},
        "position": [0.0, 0.0, 0.0],
        "axis": [0, 0, 1],
        "remanence": 1.3,
    }
    props = sources_of({"magnet": magnet})
    np.testing.assert_allclose(
        np.ptp(np.vstack([p.points for p in props]), axis=0), [0.03, 0.02, 0.01], atol=1e-12
    )


def test_a_lumen_is_drawn_and_its_distance_known() -> None:
    """The same tube as a path and as a mesh: heights agree with the distance to the wall, within the facets' size."""
    shape = tube([0.06], 0.005, 0.0, 0.06)
    mesh = pack_mesh(Mesh(1e3 * shape.points, shape.triangles))
    lumens = [
        {"tube": {"radius": 0.005, "path": [[0, 0, 0], [0.06, 0, 0]]}},
        {"surface": {"mesh": mesh, "unit": "mm"}},
    ]
    points = np.array([[0.03, 0.0, 0.0035], [0.02, -0.0045, 0.0], [0.03, 0.0, 0.0]])
    for walls in lumens:
        said = Scene.from_si(drawn.scene(effects={"walls": walls}))
        (wall,) = [o for o in obstacles.standing(said) if o.name == "wall"]
        assert wall.hollow
        np.testing.assert_allclose(np.ptp(wall.points, axis=0), [0.06, 0.01, 0.01], rtol=0.01)
        height = obstacles.surfaces(said)["walls"].height(points)
        np.testing.assert_allclose(height, [0.0015, 0.0005, 0.005], atol=1e-4)


def test_sources_are_drawn_where_the_solver_has_them() -> None:
    """A keyframed move and a rotation about a center: as fields.external_field places the field itself; blocks lie as it lays them."""
    axis = [0.6, 0.0, -0.8]
    block = {
        "cuboid": {"size": [0.03, 0.02, 0.01]},
        "position": [0.05, 0.01, 0.02],
        "axis": axis,
        "remanence": 1.2,
    }
    over = {
        "keyframes": [
            {"time": 0.0, "move": [0.0, 0.0, 0.0]},
            {"time": 1.0, "move": [-0.02, 0.01, 0.0]},
        ],
        "rotation": {
            "axis": [0.0, 0.6, 0.8],
            "frequency": -0.4,
            "center": [0.01, 0.0, 0.02],
            "start": 0.2,
            "turns": 0.25,
        },
    }
    source = FieldSource.model_validate({"magnet": block, "over_time": over})
    corners = np.array([[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)]) * [
        0.015,
        0.01,
        0.005,
    ]
    for time in (0.0, 0.3, 0.7, 2.0):
        (place,) = places(source, np.array([time]))
        wanted = (corners @ frame_of(axis).T + block["position"]) @ place["frame"].reshape(
            3, 3
        ).T + place["origin"]
        props = sources_of(source.model_dump(mode="json"), time)
        points = np.vstack([p.points for p in props])
        away = np.linalg.norm(wanted[:, None] - points, axis=2).min(axis=1)
        assert away.max() < 1e-9
