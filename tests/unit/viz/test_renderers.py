"""Laws of pictures, whichever backend draws them, checked over pixels at places the view gives."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from reference import bent_bodies, drawn

from magmpm.scene import Scene
from magmpm.viz import annotations, obstacles, style
from magmpm.viz.camera import Framing, View
from magmpm.viz.layout import TRIAL, Panel, Views
from magmpm.viz.meshes import tube
from magmpm.viz.snapshot import Balls, Snapshot
from magmpm.viz.worker import Renderer

WIDTH, HEIGHT = style.TRIAL_SIZE
ASPECT = WIDTH / HEIGHT
(MAIN,), (TOP, SIDE), (COMPASS,), FIELD = (
    TRIAL.mains,
    (inset.panel for inset in TRIAL.insets),
    TRIAL.compasses,
    TRIAL.field,
)


@pytest.fixture(scope="module", params=["pyvista", "matplotlib"])
def renderer(request: pytest.FixtureRequest) -> Iterator[Renderer]:
    with Renderer(request.param) as opened:
        opened.wait_ready()
        if opened.backend != request.param:
            pytest.skip(opened.note)
        yield opened


def body(**kind: object) -> Snapshot:
    """The spatial S beside a target it misses, so that no dot covers the body's axis."""
    settings: dict[str, object] = {"trial": 3, "rms": 2e-3, "spacing": 0.8e-3, **kind}
    return bent_bodies.catheter(bent_bodies.s_shape, bent_bodies.c_shape, **settings)  # type: ignore[arg-type]


def near(image: np.ndarray, color: str, tolerance: int = 30) -> np.ndarray:
    """(h, w) bool: where the image has about that color."""
    wanted = 255 * np.array(style.rgb(color))
    return np.abs(image.astype(float) - wanted).max(axis=2) < tolerance


def hue_share(image: np.ndarray, color: str) -> float:
    """Share of pixels with a color's hue, however light or dark it is shaded."""
    pixels = image.reshape(-1, 3).astype(float)
    pixels = pixels[np.ptp(pixels, axis=1) > 25]
    if len(pixels) == 0:
        return 0.0

    def hue(rgb: np.ndarray) -> np.ndarray:
        away = rgb - rgb.mean(axis=-1, keepdims=True)
        return np.asarray(away / np.linalg.norm(away, axis=-1, keepdims=True))

    # 0.985 is the cosine of 10 degrees of hue; the palette's colors are 20 and more apart.
    return float((hue(pixels) @ hue(np.array(style.rgb(color))) > 0.985).sum()) / (WIDTH * HEIGHT)


def part(image: np.ndarray, panel: Panel) -> np.ndarray:
    rows = slice(round((1 - panel.top) * HEIGHT), round((1 - panel.bottom) * HEIGHT))
    return image[rows, round(panel.left * WIDTH) : round(panel.right * WIDTH)]


def pixel(view: View, panel: Panel, point: np.ndarray) -> tuple[int, int]:
    """Row and column where a point (3,) m is seen."""
    ((x, y),) = panel.place(view.project(point[None]), panel.aspect(ASPECT))
    return round((1 - y) * HEIGHT), round(x * WIDTH)


def test_the_picture_has_its_size_and_is_not_blank(renderer: Renderer) -> None:
    image = renderer.image(body())
    assert image.shape == (HEIGHT, WIDTH, 3)
    assert image.dtype == np.uint8
    assert 0.03 < (image.min(axis=2) < 200).mean() < 0.6
    assert (image[0] == 255).all(), "the margin is white"


def test_drawn_twice_a_picture_is_the_same(renderer: Renderer) -> None:
    first = renderer.image(body())
    renderer.image(bent_bodies.catheter(bent_bodies.c_shape, segments=2))
    assert np.array_equal(renderer.image(body()), first)


def test_the_target_is_drawn_in_blue_where_it_is(renderer: Renderer) -> None:
    picture = body()
    framing = Framing.of(picture)
    image = renderer.image(picture, framing=framing)
    without = renderer.image(replace(picture, target=None), framing=framing)
    assert not near(without, style.TARGET).any()
    views = Views.of(framing, TRIAL, ASPECT)
    seen = near(image, style.TARGET, tolerance=70)
    for view, panel in zip((*views.mains, *views.insets), (MAIN, TOP, SIDE)):
        row, column = pixel(view, panel, picture.target[-1])
        assert seen[row - 1 : row + 2, column - 1 : column + 2].any()


def test_every_segment_has_its_color(renderer: Renderer) -> None:
    main, all_magnets = (
        part(renderer.image(body(unmagnetized=plain)), MAIN) for plain in ((1,), ())
    )
    for color in style.SEGMENTS[:4]:
        assert hue_share(main, color) > 2e-3, color
    assert hue_share(main, style.SEGMENTS[5]) < 5e-4, "a color no segment has"
    # Grey is the clamp's color too: its share must grow.
    grey, before = (
        (np.ptp(one.astype(int), axis=2) < 12) & (abs(one.mean(axis=2) - 152.5) < 62.5)
        for one in (main, all_magnets)
    )
    assert grey.sum() > before.sum() + 1500


