"""A body that cannot be is no result: what else explains its torque is asked; a heavy one that can be stays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.small_arm import URDF
from tests.test_loop_beside import ROBOT, SHOULDER, judged

from hybrid_dynamics.effects import Effect, Family, Term
from hybrid_dynamics.effects.inertia import cannot_be, link_parameters, pseudo_inertia_basis, to_body
from hybrid_dynamics.loop import LoopSettings, Model, alternatives, prune
from hybrid_dynamics.loop import find as find_module
from hybrid_dynamics.loop.augment import refit
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.search import Step
from hybrid_dynamics.loop.solve import _TRIANGLE
from hybrid_dynamics.loop.trace import Judge
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.simulation.excitation import excitations

LINK, SPRING = Term("link_inertia", 0), Term("joint_spring", 0, (("shape", "linear"),))
HIDDEN = Effect("joint_spring", (SHOULDER,), {"stiffness": 30.0, "rest_position": 0.0}, {"shape": "linear"})
#: Of the arm: 4 kg and 2 kg; the elbow .4 m from the shoulder, the farther centre .2 m from its joint.
MASS, REACH = 6.0, 0.6


def heavier(times: float) -> Effect:
    """The first link, heavier by so many times its mass."""
    return Effect("link_inertia", (SHOULDER,), to_body(link_parameters(ROBOT, 0) * (1 + times)))


def with_spring(effect: Effect) -> Judge:
    """Evidence of one run in few poses with ``effect``, where the link stands for it; a spring can be asked."""
    judge, _, _ = judged([effect])
    return judge.adding([SPRING]).at([LINK])


def stribeck(coulomb: float, static: float, velocity: float) -> dict[str, float]:
    return {"coulomb_torque": coulomb, "static_torque": static, "stribeck_velocity": velocity}


def judged_with(hidden: Sequence[Effect], start: Model) -> Judge:
    """The judge of two runs of the arm with what is ``hidden``."""
    settings = LoopSettings()
    train, test = excitations(ROBOT, hidden, train=2, test=1, duration=8.0, rate=250.0)
    return gather(start, read_motion(ROBOT, train, test, settings), settings)[0]


def silent(step: Step) -> None:
    assert step.terms is not None


def nothing(judge: Judge, current: Sequence[Term]) -> list[Term]:
    return []


def test_a_link_many_times_the_robot_gives_way_to_what_it_stood_for(monkeypatch: pytest.MonkeyPatch) -> None:
    judge = with_spring(HIDDEN)
    x = refit(judge.evidence, [LINK]).x
    assert x[0] > 5 * MASS
    assert prune.impossible(judge, [LINK]) == [LINK]
    candidates = [*judge.evidence.terms]
    _, kept, _, _ = find_module._surely(judge, [LINK], candidates, len(candidates), silent)
    assert kept == [SPRING]
    # Control: by what it explains alone it would stay.
    monkeypatch.setattr(prune, "impossible", nothing)
    _, kept, _, _ = find_module._surely(judge, [LINK], candidates, len(candidates), silent)
    assert kept == [LINK]


def test_it_is_let_go_of_when_nonlinear_parameters_are_refined(monkeypatch: pytest.MonkeyPatch) -> None:
    judge = with_spring(HIDDEN)
    for known, ends in ((prune.impossible, []), (nothing, [LINK])):
        monkeypatch.setattr(find_module, "impossible", known)
        assert find_module._refined(judge, [LINK], [LINK], silent)[1] == ends


@pytest.mark.parametrize(("coulomb", "is_none"), [(0.0, True), (0.4, False)])
def test_a_friction_that_is_nothing_in_faster_motion_is_no_stribeck_friction(coulomb: float, is_none: bool) -> None:
    """Seen in slow motion alone anything that falls makes it, and faster the joint would be without friction."""
    hidden = Effect("stribeck_friction", (SHOULDER,), stribeck(coulomb, 1.0, 0.3))
    judge = judged_with([hidden], Model(ROBOT))
    term = hidden.term(ROBOT)
    judge = judge.adding([term]).at([term])
    assert prune.impossible(judge, [term]) == ([term] if is_none else [])
    _, kept, _, _ = find_module._surely(judge, [term], [term], 1, silent)
    assert kept == ([] if is_none else [term])


@pytest.mark.parametrize(
    "known",
    [
        Effect("coulomb_friction", (SHOULDER,), {"coulomb_torque": 1.0}),
        Effect("stribeck_friction", (SHOULDER,), stribeck(1.0, 1.5, 0.3)),
        Effect("stribeck_friction", (SHOULDER,), stribeck(1.0, 1.5, 0.25)),
    ],
    ids=["plain", "the same", "another velocity"],
)
def test_a_rise_on_top_of_the_friction_of_the_starting_model_is_one(known: Effect) -> None:
    hidden = Effect("stribeck_friction", (SHOULDER,), stribeck(1.0, 2.0, 0.3))
    judge = judged_with([hidden], Model(ROBOT, (known,)))
    term = hidden.term(ROBOT)
    judge = judge.adding([term]).at([term])
    x = refit(judge.evidence, [term]).x
    assert 10 * x[0] < x[1], "a change: of dry friction itself there is hardly any"
    assert prune.impossible(judge, [term]) == []


def test_a_rise_beside_other_dry_friction_of_its_joint_is_one() -> None:
    dry = Effect("coulomb_friction", (SHOULDER,), {"coulomb_torque": 1.0})
    rise, plain = (
        effect.term(ROBOT) for effect in (Effect("stribeck_friction", (SHOULDER,), stribeck(0.0, 1.0, 0.3)), dry)
    )
    judge = judged_with([Effect("stribeck_friction", (SHOULDER,), stribeck(0.0, 1.0, 0.3))], Model(ROBOT))
    judge = judge.adding([rise, plain]).at([rise])
    assert prune.impossible(judge, [rise]) == [rise]
    # What there is of the other does not change that: all dry friction of the joint falls to nothing.
    assert prune.impossible(judge, [rise, plain]) == [rise]
    judge = judged_with([Effect("stribeck_friction", (SHOULDER,), stribeck(1.0, 2.0, 0.3))], Model(ROBOT))
    assert prune.impossible(judge.adding([rise, plain]).at([rise]), [rise, plain]) == []


UNDECLARED = Effect("hysteresis_friction", (SHOULDER,), {"presliding_stiffness": 40.0, "coulomb_torque": 1.0})
LOADED = Effect("load_dependent_friction", (SHOULDER,), {"load_coefficient": 0.1})


@pytest.mark.parametrize(("beside", "impossible"), [(UNDECLARED, True), (LOADED, False)])
def test_only_friction_that_follows_the_load_may_hold_a_rise_that_falls_to_nothing(
    monkeypatch: pytest.MonkeyPatch, beside: Effect, impossible: bool
) -> None:
    """A family that declares no dry friction, as a new one may, has none."""
    hidden = Effect("stribeck_friction", (SHOULDER,), stribeck(0.0, 1.0, 0.3))
    rise, other = hidden.term(ROBOT), beside.term(ROBOT)
    judge = judged_with([hidden], Model(ROBOT))
    judge = judge.adding([rise, other]).at([rise])
    monkeypatch.setattr(type(other.family()), "in_descriptions", Family.in_descriptions)
    assert (rise in prune.impossible(judge, [rise, other])) is impossible


@pytest.mark.parametrize(("share", "impossible"), [(0.5, False), (1.3, True)])
def test_friction_as_large_as_the_load_is_none(share: float, impossible: bool) -> None:
    hidden = Effect("load_dependent_friction", (SHOULDER,), {"load_coefficient": share})
    term = hidden.term(ROBOT)
    judge = judged_with([hidden], Model(ROBOT)).adding([term])
    assert abs(judge.evidence.fit([term])[0] - share) < 0.05
    assert prune.impossible(judge, [term]) == ([term] if impossible else [])


@pytest.mark.parametrize("times", [1.0, 1.4])
def test_a_heavy_block_that_can_be_stays(times: float) -> None:
    judge = with_spring(heavier(times))
    candidates = [*judge.evidence.terms]
    assert prune.impossible(judge, [LINK]) == []
    _, kept, _, _ = find_module._surely(judge, [LINK], candidates, len(candidates), silent)
    assert kept == [LINK]


def test_what_cannot_be_is_no_alternative(monkeypatch: pytest.MonkeyPatch) -> None:
    judge = with_spring(HIDDEN).at([SPRING])
    monkeypatch.setattr(alternatives._Named, "as_good", lambda named, held: np.zeros(2))

    def listed() -> list[str]:
        entries = alternatives.indistinguishable(judge, [SPRING], [LINK])[SPRING]
        return [e["effect"] for entry in entries for e in entry["effects"]]

    assert "link_inertia" not in listed()
    monkeypatch.setattr(alternatives, "impossible", nothing)
    assert "link_inertia" in listed()


@pytest.mark.parametrize(
    ("change", "impossible"),
    [
        ((0.9 * MASS, 0, 0, 0), False),
        ((1.1 * MASS, 0, 0, 0), True),
        ((-1.1 * MASS, 0, 0, 0), True),
        ((MASS, 0, 0.7 * MASS * REACH, 0.7 * MASS * REACH), False),
        ((0.0, 0, 0.8 * MASS * REACH, 0.8 * MASS * REACH), True),
    ],
)
def test_the_robot_itself_is_the_measure(change: tuple[float, ...], impossible: bool) -> None:
    assert cannot_be(ROBOT, np.array([*change, *[0.0] * 6])) == impossible


def test_where_a_link_has_no_mass_everything_can_be() -> None:
    unknown = Robot.from_text(URDF.replace('<mass value="4"/>', '<mass value="0"/>'), "no mass")
    assert not cannot_be(unknown, np.array([1e3, *[0.0] * 9]))


def test_every_body_of_one_link_is_measured() -> None:
    change = 2 * MASS * np.eye(10)[0]
    for name, x in (("payload", change), ("link_inertia", change), ("link_mass", change[:1])):
        term = Term(name, None if name == "payload" else 0)
        assert any(cannot_be(ROBOT, own) for own in term.family().inertial_changes(x, ROBOT, term))
        assert not any(cannot_be(ROBOT, own) for own in term.family().inertial_changes(0.4 * x, ROBOT, term))
    centre = Term("link_com", 0)
    (own,) = centre.family().inertial_changes(np.array([2 * MASS * REACH, 0.0, 0.0]), ROBOT, centre)
    assert cannot_be(ROBOT, own)


@given(st.lists(st.floats(-3, 3), min_size=20, max_size=20))
def test_a_body_in_the_solvers_triangle_has_the_products_of_its_matrix(numbers: list[float]) -> None:
    # Clarabel's scaling: <svec A, svec B> = tr(A B). A wrong one lets bodies in that cannot be.
    one, other = np.reshape(numbers, (2, 10))
    basis = np.array(pseudo_inertia_basis())
    matrices = [np.einsum("k,kij->ij", x, basis) for x in (one, other)]
    assert (_TRIANGLE @ one) @ (_TRIANGLE @ other) == pytest.approx(np.trace(matrices[0] @ matrices[1]), abs=1e-9)


@pytest.mark.parametrize(("offset", "gone"), [(0.6, True), (-0.6, True), (0.1, False)])
def test_a_zero_that_puts_a_joint_far_outside_its_limits_cannot_be(offset: float, gone: bool) -> None:
    zero, wide = Term("position_offset", 1), 'lower="-2.5" upper="2.5"'
    hidden = Effect("position_offset", (ROBOT.joint_names[1],), {"offset": offset})
    train, test = excitations(ROBOT, [hidden], train=2, test=1, duration=6.0, rate=200.0)
    read = np.concatenate([run["q"][:, 1] for run in train])
    # Limits that what is read keeps, and wider ones.
    narrow = f'lower="{read.min():.4f}" upper="{read.max():.4f}"'
    for limits, left in ((narrow, [zero] if gone else []), ('lower="-4" upper="4"', [])):
        before, after = URDF.rsplit(wide, 1)
        robot, settings = Robot.from_text(before + limits + after, "arm"), LoopSettings()
        judge, _, _ = gather(Model(robot), read_motion(robot, train, test, settings), settings)
        assert prune.impossible(judge.adding([zero]).at([zero]), [zero]) == left


@pytest.mark.parametrize(("offset", "gone"), [(1.3, True), (-1.3, True), (0.9, False)])
def test_a_zero_further_off_than_zeros_are_cannot_be(offset: float, gone: bool) -> None:
    zero = Term("position_offset", 1)
    before, after = URDF.rsplit('lower="-2.5" upper="2.5"', 1)
    robot = Robot.from_text(before + 'lower="-4" upper="4"' + after, "arm")
    hidden = Effect("position_offset", (robot.joint_names[1],), {"offset": offset})
    train, test = excitations(robot, [hidden], train=2, test=1, duration=6.0, rate=200.0)
    settings = LoopSettings()
    judge, _, _ = gather(Model(robot), read_motion(robot, train, test, settings), settings)
    for _ in range(8):
        # Newton's steps from the zero that is read.
        judge = judge.adding([zero]).at([zero])
    assert judge.evidence.fit([zero])[0] == pytest.approx(offset, abs=0.02)
    assert prune.impossible(judge, [zero]) == ([zero] if gone else [])
