"""Remedies that a failed run names: typed, valid changes of the scene, and they work."""

import numpy as np
import pytest
from reference.scenes import rod_scene

from magmpm.errors import BudgetError, Collapsed, LeftField, SolveError, TimeOver
from magmpm.scene import Scene
from magmpm.scene.remedies import remedies
from magmpm.simulate import run


def starved() -> Scene:
    """A bent rod that is given a single Newton step."""
    data = rod_scene(length=16e-3, field=(0, 0, 8e-3), cells=2).to_si()
    return Scene.from_si({**data, "solver": {"static": {"max_steps": 1}}})


def test_the_named_remedy_brings_the_answer() -> None:
    with pytest.raises(SolveError, match=r"to try: solver.static: {field_steps: 40") as caught:
        run(starved())
    first, *others = caught.value.remedies
    healed = run(first.applied(starved()))
    data = starved().to_si()
    usual = run(Scene.from_si({**data, "solver": {"static": {}}}))
    assert np.linalg.norm(healed.tip - usual.tip) < 1e-5 * usual.centreline[-1, 0]
    assert any("quasi_static" in remedy.words for remedy in others)
    for remedy in others:  # each gives a valid scene, whose load ends as the words say
        assert remedy.applied(starved()) != starved()


class Reached:
    """A last good state, as remedies look at it."""

    def __init__(self, time: float = 0.0, load_share: float = 1.0) -> None:
        self.time = time
        self.load_share = load_share


def test_motions_get_shorter_steps_or_end_before_the_trouble() -> None:
    scene = rod_scene(length=16e-3, field=(0, 0, 8e-3), cells=2)
    data = scene.to_si()
    moving = Scene.from_si({**data, "solver": {"dynamic": {"duration": 0.5}}})
    found = remedies(
        moving, SolveError("step 3: energy is not conserved: more of it", Reached(0.2))
    )
    assert [remedy.applied(moving).solver.dynamic.safety for remedy in found[:2]] == [0.4, 0.1]
    assert found[-1].applied(moving).duration == pytest.approx(0.18)
    flown = remedies(
        moving, SolveError("a particle left the box", Reached(0.2))
    )  # as it would at shorter steps
    assert [remedy.words for remedy in flown] == [
        remedy.words for remedy in (found[-1], *found[:2])
    ]
    at_once = remedies(moving, SolveError("broken"))  # there is no time up to which it went well
    assert [remedy.words.split(",")[0] for remedy in at_once[:2]] == ["a weaker field"] * 2
    assert not any("solver.dynamic.duration" in remedy.words for remedy in at_once)
    assert (
        remedies(moving, BudgetError("a full disk: raise max_disk", Reached(0.2))) == ()
    )  # it says what to raise
    [only] = remedies(moving, LeftField("inside", Reached(0.1)))
    assert only.applied(moving).duration == pytest.approx(0.09)


def test_a_body_that_is_pulled_away_gets_a_weaker_field() -> None:
    """As much of it as was borne, where that is known."""
    scene = rod_scene(length=16e-3, field=(0, 0, 8e-3), cells=2)
    strengths = []
    for state in (None, Reached(load_share=0.6)):
        for remedy in remedies(scene, LeftField("inside", state)):
            weaker = remedy.applied(scene)
            strengths.append(float(weaker.external_field().at(np.zeros(3))[0][2]) / 8e-3)
    assert strengths == pytest.approx([0.5, 0.1, 0.54, 0.3])


def test_no_remedy_changes_the_robot() -> None:
    """Loads, steps and times change; body and materials stay as they are."""
    scene = rod_scene(
        length=16e-3,
        directions=[(1, 0, 0), (1, 0, 0)],
        field=(0, 0, 1e-3),
        cells=2,
        gravity=(0, 0, -9.81),
    )
    data = scene.with_effects(magnetic_interaction={}).to_si()
    schedule = {
        "over_time": {
            "ramp": {"duration": 0.2, "begin": 0.5},
            "oscillation": {"frequency": 5.0, "cycles": 2.25},
        }
    }
    for solver in (
        {"static": {}},
        {"quasi_static": {"steps": 4, "duration": 1.0}},
        {"dynamic": {"duration": 0.5}},
    ):
        for field in (data["field"], {**data["field"], **schedule}):
            changed = Scene.from_si({**data, "solver": solver, "field": field})
            states = Reached(0.2), Reached(0.2, 0.6)
            for error in (
                SolveError("broken"),
                LeftField("outside"),
                Collapsed("collapsed", states[0]),
                TimeOver("late", states[1]),
            ):
                for remedy in remedies(changed, error):
                    assert (remedy.applied(changed).body, remedy.applied(changed).materials) == (
                        scene.body,
                        scene.materials,
                    )


