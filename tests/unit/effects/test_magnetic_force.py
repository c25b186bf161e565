"""Torque and force of a nonuniform field: derivatives of one energy, in hooks and in a model; balances; valid scenes."""

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from reference.plain_forms import to_dense
from reference.scenes import rod_scene
from reference.taylor import slopes

from magmpm.effects import acting as effects
from magmpm.effects import hooks, magnetic_force, magnetic_torque
from magmpm.errors import InputError, SolveError
from magmpm.fields.dipole import MU0
from magmpm.model import build
from magmpm.scene import Scene
from magmpm.scene.rules import without_energy
from magmpm.simulate import run
from magmpm.statics.energy import Energy
from magmpm.statics.layout import static_model

BR = np.array([0.1, 0.05, -0.08])
RHO = 1882.0
F0 = np.array([[1.1, 0.2, -0.3], [0.1, 0.8, 0.4], [-0.2, 0.3, 1.2]])
X0 = np.array([4e-3, 1e-3, -1e-3])
NEAR = {"position": (16e-3, 2e-3, 4e-3), "moment": (0.3, 0.2, -0.4)}


def scene_in(field: dict[str, Any], *names: str, length: float = 8e-3, **more: Any) -> Scene:
    """A short catheter in a field, with these effects."""
    data = rod_scene(length=length, **more).to_si()
    return Scene.from_si(
        {**data, "field": field, "effects": {**data["effects"], **{name: {} for name in names}}}
    )


BOTH = ("magnetic_torque", "magnetic_force")
SCENE = scene_in({"uniform": (1e-3, 0, 2e-3), "dipole": NEAR}, *BOTH)


def parts(named: Sequence[np.ndarray], x: np.ndarray, F: np.ndarray) -> tuple[Any, ...]:
    """W, P, f, H, M of both effects together."""
    P = np.zeros((3, 3))
    f = np.zeros(3)
    H = np.zeros((3, 3))
    M = np.zeros((3, 9))
    W = 0.0
    for record, data in hooks.pairs(named):
        for hook, out in (("stress", (P,)), ("force", (f,)), ("softening", (H, M))):
            function = hooks.hook_of(hook, record)
            if function is not None:
                function(record[0], data, BR, RHO, x, F, *out)
        energy = hooks.hook_of("energy", record)
        W += 0.0 if energy is None else energy(record[0], data, BR, RHO, x, F)
    return W, P, f, H, M


def test_hooks_are_what_the_formulas_say() -> None:
    """W = -(1/mu0) B . F Br, P = -(1/mu0) B (x) Br, f = (1/mu0) (grad B)^T F Br with B and grad B at the particle."""
    W, P, f, _, M = parts(effects.collect(SCENE), X0, F0)
    source = SCENE.external_field()
    B = source.at(X0)[0]
    G = source.gradient(X0)[0]
    assert pytest.approx(-B @ F0 @ BR / MU0, rel=1e-12) == W
    np.testing.assert_allclose(P, -np.outer(B, BR) / MU0, rtol=1e-12)
    np.testing.assert_allclose(f, G.T @ F0 @ BR / MU0, rtol=1e-12)
    np.testing.assert_allclose(M, -np.einsum("ji,l->ijl", G, BR).reshape(3, 9) / MU0, rtol=1e-12)
    assert np.linalg.norm(f) / RHO > 10, "m/s^2: there is something to compare"


@pytest.mark.parametrize("kind", ["dipole", "magnet"])
def test_gradient_and_tangent_of_a_model(kind: str, rng: np.random.Generator) -> None:
    """Residual and tangent of the model are the first and second derivative of its energy, also for the loads alone."""
    if kind == "magnet":
        pytest.importorskip("magpylib")
        magnet = {
            "position": (24e-3, 2e-3, 3e-3),
            "cylinder": {"diameter": 10e-3, "length": 8e-3},
            "axis": (1, 0, 0.3),
            "remanence": 1.3,
        }
        scene = scene_in({"magnet": magnet}, *BOTH)
    else:
        scene = SCENE
    model = static_model(build(scene))
    loaded = Energy(model)
    bare = Energy(replace(model, effects=()))
    c, v = 2e-5 * rng.standard_normal((2, *loaded.shape))
    point = loaded.at(c)
    gradient, matrix = loaded.tangent(point)
    K = to_dense(matrix.panels, model.layout.split)
    np.testing.assert_allclose(
        gradient, loaded.residual(point), rtol=0, atol=1e-13 * np.abs(gradient).max()
    )
    linear = float(np.sum(gradient * v))
    quadratic = float(v.ravel() @ K @ v.ravel()) / 2
    steps = [0.4, 0.2, 0.1, 0.05]
    first = slopes(lambda t: loaded.at(c + t * v).energy - point.energy - t * linear, steps)
    second = slopes(
        lambda t: loaded.at(c + t * v).energy - point.energy - t * linear - t**2 * quadratic, steps
    )
    assert first[-1] == pytest.approx(2.0, abs=0.02)
    assert second[-1] == pytest.approx(3.0, abs=0.05)
    # the loads alone: their part of the tangent is the derivative of their part of the residual
    small = 1e-2 * v
    change = [
        (e.residual(e.at(c + small)) - e.residual(e.at(c - small))) / 2 for e in (loaded, bare)
    ]
    K0 = to_dense(bare.tangent(bare.at(c))[1].panels, model.layout.split)
    share = (K - K0) @ small.ravel()
    # central differences of fields that vary over millimeters, at steps of 2e-7 m: 1e-6, and rounding of the body's own stiffness
    np.testing.assert_allclose(
        (change[0] - change[1]).ravel(), share, rtol=0, atol=1e-5 * np.abs(share).max()
    )