def test_the_body_is_seen_where_the_view_says(renderer: Renderer) -> None:
    picture = bent_bodies.plain(replace(body(), target=None))
    framing = Framing.of(picture)
    image = renderer.image(picture, framing=framing)
    views = Views.of(framing, TRIAL, ASPECT)
    for view, panel in zip((*views.mains, *views.insets), (MAIN, TOP, SIDE)):
        for point in picture.axis[10::10]:
            row, column = pixel(view, panel, point)
            assert image[row, column].max() < 230, "the body covers its axis"
            # A diameter aside of every part of the body there is nothing but paper, floor or shadow.
        above = picture.body.points[np.argmax(picture.body.points @ view.up)] + 1.5e-3 * view.up
        row, column = pixel(view, panel, above)
        assert image[row, column].min() > 215


def test_magnetization_is_drawn_in_front_of_the_body(renderer: Renderer) -> None:
    picture = replace(body(), target=None)
    framing = Framing.of(picture)
    plain = bent_bodies.plain(picture)
    with_arrows, without = (
        part(renderer.image(p, framing=framing), MAIN) for p in (picture, plain)
    )
    dark = [(image.max(axis=2) < 75).sum() for image in (with_arrows, without)]
    assert dark[0] > dark[1] + 800
    view = Views.of(framing, TRIAL, ASPECT).mains[0]
    image = renderer.image(picture, framing=framing)
    for start, vector in picture.arrows:
        row, column = pixel(view, MAIN, start + 0.3 * vector)
        assert image[row, column].max() < 110


def test_field_gravity_and_scale_are_there(renderer: Renderer) -> None:
    picture = body()
    image = renderer.image(picture)
    assert near(part(image, FIELD), style.FIELD, tolerance=60).sum() > 60
    assert near(image[int(0.84 * HEIGHT) :], style.FIELD, tolerance=60).sum() > 150, (
        "arrow and |B| = 10.0 mT"
    )
    none = renderer.image(replace(picture, field=np.zeros(3)))
    assert not near(part(none, FIELD), style.FIELD, tolerance=60).any()
    assert annotations.field_text(picture) == "|B| = 10.0 mT"
    assert annotations.field_text(replace(picture, field=np.zeros(3))) == ""
    assert annotations.field_text(replace(picture, field=np.array([0, 0, 5e-6]))) == "|B| = 5.00 µT"
    afloat = renderer.image(replace(picture, gravity=None))
    assert not np.array_equal(part(afloat, COMPASS), part(image, COMPASS))
    view = Views.of(Framing.of(picture), TRIAL, ASPECT).mains[0]
    middle = TRIAL.bar[0]
    half = 0.5 * annotations.bar_width(view, MAIN, MAIN.aspect(ASPECT), picture.unit)
    row = round((1 - TRIAL.bar[1]) * HEIGHT)
    line = (
        image[
            row - 1 : row + 2,
            round((middle - half) * WIDTH) + 3 : round((middle + half) * WIDTH) - 3,
        ]
        .max(axis=2)
        .min(axis=0)
    )
    assert (line < 120).all()


def test_the_legend_names_what_is_there() -> None:
    picture = body(unmagnetized=(1,))
    names = ["magnetic", "unmagnetized", "magnetization", "axis", "target", "clamp"]
    assert [sign.text for sign in annotations.legend(picture)] == names
    reference = bent_bodies.plain(replace(picture, target_name="reference"))
    assert [sign.text for sign in annotations.legend(reference)] == [
        "unmagnetized",
        "axis",
        "reference",
        "clamp",
    ]


def test_trial_and_rms_are_written(renderer: Renderer) -> None:
    one = body(rms=2e-3)
    other = body(rms=3e-3)
    change = (renderer.image(one) != renderer.image(other)).any(axis=2)
    rows, columns = np.nonzero(change)
    assert len(rows) > 0
    # Only the caption differs: its line, in the right half.
    assert rows.max() < 0.1 * HEIGHT
    assert columns.min() > 0.5 * WIDTH


def test_a_long_title_does_not_run_into_the_caption(renderer: Renderer) -> None:
    image = renderer.image(
        body(title="a catheter with a name that never seems to come to its end, " * 3, trial=1234)
    )
    ink = (image[: int(0.09 * HEIGHT)].min(axis=2) < 150).any(axis=0)
    gaps = np.flatnonzero(np.diff(np.flatnonzero(ink)) > 12)
    # Words lie closer than 12 pixels apart; what is wider is the gap before the caption and those within it.
    assert 1 <= len(gaps) <= 3


def test_a_final_picture_shows_the_same_as_a_trials(renderer: Renderer) -> None:
    small, large = (
        renderer.image(body(), size=size).astype(float)
        for size in (style.TRIAL_SIZE, style.FINAL_SIZE)
    )
    blocks = large.reshape(300, 3, 400, 3, 3).mean(axis=(1, 3))
    halves = small.reshape(300, 2, 400, 2, 3).mean(axis=(1, 3))
    # Edges and letters fall differently on the two grids; the mean over 400 x 300 blocks does not.
    assert np.abs(blocks - halves).mean() < 6.0


