"""Fewer causes in the place of what makes their torque together: an offset, another form, one or two bodies."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from tests.small_arm import arm, noisy_log

from hybrid_dynamics.effects import Effect, State, Term, family, predict
from hybrid_dynamics.effects.inertia import link_parameters, to_body
from hybrid_dynamics.effects.sign import AT_REST
from hybrid_dynamics.loop import LoopSettings, Model
from hybrid_dynamics.loop import one_for_two as one_for_two_module
from hybrid_dynamics.loop.alternatives import _Named, _several_for_one
from hybrid_dynamics.loop.cheaper import cheaper, plain_instead
from hybrid_dynamics.loop.complete import complete
from hybrid_dynamics.loop.further import merge_forms, reshaped, simplify_bodies
from hybrid_dynamics.loop.known import known_and_beside
from hybrid_dynamics.loop.narrow import narrowed
from hybrid_dynamics.loop.one_for_two import friction_for_offset, one_for_two, two_for_one, with_rest
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.prune import _common, impossible, on_every_joint
from hybrid_dynamics.loop.trace import Gain, Judge
from hybrid_dynamics.loop.widen import widened
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.simulation.excitation import excitations
from hybrid_dynamics.trajectory import Trajectory

ROBOT = arm()
SHOULDER, ELBOW = ROBOT.joint_names
NOISE = 0.1
LINEAR, SINE = (Term("joint_spring", 1, (("shape", shape),)) for shape in ("linear", "sine"))
OFFSET, DRY, UNEVEN = (Term(name, 1) for name in ("torque_offset", "coulomb_friction", "asymmetric_coulomb_friction"))


def _judged(*hidden: Effect, seed: int = 1) -> tuple[Judge, list[Term]]:
    settings = LoopSettings()
    train = [noisy_log(hidden, seed + k, "train", NOISE) for k in (0, 1)]
    logs = read_motion(ROBOT, train, [noisy_log(hidden, seed + 50, "test", NOISE)], settings)
    judge, terms, _ = gather(Model(ROBOT), logs, settings)
    return judge.adding([LINEAR, SINE, OFFSET, DRY, UNEVEN]), terms


@pytest.mark.parametrize("seed", range(3))
def test_no_offset_beside_what_makes_it_already(seed: int) -> None:
    uneven = Effect(
        "asymmetric_coulomb_friction", (ELBOW,), {"coulomb_torque_positive": 1.5, "coulomb_torque_negative": 0.5}
    )
    judge, terms = _judged(uneven, seed=seed)
    assert OFFSET not in complete(judge.at([UNEVEN]), [UNEVEN], terms)[1]
    # Control: beside friction that is the same both ways it is what is missing.
    assert OFFSET in complete(judge.at([DRY]), [DRY], terms)[1]


@pytest.mark.parametrize("seed", range(3))
def test_a_spring_on_a_crank_beside_an_offset_is_a_linear_spring_where_that_does_as_well(seed: int) -> None:
    judge, _ = _judged(Effect("joint_spring", (ELBOW,), {"stiffness": 4.0, "rest_position": 0.1}, {"shape": "linear"}))
    assert merge_forms(judge, [OFFSET, SINE])[1] == [LINEAR]
    # Control: a sine and an offset are no linear spring. The elbow swings by a radian.
    crank = Effect("joint_spring", (ELBOW,), {"stiffness": 8.0, "rest_position": 0.1}, {"shape": "sine"})
    judge, _ = _judged(crank, Effect("torque_offset", (ELBOW,), {"offset": 3.0}), seed=seed)
    assert set(merge_forms(judge, [OFFSET, SINE])[1]) == {OFFSET, SINE}


@pytest.mark.parametrize(("true", "offered"), [(LINEAR, SINE), (SINE, LINEAR)], ids=["linear", "crank"])
def test_a_spring_takes_the_form_that_is_there_whichever_was_offered(true: Term, offered: Term) -> None:
    judge, _ = _judged(Effect("joint_spring", (ELBOW,), {"stiffness": 8.0, "rest_position": 0.1}, true.options))
    dry = Term("coulomb_friction", 0)
    there, found = reshaped(judge.adding([dry]), [dry, offered])
    assert found == [dry, true]
    assert there.evidence.held(found).score < there.adding([offered]).evidence.held([dry, offered]).score


def _friction(up: float, down: float) -> Effect:
    return Effect(
        "asymmetric_coulomb_friction", (ELBOW,), {"coulomb_torque_positive": up, "coulomb_torque_negative": down}
    )


def _resting(hidden: Sequence[Effect], seed: int, split: str) -> Trajectory:
    """As :func:`noisy_log`, but the arm stops for a second or two in every five."""
    rng = np.random.default_rng(seed)
    time = np.arange(4000) / 200.0
    pace = np.clip(0.5 + 1.5 * np.sin(2 * np.pi * time / 5.0), 0.0, 1.0) ** 2
    phase = rng.uniform(0, 2 * np.pi, (2, 2, 1))
    way = np.array([[0.9, 1.7], [1.1, 2.3]])[..., None] * np.cumsum(pace) / 200.0 + phase
    q = np.einsum("k,jkt->tj", [0.5, 0.25], np.sin(way))
    dq = np.gradient(q, time, axis=0)
    tau = predict(ROBOT, list(hidden), q, dq, np.gradient(dq, time, axis=0), time)
    return Trajectory(
        f"{split}_{seed}", split, time, {"q": q, "dq": dq, "tau": tau + NOISE * rng.normal(size=tau.shape)}
    )


@pytest.mark.parametrize("seed", range(3))
def test_friction_and_an_offset_are_friction_that_is_rougher_one_way(seed: int) -> None:
    judge, _ = _judged(_friction(1.5, 0.5), seed=seed)
    assert one_for_two(judge, [DRY, OFFSET])[1] == [UNEVEN]
    # Control: an offset that is larger than the friction cannot be a friction that drives one way.
    dry, offset = (
        Effect(name, (ELBOW,), {key: value})
        for name, key, value in (("coulomb_friction", "coulomb_torque", 0.5), ("torque_offset", "offset", 1.5))
    )
    judge, _ = _judged(dry, offset, seed=seed)
    assert one_for_two(judge, [DRY, OFFSET])[1] == [DRY, OFFSET]


@pytest.mark.parametrize("seed", range(3))
def test_friction_that_would_be_next_to_nothing_one_way_is_plain_beside_an_offset(seed: int) -> None:
    """As torque sensors have it that do not read zero: no drive is rough one way only."""
    judge, _ = _judged(_friction(1.5, 0.05), seed=seed)
    assert one_for_two(judge, [DRY, OFFSET])[1] == [DRY, OFFSET]
    assert impossible(judge.at([UNEVEN]), [UNEVEN]) == [UNEVEN]
    # A tenth is where it ends.
    none = [UNEVEN.family().is_none(np.array([1.0, share]), UNEVEN, 0.5 * (1.0 + share)) for share in (0.09, 0.11)]
    assert none == [True, False]
    # On top of what the starting model has the same is no more than rougher one way.
    settings = LoopSettings()
    start = Model(ROBOT, (Effect("coulomb_friction", (ELBOW,), {"coulomb_torque": 1.0}),))
    logs = read_motion(
        ROBOT, [noisy_log([_friction(2.5, 1.05)], seed + k, "train", NOISE) for k in (0, 1)], [], settings
    )
    judge, _, _ = gather(start, logs, settings)
    judge = judge.adding([UNEVEN]).at([UNEVEN])
    assert impossible(judge, [UNEVEN]) == []


@pytest.mark.parametrize("seed", range(3))
def test_friction_that_is_none_one_way_in_the_end_is_given_back_to_plain_friction_and_an_offset(seed: int) -> None:
    """It was named while nothing stood beside it, and estimated with links beside it nothing is left of it one way."""
    judge, terms = _judged(_friction(1.5, 0.05), seed=seed)
    viscous = next(t for t in terms if t.effect == "viscous_friction" and t.joint == 0)
    there, names = two_for_one(judge.adding([viscous]), [UNEVEN, viscous], [])
    assert names == [DRY, OFFSET, viscous]
    x = there.evidence.fit(names[:2])
    assert x == pytest.approx([0.775, 0.725], abs=0.05)
    assert two_for_one(judge.adding([viscous]), [viscous], [UNEVEN])[1] == [viscous]
    assert two_for_one(judge, [UNEVEN], [], fixed=[UNEVEN])[1] == [UNEVEN]
    # The names are settled so.
    assert known_and_beside(judge, [UNEVEN], terms, [], [])[1] == [DRY, OFFSET]
    assert known_and_beside(judge, [UNEVEN], terms, [], [UNEVEN])[1] == [UNEVEN]
    # Control: friction that brakes both ways stands.
    judge, _ = _judged(_friction(1.5, 0.5), seed=seed)
    assert two_for_one(judge, [UNEVEN], [])[1] == [UNEVEN]


def _judged_one_way(*hidden: Effect, seed: int, start: Model | None = None) -> tuple[Judge, list[Term]]:
    """As :func:`_judged`, of logs in which the elbow turns one way, at changing speed, and the shoulder to and fro; of
    what ``start`` lacks."""

    def log(own: int, split: str) -> Trajectory:
        rng = np.random.default_rng(own)
        time = np.arange(4000) / 200.0
        way, phase = rng.uniform(0.5, 1.5, 2), rng.uniform(0, 2 * np.pi, 2)
        shoulder = 0.5 * np.sin(way[0] * time + phase[0])
        elbow = 0.06 * time - 0.6 + 0.03 / way[1] * np.sin(way[1] * time + phase[1])
        q = np.column_stack([shoulder, elbow])
        dq = np.gradient(q, time, axis=0)
        tau = predict(ROBOT, list(hidden), q, dq, np.gradient(dq, time, axis=0), time)
        channels = {"q": q, "dq": dq, "tau": tau + NOISE * rng.normal(size=tau.shape)}
        return Trajectory(f"{split}_{own}", split, time, channels)

    settings = LoopSettings()
    logs = read_motion(ROBOT, [log(seed, "train"), log(seed + 1, "train")], [log(seed + 50, "test")], settings)
    judge, terms, _ = gather(start or Model(ROBOT), logs, settings)
    return judge.adding([LINEAR, SINE, OFFSET, DRY, UNEVEN]), terms


@pytest.mark.parametrize("seed", range(3))
def test_a_constant_along_one_way_is_friction(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    dry = Effect("coulomb_friction", (ELBOW,), {"coulomb_torque": 1.0})
    judge, terms = _judged_one_way(dry, seed=seed)
    there, names = friction_for_offset(judge, [OFFSET], terms)
    assert [(t.effect, t.joint) for t in names] == [("coulomb_friction", 1)]
    assert there.evidence.fit(names) == pytest.approx([1.0], abs=0.05)
    # Friction that is named already, of whatever form, makes its own torque, and so does the starting model's.
    remembers = Term("hysteresis_friction", 1, (("presliding_displacement", 0.01),))
    for own in (DRY, UNEVEN, remembers):
        assert friction_for_offset(judge.adding([own]), [OFFSET, own], terms)[1] == [OFFSET, own]
    for start in (dry, Effect("hysteresis_friction", (ELBOW,), {"coulomb_torque": 1.0, "presliding_stiffness": 100.0})):
        lacks = Effect("torque_offset", (ELBOW,), {"offset": 1.0})
        asked, offered = _judged_one_way(start, lacks, seed=seed, start=Model(ROBOT, (start,)))
        assert friction_for_offset(asked, [OFFSET], offered)[1] == [OFFSET]
    # Controls: a constant that drives the joint, one that is seen both ways, one that the rests show.
    drives = Effect("torque_offset", (ELBOW,), {"offset": -1.0})
    assert friction_for_offset(_judged_one_way(drives, seed=seed)[0], [OFFSET], terms)[1] == [OFFSET]
    # Seen both ways it is none, however small, as long as it is surely there.
    for size in (1.0, 0.03):
        offset = Effect("torque_offset", (ELBOW,), {"offset": size})
        assert friction_for_offset(_judged(offset, seed=seed)[0], [OFFSET], terms)[1] == [OFFSET]
    monkeypatch.setattr(one_for_two_module, "_at_rest", lambda *_: True)
    assert friction_for_offset(judge, [OFFSET], terms)[1] == [OFFSET]


@pytest.mark.parametrize("seed", range(3))
def test_what_every_joint_has_stands_in_the_place_of_a_spring_that_does_no_better(seed: int) -> None:
    dry = Effect("coulomb_friction", (ELBOW,), {"coulomb_torque": 1.0})
    judge, terms = _judged_one_way(dry, seed=seed)
    ((name,),) = [plain_instead(judge, [LINEAR], terms)[1]]
    assert name.family().everywhere
    assert name.joint == 1
    # Controls: a spring that is there, seen both ways or one.
    spring = Effect("joint_spring", (ELBOW,), {"stiffness": 4.0, "rest_position": 0.1}, LINEAR.options)
    assert plain_instead(_judged(spring, seed=seed)[0], [LINEAR], terms)[1] == [LINEAR]
    assert plain_instead(_judged_one_way(spring, seed=seed)[0], [LINEAR], terms)[1] == [LINEAR]
    # Nor does a change of friction that the starting model has stand for it.
    asked, offered = _judged_one_way(
        dry, seed=seed, start=Model(ROBOT, (Effect("coulomb_friction", (ELBOW,), {"coulomb_torque": 0.5}),))
    )
    named = plain_instead(asked, [LINEAR], [t for t in offered if t.effect == "coulomb_friction"])[1]
    assert named == [LINEAR]
    # What is there already is not put there again.
    plain = [t for t in on_every_joint(terms) if t.joint == 1 and t != OFFSET]
    assert plain_instead(judge.adding(plain), [LINEAR, *plain], plain)[1] == [LINEAR, *plain]


@pytest.mark.parametrize("seed", range(3))
def test_friction_that_is_rougher_one_way_makes_its_offset_itself(seed: int) -> None:
    judge, _ = _judged(_friction(1.5, 0.5), seed=seed)
    assert one_for_two(judge, [UNEVEN, OFFSET])[1] == [UNEVEN]
    assert one_for_two(judge, [OFFSET, UNEVEN])[1] == [UNEVEN]
    # Control: of another joint it is another torque.
    shoulder = Term("torque_offset", 0)
    assert one_for_two(judge.adding([shoulder]), [UNEVEN, shoulder])[1] == [UNEVEN, shoulder]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("acts", [True, False])
def test_an_offset_that_acts_at_rest_is_one(acts: bool, seed: int) -> None:
    # The same torque in motion, whichever it is.
    dry = Effect("coulomb_friction", (ELBOW,), {"coulomb_torque": 1.0})
    hidden = [dry, Effect("torque_offset", (ELBOW,), {"offset": 0.5})] if acts else [_friction(1.5, 0.5)]
    settings = LoopSettings()
    train = [_resting(hidden, seed + k, "train") for k in (0, 1)]
    logs = read_motion(ROBOT, train, [_resting(hidden, seed + 50, "test")], settings)
    judge, _, _ = gather(Model(ROBOT), logs, settings)
    judge = judge.adding([OFFSET, DRY, UNEVEN])
    assert one_for_two(judge, [DRY, OFFSET])[1] == ([DRY, OFFSET] if acts else [UNEVEN])
    # Named as one all the same, the law says of a joint at rest what its rests say.
    (term,) = with_rest(judge, [UNEVEN])[1]
    assert (AT_REST in term.options) == acts


@pytest.mark.parametrize("seed", range(3))
def test_where_no_rest_tells_the_middle_of_what_may_hold_a_joint_is_said(seed: int) -> None:
    judge, _ = _judged(_friction(1.5, 0.5), seed=seed)
    there, (term,) = with_rest(judge, [UNEVEN])
    x = there.evidence.fit([term])
    assert x == pytest.approx(judge.evidence.fit([UNEVEN]), rel=1e-6)
    # The same torque in motion; at rest that of friction and an offset, half way from one to the other.
    parameters, settings = term.family().at_term(term, x, ROBOT)
    speeds = np.array([[0.0, 0.0, 0.0], [-0.5, 0.0, 0.5]])
    torque = term.family().law(np, State(speeds, speeds, joint=1), parameters, settings)
    assert torque == pytest.approx([-x[1], 0.5 * (x[0] - x[1]), x[0]])
    assert with_rest(judge, [DRY, OFFSET])[1] == [DRY, OFFSET]
    # What the starting model says of it stays.
    start = Model(ROBOT, (_friction(1.5, 0.5),))
    loop = LoopSettings()
    logs = read_motion(ROBOT, [noisy_log([_friction(1.5, 0.5)], k, "train", NOISE) for k in (1, 2)], [], loop)
    judge, _, _ = gather(start, logs, loop)
    assert with_rest(judge.adding([UNEVEN]), [UNEVEN])[1] == [UNEVEN]


def _alone(judge: Judge, term: Term) -> _Named:
    """``term`` as the only name."""
    judge = judge.adding([term]).at([term])
    return _Named(judge, [term], [], {}, judge.evidence.held([term]))


def test_only_plain_effects_of_one_joint_are_listed_for_what_they_make_together() -> None:
    judge, _ = _judged(_friction(1.5, 0.5))
    (entry,) = _several_for_one(_alone(judge, UNEVEN), UNEVEN)
    assert [(e["effect"], e["joints"]) for e in entry["effects"]] == [(t.effect, [ELBOW]) for t in (DRY, OFFSET)]
    # What has a parameter to refine, or acts on two joints, is asked elsewhere.
    moving = np.ones(2, bool)
    for name in ("nonlinear_viscous_friction", "joint_coupling"):
        term = family(name).terms(ROBOT, moving, judge.settings.options)[0]
        assert any(len(alike.effects) > 1 for alike in term.family().equivalent_to)
        assert _several_for_one(_alone(judge, term), term) == []


def test_what_the_starting_model_has_of_them_stays_and_its_place_in_the_list_too() -> None:
    judge, terms = _judged(_friction(1.5, 0.5))
    viscous = next(t for t in terms if t.effect == "viscous_friction" and t.joint == 0)
    assert one_for_two(judge.adding([viscous]), [OFFSET, viscous, DRY])[1] == [UNEVEN, viscous]
    start = Model(ROBOT, (Effect("coulomb_friction", (ELBOW,), {"coulomb_torque": 0.4}),))
    settings = LoopSettings()
    hidden = [_friction(1.5, 0.5)]
    logs = read_motion(ROBOT, [noisy_log(hidden, k, "train", NOISE) for k in (1, 2)], [], settings)
    judge, _, _ = gather(start, logs, settings)
    assert one_for_two(judge.adding([DRY, OFFSET]), [DRY, OFFSET])[1] == [DRY, OFFSET]


def _chain(joints: int) -> Robot:
    """An arm of ``joints`` joints about the axes y and x in turn, links of a kilogram."""
    axes = ("0 1 0", "1 0 0")
    links = "".join(
        f'<link name="l{k}"><inertial><origin xyz="0.02 0.01 0.15"/><mass value="1.0"/>'
        '<inertia ixx="0.01" iyy="0.01" izz="0.004" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        f'<joint name="j{k}" type="revolute"><parent link="{f"l{k - 1}" if k else "base"}"/><child link="l{k}"/>'
        f'<origin xyz="0 0 {0.3 if k else 0.0}"/><axis xyz="{axes[k % 2]}"/>'
        '<limit lower="-2.5" upper="2.5" velocity="3" effort="60"/></joint>'
        for k in range(joints)
    )
    return Robot.from_text(f'<robot name="chain"><link name="base"/>{links}</robot>', "chain")


def _of_chain(robot: Robot, hidden: Sequence[Effect]) -> tuple[Judge, Term]:
    settings = LoopSettings()
    train, test = excitations(robot, hidden, train=3, test=1, duration=6.0, rate=200.0)
    judge, terms, _ = gather(Model(robot), read_motion(robot, train, test, settings), settings)
    return judge, next(t for t in terms if t.family().all_links)


@pytest.mark.slow
def test_two_bodies_take_the_place_of_all_links_and_links_that_are_all_off_keep_it() -> None:
    robot = _chain(5)
    names = robot.joint_names
    two = [Effect("link_mass", (names[1],), {"mass": 1.6}), Effect("link_mass", (names[4],), {"mass": 1.4})]
    judge, links = _of_chain(robot, two)
    found = narrowed(judge.at([links]), [links])[1]
    assert links not in found
    assert len(found) == 2
    # What has been narrowed is not widened again.
    judge = judge.adding(found).at(found)
    assert widened(judge, found)[1] == found
    rng = np.random.default_rng(3)
    masses = rng.uniform(0.6, 1.6, 5)
    every = [Effect("link_mass", (n,), {"mass": float(m)}) for n, m in zip(names, masses, strict=True)]
    judge, links = _of_chain(robot, every)
    assert narrowed(judge.at([links]), [links])[1] == [links]


@pytest.mark.slow
def test_three_causes_take_the_place_of_all_links_where_no_two_do() -> None:
    robot = _chain(4)
    names = robot.joint_names
    three = [
        Effect("link_mass", (names[1],), {"mass": 1.8}),
        Effect("joint_spring", (names[2],), {"stiffness": 3.0, "rest_position": 0.1}, {"shape": "linear"}),
        Effect("joint_spring", (names[0],), {"stiffness": 5.0, "rest_position": -0.2}, {"shape": "linear"}),
    ]
    judge, links = _of_chain(robot, three)
    # What all ten numbers of a link have done at first, its mass does.
    found = simplify_bodies(*narrowed(judge.at([links]), [links]), [])[1]
    assert {(t.effect, t.joint) for t in found} == {(e.effect, e.joint_index(robot)) for e in three}
    # Two of them do not do as well, so they are not named in the place of what is more.
    judge = judge.adding(found).at(found)
    full = judge.evidence.held(found, physical=True)
    assert all(judge.news(full, judge.evidence.held([t for t in found if t != o])).surer_than(1.0) for o in found)


def test_harmonics_of_one_joint_are_no_cause_of_all_joints() -> None:
    robot = _chain(3)
    judge, _ = _of_chain(robot, [])
    waves = [Term("torque_ripple", 0, (("harmonic", h),)) for h in (7.0, 14.0, 21.0)]
    dry = [Term("coulomb_friction", j) for j in range(3)]
    judge = judge.adding([*waves, *dry])
    sure = Gain(1e4, 1.0, np.ones(3), 50)
    assert _common(judge, waves, dict.fromkeys(waves, sure), 50) == set()
    # Control: what surely sits on all three joints is one.
    assert _common(judge, dry, dict.fromkeys(dry, sure), 50) == {"coulomb_friction"}


def test_a_body_gives_way_to_the_gain_of_a_joint_that_carries_it() -> None:
    robot = _chain(3)
    body, gain = Term("link_inertia", 1), Term("torque_gain", 0)
    judge, _ = _of_chain(robot, [Effect("torque_gain", (robot.joint_names[0],), {"gain": 1.1})])
    assert cheaper(judge.adding([body]), [body])[1] == [gain]
    # Control: a body that is there loads its own joint, too.
    heavier = to_body(link_parameters(robot, 1) * 1.3)
    judge, _ = _of_chain(robot, [Effect("link_inertia", (robot.joint_names[1],), heavier)])
    assert cheaper(judge.adding([body]), [body])[1] == [body]
