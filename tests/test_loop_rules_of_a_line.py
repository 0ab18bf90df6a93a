"""Rules of a line each that no other test fails without: whose error is whose, what is pooled, held out, allowed, told.

Found by turning operators into their opposites: each of these tests fails where its line says the contrary.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from tests.small_arm import arm, noisy_log

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.effects.base import ONLY_RUN
from hybrid_dynamics.effects.settings import check_settings
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.loop import LoopSettings, Model
from hybrid_dynamics.loop import alternatives as alternatives_module
from hybrid_dynamics.loop import floor as floor_module
from hybrid_dynamics.loop import identifiability as identifiability_module
from hybrid_dynamics.loop import known as known_module
from hybrid_dynamics.loop import one_for_two as one_for_two_module
from hybrid_dynamics.loop import prune as prune_module
from hybrid_dynamics.loop.augment import effects_of
from hybrid_dynamics.loop.blocks import Blocks, Folds
from hybrid_dynamics.loop.hold_out import _at_the_end
from hybrid_dynamics.loop.identifiability import DIFFERENCE, inconsistent
from hybrid_dynamics.loop.in_the_hand import payload_for_links
from hybrid_dynamics.loop.physics import physical_constraints
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.runs import pool
from hybrid_dynamics.loop.solve import Constraints
from hybrid_dynamics.loop.trace import Judge

ROBOT = arm()
SHOULDER, ELBOW = ROBOT.joint_names
VISCOUS = Term("viscous_friction", 0)
PAYLOAD = Term("payload")
FRICTION = Term("asymmetric_coulomb_friction", 1)


def _judge(*hidden: Sequence[Effect]) -> tuple[Judge, list[Term]]:
    """A run for each of ``hidden``, and one to test."""
    train = [noisy_log(list(own), k, "train", 0.05) for k, own in enumerate(hidden)]
    logs = read_motion(ROBOT, train, [noisy_log([], 9, "test", 0.05)], LoopSettings())
    judge, terms, _ = gather(Model(ROBOT), logs, LoopSettings())
    return judge, terms


def test_the_error_of_a_refined_number_is_its_own_and_not_that_of_the_effect_before() -> None:
    judge, _ = _judge([])
    terms = [Term("stribeck_friction", j, (("stribeck_velocity", 0.1),)) for j in (0, 1)]
    evidence = judge.adding(terms).evidence
    # Four coordinates, then both velocities, in the order of the effects.
    covariance = np.diag([0.0, 0.0, 0.0, 0.0, 0.02**2, 0.07**2])
    effects = effects_of(evidence, terms, np.ones(4), covariance)
    told = {e.joints[0]: e.std_errors["stribeck_velocity"] for e in effects}
    assert told == pytest.approx({SHOULDER: 0.02, ELBOW: 0.07})


def test_what_the_parts_of_an_effect_come_to_is_fitted_on_all_runs_beside_what_comes_before_it() -> None:
    own = {"mass": 1.0, "com_x": 0.1, "com_y": 0.0, "com_z": 0.0}
    inertia = {"inertia_xx": 0.01, "inertia_xy": 0.0, "inertia_yy": 0.02, "inertia_xz": 0.0, "inertia_yz": 0.0}
    tool = [Effect("payload", (), {**own, **inertia, "inertia_zz": 0.02, "mass": mass}) for mass in (0.4, 2.0)]
    judge, terms = _judge([tool[0]], [tool[1]])
    (payload,) = [t for t in terms if t.effect == "payload"]
    names = [run.name for run in judge.evidence.runs]
    parts = [Term("payload", None, tuple(sorted({**payload.options, ONLY_RUN: n}.items()))) for n in names]
    # The whole stands behind a coordinate of another effect.
    judge = judge.adding([VISCOUS, *parts, payload])
    judge, merged, x = pool(judge, [VISCOUS, *parts])
    layout = judge.evidence.layout(merged)
    start = dict(zip(layout.terms, layout.starts, strict=True))[payload]
    assert start > 0
    effects = effects_of(judge.evidence, merged, x)
    (found,) = [e for e in effects if e.effect == "payload"]
    # Neither run's own: between both.
    assert 0.7 < found.parameters["mass"] < 1.7


def test_a_body_is_not_given_back_to_a_part_of_it_for_numbers_that_are_not_known(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def asked(*_: object) -> Any:
        raise AssertionError("a body of ten numbers was asked for its plainer forms")

    monkeypatch.setattr(known_module, "plainer_forms", asked)
    body = Term("link_inertia", 1)
    assert body.family().is_body
    assert body.family().contains
    numbers = {"mass": 1.0, "com_x": 0.1, "com_y": 0.0, "com_z": 0.0, "inertia_xx": 0.1, "inertia_xy": 0.0}
    numbers |= {"inertia_yy": 0.1, "inertia_xz": 0.0, "inertia_yz": 0.0, "inertia_zz": 0.1}
    unknown = Effect("link_inertia", (ELBOW,), numbers, {}, dict.fromkeys(numbers, 9.0))
    judge = cast(Judge, SimpleNamespace(evidence=SimpleNamespace(robot=ROBOT)))
    assert known_module._plainer(judge, [body], [unknown], [], []) == (judge, [body])


def test_what_is_held_out_at_the_end_begins_after_a_gap_of_seconds() -> None:
    run = noisy_log([], 1, "train", 0.05)
    settings = LoopSettings(held_out_gap=1.0, held_out_share=0.25)
    (learned,), (held,) = _at_the_end(run, settings)
    assert learned.time[-1] - run.time[0] == pytest.approx(15.0, abs=2 * run.dt)
    assert len(run.time) - len(learned.time) - len(held.time) == pytest.approx(1.0 / run.dt, abs=1)


@pytest.mark.parametrize(("x", "satisfied"), [(1.0, True), (0.0, True), (-1.0, False)])
def test_coordinates_satisfy_their_bounds_from_there_on(x: float, satisfied: bool) -> None:
    assert Constraints(np.zeros(1)).satisfied(np.array([x])) is satisfied


def _never(*_: object) -> Any:
    raise AssertionError("a payload was asked for")


@pytest.mark.parametrize(
    ("chosen", "candidates", "identified"),
    [
        ([Term("link_inertia", 1)], [VISCOUS], True),  # no hand to hold it
        ([VISCOUS], [PAYLOAD], True),  # no link to stand for it
        ([Term("link_inertia", 1), PAYLOAD], [PAYLOAD], True),  # there already
        ([Term("link_inertia", 1)], [PAYLOAD], False),  # links that nobody has identified
    ],
)
def test_a_payload_is_asked_for_only_where_a_link_may_stand_for_it(
    chosen: list[Term], candidates: list[Term], identified: bool
) -> None:
    problem = SimpleNamespace(links_identified=identified)
    judge = cast(Judge, SimpleNamespace(evidence=SimpleNamespace(problem=problem), adding=_never))
    assert payload_for_links(judge, chosen, candidates) == (judge, chosen)


@pytest.mark.parametrize(
    ("apart", "error", "told"),
    [
        (0.5 * DIFFERENCE, 1e-6, False),  # sure, and nothing that anybody would notice
        (3.0 * DIFFERENCE, 1e-6, True),
        # Beyond three standard errors for each run but one: of four runs more may differ by chance.
        (3.0 * DIFFERENCE, DIFFERENCE, False),
    ],
)
def test_runs_differ_in_a_parameter_where_it_is_sure_and_of_practical_size(
    monkeypatch: pytest.MonkeyPatch, apart: float, error: float, told: bool
) -> None:
    judge, _ = _judge([], [], [], [])
    judge = judge.adding([VISCOUS])
    size = 20.0
    values = iter(size * (1.0 + apart * np.array([0.0, 1.0, 0.0, 1.0])))

    def alone(*_: object) -> tuple[Any, ...]:
        return np.array([next(values)]), np.array([[(size * error) ** 2]]), np.full(2, 1e9)

    monkeypatch.setattr(identifiability_module, "fit_alone", alone)
    found = inconsistent(judge, [VISCOUS], np.array([size]), [VISCOUS])
    assert bool(found) is told


@pytest.mark.parametrize("value", [5, "", None, True])
def test_a_name_in_a_setting_is_text(value: object) -> None:
    check_settings("joint_coupling", {"from_joint": "elbow"}, ["from_joint"])
    with pytest.raises(InputError, match="setting from_joint is"):
        check_settings("joint_coupling", {"from_joint": value}, ["from_joint"])


@pytest.mark.parametrize(("rests", "says"), [([1.0, 1.2], None), ([1.0, 1.01], True), ([0.0, 0.01], False)])
def test_rests_say_whether_a_constant_acts_where_they_are_sure(
    monkeypatch: pytest.MonkeyPatch, rests: list[float], says: bool | None
) -> None:
    """Nearer to a constant of 1 N m or to nothing, by Student's t: of two rests one degree of freedom is left."""
    monkeypatch.setattr(one_for_two_module, "_constant", lambda *_: 1.0)
    monkeypatch.setattr(one_for_two_module, "rests", lambda *_: [slice(0, 1), slice(1, 2)])
    run = SimpleNamespace(time=np.arange(2.0), dq=np.zeros((2, 2)))
    left = np.column_stack([np.zeros(2), rests])
    layout = SimpleNamespace(terms=[FRICTION], starts=[0])
    evidence = SimpleNamespace(
        fit=lambda terms: np.ones(2), layout=lambda terms: layout, residuals=lambda terms, x: [left], runs=[run]
    )
    judge = cast(Judge, SimpleNamespace(evidence=evidence, settings=LoopSettings()))
    assert one_for_two_module._at_rest(judge, [FRICTION], [FRICTION]) is says