def test_a_uniform_field_does_not_pull() -> None:
    scene = rod_scene(length=8e-3, field=(1e-3, 0, 2e-3)).with_effects(magnetic_force={})
    assert [record.dtype for record in effects.collect(scene)[::2]] == [magnetic_torque.DTYPE]
    assert any("magnetic_force has no effect" in text for text in scene.warnings())


def test_records_over_time() -> None:
    """One record for every step, one table for all; a uniform field keeps its short kernel."""
    times = np.linspace(0.0, 1.0, 5)
    over = {"ramp": {"duration": 1.0}}
    record, data, pulls, same = effects.collect(
        scene_in({"dipole": NEAR, "over_time": over}, *BOTH), times=times
    )
    assert record.dtype == magnetic_torque.VARYING
    assert pulls.dtype == magnetic_force.DTYPE
    np.testing.assert_allclose(record["strength"], times)
    np.testing.assert_allclose(pulls["strength"], times)
    assert data is same
    uniform, nothing = effects.collect(
        scene_in({"uniform": (0, 0, 1e-3), "over_time": over}, "magnetic_torque"), times=times
    )
    assert uniform.dtype == magnetic_torque.DTYPE
    np.testing.assert_allclose(uniform["field_over_mu0"][:, 2], 1e-3 * times / MU0)
    assert len(nothing) == 0
    assert effects.collect(scene_in({"dipole": NEAR}, *BOTH), strength=0.0) == ()


@pytest.mark.parametrize("alone", BOTH)
def test_equilibrium_needs_both(alone: str) -> None:
    scene = scene_in({"dipole": NEAR}, alone)
    missing = next(name for name in BOTH if name != alone)
    assert without_energy(scene) == missing
    assert len(scene.warnings()) == 1
    with pytest.raises(
        InputError, match=rf"effects.{missing}: received nothing\n.*neither alone has an energy"
    ):
        run(scene)


def test_a_magnet_in_the_body_is_refused_before_the_run() -> None:
    sphere = {"position": (7e-3, 0, 2e-3), "moment": (0.1, 0, 0), "diameter": 2e-3}
    with pytest.raises(
        InputError,
        match=r"field.dipole: the body's point at .* is inside field.dipole, center \(7, 0, 2\) mm",
    ):
        build(scene_in({"dipole": sphere}, *BOTH))


@pytest.mark.parametrize(
    "place",
    [(3e-3, 0, 0), (4e-3, 0.7e-3, -1.1e-3), (4e-3, 0, 2.3e-3)],
    ids=["axis", "inside", "at the surface"],
)
def test_a_point_dipole_in_or_at_the_body_is_refused(place: tuple[float, float, float]) -> None:
    """Nearer than a cell, 2 mm, its field has no meaning: the message says which dipole, where, and the remedy."""
    near = {"position": place, "moment": (0.1, 0, 0)}
    with pytest.raises(
        InputError,
        match=r"field.dipole\[1\]: the body's .* mm from the point dipole field.dipole\[1\] at ",
    ) as caught:
        build(scene_in({"dipole": [NEAR, near]}, *BOTH))
    for part in (
        "nearer than a cell of the grid, 2 mm",
        "rule: ",
        "remedy: move the dipole away",
        "`diameter`",
        "`magnet`",
    ):
        assert part in str(caught.value)
    build(scene_in({"dipole": [NEAR, {**near, "position": (4e-3, 0, 4.5e-3)}]}, *BOTH))


@pytest.mark.parametrize(
    ("source", "says"),
    [
        ({}, "mm from the point dipole field.dipole at {}, nearer than a cell"),
        ({"diameter": 2e-3}, "is inside field.dipole, center {}; move the magnet away"),
    ],
    ids=["point", "sphere"],
)
def test_a_magnet_that_comes_too_near_is_met_in_time(source: dict[str, Any], says: str) -> None:
    """Outside at first, too near or inside later: the check at a given time says where, and names the magnet."""
    moves = {"keyframes": [{"time": 0, "move": (0, 0, 0)}, {"time": 1, "move": (-40e-3, 0, 0)}]}
    scene = scene_in(
        {
            "dipole": {"position": (30e-3, 0, 0), "moment": (0.1, 0, 0), **source},
            "over_time": moves,
        },
        *BOTH,
    )
    x = build(scene).particles.position
    field = scene.external_field()
    field.check(x, 0.0)
    with pytest.raises(SolveError, match=re.escape(says.format("(6, 0, 0) mm"))):
        field.check(x, 0.6)


def test_other_sources_stay_when_a_study_changes_the_uniform_field() -> None:
    changed = SCENE.with_field((0, 0, 5e-3))
    assert changed.field.uniform == (0, 0, 5e-3)
    assert changed.field.dipole == SCENE.field.dipole
    assert Scene.from_si(changed.to_si()) == changed


def test_a_uniform_scene_hashes_as_it_did() -> None:
    """The keys of other sources are not part of the hashed content, so older results and studies are still found."""
    scene = rod_scene(field=(0, 0, 1e-3))
    content = scene.model_dump(mode="json", exclude_none=True)["field"]
    assert content == {"uniform": [0.0, 0.0, 1e-3]}
