"""How near all links are held to the starting model's: as near as predicts held-out rows best."""

from __future__ import annotations

import numpy as np
import pytest
from tests.small_arm import arm, heavier_links

from hybrid_dynamics.effects import Effect, Term, family
from hybrid_dynamics.effects.base import HELD
from hybrid_dynamics.loop import LoopSettings, Model
from hybrid_dynamics.loop import find as find_module
from hybrid_dynamics.loop import known as known_module
from hybrid_dynamics.loop.augment import refit
from hybrid_dynamics.loop.beside import LINKS_WITHIN
from hybrid_dynamics.loop.diagnosis import errors_of
from hybrid_dynamics.loop.identifiability import undetermined
from hybrid_dynamics.loop.nearer import links_nearer
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.loop.tangents import published_covariance
from hybrid_dynamics.loop.trace import Judge
from hybrid_dynamics.simulation.excitation import excitations
from hybrid_dynamics.trajectory import Trajectory

ROBOT = arm()
(LINKS,) = family("inertial_parameters").terms(ROBOT, np.ones(2, bool), {})


def judged(effects: list[Effect], noise: float, duration: float) -> tuple[Judge, list[Term], list[Run]]:
    """Of two short runs, with what is named: all links and friction."""
    settings, rng = LoopSettings(), np.random.default_rng(5)

    def noisy(run: Trajectory) -> Trajectory:
        return run.with_signals(tau=run["tau"] + noise * rng.normal(size=run["tau"].shape))

    train, test = excitations(ROBOT, effects, train=2, test=1, duration=duration, rate=200.0)
    logs = read_motion(ROBOT, [noisy(run) for run in train], [noisy(run) for run in test], settings)
    judge, candidates, _ = gather(Model(ROBOT), logs, settings)
    friction = next(t for t in candidates if t.effect == "coulomb_friction" and t.joint == 1)
    return judge.adding([LINKS, friction]), [LINKS, friction], logs.test


def test_links_that_are_as_described_are_held_there_and_other_runs_are_predicted_no_worse() -> None:
    judge, names, test = judged([Effect("coulomb_friction", ("elbow",), {"coulomb_torque": 0.5})], 0.5, 6.0)
    near, (note,) = links_nearer(judge, names, [])
    share = near.evidence.problem.links_within
    assert share in LINKS_WITHIN
    assert f"{share:.0%}" in note
    free, held = (np.array(errors_of(refit(j.evidence, names).model(), test)["rmse"]) for j in (judge, near))
    assert np.sum(held**2) < np.sum(free**2)
    # Nothing else is held nearer, and the judge who was asked stands where it stood.
    plain, asked = judge.evidence.problem, near.evidence.problem
    layouts = [judge.evidence.layout([t]) for t in names]
    np.testing.assert_allclose(asked.prior(layouts[0]) * share**2, plain.prior(layouts[0]))
    np.testing.assert_array_equal(asked.prior(layouts[1]), plain.prior(layouts[1]))
    held_beside = Term(LINKS.effect, None, tuple(sorted([*LINKS.settings, (HELD, 0.1)])))
    own = judge.evidence.layout([held_beside])
    np.testing.assert_array_equal(asked.prior(own), plain.prior(own))


def test_links_that_are_half_as_heavy_again_are_left_free() -> None:
    judge, names, _ = judged([heavier_links(0.5)], 0.001, 8.0)
    near, notes = links_nearer(judge, names, [])
    assert near.evidence.problem.links_within == 1.0
    assert notes == []


@pytest.mark.parametrize("beside", [[], [Term("torque_offset", 0)]])
def test_nobody_is_asked_where_the_links_are_no_name(beside: list[Term]) -> None:
    judge, names, _ = judged([], 0.1, 6.0)
    same, notes = links_nearer(judge, names[1:], beside)
    assert same is judge
    assert notes == []


