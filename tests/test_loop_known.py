"""A name of whose numbers nothing is known is none: it stands beside the names, or its plain form in its place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.small_arm import arm, noisy_log

from hybrid_dynamics.effects import Effect, Term, predict
from hybrid_dynamics.loop import LoopSettings, Model
from hybrid_dynamics.loop import confirm as confirm_module
from hybrid_dynamics.loop import known as known_module
from hybrid_dynamics.loop.describe import _confirmed
from hybrid_dynamics.loop.known import known_and_beside, notes_on, published_in_errors, taken_back
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.trace import Judge
from hybrid_dynamics.trajectory import Trajectory

ROBOT = arm()
SHOULDER, ELBOW = ROBOT.joint_names
NOISE = 0.05
DRY, OFFSET, VISCOUS = (Term(name, 1) for name in ("coulomb_friction", "torque_offset", "viscous_friction"))


def falls(velocity: float) -> Term:
    return Term("stribeck_friction", 1, (("stribeck_velocity", velocity),))


def one_way(effects: Sequence[Effect], seed: int) -> Trajectory:
    """As :func:`noisy_log`, but the elbow turns one way all the time, at a speed that hardly varies."""
    log = noisy_log([], seed, "train", 0.0)
    rng, time = np.random.default_rng(seed), log.time
    q = np.column_stack([log["q"][:, 0], -1.0 + 0.1 * time + 0.01 * np.sin(0.9 * time + seed)])
    dq = np.gradient(q, time, axis=0)
    tau = predict(ROBOT, list(effects), q, dq, np.gradient(dq, time, axis=0), time)
    return Trajectory(log.name, "train", time, {"q": q, "dq": dq, "tau": tau + NOISE * rng.normal(size=tau.shape)})


def judged(train: list[Trajectory], *terms: Term) -> tuple[Judge, list[Term]]:
    settings = LoopSettings()
    judge, candidates, _ = gather(Model(ROBOT), read_motion(ROBOT, train, [], settings), settings)
    return judge.adding(terms), candidates


def dry(size: float) -> Effect:
    return Effect("coulomb_friction", (ELBOW,), {"coulomb_torque": size})


@pytest.mark.parametrize("seed", range(3))
def test_of_what_one_way_of_motion_cannot_tell_apart_not_both_are_names(seed: int) -> None:
    judge, candidates = judged([one_way([dry(1.0)], seed + k) for k in (1, 2)], DRY, OFFSET, VISCOUS)
    chosen = [DRY, OFFSET, VISCOUS]
    judge, names, beside = known_and_beside(judge, chosen, candidates, [], [])
    assert len(names) < len(chosen)
    assert not {(t.effect, t.joint) for t in beside} & {(n.effect, n.joint) for n in names}
    # The torque stays in the model, whatever it is called.
    left = np.sqrt(judge.mean_square(judge.evidence.held([*names, *beside], physical=True)))
    assert left[1] < 3 * NOISE
    # Control: of a joint that moves both ways each is known.
    both = [
        noisy_log([dry(1.0), Effect("torque_offset", (ELBOW,), {"offset": 0.5})], k, "train", NOISE) for k in (1, 2)
    ]
    judge, candidates = judged(both, DRY, OFFSET)
    assert known_and_beside(judge, [DRY, OFFSET], candidates, [], [])[1:] == ([DRY, OFFSET], [])


@pytest.mark.parametrize("seed", range(3))
def test_a_fall_with_speed_of_which_nothing_is_known_is_plain_dry_friction(seed: int) -> None:
    law = falls(0.05)
    judge, candidates = judged([noisy_log([dry(1.0)], seed + k, "train", NOISE) for k in (1, 2)], law)
    (name,) = known_and_beside(judge.at([law]), [law], candidates, [], [])[1]
    assert (name.effect, name.joint) == ("coulomb_friction", 1)
    # It may be kept by name: what the search was given.
    assert law in known_and_beside(judge.at([law]), [law], candidates, [], [law])[1]
    # Control: a fall that is there is known, and keeps its name.
    values = {"coulomb_torque": 0.5, "static_torque": 2.0, "stribeck_velocity": 0.2}
    hidden = Effect("stribeck_friction", (ELBOW,), values)
    law = falls(0.2)
    judge, candidates = judged([noisy_log([hidden], seed + k, "train", NOISE) for k in (1, 2)], law)
    (name,) = known_and_beside(judge.at([law]), [law], candidates, [], [])[1]
    assert name.effect == "stribeck_friction"


@pytest.mark.parametrize("seed", range(2))
def test_friction_one_way_of_which_the_other_way_is_not_known_is_plain(seed: int) -> None:
    """What holds both ways to each other makes the one that no row shows as large as the other: no finding."""
    law = Term("asymmetric_coulomb_friction", 1)
    judge, candidates = judged([one_way([dry(1.0)], seed + k) for k in (1, 2)], law)
    names = known_and_beside(judge.at([law]), [law], candidates, [], [])[1]
    assert [(n.effect, n.joint) for n in names] == [("coulomb_friction", 1)]
    # Control: where both ways are seen and differ it keeps its name.
    values = {"coulomb_torque_positive": 1.0, "coulomb_torque_negative": 0.5}
    rougher = [Effect("asymmetric_coulomb_friction", (ELBOW,), values)]
    judge, candidates = judged([noisy_log(rougher, seed + k, "train", NOISE) for k in (1, 2)], law)
    (name,) = known_and_beside(judge.at([law]), [law], candidates, [], [])[1]
    assert name.effect == law.effect


def test_the_surest_parameter_counts() -> None:
    effect = Effect(
        "stribeck_friction",
        (ELBOW,),
        {"coulomb_torque": 1.0, "static_torque": 2.0, "stribeck_velocity": 0.1},
        std_errors={"coulomb_torque": 2.0, "static_torque": 0.5, "stribeck_velocity": 0.4},
    )
    term = effect.term(ROBOT)
    assert published_in_errors(term, effect, ROBOT) == pytest.approx(4.0)
    assert published_in_errors(term, effect, ROBOT, ["stribeck_velocity"]) == pytest.approx(0.25)
    # Without an error nothing says that it is unknown.
    assert published_in_errors(OFFSET, Effect("torque_offset", (ELBOW,), {"offset": 0.0}), ROBOT) == float("inf")


def test_an_only_number_within_two_errors_of_nothing_is_not_known_and_one_of_several_within_one() -> None:
    mass = float(ROBOT.model.inertias[2].mass)
    heavier = Term("link_mass", 1)

    def of(errors: float, name: str = "coulomb_torque") -> dict[Term, Effect]:
        return {DRY: Effect("coulomb_friction", (ELBOW,), {name: errors}, std_errors={name: 1.0})}

    def weighs(errors: float) -> dict[Term, Effect]:
        more = {"mass": mass + 0.01 * errors}
        return {heavier: Effect("link_mass", (ELBOW,), more, std_errors={"mass": 0.01})}

    # Every real joint has dry friction: it takes less to be known.
    assert known_module.unknown(of(0.9), ROBOT) == DRY
    assert known_module.unknown(of(1.1), ROBOT) is None
    assert known_module.unknown(weighs(-1.9), ROBOT) == heavier
    assert known_module.unknown(weighs(-2.1), ROBOT) is None
    assert known_module.unknown({**of(0.8), **weighs(1.0)}, ROBOT) == heavier
    # An offset not every sensor has.
    for errors, known in ((1.9, False), (2.1, True)):
        own = Effect("torque_offset", (ELBOW,), {"offset": -errors}, std_errors={"offset": 1.0})
        assert (known_module.unknown({OFFSET: own}, ROBOT) is None) is known
    # Of friction of two numbers, one that is 1.5 errors off is known; of what follows another joint it is not, nor
    # of a turned base. Of a body's many only sums may be.
    law = Term("asymmetric_coulomb_friction", 1)
    for sizes, known in (((1.5, 0.2), True), ((0.9, 0.2), False)):
        two = dict(zip(("coulomb_torque_positive", "coulomb_torque_negative"), sizes, strict=True))
        own = Effect("asymmetric_coulomb_friction", (ELBOW,), two, std_errors=dict.fromkeys(two, 1.0))
        assert (known_module.unknown({law: own}, ROBOT) is None) is known
    of_coupling = ("viscous_coefficient", "coulomb_torque", "armature")
    of_tilt = ("roll", "pitch")
    coupled = Term("joint_coupling", 1, (("from_joint", SHOULDER), ("rows", "own"), ("sign_of", "partner")))
    for term, keys in ((coupled, of_coupling), (Term("gravity_tilt"), of_tilt)):
        for sure, known in ((1.9, False), (2.1, True)):
            values = dict(zip(keys, (sure, 1.0, 0.5)[: len(keys)], strict=True))
            where = () if term.joint is None else (ELBOW,)
            own = Effect(term.effect, where, values, term.options, std_errors=dict.fromkeys(values, 1.0))
            assert (known_module.unknown({term: own}, ROBOT) is None) is known
    tool = Term("payload")
    numbers = tool.family().parameters_of(np.full(tool.size, 1e-3), ROBOT, tool)
    body = Effect("payload", (), numbers, std_errors=dict.fromkeys(numbers, 1.0))
    assert known_module.unknown({tool: body}, ROBOT) is None


@pytest.mark.parametrize(
    ("name", "amount", "where", "settings"),
    [
        ("joint_spring", "stiffness", {"rest_position": 3.0}, {"shape": "linear"}),
        ("torque_ripple", "amplitude", {"harmonic": 12.0, "phase": 1.0}, {}),
        ("hysteresis_friction", "coulomb_torque", {"presliding_stiffness": 40.0}, {}),
    ],
)
def test_where_an_effect_acts_says_not_that_it_is_there(name: str, amount: str, where: dict, settings: dict) -> None:
    # The place is known to a hundredth; of how much there is only that it is so many errors from nothing.
    for errors, known in ((1.9, False), (2.1, True)):
        values = {amount: 0.1 * errors, **where}
        error = {amount: 0.1, **{key: 0.01 * value for key, value in where.items()}}
        effect = Effect(name, (ELBOW,), values, settings, std_errors=error)
        term = effect.term(ROBOT)
        assert (known_module.unknown({term: effect}, ROBOT) is None) is known


def test_what_is_published_in_all_is_known_by_what_it_differs_by() -> None:
    """A gain of one is none; a base that is level after all has turned back from where the starting model has it."""
    gain = Effect("torque_gain", (ELBOW,), {"gain": 1.001}, std_errors={"gain": 0.01})
    assert published_in_errors(gain.term(ROBOT), gain, ROBOT) == pytest.approx(0.1)
    leaning = ROBOT.copy()
    leaning.model.gravity.linear = 9.81 * np.array([np.sin(0.2), 0.0, -np.cos(0.2)])
    level = Effect("gravity_tilt", (), {"roll": 0.0, "pitch": 0.001}, std_errors={"roll": 0.01, "pitch": 0.01})
    term = level.term(ROBOT)
    assert published_in_errors(term, level, leaning) == pytest.approx(19.9)
    assert published_in_errors(term, level, ROBOT) == pytest.approx(0.1)
    # A spring that is none rests nowhere.
    spring = Effect("joint_spring", (ELBOW,), {"stiffness": 1.0, "rest_position": 0.3}, {"shape": "linear"})
    spring = replace(spring, std_errors={"stiffness": 2.0, "rest_position": 0.1})
    assert published_in_errors(spring.term(ROBOT), spring, ROBOT) == pytest.approx(3.0)


@pytest.mark.parametrize("seed", range(2))
def test_a_base_that_is_level_after_all_stays_a_name(seed: int) -> None:
    start = Model(ROBOT, (Effect("gravity_tilt", (), {"roll": 0.0, "pitch": 0.08}),))
    settings = LoopSettings()
    train = [noisy_log([], seed + k, "train", NOISE) for k in (1, 2)]
    logs = read_motion(start.completed_robot, train, [], settings)
    judge, candidates, _ = gather(start, logs, settings)
    tilt = Term("gravity_tilt", None)
    assert known_and_beside(judge.adding([tilt]).at([tilt]), [tilt], candidates, [], [])[1] == [tilt]


@pytest.mark.parametrize("seed", range(2))
def test_a_law_that_held_out_rows_surely_miss_stays_however_little_is_known_of_its_numbers(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    values = {"coulomb_torque": 0.5, "static_torque": 2.0, "stribeck_velocity": 0.2}
    hidden = Effect("stribeck_friction", (ELBOW,), values)
    law = falls(0.2)
    judge, candidates = judged([noisy_log([hidden], seed + k, "train", NOISE) for k in (1, 2)], law)
    judge = judge.at([law])
    published = known_module._published

    def doubtful(judge: Judge, names: Sequence[Term], beside: Sequence[Term]) -> tuple[Judge, list[Effect]]:
        """As if the velocity were known to less than its size."""
        judge, effects = published(judge, names, beside)
        errors = [{**e.std_errors, "stribeck_velocity": 1.0} for e in effects]
        return judge, [replace(e, std_errors=own) for e, own in zip(effects, errors, strict=True)]

    monkeypatch.setattr(known_module, "_published", doubtful)
    assert [t.effect for t in known_and_beside(judge, [law], candidates, [], [])[1]] == ["stribeck_friction"]
    # Control: of plain dry friction nothing is missed.
    judge, candidates = judged([noisy_log([dry(1.0)], seed + k, "train", NOISE) for k in (1, 2)], law)
    assert [t.effect for t in known_and_beside(judge.at([law]), [law], candidates, [], [])[1]] == ["coulomb_friction"]


@pytest.mark.parametrize("seed", [1, 5])
def test_friction_that_turns_over_along_a_way_nobody_knows_is_dry_friction(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is the same torque, and the distance a way of turning over; known it is presliding friction."""
    law = Term("hysteresis_friction", 1, (("presliding_displacement", 0.05),))
    hidden = Effect("hysteresis_friction", (ELBOW,), {"presliding_stiffness": 20.0, "coulomb_torque": 1.0})
    judge, candidates = judged([noisy_log([hidden], seed + k, "train", NOISE) for k in (1, 2)], law)
    judge = judge.at([law])
    assert known_and_beside(judge, [law], candidates, [], [])[1] == [law]
    published = known_module._published

    def doubtful(judge: Judge, names: Sequence[Term], beside: Sequence[Term]) -> tuple[Judge, list[Effect]]:
        """As if the stiffness were known to less than its size."""
        judge, effects = published(judge, names, beside)
        return judge, [
            replace(e, std_errors={**e.std_errors, "presliding_stiffness": 300.0}) if e.effect == law.effect else e
            for e in effects
        ]

    monkeypatch.setattr(known_module, "_published", doubtful)
    (name,) = known_and_beside(judge, [law], candidates, [], [])[1]
    assert (name.effect, name.options) == ("coulomb_friction", {"sign_displacement": 0.05})


