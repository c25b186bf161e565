"""The builder of the gallery on one tiny scene: its files, what it keeps, and what it does not repeat."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from PIL import Image
from reference.modules import module_of

ROOT = Path(__file__).parents[2]
SCENE = """\
# A short rod in a field,
# let go at once.
name: rod let go
materials: {m: {shear_modulus: 120 kPa, bulk_to_shear: 20, density: 1882 kg/m^3, remanence: 100 mT}}
body: {catheter: {length: 10 mm, diameter: 4 mm, material: m, segments: [{magnetization: [1, 0, 0]}]}}
field: {uniform: [0 mT, 0 mT, 5 mT]}
effects: {magnetic_torque: {}}
solver: {dynamic: {duration: 2 ms, output_every: 1 ms}}
resolution: {cells_across: 2}
"""


@pytest.fixture(scope="module")
def build() -> ModuleType:
    return module_of(ROOT / "docs/gallery/build.py", "gallery_build")


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("MAGMPM_RENDER", "matplotlib")
    scenes = tmp_path / "data/scenes/gallery"
    scenes.mkdir(parents=True)
    (scenes / "rod.yaml").write_text(SCENE)
    return tmp_path


def test_a_scene_becomes_a_page_with_poster_movie_and_numbers(build: ModuleType, root: Path) -> None:
    assert build.main([], root) == 0
    page = (root / "docs/gallery/rod.md").read_text()
    assert page.startswith("# Rod let go\n\nA short rod in a field, let go at once.\n")
    assert "| formulation | total |" in page
    images = root / "docs/images/gallery"
    assert "../images/gallery/rod.png" in page
    assert (images / "rod.png").stat().st_size <= build.POSTER_BYTES
    assert (images / "rod.mp4").stat().st_size < build.MOVIE_BYTES
    assert "rod.mp4" in page
    assert "## [Rod let go](rod.md)" in (root / "docs/gallery/README.md").read_text()

    (root / "docs/gallery/costs.md").write_text("# A page of no scene\n")
    # Second build: nothing is run, text written by hand stays, and the numbers are restored.
    written = root / "docs/gallery/rod.md"
    before, after = page.split("| particles |")[0], "\n<!-- /measured -->\n\nBy hand, below.\n"
    written.write_text(before.replace("A short rod", "By hand: a short rod") + "| particles | 3 |" + after)
    result = root / "runs/gallery/rod/result.json"
    stamp = result.stat().st_mtime_ns
    assert build.main(["rod"], root) == 0
    assert result.stat().st_mtime_ns == stamp
    assert "costs" not in (root / "docs/gallery/README.md").read_text(), "there is no poster of it"
    again = written.read_text()
    assert again == page.replace("A short rod", "By hand: a short rod") + "\nBy hand, below.\n"

    # A changed scene with the same name is run.
    (root / "data/scenes/gallery/rod.yaml").write_text(SCENE.replace("5 mT", "6 mT"))
    assert build.main([], root) == 0
    assert result.stat().st_mtime_ns > stamp


@pytest.mark.slow
def test_a_scene_shown_beside_another_is_on_its_page(build: ModuleType, root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One poster, one movie, a column of numbers for each scene; no separate page."""
    short = SCENE.replace("body: {", "body: {strip: {width: 4 mm, thickness: 2 mm, clamp: base, ").replace("catheter: {", "", 1)
    short = short.replace("diameter: 4 mm, ", "")
    scenes = root / "data/scenes/gallery"
    (scenes / "rod.yaml").write_text(short)
    (scenes / "thick.yaml").write_text(short.replace("rod let go", "thick one").replace("thickness: 2", "thickness: 3"))
    monkeypatch.setitem(build.BESIDE, "rod", ("thick",))
    monkeypatch.setitem(build.MOMENTS, "rod", (0.0, 0.002))
    assert build.main(["thick"], root) == 0
    page = (root / "docs/gallery/rod.md").read_text()
    assert "| measured | rod let go | thick one |" in page
    assert not (root / "docs/gallery/thick.md").exists()
    assert "thick" not in (root / "docs/gallery/README.md").read_text()
    images = root / "docs/images/gallery"
    assert sorted(path.name for path in images.iterdir()) == ["rod.mp4", "rod.png"]
    with Image.open(images / "rod.png") as poster:
        assert poster.width > 1500


def test_a_scene_that_is_wrong_ends_with_its_status_and_the_others_are_built(
    build: ModuleType, root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (root / "data/scenes/gallery/a_wrong_one.yaml").write_text(SCENE.replace("length: 10 mm", "length: 10"))
    assert build.main([], root) == 2
    assert "a_wrong_one.yaml" in capsys.readouterr().err
    assert (root / "docs/gallery/rod.md").exists()
    assert build.main(["no_such"], root) == 2
    assert "no_such" in capsys.readouterr().err


def test_posters_are_made_to_fit(build: ModuleType, tmp_path: Path) -> None:
    noise = np.random.default_rng(1).integers(0, 255, (500, 700, 3), dtype=np.uint8)
    Image.fromarray(noise).save(tmp_path / "noise.png")
    poster = build.poster(tmp_path / "noise.png", 120_000)
    assert len(poster) <= 120_000
    with pytest.raises(ValueError, match="does not fit"):
        build.poster(tmp_path / "noise.png", 10_000)
