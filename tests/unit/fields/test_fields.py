"""Fields in space: closed forms against magpylib, derivatives against differences, tables against their exact fields."""

import sys
from typing import Any

import numpy as np
import pytest
from reference.taylor import slopes

from magmpm.errors import InputError
from magmpm.fields import kernels as evaluate
from magmpm.fields import magnets as solids
from magmpm.fields import spline, table
from magmpm.fields.dipole import POINT
from magmpm.fields.external_field import external_field
from magmpm.fields.magnets import Box
from magmpm.fields.schedule import end_time, places
from magmpm.fields.sources import FieldSource

magpylib = pytest.importorskip("magpylib")

POSITION = np.array([50e-3, 10e-3, 20e-3])
MOMENT = np.array([1.0, 2.0, -1.0])
M = np.array([0.3, 0.2, -0.5])  # A m^2, the moment on which a field acts
CYLINDER = {
    "cylinder": {"diameter": 20e-3, "length": 16e-3},
    "position": (60e-3, 5e-3, 8e-3),
    "remanence": 1.3,
}
BLOCK = {
    "cuboid": {"size": (20e-3, 16e-3, 12e-3)},
    "position": (60e-3, 5e-3, 8e-3),
    "remanence": 1.3,
}
TILTED = {"axis": (0.6, 0.0, 0.8), "magnetization": (0.0, 1.0, 0.0)}
BOX = Box(np.full(3, -20e-3), np.full(3, 20e-3))


def place(
    frame: np.ndarray | None = None,
    strength: float = 1.0,
    origin: object = (0, 0, 0),
    uniform: object = (0, 0, 0),
) -> np.void:
    record = np.zeros(1, np.dtype(evaluate.PLACE))
    record["frame"] = (np.eye(3) if frame is None else frame).ravel()
    record["strength"], record["origin"], record["uniform"] = strength, origin, uniform
    return record[0]


def dipoles(*rows: np.ndarray) -> np.ndarray:
    return np.concatenate([[len(rows), 0], *rows])


def tabulated(packed: np.ndarray) -> np.ndarray:
    return np.concatenate([[0, 1], packed])


ONE = dipoles(np.concatenate([POSITION, MOMENT, [POINT]]))


