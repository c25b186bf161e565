"""New effects as users write them: the worked example of docs/adding_an_effect.md, from its text, and one that is nonlinear in F."""

import hashlib
import re
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from reference.dynamics import Total
from reference.modules import module_of
from reference.plain_forms import to_dense
from reference.scenes import G, rod_scene
from reference.taylor import slopes

from magmpm.compiled.jit import compiled
from magmpm.dynamics.total_lagrangian import TotalMotion
from magmpm.effects import acting as effects
from magmpm.effects.hooks import NO_DATA, register
from magmpm.errors import InputError
from magmpm.inputs.settings import validate
from magmpm.model import build
from magmpm.scene import Scene
from magmpm.statics.energy import Energy
from magmpm.statics.layout import StaticModel, static_model

ROOT = Path(__file__).resolve().parents[3]
# 1/s, s: so slow that only the drag acts on a body without stiffness
RATE = 5.0
DT = 1e-3


pytestmark = pytest.mark.usefixtures("own_registry")


@pytest.fixture
def drag(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The example's file as a module among the effects, and its line among their keys, for one test."""
    return joined(*example(), tmp_path, monkeypatch)


def example() -> tuple[str, str]:
    """The file and the line from docs/adding_an_effect.md."""
    text = (ROOT / "docs/adding_an_effect.md").read_text(encoding="utf-8")
    file, line = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert file.startswith("# magmpm/effects/drag.py")
    return file, line


def joined(file: str, line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """A file as the module of the effect `drag`, named by a line of Effects."""
    (tmp_path / "drag.py").write_text(file)
    monkeypatch.setitem(sys.modules, "magmpm.effects.drag", None)  # which goes with the test
    module = module_of(tmp_path / "drag.py", "magmpm.effects.drag")
    body = "".join(f"    {part}" for part in line.splitlines(keepends=True))
    monkeypatch.setattr(effects, "Drag", module.Drag, raising=False)  # imported
    space: dict[str, Any] = {**vars(effects), "Base": effects.Effects}
    exec(f"class Effects(Base):\n{body}", space)
    monkeypatch.setattr(effects, "Effects", space["Effects"])
    return module


def named(settings: dict[str, Any]) -> tuple[np.ndarray, ...]:
    found = validate(effects.Effects, settings, "example.yaml")
    return effects.collect(rod_scene(length=12e-3).model_copy(update={"effects": found}))


def dragged(rate: str) -> Scene:
    settings = validate(effects.Effects, {"drag": {"rate": rate}}, "example.yaml")
    return rod_scene(length=6e-3).model_copy(update={"effects": settings})


def test_the_line_names_it(drag: ModuleType) -> None:
    """Found by its key, with a unit; refused with a wrong unit; left out at zero strength; called in its phase."""
    record, data = named({"drag": {"rate": "5 1/s"}})
    assert record["drag_rate"] == RATE
    assert not len(data)
    assert named({"drag": {"rate": "0 1/s"}}) == ()
    assert [r.dtype.names[0] for r in named({"drag": {"rate": "5 1/s"}, "gravity": {}})[::2]] == [
        "gravity",
        "drag_rate",
    ]
    with pytest.raises(
        InputError, match=r"drag\.rate: received \"5 mm\"[^@]*is not a unit of rate"
    ):
        named({"drag": {"rate": "5 mm"}})


def test_the_file_brakes(drag: ModuleType) -> None:
    """A free body without stiffness slows by 1 - rate dt per step; and its step is stable."""
    model = build(dragged("5 1/s"))
    assert effects.stable_steps(
        replace(model, shear=0 * model.shear, bulk=0 * model.bulk, clamped_face=False)
    ) == {"drag": 1 / RATE}
    total = Total.of(model)
    v = np.where(total.mass[:, None] > 0, np.array([0.1, 0.0, -0.2]), 0.0)  # m/s
    _, after = total.step(np.zeros_like(v), v, DT)  # no strain and no stress; the clamp is left out
    np.testing.assert_allclose(after, (1 - RATE * DT) * v, rtol=0, atol=1e-15)


def test_the_file_brakes_in_a_compiled_kernel(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Three steps of the solver's kernel, compiled with the example, equal those of the plain reference.

    Compiled kernels are cached on disk by the field names of their effects: a name that changes with the text avoids outdated ones.
    """
    file, line = example()
    stamp = hashlib.sha256(file.encode()).hexdigest()[:8]
    joined(file.replace("drag_rate", f"drag_rate_{stamp}"), line, tmp_path, monkeypatch)
    model = build(dragged("500 1/s"))
    found = {}
    for loads in (model.effects, ()):
        total = Total.of(replace(model, effects=loads))
        motion = TotalMotion(model)
        c, v = np.zeros((2, *total.X.shape))
        on = motion.packed.nodes.inverse_mass.reshape(-1, 3).all(axis=1)
        v[on] = np.random.default_rng(5).standard_normal((on.sum(), 3))
        motion.restore({"u": c.ravel(), "v": v.ravel()})
        for _ in range(3):
            c, v = total.step(c, v, 1e-6)
        assert motion.advance(3, 1e-6, loads) == (3, False)
        np.testing.assert_allclose(
            motion.v.reshape(-1, 3), v, rtol=0, atol=1e-12 * np.abs(v).max()
        )  # sums over some hundred particles
        found[bool(loads)] = v
    assert np.abs(found[True] - found[False]).max() > 1e-4 * np.abs(v).max(), "the drag is felt"


# Kernels are cached on disk by the field names of their effects: a name that changes with this file avoids
# outdated ones.
_STAMP = hashlib.sha256(Path(__file__).read_bytes()).hexdigest()[:8]
DTYPE = np.dtype(
    [("stiffness", np.float64), ("pull", np.float64, (3,)), (f"test_{_STAMP}", np.int8)]
)


def parameters(stiffness: float, pull: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    record = np.zeros(1, DTYPE)
    record["stiffness"], record["pull"] = stiffness, pull
    return record, NO_DATA


@compiled
def squares(F):  # type: ignore[no-untyped-def]
    total = 0.0
    for i in range(3):
        for j in range(3):
            total += F[i, j] * F[i, j]
    return total


@compiled
def energy(effect, data, magnet, rho, x, F):  # type: ignore[no-untyped-def]
    a = effect.pull
    return 0.25 * effect.stiffness * (squares(F) - 3.0) ** 2 - rho * (
        a[0] * x[0] + a[1] * x[1] + a[2] * x[2]
    )


@compiled
def stress(effect, data, magnet, rho, x, F, P):  # type: ignore[no-untyped-def]
    s = effect.stiffness * (squares(F) - 3.0)
    for i in range(3):
        for j in range(3):
            P[i, j] += s * F[i, j]


@compiled
def tangent(effect, data, magnet, rho, x, F, A):  # type: ignore[no-untyped-def]
    s = effect.stiffness * (squares(F) - 3.0)
    for i in range(9):
        for j in range(9):
            A[i, j] += 2.0 * effect.stiffness * F[i // 3, i % 3] * F[j // 3, j % 3]
        A[i, i] += s


@compiled
def force(effect, data, magnet, rho, x, F, f):  # type: ignore[no-untyped-def]
    for i in range(3):
        f[i] += rho * effect.pull[i]


register(DTYPE, energy=energy, stress=stress, tangent=tangent, force=force)


@pytest.fixture(scope="module")
def model() -> StaticModel:
    return static_model(build(rod_scene(length=6e-3)))


def test_gradient_and_tangent_belong_to_its_energy(
    model: StaticModel, rng: np.random.Generator
) -> None:
    """Taylor test of the whole model, with only the new effect, as stiff as the material: orders 2 and 3."""
    named = Energy(replace(model, effects=parameters(G, (3.0, 2.0, -9.81))))
    c, d = 2e-5 * rng.standard_normal((2, *named.shape))
    point = named.at(c)
    gradient, matrix = named.tangent(point)
    np.testing.assert_allclose(
        gradient, named.residual(point), rtol=0, atol=1e-12 * np.abs(gradient).max()
    )
    linear = float(np.sum(gradient * d))
    quadratic = float(d.ravel() @ to_dense(matrix.panels, model.layout.split) @ d.ravel()) / 2
    steps = [0.4, 0.2, 0.1, 0.05]
    first = slopes(lambda t: named.at(c + t * d).energy - point.energy - t * linear, steps)
    second = slopes(
        lambda t: named.at(c + t * d).energy - point.energy - t * linear - t**2 * quadratic, steps
    )
    # Strains here reach 0.1, and the next term of the series changes the slope by about as much at the first
    # step.
    np.testing.assert_allclose(first[-1], 2.0, atol=0.1)
    assert second[-1] == pytest.approx(3.0, abs=0.2)