def test_what_is_no_name_any_more_is_asked_for_beside_the_names(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[list[Term]] = []
    sizes: dict[tuple[Any, ...], float] = {}

    def beside(
        judge: Judge, names: Any, candidates: Any, unsure: Sequence[Term], found: Any
    ) -> tuple[Judge, list[Term]]:
        asked.append(list(unsure))
        sizes.update(found)
        return judge, []

    monkeypatch.setattr(known_module, "all_beside", beside)
    judge, candidates = judged([one_way([dry(1.0)], k) for k in (1, 2)], DRY, OFFSET, VISCOUS)
    names = known_and_beside(judge, [DRY, OFFSET, VISCOUS], candidates, [], [])[1]
    lost = {DRY, OFFSET, VISCOUS} - set(names)
    assert lost
    assert set(asked[-1]) == lost
    # With the size at which each had been found.
    assert set(sizes) == {t.place for t in lost}
    assert all(0 < size < 2.0 for size in sizes.values())


def _sized(name: str, parameter: str, value: float, error: float) -> Effect:
    return Effect(name, (ELBOW,), {parameter: value}, std_errors={parameter: error})


def test_what_was_known_beside_a_contradicted_name_alone_goes_with_it() -> None:
    sure, less, least = (
        _sized("coulomb_friction", "coulomb_torque", 1.0, 0.1),
        _sized("torque_offset", "offset", 0.3, 0.4),
        _sized("viscous_friction", "viscous_coefficient", 0.0, 0.2),
    )
    kept = [DRY, OFFSET, VISCOUS]
    judge = SimpleNamespace(evidence=SimpleNamespace(robot=ROBOT))
    found: Any = SimpleNamespace(start=Model(ROBOT, (sure,)), inconsistent=[], judge=judge)

    def lost(*effects: Effect) -> Term | None:
        return confirm_module._unknown(found, kept[: len(effects)], Model(ROBOT, (sure, *effects)), spared)

    spared: list[Term] = []
    assert lost(sure, less, least) == VISCOUS
    spared = [VISCOUS]
    assert lost(sure, less, least) == OFFSET
    spared = []
    assert lost(sure, less) == OFFSET
    assert lost(sure) is None
    # Where runs disagree every run has its own numbers, and none is that of the model.
    found.inconsistent = [DRY]
    assert lost(sure, less, least) is None


def test_a_joint_that_ends_worse_loses_what_makes_it_so_and_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(confirm_module, "ends_worse", lambda *_: np.array([True, True]))
    own, other = Term("coulomb_friction", 0), VISCOUS

    def asked(relative: float, first: float, second: float) -> Any:
        return confirm_module.TestChange(relative, 0.01, False, np.array([first, second]))

    def gone(change: Any, of: Term) -> bool:
        nothing: Any = None
        return confirm_module._worse_joints(nothing, nothing, nothing, [of], {of: change}, []) == [of]

    assert gone(asked(-0.5, 0.9, -0.9), own), "its own joint, whatever the others gain"
    assert not gone(asked(-0.5, -0.9, 0.9), own), "it helps its joint, and the whole"
    assert not gone(asked(0.5, -0.9, 0.9), own), "it helps its joint"
    assert gone(asked(-0.5, -0.9, 0.9), other)
    links = Term("inertial_parameters")
    assert gone(asked(0.5, 0.9, -0.1), links)
    assert not gone(asked(-0.5, 0.9, -0.9), links), "it helps the whole"


def test_the_page_says_why_it_went() -> None:
    change = confirm_module.TestChange(-0.1, 0.05, False, np.zeros(2))
    said = confirm_module.Confirmation({DRY: change, OFFSET: change}, (DRY, OFFSET), Model(ROBOT), (OFFSET,))
    entry: dict[str, Any] = {"indistinguishable_from": []}
    gone, contradicted = (_confirmed(ROBOT, term, said, [], entry, 2) for term in (OFFSET, DRY))
    assert gone["confirmed"] is contradicted["confirmed"] is False
    assert gone["why_not"] == "known only beside names that the test runs contradict"
    assert contradicted["why_not"].startswith("the test runs are predicted better without it")


def test_what_went_since_nothing_is_known_of_it_is_told() -> None:
    """A gain, and a delay of all joints; friction that stays in its plain form, and what every joint has, are not."""
    gain, delay, law = Term("torque_gain", 0), Term("time_delay"), Term("asymmetric_coulomb_friction", 1)
    gone = taken_back([gain, delay, law, OFFSET], [Term("coulomb_friction", 1)])
    assert gone == [gain, delay]
    of_one, of_all = notes_on(gone, ROBOT.joint_names)
    assert of_one.startswith(f"torque_gain of {ROBOT.joint_names[0]}: ")
    assert of_all.startswith("time_delay: ")
    assert all(line.count("no finding") == 1 for line in (of_one, of_all))
    assert taken_back([gain], [gain]) == []