def at(where: np.void, data: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """B (n, 3) and grad B (n, 3, 3)."""
    B = np.empty((len(x), 3))
    G = np.empty((len(x), 3, 3))
    evaluate.fields_at(where, data, x, B)
    evaluate.gradients_at(where, data, x, G)
    return B, G


def some_points(rng: np.random.Generator, count: int = 200) -> np.ndarray:
    return rng.uniform(-19e-3, 19e-3, (count, 3))


@pytest.fixture
def turned(rng: np.random.Generator) -> np.void:
    """A rotated and moved frame with reduced strength, plus a uniform field."""
    Q, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    return place(Q * np.linalg.det(Q), 0.7, (1e-3, 2e-3, -1e-3), (1e-3, 0, 2e-3))


@pytest.fixture(scope="module")
def spline_data() -> np.ndarray:
    """The field of a dipole as a table."""
    spacing = np.full(3, 2.5e-3)
    shape = (17, 17, 17)
    nodes = table.grid_points(BOX.lower, spacing, shape)
    B, _ = at(place(), ONE, nodes)
    return tabulated(spline.packed(BOX.lower, spacing, B.reshape(*shape, 3)))


@pytest.fixture(scope="module")
def turned_table() -> np.ndarray:
    """The field of a dipole as a table along axes of its own."""
    Q, _ = np.linalg.qr(np.random.default_rng(5).standard_normal((3, 3)))
    spacing = np.full(3, 2.5e-3)
    shape = (17, 17, 17)
    B, _ = at(place(), ONE, table.grid_points(BOX.lower, spacing, shape) @ Q.T)
    return tabulated(spline.packed(BOX.lower, spacing, (B @ Q).reshape(*shape, 3), Q))


def test_dipole_is_magpylibs(rng: np.random.Generator) -> None:
    """To 2e-10: mu0 has been a measured number since 2019, and magpylib uses it; ours is 4 pi 1e-7."""
    x = some_points(rng)
    exact = magpylib.misc.Dipole(moment=MOMENT, position=POSITION).getB(x)
    np.testing.assert_allclose(
        at(place(), ONE, x)[0], exact, rtol=0, atol=2e-10 * np.abs(exact).max()
    )


@pytest.mark.parametrize("source", ["dipole", "table", "turned table"])
def test_derivatives_are_those_of_the_field(
    source: str,
    spline_data: np.ndarray,
    turned_table: np.ndarray,
    turned: np.void,
    rng: np.random.Generator,
) -> None:
    """Taylor: the remainder of B after the slope has order 2, of m . B after slope and curvature order 3, in a rotated, moved frame."""
    data = {"dipole": ONE, "table": spline_data, "turned table": turned_table}[source]
    for x in rng.uniform(-9e-3, 9e-3, (4, 3)):
        d = 1e-3 * rng.standard_normal(3)
        B, G = (a[0] for a in at(turned, data, x[None]))
        H = np.zeros((3, 3))
        evaluate.curvature(turned, data, x, *M, 1.0, H)
        f = np.array(evaluate.pull(turned, data, x, *M))
        np.testing.assert_allclose(f, G.T @ M, rtol=0, atol=1e-13 * np.abs(f).max())
        np.testing.assert_allclose(H, H.T, rtol=0, atol=1e-12 * np.abs(H).max())

        def moved(t: float, x: np.ndarray = x, d: np.ndarray = d) -> np.ndarray:
            return np.array(evaluate.field(turned, data, x + t * d))

        steps = [0.2, 0.1, 0.05, 0.025]
        first = slopes(lambda t: moved(t) - B - t * G @ d, steps)  # noqa: B023
        second = slopes(lambda t: M @ (moved(t) - B) - t * f @ d - t**2 * d @ H @ d / 2, steps)  # noqa: B023
        assert first[-1] == pytest.approx(2.0, abs=0.05)
        # the third derivative of a cubic spline jumps from cell to cell, that of the dipole is smooth
        assert second[-1] == pytest.approx(3.0, abs=0.1 if source == "dipole" else 0.5)


def test_a_turned_frame_turns_the_field(turned: np.void, rng: np.random.Generator) -> None:
    """B(x) = uniform + s R B0(R^T (x - o)), written explicitly."""
    x = some_points(rng)
    R = turned["frame"].reshape(3, 3)
    local = (x - turned["origin"]) @ R
    want = turned["uniform"] + 0.7 * at(place(), ONE, local)[0] @ R.T
    np.testing.assert_allclose(at(turned, ONE, x)[0], want, rtol=1e-12)


def test_inside_a_dipoles_sphere_all_is_finite() -> None:
    """The inner field of a magnetized sphere, 2/3 mu0 M, without a force."""
    radius = 5e-3
    data = dipoles(np.concatenate([POSITION, MOMENT, [radius]]))
    B, G = at(place(), data, np.stack([POSITION, POSITION + 1e-3]))
    np.testing.assert_allclose(B, np.tile(2e-7 * MOMENT / radius**3, (2, 1)), rtol=1e-14)
    assert not G.any()
    assert np.isfinite(at(place(), ONE, POSITION[None])[0]).all()


def cubic(x: np.ndarray) -> np.ndarray:
    """A cubic polynomial in each coordinate, three components."""
    a, b, c = (x / 10e-3).T
    return np.stack([a**3 - 2 * a * b**2 * c, b**3 * c**2 + 1.0, a**2 * b * c**3 - b], axis=1)


def test_spline_meets_cubics_exactly(rng: np.random.Generator) -> None:
    """Up to the faces of the box: the not-a-knot ends. Value, slope and curvature."""
    lower = np.array([-20e-3, -10e-3, 5e-3])
    spacing = np.array([4e-3, 3e-3, 2e-3])
    shape = (9, 7, 6)
    nodes = table.grid_points(lower, spacing, shape)
    data = tabulated(spline.packed(lower, spacing, cubic(nodes).reshape(*shape, 3)))
    upper = lower + spacing * (np.array(shape) - 1)
    x = lower + rng.random((100, 3)) * (upper - lower)
    B, G = at(place(), data, x)
    size = np.abs(cubic(x)).max()
    np.testing.assert_allclose(B, cubic(x), rtol=0, atol=1e-12 * size)
    h = 1e-6
    for k in range(3):
        step = h * np.eye(3)[k]
        differences = (cubic(x + step) - cubic(x - step)) / (2 * h)
        np.testing.assert_allclose(
            G[:, :, k], differences, rtol=0, atol=1e-7 * np.abs(differences).max()
        )


def test_a_table_along_its_own_axes_has_the_same_field(
    turned_table: np.ndarray, spline_data: np.ndarray
) -> None:
    """As near to the dipole's as the table along the axes of space; the worst of either differ by the places of their nodes, not by 3."""
    x = np.random.default_rng(6).uniform(-9e-3, 9e-3, (200, 3))
    exact, slope = at(place(), ONE, x)
    errors = []
    for data in (spline_data, turned_table):
        B, G = at(place(), data, x)
        errors.append([np.abs(B - exact).max(), np.abs(G - slope).max()])
    assert errors[1][0] < 3 * errors[0][0]
    assert errors[1][1] < 3 * errors[0][1]


def test_beyond_the_box_the_value_stays(spline_data: np.ndarray) -> None:
    """Beyond the box the value of its nearest point, with zero slope: finite, so that a check can report it."""
    x = np.array(
        [[30e-3, 1e-3, 2e-3], [20e-3, 1e-3, 2e-3], [-50e-3, 90e-3, 2e-3], [-20e-3, 20e-3, 2e-3]]
    )
    B, G = at(place(), spline_data, x)
    np.testing.assert_allclose(B[[0, 2]], B[[1, 3]], rtol=1e-12)
    assert not G[0, :, 0].any()
    assert G[0, :, 1].any()


def test_a_spline_needs_four_nodes() -> None:
    with pytest.raises(ValueError, match="needs 4 nodes along each axis, got 3"):
        spline.coefficients(np.zeros((5, 5, 3, 3)))


def source(**given: object) -> FieldSource:
    return FieldSource.model_validate(given)


COILS = {"position": (0, 0, -50e-3), "diameter": 60e-3, "current": 5.0, "turns": 200}


@pytest.mark.parametrize(
    "given",
    [
        {"magnet": CYLINDER},
        {"magnet": {**BLOCK, **TILTED}},
        {"coils": COILS},
        {"magnet": [CYLINDER], "coils": [COILS]},
    ],
    ids=["cylinder", "block", "coil", "both"],
)
def test_table_is_as_exact_as_it_says(given: dict[str, object], rng: np.random.Generator) -> None:
    """At points that its own check did not use. Also curl and divergence, which are zero for the exact field."""
    exact = solids.exact(source(**given))
    tolerance = 2e-3
    packed, errors = table.tabulate(exact, BOX, tolerance, "field.magnet")
    x = some_points(rng, 1000)
    B, G = table.evaluate(packed, x)
    want = exact(x)
    assert errors.within(tolerance)
    # 2: the maximum of a thousand points may be slightly above the maximum of the fifteen hundred points of the check
    assert (np.linalg.norm(B - want, axis=1) / np.linalg.norm(want, axis=1)).max() <= 2 * tolerance
    size = np.linalg.norm(G, axis=(1, 2)).max()
    assert np.abs(G - G.transpose(0, 2, 1)).max() <= 2 * table.GRADIENT * tolerance * size
    assert np.abs(np.trace(G, axis1=1, axis2=2)).max() <= 2 * table.GRADIENT * tolerance * size


def test_orientation_and_magnetisation_of_a_magnet(rng: np.random.Generator) -> None:
    """Far away any magnet is the dipole Br V/mu0; a coil is the dipole I N A."""
    x = 0.5 * np.array([1.0, 0.2, -0.3]) + 0.01 * rng.standard_normal((5, 3))
    block = source(magnet={**BLOCK, **TILTED, "position": (0, 0, 0)})
    volume = 20e-3 * 16e-3 * 12e-3
    far = dipoles(
        np.concatenate([np.zeros(3), np.array([0, 1, 0]) * 1.3 * volume / (4e-7 * np.pi), [POINT]])
    )
    np.testing.assert_allclose(
        solids.exact(block)(x),
        at(place(), far, x)[0],
        rtol=0,
        atol=2e-3 * np.abs(at(place(), far, x)[0]).max(),
    )
    coil = source(coils={**COILS, "position": (0, 0, 0), "axis": (1, 0, 0), "diameter": 20e-3})
    ring = dipoles(
        np.concatenate([np.zeros(3), np.array([1, 0, 0]) * 1000 * np.pi * 1e-4, [POINT]])
    )
    np.testing.assert_allclose(
        solids.exact(coil)(x),
        at(place(), ring, x)[0],
        rtol=0,
        atol=2e-3 * np.abs(at(place(), ring, x)[0]).max(),
    )


def test_frame_carries_z_onto_the_axis(rng: np.random.Generator) -> None:
    for axis in [*np.eye(3), *-np.eye(3), *rng.standard_normal((5, 3))]:
        unit = axis / np.linalg.norm(axis)
        frame = solids.frame_of(unit)
        np.testing.assert_allclose(frame[:, 2], unit, atol=1e-15)
        np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-14)
        assert np.linalg.det(frame) > 0


