"""Strain beyond the limits of the material law or the grid gives a warning, in equilibrium and in motion; usual strain does not."""

import json
from pathlib import Path

import numpy as np
import pytest
from reference.moving import moving_scene
from reference.scenes import rod_scene
from scipy.stats import special_ortho_group

from magmpm.bodies.curves import tightest_radius
from magmpm.cli import main
from magmpm.dynamics.checkpoint import Checkpoint
from magmpm.model import Model, build
from magmpm.results.result import Result
from magmpm.results.strain import LARGE_STRETCH, VOLUME, Strain, strain_of
from magmpm.scene import Scene, load_scene
from magmpm.simulate import run
from magmpm.viz.from_result import Still, trial_snapshot

ROOT = Path(__file__).parents[3]
L = 40e-3
D = 4e-3


@pytest.fixture(scope="module")
def model() -> Model:
    return build(
        rod_scene(length=L, diameter=D, cells=2, field=(0, 0, 1e-3), gravity=(0, 0, -9.81))
    )


def held(model: Model, gradient: np.ndarray) -> Strain:
    """The strain of a body with a uniform deformation gradient (3, 3)."""
    return strain_of(
        model, model.particles.position @ gradient.T, np.tile(gradient, (len(model.density), 1, 1))
    )


@pytest.mark.parametrize("stretch", [1.2, 1.49, 1.51, 3.0])
def test_stretches_are_the_principal_ones(
    stretch: float, model: Model, rng: np.random.Generator
) -> None:
    """Uniaxial tension at constant volume, with any rotation before and after: a warning above 1.5, and no other."""
    before, after = special_ortho_group.rvs(3, size=2, random_state=rng)
    F = after @ np.diag([stretch, stretch**-0.5, stretch**-0.5]) @ before
    found = held(model, F)
    assert found.stretch == pytest.approx(stretch, rel=1e-12)
    assert (found.stretched, found.swollen) == pytest.approx((float(stretch > LARGE_STRETCH), 0.0))
    said = found.warnings(model)
    assert len(said) == (stretch > LARGE_STRETCH)
    assert all(
        "100 % of the volume is stretched to more than 1.5" in text
        and f"at most {stretch:.3g} times" in text
        for text in said
    )


def test_the_largest_stretch_is_not_that_of_the_largest_strain(model: Model) -> None:
    """One particle in plane tension (1.09, 1.09, 1) has more tr F^T F than another in uniaxial tension at constant volume by 1.12."""
    F = np.tile(np.diag([1.12, 1.12**-0.5, 1.12**-0.5]), (len(model.density), 1, 1))
    F[0] = np.diag([1.09, 1.09, 1.0])
    assert np.sum(F[0] ** 2) > np.sum(F[1] ** 2)
    assert strain_of(model, model.particles.position, F).stretch == pytest.approx(1.12, rel=1e-12)


@pytest.mark.parametrize(("J", "told"), [(0.81, False), (0.79, True), (1.19, False), (1.21, True)])
def test_volume_is_kept_within_a_fifth(
    J: float, told: bool, model: Model, rng: np.random.Generator
) -> None:
    found = held(model, J ** (1 / 3) * special_ortho_group.rvs(3, random_state=rng))
    assert (found.min_det_F, found.max_det_F) == pytest.approx((J, J))
    says = (
        f"100 % of the volume has a det F below {1 - VOLUME:g} or above {1 + VOLUME:g} (it is"
        f" {J:.3g} to {J:.3g})"
    )
    assert [says in text for text in found.warnings(model)] == [True] * told