@pytest.mark.parametrize(("above", "forced"), [(0.5, True), (2.0, False)])
def test_what_stands_at_the_end_of_what_is_plausible_is_something_else(
    monkeypatch: pytest.MonkeyPatch, above: float, forced: bool
) -> None:
    """Within a share of the end itself, however large that is."""
    monkeypatch.setattr(prune_module, "impossible", lambda *_: [])
    lowest = -0.02
    monkeypatch.setattr(type(VISCOUS.family()), "lower_bounds", lambda *_: np.array([lowest]))
    x = np.array([lowest + above * prune_module.BOUND * abs(lowest)])
    layout = SimpleNamespace(terms=[VISCOUS], starts=[0])
    evidence = SimpleNamespace(fit=lambda terms: x, layout=lambda terms: layout, robot=ROBOT)
    judge = cast(Judge, SimpleNamespace(evidence=evidence))
    assert prune_module._forced(judge, [VISCOUS]) == ({VISCOUS} if forced else set())


@pytest.mark.parametrize(("folds", "edges"), [([0, 1], [[], []]), ([0, 1, 1], [[1], []]), ([0, 0, 1, 1], [[2], [1]])])
def test_neighbours_of_what_is_held_out_take_no_part_unless_nothing_else_is_left(
    folds: list[int], edges: list[list[int]]
) -> None:
    rows = tuple((10 * k, 10 * k + 10) for k in range(len(folds)))
    blocks = Blocks(np.zeros(len(folds), int), rows)
    found = Folds(blocks, 2, np.array(folds)).edges
    assert [own.tolist() for own in found] == edges