def test_a_table_too_near_to_a_magnet_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table, "MOST_TABLE_NODES", 40_000)
    near = Box(np.array([-10e-3, -10e-3, -10e-3]), np.array([49.9e-3, 10e-3, 10e-3]))
    with pytest.raises(
        InputError,
        match=r"field.magnet: a table over .* can't be accurate to 0.2 %.*\n.*\n.*smaller box",
    ):
        table.tabulate(solids.exact(source(magnet=CYLINDER)), near, 2e-3, "field.magnet")


@pytest.mark.parametrize(
    "given",
    [CYLINDER, {**BLOCK, **TILTED}, {**CYLINDER, **TILTED}],
    ids=["cylinder", "block", "tilted"],
)
def test_cloud_of_dipoles(given: dict[str, object], rng: np.random.Generator) -> None:
    """Meets the requested accuracy from the requested distance on, at points its own check did not use; it has the magnet's moment."""
    field = source(magnet=given)
    exact = solids.exact(field)
    solid = solids.taken(field)[0]
    rows = table.cloud(solid, solids.polarization(field.magnet[0]), exact, 8e-3, 2e-3)
    x = solid.position + rng.uniform(-50e-3, 50e-3, (3000, 3))
    x = x[solid.depth(x) < -8e-3]
    B = at(place(), dipoles(*rows), x)[0]
    want = exact(x)
    assert (np.linalg.norm(B - want, axis=1) / np.linalg.norm(want, axis=1)).max() <= 2 * 2e-3
    volume = 20e-3 * 16e-3 * 12e-3 if "cuboid" in given else np.pi * 10e-3**2 * 16e-3
    np.testing.assert_allclose(
        np.linalg.norm(rows[:, 3:6].sum(axis=0)), 1.3 * volume / (4e-7 * np.pi), rtol=1e-12
    )