def test_a_few_particles_are_let_pass(model: Model) -> None:
    """For example at the rim of a clamp, where strain is singular: 0.5 % of the volume."""
    F = np.tile(np.eye(3), (len(model.density), 1, 1))
    F[: len(F) // 250] = np.diag([2.0, 0.5, 1.0])
    found = strain_of(model, model.particles.position, F)
    assert found.stretch == pytest.approx(2.0)
    assert found.warnings(model) == []
    F[: len(F) // 100] = np.diag([2.0, 0.5, 1.0])
    assert len(strain_of(model, model.particles.position, F).warnings(model)) == 1


@pytest.mark.parametrize("radius", [0.9 * D, 1.1 * D, 10 * D])
def test_the_axis_bends_no_tighter_than_the_body_is_thick(radius: float, model: Model) -> None:
    """Bent to a circle, measured on slices of the body."""
    angle = model.particles.position[:, 0] / radius
    aside = radius - model.particles.position[:, 2]
    bent = np.column_stack(
        [aside * np.sin(angle), model.particles.position[:, 1], radius - aside * np.cos(angle)]
    )
    found = strain_of(model, bent, np.tile(np.eye(3), (len(bent), 1, 1)))
    assert found.radius == pytest.approx(
        radius, rel=0.05
    )  # slices of 2 mm lie inside the arc: at 3.6 mm by 1 %
    assert [
        f"less than the body is thick, {1e3 * D:g} mm" in text for text in found.warnings(model)
    ] == [True] * (radius < D)


def test_a_tube_that_would_kink_is_told(model: Model) -> None:
    """Brazier's curvature, (sqrt(2)/3) t/(r^2 sqrt(1 - nu^2)), from both sides; a solid rod has none."""
    data = model.scene.to_si()
    across = data["body"]["catheter"]["diameter"]
    wall = 0.1e-3
    data["body"]["catheter"]["inner_diameter"] = across - 2 * wall
    tube = build(Scene.from_si(data))
    K = model.bulk[0]
    G = model.shear[0]
    nu = (3 * K - 2 * G) / (2 * (3 * K + G))
    curvature = np.sqrt(2) / 3 * wall / ((across - wall) / 2) ** 2 / np.sqrt(1 - nu**2)
    assert Strain(radius=1.01 / curvature).warnings(tube) == []
    [told] = Strain(radius=0.99 / curvature).warnings(tube)
    assert "kinks" in told
    assert Strain(radius=0.99 / curvature).warnings(model) == []


def test_radius_of_a_curve() -> None:
    arc = np.array([[np.cos(t), np.sin(t), 0.0] for t in np.linspace(0, 1, 9)])
    assert tightest_radius(3e-3 * arc) == pytest.approx(3e-3)
    assert tightest_radius(np.outer(np.arange(5.0), [1, 2, 3])) == np.inf


def test_absurdly_soft_silicone_is_warned_of(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """G of 1.5 kPa instead of 120 kPa: stretch 2.5, det F 0.4, radius below the thickness; reported in both places."""
    text = (ROOT / "data/scenes/five_segments.yaml").read_text(encoding="utf-8")
    path = tmp_path / "soft.yaml"
    out = tmp_path / "out"
    for old, new in (
        ("shear_modulus: 120 kPa", "shear_modulus: 1.5 kPa"),
        ("cells_across: 4", "cells_across: 2"),
    ):
        assert old in text
        text = text.replace(old, new)
    path.write_text(text, encoding="utf-8")
    assert main(["run", str(path), "--out", str(out), "--json"]) == 0
    printed = capsys.readouterr()
    told = json.loads(printed.out)
    saved = Result.load(out)
    assert told["largest_stretch"] == saved.largest_stretch > LARGE_STRETCH
    assert told["tightest_radius"] == saved.tightest_radius < D
    said = [text for text in saved.warnings if text.startswith("strain: ")]
    for text, about in zip(
        said, ("is stretched to more than", "has a det F below", "the axis is bent"), strict=True
    ):
        assert about in text
        assert f"magmpm: warning: {text}\n" in printed.err
    mark = f"BEYOND THE MATERIAL LAW: stretch {saved.largest_stretch:.2g}"
    assert trial_snapshot(saved).caption() == Still(saved).snapshot().caption() == mark
    assert trial_snapshot(saved, trial=3).caption() == "trial 3"


@pytest.mark.parametrize(
    "name", ["five_segments", "hollow", "zhao_plane_strain", "three_segments_3d"]
)
def test_usual_scenes_are_not(name: str) -> None:
    """Strongly bent catheters and strips on coarse grids: stretches of 1.03 to 1.11."""
    result = run(
        load_scene(ROOT / f"data/scenes/{name}.yaml").with_cells(
            2 if name != "zhao_plane_strain" else 4
        )
    )
    assert [text for text in result.warnings if text.startswith("strain")] == []
    assert 1.02 < result.largest_stretch < 1.2
    assert result.tightest_radius is not None
    assert trial_snapshot(result).caption() == ""


def test_a_motion_keeps_the_worst_of_its_frames(tmp_path: Path) -> None:
    """Stretched by 60 times its weight, then swinging: the maximum, during the motion, is reported with its time, also after a resume."""
    scene = swinging(duration=30e-3)
    whole = run(scene)
    (said,) = (text for text in whole.warnings if "is stretched to more than" in text)
    assert whole.largest_stretch > LARGE_STRETCH
    assert "times, at 0.0" in said
    part = swinging(duration=20e-3)
    run(part, folder=tmp_path)
    saved = Checkpoint.load(tmp_path, part)
    assert Strain.restored(saved.control).stretch > 1.2
    assert run(scene, folder=tmp_path, resume=True).largest_stretch == whole.largest_stretch


def swinging(duration: float) -> Scene:
    body = {"catheter": {"length": 12e-3, "diameter": 4e-3, "material": "m", "segments": [{}]}}
    effects = {"gravity": {"acceleration": [600.0, 0.0, 0.0]}, "damping": {"rate": 1e-6}}
    return moving_scene(
        body, effects, shear=20e3, solver={"dynamic": {"duration": duration, "output_every": 1e-3}}
    )
