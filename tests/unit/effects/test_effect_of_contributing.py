"""The worked example of docs/adding_an_effect.md, one file and one line, taken from its text and run."""

from __future__ import annotations

import hashlib
import importlib.util
import re
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from reference.dynamics import Total
from reference.scenes import rod_scene

from magmpm.dynamics.total_lagrangian import TotalMotion
from magmpm.effects import acting as effects
from magmpm.errors import InputError
from magmpm.inputs.settings import validate
from magmpm.model import build

ROOT = Path(__file__).resolve().parents[3]
RATE, DT = 5.0, 1e-3  # 1/s, s: so slow that only the drag acts on a body without stiffness


pytestmark = pytest.mark.usefixtures("own_registry")


@pytest.fixture
def drag(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The example's file as a module among the effects, and its line among their keys, for one test."""
    file, line = example()
    return joined(file, line, tmp_path, monkeypatch)


def example() -> tuple[str, str]:
    """The file and the line from docs/adding_an_effect.md."""
    text = (ROOT / "docs/adding_an_effect.md").read_text(encoding="utf-8")
    file, line = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert file.startswith("# magmpm/effects/drag.py")
    return file, line


def joined(file: str, line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """A file as the module of the effect `drag`, named by a line of Effects."""
    (tmp_path / "drag.py").write_text(file)
    spec = importlib.util.spec_from_file_location("magmpm.effects.drag", tmp_path / "drag.py")
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "magmpm.effects.drag", module)
    spec.loader.exec_module(module)
    body = "".join(f"    {part}" for part in line.splitlines(keepends=True))
    monkeypatch.setattr(effects, "Drag", module.Drag, raising=False)  # imported
    space: dict[str, Any] = {**vars(effects), "Base": effects.Effects}
    exec(f"class Effects(Base):\n{body}", space)
    monkeypatch.setattr(effects, "Effects", space["Effects"])
    return module


def named(settings: dict[str, Any]) -> tuple[np.ndarray, ...]:
    found = validate(effects.Effects, settings, "example.yaml")
    return effects.collect(rod_scene(length=12e-3).model_copy(update={"effects": found}))


def test_the_line_names_it(drag: ModuleType) -> None:
    """Found by its key, with a unit; refused with a wrong unit; left out at zero strength; called in its phase."""
    (record, data) = named({"drag": {"rate": "5 1/s"}})
    assert record["drag_rate"] == RATE
    assert not len(data)
    assert named({"drag": {"rate": "0 1/s"}}) == ()
    assert [r.dtype.names[0] for r in named({"drag": {"rate": "5 1/s"}, "gravity": {}})[::2]] == ["gravity", "drag_rate"]
    with pytest.raises(InputError, match=r"drag\.rate: received \"5 mm\"[^@]*is not a unit of rate"):
        named({"drag": {"rate": "5 mm"}})


def test_the_file_brakes(drag: ModuleType) -> None:
    """A free body without stiffness slows by 1 - rate dt per step; and its step is stable."""
    scene = rod_scene(length=12e-3).model_copy(update={"effects": validate(effects.Effects, {"drag": {"rate": "5 1/s"}}, "example.yaml")})
    model = build(scene)
    model = replace(model, shear=0 * model.shear, bulk=0 * model.bulk, clamped_face=False)
    assert effects.stable_steps(model) == {"drag": 1 / RATE}
    start = np.array([0.1, 0.0, -0.2])  # m/s
    total = Total.of(build(scene))
    v = np.where(total.mass[:, None] > 0, start, 0.0)
    _, after = total.step(np.zeros_like(v), v, DT)  # no strain and no stress; the clamp is left out
    np.testing.assert_allclose(after, (1 - RATE * DT) * v, rtol=0, atol=1e-15)


def test_the_file_brakes_in_a_compiled_kernel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Three steps of the solver's kernel, compiled with the example, equal those of the plain reference.

    Compiled kernels are cached on disk by the field names of their effects: a name that changes with the text avoids outdated ones."""
    file, line = example()
    stamp = hashlib.sha256(file.encode()).hexdigest()[:8]
    joined(file.replace("drag_rate", f"drag_rate_{stamp}"), line, tmp_path, monkeypatch)
    settings = validate(effects.Effects, {"drag": {"rate": "500 1/s"}}, "example.yaml")
    model = build(rod_scene(length=6e-3).model_copy(update={"effects": settings}))
    found = {}
    for loads in (model.effects, ()):
        total, motion = Total.of(replace(model, effects=loads)), TotalMotion(model)
        c, v = np.zeros((2, *total.X.shape))
        on = motion.packed.nodes.inverse_mass.reshape(-1, 3).all(axis=1)
        v[on] = np.random.default_rng(5).standard_normal((on.sum(), 3))
        motion.restore({"u": c.ravel(), "v": v.ravel()})
        for _ in range(3):
            c, v = total.step(c, v, 1e-6)
        assert motion.advance(3, 1e-6, loads) == (3, False)
        np.testing.assert_allclose(motion.v.reshape(-1, 3), v, rtol=0, atol=1e-12 * np.abs(v).max())  # sums over some hundred particles
        found[bool(loads)] = v
    assert np.abs(found[True] - found[False]).max() > 1e-4 * np.abs(v).max(), "the drag is felt"
