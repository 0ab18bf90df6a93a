"""Rules of a few lines, each against what it is to be, where the tests of what is built on them hardly feel it."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.signal.windows import hann
from tests.small_arm import arm

from hybrid_dynamics.effects import Effect, Term, family, predict
from hybrid_dynamics.loop import LoopSettings, close_loop
from hybrid_dynamics.loop.blackbox import _trees
from hybrid_dynamics.loop.boxes import _jumps
from hybrid_dynamics.loop.contact import _spread
from hybrid_dynamics.loop.describe import _no_better, _unbelievable
from hybrid_dynamics.loop.described import _beside, _worse
from hybrid_dynamics.loop.floor import examine
from hybrid_dynamics.loop.further import further_beside
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.outliers import outlier_segments
from hybrid_dynamics.loop.paths import _finer
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.process import END_PERIODS, ProcessSettings, derivative, hann_kernel, least_rows, process
from hybrid_dynamics.loop.trace import Judge
from hybrid_dynamics.loop_report.words import other_notes, told_first
from hybrid_dynamics.simulation.excitation import excitations


def test_a_derivative_is_exact_for_what_bends_and_twists():
    t = np.arange(9) * 0.1
    # Fourth order is exact for t^4 inside, second order is not; near the ends it is of second order.
    np.testing.assert_allclose(derivative((t**4)[:, None], 0.1)[2:-2, 0], 4 * t[2:-2] ** 3, atol=1e-12)
    np.testing.assert_allclose(derivative((t[:4] ** 2)[:, None], 0.1)[1:-1, 0], 2 * t[1:3], atol=1e-12)
    assert derivative(t[:4, None] ** 4, 0.1).shape == (4, 1)


@pytest.mark.parametrize("step", [1, 2, 5])
def test_a_hann_window_is_even_of_unit_sum_and_halves_its_own_frequency(step):
    taps = hann_kernel(0.2, 0.001, step)
    assert len(taps) % 2 == 1
    np.testing.assert_allclose(taps, taps[::-1])
    assert taps.sum() == pytest.approx(1.0)
    assert taps.argmax() == len(taps) // 2
    at = (np.arange(len(taps)) - len(taps) // 2) * 0.001 * step
    assert abs(np.sum(taps * np.exp(-2j * np.pi * 5.0 * at))) == pytest.approx(0.5, abs=0.01)
    # Samples left out leave the window as wide.
    assert at[-1] == pytest.approx(0.1, abs=0.001 * step)


def test_a_hann_window_is_that_of_the_books():
    # Without its zeros, in SciPy's words: 201 taps of 1 ms.
    book = hann(203)[1:-1]
    np.testing.assert_allclose(hann_kernel(0.2, 0.001), book / book.sum(), atol=1e-12)


@pytest.mark.parametrize("rate", [100.0, 500.0, 1000.0])
def test_a_run_needs_more_than_the_filters_ends_by_a_third_of_a_second(rate):
    settings = ProcessSettings()
    # Both ends of the filter, some periods of its cutoff, then .3 s of rows, twenty at least.
    ends = least_rows(1 / rate, settings) - max(20, round(0.3 * rate))
    assert ends / rate == pytest.approx(2 * END_PERIODS / settings.cutoff_at(1 / rate), abs=2 / rate)


def test_states_between_two_lie_on_the_way_from_one_to_the_other():
    states = np.array([[0.0, 2.0], [1.0, 0.0], [3.0, -2.0]])
    finer = _finer(states)
    assert len(finer) > 3
    np.testing.assert_allclose(finer[0], states[0])
    np.testing.assert_allclose(finer[-1], states[-1])
    for row in finer:
        assert (row[1] == pytest.approx(2 - 2 * row[0])) or (row[1] == pytest.approx(1 - row[0]))
        assert 0.0 <= row[0] <= 3.0


def test_a_jump_is_what_comes_after_less_what_was_before():
    seen = np.concatenate([np.full(40, 1.0), np.full(40, 4.0)])
    jumps = _jumps(seen, np.ones(80, bool), near=3, reach=10)
    assert len(jumps) == 81
    assert jumps[40] == pytest.approx(3.0)
    assert jumps[20] == jumps[60] == pytest.approx(0.0)
    # Within a few rows nothing is known of either side.
    assert np.isnan(jumps[[0, 1, 80]]).all()


def test_the_average_of_rows_that_remember_each_other_is_as_uncertain_as_of_fewer():
    noise = np.random.default_rng(0).normal(size=4000)
    run = SimpleNamespace(time=np.arange(4000) * 0.01, cutoff=5.0)
    seen = [np.ones(4000, bool)]
    # A second holds five rows at 5 Hz, whatever the rate of the log.
    assert _spread([], [noise], seen, 100, run) == pytest.approx(noise.std() / np.sqrt(5.0), rel=0.01)
    # What other stretches leave counts where there are some, and is more.
    assert _spread([3.0] * 8, [noise], seen, 100, run) == pytest.approx(3.0)
    assert _spread([3.0] * 2, [noise], seen, 100, run) < 1.0


@pytest.mark.parametrize(("joints", "found"), [(4, 1), (3, 1), (2, 0)])
def test_a_moment_that_surprises_most_joints_is_left_out_without_a_jolt(joints, found):
    rng = np.random.default_rng(3)
    time = np.arange(2000) * 0.01
    residual, ddq = rng.normal(size=(2000, 5)), rng.normal(size=(2000, 5))
    residual[1000:1010, :joints] += 40.0
    segments = outlier_segments(0, time, ddq, residual, np.ones((2000, 5), bool), pad=0.05)
    assert len(segments) == found
    assert all(s.start <= 1000 and s.stop >= 1010 and s.joints == joints for s in segments)


def test_a_coupling_is_asked_of_neighbours_of_which_one_is_asked_about():
    robot, kind = arm(), family("joint_coupling")

    def rows(*moving: bool) -> set[tuple[int | None, str]]:
        return {(t.joint, t.options["rows"]) for t in kind.terms(robot, np.array(moving), {})}

    assert rows(True, True) == {(0, "both"), (0, "own"), (1, "own")}
    assert rows(True, False) == {(0, "both"), (0, "own")}
    assert rows(False, True) == {(0, "both"), (1, "own")}
    assert rows(False, False) == set()


def test_columns_of_a_lag_are_the_slope_of_the_torque_behind_it():
    time = np.arange(400) * 0.005
    torque = np.column_stack([np.sin(3 * time), np.cos(2 * time)])
    kind = family("time_delay")

    def slope(lag: float, **options: object) -> np.ndarray:
        motion = SimpleNamespace(torque=torque, time=time, given_lag=lag)
        term = Term("time_delay", None, tuple(options.items()))
        return kind.columns(motion, term)[100:-100, :, 0]

    plain = -np.gradient(torque, time, axis=0)[100:-100]
    np.testing.assert_allclose(slope(0.1), plain, atol=1e-3)
    behind = 1 / np.sqrt(1 + (3 * 0.1) ** 2)
    late = -3 * behind * np.cos(3 * time - np.arctan(0.3))[100:-100]
    np.testing.assert_allclose(slope(0.1, response="lag")[150:, 0], late[150:], atol=0.01)


@pytest.mark.parametrize(("memory", "colour"), [(0.0, 0.0), (0.92, 0.4)])
def test_a_floor_is_as_wide_as_its_rows_are_few_and_remember_each_other(memory, colour):
    (log,), _ = excitations(arm(), (), train=1, test=0, duration=10.0, rate=200.0)
    run = process(log, arm(), ProcessSettings())
    noise = lfilter([1.0], [1.0, -memory], np.random.default_rng(0).normal(size=run.tau.shape), axis=0)
    floor = examine([run], [noise], [run.mask], np.zeros(2), np.zeros(2), LoopSettings())
    rms = np.array([np.sqrt(np.mean(noise[m, j] ** 2)) for j, m in enumerate(run.mask.T)])
    np.testing.assert_allclose(floor.autocorrelation, colour, atol=0.06)
    # One standard deviation of an rms: of a quarter of the rows, fewer where they remember each other.
    rows = run.mask.sum(axis=0) / 4 * (1 - floor.autocorrelation) / (1 + floor.autocorrelation)
    np.testing.assert_allclose(floor.high / rms, 1 + 1 / np.sqrt(rows), rtol=0.015)
    np.testing.assert_array_less(floor.low, 1.05 * rms)
    np.testing.assert_array_less(rms, 2.0 * floor.low)
    # Colour alone, less than twice its second differences, is neither an alarm nor a doubt.
    assert not floor.motion_dependent.any()
    assert not floor.cannot_tell.any()


def test_what_takes_less_than_its_share_where_it_acts_only_nibbles():
    """Of a joint's own effect by its joint, of a robot's by all joints together, in floors."""

    def nibbles(gain: list[float], joint: int | None) -> bool:
        evidence = SimpleNamespace(
            weights=np.array([4.0, 1.0]), acts=lambda term: np.array([True, joint is None]), robot=None
        )
        judge = SimpleNamespace(
            mean_square=lambda held: np.array([3.0, 3.0]), low=np.zeros(2), floor=np.ones(2), evidence=evidence
        )
        after = SimpleNamespace()
        name = "time_delay" if joint is None else "torque_ripple"
        worth = SimpleNamespace(per_joint=np.array(gain))
        return bool(Judge.nibbles(judge, Term(name, joint), worth, after, 0.25))

    # What was left: 3 and what was gained. A quarter of 4 is 1.
    assert not nibbles([1.01, 0.0], 0)
    assert nibbles([0.9, 5.0], 0)
    # Together by weight: (4 g1 + g2) against a quarter of (4 (3 + g1) + 3 + g2).
    assert not nibbles([1.3, 0.0], None)
    assert nibbles([0.9, 0.0], None)
    assert nibbles([0.0, 3.0], None)


def test_trees_predict_a_fold_from_the_others():
    rng = np.random.default_rng(2)
    x = rng.uniform(-1, 1, (1200, 2))
    y = np.sin(3 * x[:, 0]) + 0.01 * rng.normal(size=1200)
    folds = np.repeat(np.arange(4), 300)
    hat = _trees(x, y, np.ones(1200, bool), folds, seed=0)
    assert np.sqrt(np.mean((hat - y) ** 2)) < 0.3 * y.std()
    # Rows of no fold are neither learnt from nor predicted.
    folds[:300] = -1
    wrong = np.where(folds < 0, -y, y)
    hat = _trees(x, wrong, np.ones(1200, bool), folds, seed=0)
    np.testing.assert_array_equal(hat[:300], 0.0)
    assert np.sqrt(np.mean((hat - y)[300:] ** 2)) < 0.3 * y.std()


def test_friction_of_a_urdf_that_makes_the_training_error_larger_is_told_and_other_is_not():
    true = Effect("viscous_friction", ("shoulder",), {"viscous_coefficient": 3.0})
    train, _ = excitations(arm(), [true], train=2, test=0, duration=6.0, rate=200.0)
    runs = [process(log, arm(), ProcessSettings()) for log in train]
    result = SimpleNamespace(model=Model(arm()), train=runs)
    assert _worse(result, [true]) == []
    placeholder = Effect("viscous_friction", ("shoulder",), {"viscous_coefficient": 30.0})
    (line,) = _worse(result, [placeholder])
    assert "shoulder" in line
    assert "placeholder" in line
    # Of a joint without any nothing is told, however bad.
    nothing = Effect("viscous_friction", ("elbow",), {"viscous_coefficient": 0.0})
    assert _worse(result, [nothing]) == []


def test_a_richer_law_comes_on_top_of_the_urdfs_plainer_one_of_its_own_joint():
    coulomb = [Effect("coulomb_friction", (j,), {"coulomb_torque": 1.5}) for j in ("shoulder", "elbow")]
    law = Effect(
        "stribeck_friction", ("elbow",), {"coulomb_torque": 1.0, "static_torque": 0.5, "stribeck_velocity": 0.05}
    )
    entry: Any = SimpleNamespace(effect=law)
    (line,) = _beside(entry, [entry], coulomb, ())
    assert line.startswith("stribeck_friction of elbow comes on top of the URDF's coulomb_friction of 1.5 N m")
    changed: Any = SimpleNamespace(effect=coulomb[1])
    assert _beside(entry, [entry, changed], coulomb, ()) == []
    assert _beside(entry, [entry], coulomb[:1], ()) == []


def test_a_links_mass_has_a_bound_where_the_link_is_known():
    robot, kind = arm(), family("link_mass")
    term = Term("link_mass", 1)
    mass = float(robot.model.inertias[2].mass)
    (bound,) = kind.lower_bounds(robot, term)
    assert -mass < bound < -0.5 * mass
    for known in ((None, None), (robot, None), (None, term)):
        assert kind.lower_bounds(*known) == 0.0


def test_what_a_name_may_stand_for_is_asked_of_its_joint_and_of_all_together():
    train, test = excitations(arm(), (), train=2, test=1, duration=6.0, rate=200.0)
    judge, _, _ = gather(Model(arm()), read_motion(arm(), train, test, LoopSettings()), LoopSettings())
    _, asked = further_beside(judge, [Term("viscous_friction", 1)])
    assert {t.joint for t in asked} == {None, 1}
    assert "time_delay" in {t.effect for t in asked if t.joint is None}
    assert "torque_gain" in {t.effect for t in asked if t.joint == 1}
    assert further_beside(judge, []) == (judge, [])


@pytest.mark.parametrize(("which", "turning"), [("partner", -0.8), ("sum", -0.3), ("difference", 1.3)])
def test_a_coupling_brakes_by_the_partners_speed_and_by_the_sign_that_turns_over(which, turning):
    robot, ddq = arm(), np.array([[0.7, -0.4]])
    q, dq = np.array([[0.3, -0.2]]), np.array([[-0.8, 0.5]])
    bare = robot.inverse_dynamics(q, dq, ddq)

    def of(**numbers: float) -> float:
        settings = {"from_joint": "shoulder", "rows": "own", "sign_of": which}
        parameters = dict.fromkeys(("viscous_coefficient", "coulomb_torque", "armature"), 0.0) | numbers
        coupled = Effect("joint_coupling", ("elbow",), parameters, settings)
        added = predict(robot, [coupled], q, dq, ddq, np.zeros(1)) - bare
        assert added[0, 0] == pytest.approx(0.0, abs=1e-9)
        return float(added[0, 1])

    assert of(viscous_coefficient=2.0) == pytest.approx(-1.6)
    assert of(coulomb_torque=3.0) == pytest.approx(3.0 * np.sign(turning))
    assert of(armature=0.5) == pytest.approx(0.35)


@pytest.mark.parametrize(("which", "sign"), [("sum", 1.0), ("difference", -1.0)])
def test_a_motor_that_sees_two_joints_brakes_both(which, sign):
    """f (dq_j + dq_k) or f (dq_j - dq_k) in the row of j: the partner's part is f or -f, and f is no less than zero."""
    robot = arm()
    settings = {"from_joint": "elbow", "rows": "both", "sign_of": which}
    parameters = {"viscous_coefficient": 0.4 * sign, "coulomb_torque": 0.2, "armature": 0.1 * sign}
    term = Effect("joint_coupling", ("shoulder",), parameters, settings).term(robot)
    kind = term.family()
    x = kind.coordinates_of(parameters, robot, term)
    assert x == pytest.approx([0.4, 0.2, 0.1])
    assert kind.parameters_of(x, robot, term) == pytest.approx(parameters)
    assert list(kind.lower_bounds(robot, term)) == [0.0, 0.0, 0.0]
    assert ("<= 0" in kind.admissible(term)) == (which == "difference")
    # Control: what one joint does to another, without a motor that sees both, may have any sign.
    own = Effect("joint_coupling", ("shoulder",), parameters, {**settings, "rows": "own", "sign_of": "partner"})
    assert np.all(np.isneginf(kind.lower_bounds(robot, own.term(robot))))
    assert kind.coordinates_of(parameters, robot, own.term(robot)) == pytest.approx(list(parameters.values()))