def test_a_cloud_too_near_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table, "MAX_DIPOLES", 50)
    field = source(magnet=CYLINDER)
    with pytest.raises(InputError, match=r"field.magnet: within 0.5 mm .* can't be known to"):
        table.cloud(
            solids.taken(field)[0],
            solids.polarization(field.magnet[0]),
            solids.exact(field),
            0.5e-3,
            2e-3,
        )


def test_without_magpylib_the_message_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "magpylib", None)
    with pytest.raises(
        InputError, match=r"magpylib, which is not installed\n.*\n.*pip install .*\[magnets\]'"
    ) as caught:
        solids.exact(source(magnet=CYLINDER))
    assert caught.value.exit_status == 2


BODY = Box(np.array([0, -2e-3, -2e-3]), np.array([40e-3, 2e-3, 2e-3]))


def test_reach_of_a_held_body_is_its_length() -> None:
    box = solids.reach(BODY, anchored=True)
    assert box.holds(np.array([[-40e-3, 0, 0], [0, 40e-3, 0], [40e-3, 2e-3, 2e-3]])).all()
    free = solids.reach(BODY, anchored=False)
    assert free.holds(np.array([[79e-3, 0, 0], [-39e-3, 0, 0]])).all()


def test_box_is_cut_between_body_and_magnet() -> None:
    """A quarter of the gap remains to the magnet; the body is in the box, the magnet is not."""
    magnet = solids.taken(source(magnet={**CYLINDER, "position": (52e-3, 5e-3, 8e-3)}))
    box = solids.cut_for(solids.reach(BODY, True), BODY, magnet)
    assert box.cut == ("field.magnet",)
    assert box.upper[0] == pytest.approx(42e-3 - 0.25 * 2e-3)
    assert np.all(box.lower <= BODY.lower)
    assert not box.meets(*magnet[0].box())
    reach = solids.reach(BODY, True)
    beside = solids.taken(
        source(magnet={**CYLINDER, "position": (reach.upper[0] + 10.1e-3, 5e-3, 8e-3)})
    )
    assert solids.cut_for(reach, BODY, beside) is reach
    near = solids.cut_for(reach, BODY, beside, keeps_off=0.0)
    assert near.upper[0] < reach.upper[0], (
        "no table is exact a tenth of a millimeter beside a magnet's edge"
    )
    assert near.volume > 0.5 * reach.volume
    aside = solids.taken(
        source(magnet={**CYLINDER, "position": (reach.upper[0] + 10.1e-3, 30e-3, 8e-3)})
    )
    kept = [solids.cut_for(reach, BODY, aside, keeps_off=off) for off in (0.0, 3e-3)]
    low = aside[0].box()[0]
    assert low[0] - kept[0].upper[0] == pytest.approx(
        0.25 * (low[0] - BODY.upper[0])
    )  # the least that a cut loses
    assert low[1] - kept[1].upper[1] == pytest.approx(
        0.25 * (low[1] - BODY.upper[1])
    )  # where more than 3 mm are kept
    far = solids.cut_for(solids.reach(BODY, True), BODY, solids.taken(source(magnet=CYLINDER)))
    assert not far.cut, "out of reach: nothing to cut"
    inside = solids.taken(source(magnet={**CYLINDER, "position": (20e-3, 0, 0)}))
    assert solids.cut_for(solids.reach(BODY, True), BODY, inside) is None