def test_a_schedule_is_weakened_by_its_ramp() -> None:
    """All of it, and the weight as well."""
    data = rod_scene(length=16e-3, field=(0, 0, 1e-3), cells=2, gravity=(0, 0, -9.81)).to_si()
    swinging = {
        **data["field"],
        "over_time": {
            "ramp": {"duration": 0.2, "begin": 0.5},
            "oscillation": {"frequency": 5.0, "cycles": 2.25},
        },
    }
    scene = Scene.from_si(
        {**data, "field": swinging, "solver": {"quasi_static": {"steps": 4, "duration": 1.0}}}
    )
    weaker = remedies(scene, LeftField("outside"))[0].applied(scene)
    at = [one.external_field().at(np.zeros(3))[0][2] for one in (scene, weaker)]
    assert at[1] == pytest.approx(0.5 * at[0], rel=1e-12)  # rounding
    assert weaker.effects.gravity.acceleration[2] == pytest.approx(
        0.5 * scene.effects.gravity.acceleration[2]
    )


def test_equilibria_along_time_that_fail_at_once_get_a_weaker_load() -> None:
    """There is no time up to which it went well."""
    data = rod_scene(length=16e-3, field=(0, 0, 8e-3), cells=2).to_si()
    path = Scene.from_si({**data, "solver": {"quasi_static": {"steps": 4, "duration": 1.0}}})
    assert [
        remedy.words.split(",")[0] for remedy in remedies(path, LeftField("outside", None))
    ] == ["a weaker field"] * 2
    *weaker, finer = remedies(path, SolveError("no equilibrium", None))
    assert len(finer.applied(path).path_times()) == 17
    assert [remedy.words.split(",")[0] for remedy in weaker] == ["a weaker field"] * 2
    [later, _] = remedies(path, SolveError("no equilibrium", Reached(0.5)))
    assert later.applied(path).duration == pytest.approx(0.45)
    begun = Reached(
        0.5, load_share=0.6
    )  # a first equilibrium, of a later time, of which a part of the load was borne
    for error in (SolveError("no equilibrium", begun), TimeOver("late", begun)):
        assert [remedy.words.split(",")[0] for remedy in remedies(path, error)[-2:]] == [
            "a weaker field"
        ] * 2


def test_a_path_out_of_time_takes_no_more_steps_than_it_took() -> None:
    """A shorter path of as many steps would run out of time again. One that failed otherwise gets as many."""
    scene = rod_scene(length=16e-3, field=(0, 0, 8e-3), cells=2)
    along = Scene.from_si(
        {**scene.to_si(), "solver": {"quasi_static": {"steps": 10, "duration": 1.0}}}
    )
    [late] = remedies(along, TimeOver("time limit of 1 s reached", Reached(0.5)))
    assert len(late.applied(along).path_times()) == 5  # of 0.45 s, the first among them
    finer = remedies(along, SolveError("broken", Reached(0.5)))[0].applied(along)
    assert len(finer.path_times()) > 10


def test_what_only_is_moved_has_no_weaker_load() -> None:
    """Neither field nor weight: a finer path is what is left."""
    data = rod_scene(length=16e-3, field=(0, 0, 0), cells=2).to_si()
    path = {"quasi_static": {"steps": 4, "duration": 1.0}}
    alone = Scene.from_si({**data, "solver": path, "effects": {"self_contact": {}}})
    words = [remedy.words for remedy in remedies(alone, SolveError("no equilibrium", None))]
    assert words == ["solver.quasi_static: {steps: 16}"]