def test_hollow_body_without_centerline_target_or_gravity_is_drawn(renderer: Renderer) -> None:
    picture = replace(
        body(), axis=np.zeros((0, 3)), target=None, gravity=None, trial=None, rms=None, title=""
    )
    assert (renderer.image(picture).min(axis=2) < 200).mean() > 0.03


@pytest.mark.parametrize("near_first", [True, False])
def test_what_is_nearer_hides_what_is_behind(renderer: Renderer, near_first: bool) -> None:
    """Two bars that cross as seen from the side (along +y): the one at y = -5 mm is nearer."""
    along = np.linspace(0.0, 0.03, 61)
    near_bar = np.stack([along, 0 * along - 5e-3, 0 * along + 0.015], axis=1)
    far_bar = np.stack([0 * along + 0.015, 0 * along + 5e-3, along], axis=1)
    bars = (
        np.concatenate([near_bar, far_bar]) if near_first else np.concatenate([far_bar, near_bar])
    )
    picture = Snapshot(
        body=Balls(bars.astype(np.float32), np.repeat([0, 1] if near_first else [1, 0], 61), 2e-3),
        magnetized=np.ones(2, dtype=bool),
        length=0.04,
        thickness=0.004,
        axis=np.array([[0.005, -5e-3, 0.015], [0.015, 5e-3, 0.005]]),
        insets=True,
    )
    framing = Framing.of(picture)
    view = Views.of(framing, TRIAL, ASPECT).insets[1]
    row, column = pixel(view, SIDE, np.array([0.015, -5e-3, 0.015]))
    at = renderer.image(picture, framing=framing)[row, column].astype(float)
    palette = 255 * np.array([style.rgb(color) for color in style.SEGMENTS[:2]])
    assert np.argmin(np.linalg.norm(palette - at, axis=1)) == 0


def test_magnet_near_the_body_is_drawn_in_every_view(renderer: Renderer) -> None:
    """With a word in the legend; one that is far is in no view, or the body would be a speck."""
    magnet = {
        "cylinder": {"length": 0.02, "diameter": 0.02},
        "position": [0.07, 0.0, 0.01],
        "axis": [1.0, 0.0, 0.0],
        "remanence": 1.3,
    }
    picture = replace(body(), target=None)
    for place, shown in (([0.07, 0.0, 0.01], True), ([3.0, 0.0, 0.0], False)):
        said = Scene.from_si(drawn.scene(field={"magnet": [{**magnet, "position": place}]}))
        sources = obstacles.in_reach(
            obstacles.sources(said), picture.body.points, obstacles.REACH_OF_VIEW * picture.length
        )
        image = renderer.image(replace(picture, obstacles=tuple(sources)))
        for panel in (MAIN, TOP, SIDE):
            assert (hue_share(part(image, panel), style.SOUTH) > 2e-4) == shown, (
                panel
            )  # no segment is blue
    assert (
        annotations.legend(replace(picture, obstacles=tuple(sources)))[-1].text == "magnet (N, S)"
    )


def test_surface_in_place_of_particles_lies_where_they_lie(renderer: Renderer) -> None:
    """It has one color a segment and no gaps as balls have, and covers what they cover; target, axis and arrows stay."""
    picture = bent_bodies.plain(replace(body(), target=None))
    rod = tube([0.008 * k for k in range(1, 6)], 2e-3, 0.0, 5e-4)
    x, r, a = (
        g.ravel()
        for g in np.meshgrid(
            np.arange(2e-4, 0.04, 4e-4), (1e-3, 1.8e-3), np.arange(0, 6.28, 0.2), indexing="ij"
        )
    )
    straight = replace(
        picture,
        body=Balls(
            np.column_stack([x, r * np.cos(a), r * np.sin(a)]), (x / 0.008).astype(int), 4e-4
        ),
        axis=np.column_stack([np.linspace(0, 0.04, 21), np.zeros(21), np.zeros(21)]),
    )
    cloud = renderer.image(straight)
    smooth = renderer.image(replace(straight, body=rod))
    side = [part(image, SIDE).astype(int) for image in (cloud, smooth)]
    grey = [(np.ptp(image, axis=2) < 12) & (image.max(axis=2) < 215) for image in side]
    assert (grey[0] & grey[1]).sum() > 0.9 * grey[0].sum() > 300  # a ball's width at the edges
    assert np.abs(cloud.astype(int) - smooth).max() > 20


def test_nothing_of_the_body_leaves_the_main_view() -> None:
    """Its clamp's plate, the widest part, is in the panel wherever the base lies."""
    for curvature in (bent_bodies.s_shape, bent_bodies.c_shape):
        picture = bent_bodies.catheter(curvature, spacing=1e-3)
        framing = Framing.of(picture)
        view = framing.view(1.3)
        angle = np.linspace(0, 2 * np.pi, 40)
        rim = (
            style.CLAMP_RADIUS
            * picture.thickness
            * np.column_stack([0 * angle, np.cos(angle), np.sin(angle)])
        )
        flat = view.project(np.vstack([rim, picture.body.points]))[:, :2] / [1.3, 1.0]
        assert np.abs(flat).max() <= 1.0