def on_the_axis_of(body: Box) -> np.ndarray:
    return np.outer(np.linspace(0.0, body.upper[0], 101), [1.0, 0.0, 0.0])


def beside(way: np.ndarray, gap: float, body: Box, **shape: object) -> FieldSource:
    """A magnet whose center is so far along `way` from the origin that it is `gap` m away from a body's axis."""
    line = on_the_axis_of(body)
    near = 0.0
    far = 0.5
    for _ in range(60):
        where = (near + far) / 2
        found = source(magnet={**shape, "position": tuple(where * way), "remanence": 1.3})
        (solid,) = solids.taken(found)
        clear = np.linalg.norm(line - solid.nearest(line), axis=1).min()
        near, far = (near, where) if clear > gap else (where, far)
    return found


@pytest.mark.parametrize("number", range(8))
def test_a_tilted_magnet_that_is_clear_of_the_body_has_its_field(number: int) -> None:
    """Drawn directions: a wire beside a magnet three times as large, 9 to 15 mm from it. The field is as exact as it says, 0.2 %."""
    rng = np.random.default_rng(number)
    axis, way = (one / np.linalg.norm(one) for one in rng.standard_normal((2, 3)))
    shape = (
        {"cylinder": {"diameter": 50e-3, "length": 50e-3}}
        if number % 2
        else {"cuboid": {"size": (50e-3, 50e-3, 30e-3)}}
    )
    wire = Box(np.array([0.0, -2e-4, -2e-4]), np.array([18e-3, 2e-4, 2e-4]))
    given = beside(way, rng.uniform(9e-3, 15e-3), wire, **shape, axis=tuple(axis))
    field = external_field(
        given, (tuple(wire.lower.tolist()), tuple(wire.upper.tolist())), anchored=True, cell=1e-4
    )
    x = on_the_axis_of(wire)
    exact = solids.exact(given)(x)
    assert (
        np.linalg.norm(field.at(x) - exact, axis=1) / np.linalg.norm(exact, axis=1)
    ).max() <= 2e-3
    assert field.outside_domain(x) is None
    assert field.limits, "a table, not a cloud, whose errors grow toward the magnet"
    (solid,) = solids.taken(given)
    surface = solid.nearest(solid.position + 0.1 * rng.standard_normal((500, 3)))
    assert not field.limits[0].box.holds(surface).any(), "no table reaches into the magnet"


def test_the_least_box_of_a_tilted_cylinder() -> None:
    """Its rim's farthest points: r sin + h cos of the tilt along each axis, less than the box around its own box."""
    (solid,) = solids.taken(source(magnet={**CYLINDER, "axis": (np.sin(0.5), 0.0, np.cos(0.5))}))
    low, high = solid.box()
    r = 10e-3
    h = 8e-3
    half = [r * np.cos(0.5) + h * np.sin(0.5), r, r * np.sin(0.5) + h * np.cos(0.5)]
    np.testing.assert_allclose((high - low) / 2, half, rtol=1e-12)