@pytest.mark.parametrize(("gain", "told"), [(0.5, True), (0.7, False), (1.5, False), (6.9, True)])
def test_a_gain_that_no_drive_has_is_told_with_what_it_may_be(gain, told):
    effect = Effect("torque_gain", ("elbow",), {"gain": gain})
    lines = _unbelievable(arm(), effect.term(arm()), effect, {})
    assert [f"torque_gain of elbow: gain is {gain:.3g}" in line and "another unit" in line for line in lines] == (
        [True] * told
    )
    dry = Effect("coulomb_friction", ("elbow",), {"coulomb_torque": 6.9})
    assert _unbelievable(arm(), dry.term(arm()), dry, {}) == []
    # On top of a gain that the starting model has, what it comes to in all.
    assert bool(_unbelievable(arm(), effect.term(arm()), effect, {"gain": {"start": 2.0, "now": 2.0 * gain}})) is (
        2.0 * gain > 2.0
    )


def test_a_joint_that_a_constant_predicts_as_well_is_told_before_the_numbers():
    useless, held_out = np.array([False, True]), np.array([0.2, 1.3])
    (line,) = _no_better(arm(), useless, held_out)
    assert "elbow (rmse 1.3 of its spread)" in line
    assert "shoulder" not in line
    assert told_first({"notes": ["something else", line]}) == [line]
    assert other_notes({"notes": ["something else", line]}) == ["something else"]
    assert _no_better(arm(), np.array([False, False]), held_out) == []


@pytest.mark.parametrize("wrong", [True, False])
def test_a_torque_that_is_not_of_the_motion_is_told_as_that(wrong):
    train, test = excitations(
        arm(),
        [Effect("viscous_friction", ("shoulder",), {"viscous_coefficient": 3.0})],
        train=2,
        test=1,
        duration=8.0,
        rate=200.0,
    )
    # The elbow's torque of another time: smooth, of the right size, and of no use.
    late = [
        r.with_signals(tau=np.column_stack([r["tau"][:, 0], np.roll(r["tau"][:, 1], 500)])) for r in [*train, *test]
    ]
    runs = late if wrong else [*train, *test]
    notes = close_loop(arm(), runs[:2], runs[2:], LoopSettings(effects=("viscous_friction",))).diagnosis.notes
    told = [n for n in notes if n.startswith("a constant would predict")]
    assert ["elbow" in n and "shoulder" not in n for n in told] == [True] * wrong