@pytest.mark.parametrize(
    ("growth", "says"),
    [
        ([0.0, -0.2], "held-out error is smaller by up to 20.0 % (mean square) and larger on no joint"),
        ([0.04, -0.2], "held-out error grows by at most 4.0 % (mean square, worst joint)"),
        ([0.0, 0.0], "held-out error grows by at most 0.0 % (mean square, worst joint)"),
    ],
)
def test_what_an_alternative_does_to_the_error_is_told_by_its_worst_joint(growth: list[float], says: str) -> None:
    assert alternatives_module._why(np.array(growth), False) == says


def test_the_motion_that_would_tell_has_both_motions_each_once() -> None:
    viscous, load = Term("viscous_friction", 0), Term("load_dependent_friction", 0)
    told = alternatives_module.motion_that_would_tell(viscous, [load, load], False)
    own, other = viscous.family().shown_by, load.family().shown_by
    assert own != other
    assert told == f"A motion in which {own}; then one in which {other}."
    again = alternatives_module.motion_that_would_tell(viscous, [Term("viscous_friction", 1)], False)
    assert again == f"A motion in which {own}, one joint at a time."


def test_rows_outside_the_states_of_the_other_folds_are_counted_over_all_folds() -> None:
    """Of the first fold half the rows lie beyond the second's, of the second none lies beyond the first's."""
    q = np.concatenate([np.linspace(0.0, 2.0, 10), np.linspace(0.0, 1.0, 10)])[:, None]
    run = cast(Any, SimpleNamespace(q=q, dq=np.zeros((20, 1))))
    fold = np.repeat([0, 1], 10)
    outside = floor_module._unshared([run], [np.ones((20, 1), bool)], [fold], 0)
    assert outside == pytest.approx(np.mean(q[:10, 0] > 1.0) / 2)


def test_friction_that_changes_with_the_time_opposes_the_motion_at_the_speeds_of_the_log() -> None:
    """From a tenth of the fastest one on, and no farther: beyond it nothing was seen."""
    drift = Term("drift", 0, (("of", "viscous"), ("time_constant", 10.0)))
    fastest = np.array([0.5, 0.5])
    asked = physical_constraints([VISCOUS, drift], [0, 1], 2, {}, ROBOT, fastest)
    # Viscous friction of one unit at the fastest speed and a tenth of it, either way.
    speeds = {round(float(abs(row[0])), 9) for row in asked.rows}
    assert max(speeds) == pytest.approx(0.5)
    assert min(speeds) == pytest.approx(0.05)