def test_a_given_box_may_lie_beside_a_tilted_magnet() -> None:
    """In its axis-parallel box, but clear of it: the field is known there; a box that reaches into the magnet is refused."""
    magnet = {**CYLINDER, "position": (60e-3, 0.0, 60e-3), "axis": (0.6, 0.0, 0.8)}
    box = {"lower": (-44e-3, -44e-3, -44e-3), "upper": (49e-3, 44e-3, 50e-3)}
    (solid,) = solids.taken(source(magnet=magnet))
    assert Box(np.array(box["lower"]), np.array(box["upper"])).meets(*solid.box())
    given = source(magnet=magnet, tabulation={**box, "tolerance": 1e-2})
    corners = (tuple(BODY.lower.tolist()), tuple(BODY.upper.tolist()))
    x = on_the_axis_of(BODY)
    exact = solids.exact(given)(x)
    found = external_field(given, corners, anchored=True, cell=1e-3).at(x)
    assert (
        np.linalg.norm(found - exact, axis=1) / np.linalg.norm(exact, axis=1)
    ).max() <= 1e-2  # the tolerance asked for
    larger = {**box, "upper": (56e-3, 44e-3, 56e-3), "tolerance": 1e-2}
    with pytest.raises(InputError, match=r"field.magnet is in the box"):
        external_field(source(magnet=magnet, tabulation=larger), corners, anchored=True, cell=1e-3)


def test_sources_that_turn_see_the_body_all_round() -> None:
    given = {"rotation": {"axis": (0, 0, 1), "frequency": 2.0, "center": (60e-3, 0, 0)}}
    seen = solids.seen_from_sources(source(magnet=CYLINDER, over_time=given), BODY)
    assert seen.upper[0] >= 119e-3
    assert seen.lower[1] <= -59e-3
    assert seen.upper[2] == pytest.approx(2e-3)


def at_times(over: dict[str, object], times: object, **more: object) -> np.ndarray:
    return places(
        source(uniform=(0, 0, 1e-2), over_time=over, **more), np.asarray(times, dtype=float)
    )


@pytest.mark.parametrize(
    ("over", "times", "strength"),
    [
        (
            {"ramp": {"start": 1.0, "duration": 2.0, "begin": 0.5, "end": 2.0}},
            [0, 1, 2, 3, 9],
            [0.5, 0.5, 1.25, 2, 2],
        ),
        (
            {
                "oscillation": {
                    "frequency": 5.0,
                    "amplitude": 2.0,
                    "mean": 1.0,
                    "phase": np.pi / 2,
                    "start": 0.1,
                    "cycles": 1.5,
                }
            },
            [0, 0.1, 0.2, 0.3, 0.4, 7],
            [3, 3, -1, 3, -1, -1],
        ),
    ],
    ids=["ramp", "oscillation"],
)
def test_strength_over_time(
    over: dict[str, object], times: list[float], strength: list[float]
) -> None:
    found = at_times(over, times)
    np.testing.assert_allclose(found["strength"], strength, atol=1e-12)
    np.testing.assert_allclose(found["uniform"][:, 2], 1e-2 * found["strength"])
    assert len(places(source(uniform=(0, 0, 1e-2)), np.arange(5.0))) == 1, (
        "a field that does not change has one record"
    )


def test_rotation_is_right_handed_and_stops() -> None:
    over = {"rotation": {"axis": (0, 1, 0), "frequency": 2.0, "start": 1.0, "turns": 0.75}}
    found = at_times(over, [0, 1, 1.125, 1.25, 1.375, 50])["uniform"]
    z = np.array([0, 0, 1e-2])
    x = np.array([1e-2, 0, 0])
    np.testing.assert_allclose(found, [z, z, x, -z, -x, -x], atol=1e-16)
    back = at_times({"rotation": {"axis": (0, 1, 0), "frequency": -2.0}}, [0.125])["uniform"]
    np.testing.assert_allclose(back, [-x], atol=1e-16)