def test_what_is_left_open_and_how_sure_the_rest_is_are_told_as_with_free_links() -> None:
    judge, names, _ = judged([Effect("coulomb_friction", ("elbow",), {"coulomb_torque": 0.5})], 0.5, 6.0)
    open_, errors = [], []
    for share in (1.0, *LINKS_WITHIN):
        evidence = judge.evidence.holding_links(share)
        open_.append(undetermined(evidence, names, LINKS))
        errors.append(np.sqrt(np.diag(published_covariance(evidence, names, evidence.fit(names)))))
    assert len(open_[0]) > 0
    assert all(left == open_[0] for left in open_)
    # What only the prior holds is as unknown as ever.
    plausible = LINKS.prior_scale(ROBOT)
    silent = errors[0][:20] > 0.95 * plausible
    assert silent.any()
    for own in errors[1:]:
        np.testing.assert_allclose(own[:20][silent], errors[0][:20][silent], rtol=0.06)


def test_a_search_ends_with_the_links_held_so(monkeypatch: pytest.MonkeyPatch) -> None:
    settings = LoopSettings(effects=("inertial_parameters",))
    train, _ = excitations(ROBOT, [heavier_links(0.4)], train=2, test=0, duration=8.0, rate=200.0)
    judge, candidates, _ = gather(Model(ROBOT), read_motion(ROBOT, train, [], settings), settings)

    def nearer(there: Judge, chosen: list[Term], beside: list[Term]) -> tuple[Judge, list[str]]:
        return there.over(there.evidence.holding_links(0.05)), ["near"]

    monkeypatch.setattr(known_module, "links_nearer", nearer)
    found = find_module.find(judge, candidates, lambda step: None)
    assert [t.effect for t in found.terms] == ["inertial_parameters"]
    assert found.judge.evidence.problem.links_within == 0.05
    assert found.notes == ["near"]


@pytest.mark.parametrize("error", [0.2, 0.8])
def test_a_name_that_nearer_links_make_as_little_as_its_error_stands_beside(
    error: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    judge, names, _ = judged([Effect("coulomb_friction", ("elbow",), {"coulomb_torque": 0.5})], 0.5, 6.0)
    friction, asked = names[1], []

    def published(there: Judge, kept: list[Term], beside: list[Term]) -> tuple[Judge, list[Effect]]:
        asked.append(there.evidence.problem.links_within)
        dry = Effect("coulomb_friction", ("elbow",), {"coulomb_torque": 0.5}, std_errors={"coulomb_torque": error})
        links = LINKS.family().parameters_of(np.zeros(LINKS.size), ROBOT, LINKS)
        effects = {LINKS: Effect(LINKS.effect, (), links, {"links": LINKS.options["links"]}), friction: dry}
        return there, [effects[t] for t in kept]

    monkeypatch.setattr(known_module, "_published", published)
    # A coefficient of which something is known from one standard error on.
    known = 0.5 / error > known_module.EXPECTED
    there, kept, beside, notes = known_module.known_nearer(judge, names, [], [])
    assert kept == (names if known else [LINKS])
    assert [t.as_finding.place for t in beside] == ([] if known else [friction.place])
    assert all(not t.is_finding for t in beside)
    assert len(notes) == 1
    # It is asked where the links are held nearer, and where it went once more without it.
    assert len(asked) == (1 if known else 2)
    assert asked[-1] == there.evidence.problem.links_within < 1.0
    # What is fixed stays, whatever is known of it.
    assert known_module.known_nearer(judge, names, [], [friction])[1] == names
    # Where without it the links are as free as before, it is known as it was.
    near = links_nearer

    def once(there: Judge, kept: list[Term], beside: list[Term]) -> tuple[Judge, list[str]]:
        return (there, []) if beside else near(there, kept, beside)

    monkeypatch.setattr(known_module, "links_nearer", once)
    assert known_module.known_nearer(judge, names, [], [])[1:3] == (names, [])
    # Nor do nearer links cost a name that not every joint has.
    monkeypatch.setattr(known_module, "links_nearer", near)
    with monkeypatch.context() as patched:
        patched.setattr(known_module, "_least_known", lambda there, kept, effects, fixed: kept[0])
        assert known_module.known_nearer(judge, names, [], []) == (judge, names, [], [])
    # Control: with links as free as before nobody is asked.
    asked.clear()
    monkeypatch.setattr(known_module, "links_nearer", lambda there, kept, beside: (there, []))
    assert known_module.known_nearer(judge, names, [], []) == (judge, names, [], [])
    assert asked == []