def test_rotation_turns_sources_about_its_centre() -> None:
    """The frame of the sources: a point at the center stays, another one moves around it, and the field rotates with it."""
    over = {"rotation": {"axis": (0, 0, 1), "frequency": 1.0, "center": (60e-3, 0, 0)}}
    field = source(dipole={"position": (70e-3, 0, 0), "moment": (1, 0, 0)}, over_time=over)
    where = places(field, np.array([0.25]))[0]
    data = dipoles(np.array([70e-3, 0, 0, 1, 0, 0, POINT]))
    turned = dipoles(np.array([60e-3, 10e-3, 0, 0, 1, 0, POINT]))
    x = np.array([[0.01, 0.02, 0.005]])
    np.testing.assert_allclose(at(where, data, x)[0], at(place(), turned, x)[0], rtol=1e-12)


def test_keyframes_move_and_multiply() -> None:
    """Each quantity is interpolated between the keyframes that give it; strengths multiply; the move comes before the rotation."""
    frames = [
        {"time": 0, "strength": 0},
        {"time": 1, "strength": 1, "move": (0, 0, 0)},
        {"time": 3, "move": (2e-3, 0, 0), "uniform": (1e-3, 0, 0)},
    ]
    over = {"keyframes": frames, "ramp": {"duration": 2.0}}
    found = at_times(
        over, [0.5, 1, 2, 3, 4], dipole={"position": (60e-3, 0, 0), "moment": (1, 0, 0)}
    )
    np.testing.assert_allclose(found["strength"], [0.125, 0.5, 1, 1, 1])
    np.testing.assert_allclose(found["origin"][:, 0], [0, 0, 1e-3, 2e-3, 2e-3])
    np.testing.assert_allclose(found["uniform"][-1], [1e-3, 0, 0])
    spun = {**over, "rotation": {"axis": (0, 0, 1), "frequency": 1 / 16}}
    np.testing.assert_allclose(at_times(spun, [4.0])["origin"][0], [0, 2e-3, 0], atol=1e-15)


@pytest.mark.parametrize("strength", [0.0, 0.25, 1.0])
def test_strength_scales_all(strength: float) -> None:
    field = source(uniform=(1e-3, 0, 0), dipole={"position": (60e-3, 0, 0), "moment": (1, 0, 0)})
    found = places(field, None, strength)[0]
    np.testing.assert_array_equal(found["uniform"], [strength * 1e-3, 0, 0])
    assert found["strength"] == strength


STARTED_LATE: dict[str, tuple[dict[str, Any], float]] = {
    "ramp": ({"ramp": {"start": 0.3, "duration": 0.2, "end": 0.5}}, 0.5),
    "rotation": (
        {"rotation": {"axis": (0, 1, 0), "frequency": 2.0, "start": 1.0, "turns": 0.75}},
        1.375,
    ),
    "rotation the other way": (
        {"rotation": {"axis": (0, 1, 0), "frequency": -2.0, "start": 1.0, "turns": 0.75}},
        1.375,
    ),
    "oscillation": (
        {
            "oscillation": {
                "frequency": 5.0,
                "amplitude": 2.0,
                "mean": 1.0,
                "start": 0.1,
                "cycles": 1.25,
            }
        },
        0.35,
    ),
    "keyframes": ({"keyframes": [{"time": 0, "strength": 0}, {"time": 0.7, "strength": 1}]}, 0.7),
}


def field(over: dict[str, Any]) -> FieldSource:
    return FieldSource.model_validate({"uniform": (1e-3, 0, 1e-2), "over_time": over})


@pytest.mark.parametrize("part", STARTED_LATE)
def test_the_end_counts_from_the_start_of_each_part(part: str) -> None:
    """Just before the end the field still changes, after it no more."""
    over, end = STARTED_LATE[part]
    given = field(over)
    assert end_time(given) == pytest.approx(end, rel=1e-12)
    before, at, after, long_after = places(given, np.array([end - 0.01, end, end + 0.01, 1e5]))[
        "uniform"
    ]
    assert np.abs(before - at).max() > 1e-5  # T
    np.testing.assert_allclose([after, long_after], [at, at], rtol=0, atol=1e-14)
    np.testing.assert_array_equal(
        places(given)["uniform"][0], places(given, np.array([end_time(given)]))["uniform"][0]
    )


def test_the_last_part_to_end_counts() -> None:
    parts = [over for over, _ in STARTED_LATE.values()]
    assert end_time(field({**parts[0], **parts[1], **parts[3]})) == pytest.approx(1.375)
    assert end_time(FieldSource.model_validate({"uniform": (0, 0, 1e-2)})) == 0.0
