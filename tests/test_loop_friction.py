"""Friction curves: not proportional to speed, and a sign that turns over a speed or over a presliding displacement."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from hybrid_dynamics.effects import Effect, State, Term, family
from hybrid_dynamics.effects.sign import presliding_sign
from hybrid_dynamics.loop import Model, close_loop
from hybrid_dynamics.loop.physics import BEYOND, FAR, physical_constraints, speeds_to_oppose
from hybrid_dynamics.loop.solve import Constraints, solve
from hybrid_dynamics.robots import Robot, find_description
from hybrid_dynamics.simulation.excitation import excitation, excitations
from hybrid_dynamics.trajectory import Trajectory

JOINT = ("panda_joint2",)


@pytest.fixture(scope="module")
def panda() -> Robot:
    return Robot.from_urdf(find_description("panda.urdf"), lock=("panda_finger_joint1", "panda_finger_joint2"))


def thinning() -> list[Effect]:
    """Coulomb friction and a viscous friction that grows less than speed does."""
    return [
        Effect("coulomb_friction", JOINT, {"coulomb_torque": 2.0}),
        Effect("viscous_friction", JOINT, {"viscous_coefficient": 9.0}),
        Effect("nonlinear_viscous_friction", JOINT, {"quadratic_coefficient": -4.0, "cubic_coefficient": 0.6}),
    ]


def test_a_viscous_friction_that_grows_less_than_speed_is_named_with_its_curve(panda):
    train, test = excitations(panda, thinning(), train=3, test=1, duration=8.0)
    result = close_loop(panda, train, test)
    found = {e["effect"]: e for e in result.diagnosis.to_json()["effects"]}
    assert sorted(found) == ["coulomb_friction", "nonlinear_viscous_friction", "viscous_friction"]
    assert all(e["joints"] == list(JOINT) for e in found.values())
    assert result.diagnosis.to_json()["verdict"] == "explained"
    # Quadratic and cubic coefficients are alike; the curve they make together is what the data determines.
    fastest = max(np.abs(run.dq[:, 1]).max() for run in result.train)
    dq = np.zeros((50, 7))
    dq[:, 1] = np.linspace(0.1, fastest, 50)
    still = np.zeros_like(dq)
    curve = [m.predict(still, dq, still)[:, 1] for m in (result.model, Model(panda, tuple(thinning())))]
    np.testing.assert_allclose(curve[0] - curve[1], 0, atol=0.02 * np.abs(curve[1]).max())


def rests(robot: Robot, effects: list[Effect], seed: int) -> Trajectory:
    """A run that comes to rest for a second every two seconds, always short of a reversal or just after one."""
    run = excitation(robot, [], name=f"run_{seed}", seed=seed, duration=12.0, torque_noise_share=0.0, encoder_bits=0)
    # Time stands still in every third second: the path is the same, its speed falls to zero and rises again.
    phase = np.mod(run.time, 3.0)
    pace = np.where(phase < 2.0, np.sin(np.pi * phase / 2.0) ** 2 * 1.5, 0.0)
    s = np.concatenate([[0.0], np.cumsum(0.5 * (pace[1:] + pace[:-1]) * run.dt)])
    q = np.column_stack([np.interp(s, run.time, column) for column in run["q"].T])
    dq = np.gradient(q, run.dt, axis=0)
    tau = Model(robot, tuple(effects)).predict(q, dq, np.gradient(dq, run.dt, axis=0), run.time)
    noise = np.random.default_rng(seed).normal(size=tau.shape) * 0.003 * robot.effort_limits
    return Trajectory(f"run_{seed}", "train", run.time, {"q": q, "tau": tau + noise})


@pytest.mark.parametrize("planted", [{"sign_displacement": 3e-4}, {"sign_width": 0.03}])
def test_standing_rows_tell_a_sign_over_a_displacement_from_one_over_a_speed(planted, panda):
    effects = [Effect("coulomb_friction", JOINT, {"coulomb_torque": 4.0}, planted)]
    runs = [rests(panda, effects, seed) for seed in range(3)]
    diagnosis = close_loop(panda, runs[:2], runs[2:]).diagnosis.to_json()
    assert [(e["effect"], tuple(e["joints"])) for e in diagnosis["effects"]] == [("coulomb_friction", JOINT)]
    assert set(diagnosis["effects"][0]["settings"]) == set(planted)
    # Right at rest as well: what is left over all rows is no more than the noise.
    assert diagnosis["error"]["test"]["after"]["rmse"][1] < 1.15 * diagnosis["noise_floor"][1]
    assert diagnosis["effects"][0]["parameters"][0]["value"] == pytest.approx(4.0, rel=0.01)


paths = st.lists(st.floats(-1e-2, 1e-2), min_size=2, max_size=30)


@settings(max_examples=60, deadline=None)
@given(paths, st.floats(1e-4, 1e-2))
def test_a_presliding_sign_is_bounded_takes_energy_and_solves_its_equation(corners, displacement):
    q = np.interp(np.linspace(0, len(corners) - 1, 400 * len(corners)), np.arange(len(corners)), corners)
    z = presliding_sign(q, displacement)
    assert np.all(np.abs(z) <= 1)
    step = np.diff(q)
    # dz = (1 - z sign) |dq| / displacement, exactly between two rows: the tanh-free form of Dahl's equation.
    expected = np.sign(step) + (z[:-1] - np.sign(step)) * np.exp(-np.abs(step) / displacement)
    np.testing.assert_allclose(z[1:], np.where(step == 0, z[:-1], expected), atol=1e-12)
    # Starting with nothing stored it can only take energy (trapezoids are right to second order in the step).
    work = np.cumsum(0.5 * (z[1:] + z[:-1]) * step)
    assert np.all(work > -1e-3 * displacement - np.cumsum(np.abs(step) ** 3) / displacement**2)


@settings(max_examples=60, deadline=None)
@given(paths, st.floats(1e-3, 1e-1), st.integers(0, 2**16))
def test_a_level_that_changes_on_the_way_is_followed_row_by_row(corners, displacement, seed):
    """The maps of all rows, composed by pairs, against walking through them; its bound is the highest level so far."""
    q = np.interp(np.linspace(0, len(corners) - 1, 40 * len(corners)), np.arange(len(corners)), corners)
    level = np.random.default_rng(seed).uniform(1.0, 3.0, len(q))
    z = presliding_sign(q, displacement, level)
    step, middle, expected = np.diff(q), 0.5 * (level[1:] + level[:-1]), [0.0]
    for dq, g in zip(step, middle, strict=True):
        goal = g * np.sign(dq)
        expected.append(goal + (expected[-1] - goal) * np.exp(-abs(dq) / (displacement * g)))
    np.testing.assert_allclose(z, expected, atol=1e-12)
    assert np.all(np.abs(z[1:]) <= np.maximum.accumulate(middle))
    # One level all along is Dahl's law times that level.
    np.testing.assert_allclose(
        presliding_sign(q, displacement, np.full(len(q), 2.0)), 2.0 * presliding_sign(q, 2.0 * displacement), atol=1e-12
    )


@given(st.floats(-1.0, 1.0), st.floats(1e-3, 1e-1), st.floats(-1.0, 1.0))
def test_where_a_run_begins_its_memory_goes_on_and_is_forgotten(begun, displacement, end):
    q = np.linspace(0.0, end, 200)
    way = float(np.sign(end))
    expected = way + (begun - way) * np.exp(-np.abs(q) / displacement) if way else np.full(200, begun)
    np.testing.assert_allclose(presliding_sign(q, displacement, start=begun), expected, atol=1e-9)
    np.testing.assert_allclose(presliding_sign(q, displacement, np.ones(200), begun), expected, atol=1e-9)


@pytest.mark.parametrize("settings", [{}, {"law": "lugre"}])
def test_the_memory_of_a_run_that_began_before_its_first_row_is_that_of_its_speed(settings):
    """Of a run whose edges were cut off the joint has come some way: at speed it is sliding, at rest nobody knows."""
    kind, numbers = family("hysteresis_friction"), {"presliding_stiffness": 50.0, "coulomb_torque": 1.0}
    if settings:
        numbers |= {"static_torque": 1.5, "micro_damping": 0.0, "stribeck_velocity": 0.1}

    def first(speed: float, began: float) -> float:
        time = began + np.arange(3) / 100.0
        still = np.zeros((1, 3))
        return float(kind.along(State(still, speed + still, time=time), numbers, settings)[0])

    assert first(0.5, 0.5) == pytest.approx(1.0, abs=1e-5)
    assert first(-0.5, 0.5) == pytest.approx(-1.0, abs=1e-5)
    assert first(0.0, 0.5) == first(0.5, 0.0) == 0.0
    level = 1.0 + 0.5 * np.exp(-0.01) if settings else 1.0
    # At .01 rad/s for half a second it has gone a quarter of the displacement.
    assert first(0.01, 0.5) == pytest.approx(level * (1.0 - np.exp(-0.25 / level)))


def test_friction_that_would_drive_at_a_speed_seen_is_held_back():
    """Viscous and nonlinear coordinates (fv, f2, f3); the free fit turns negative at 2 rad/s."""
    speed = np.linspace(0.05, 2.0, 80)
    columns = np.column_stack([speed, speed**2, speed**3])
    target = 3.0 * speed - 2.5 * speed**2
    a, b = columns.T @ columns * 1e4, columns.T @ target * 1e4
    v = 2.0 * np.linspace(0.1, 1, 10)
    rows = np.column_stack([np.ones_like(v), v, v**2])
    limits = Constraints(np.array([0.0, -np.inf, -np.inf]), (), rows, np.zeros(10))
    free = solve(a, b, Constraints(limits.lower))
    assert (rows @ free).min() < -1.0
    x = solve(a, b, limits)
    assert (rows @ x).min() >= 0
    reference = minimize(  # type: ignore[call-overload]
        lambda y: np.mean((columns @ y - target) ** 2),
        np.ones(3),
        constraints=[{"type": "ineq", "fun": lambda y: rows @ y}, {"type": "ineq", "fun": lambda y: y[:1]}],
        method="SLSQP",
        options={"ftol": 1e-14, "maxiter": 500},
    )
    assert np.mean((columns @ x - target) ** 2) <= reference.fun * 1.001
    # A starting model that brakes as much leaves room: then the free optimum is allowed.
    room = Constraints(np.array([-4.0, -np.inf, -np.inf]), (), rows, np.full(10, -4.0))
    np.testing.assert_allclose(solve(a, b, room), free, atol=1e-6)


def test_speeds_beyond_those_fitted_are_told_where_friction_would_drive(panda):
    model = Model(panda, tuple(thinning()))
    dq = np.zeros((10, 7))
    dq[:, 1] = np.linspace(-2.0, 2.0, 10)
    assert model.extrapolation_warnings(dq) == []
    bad = Effect("nonlinear_viscous_friction", JOINT, {"quadratic_coefficient": -1.0, "cubic_coefficient": 0.0})
    (line,) = model.adding([bad, bad]).extrapolation_warnings(2 * dq)
    assert "panda_joint2 moves at up to 4 rad/s" in line
    assert "would drive it" in line


def test_less_viscous_friction_must_not_let_the_curve_of_the_starting_model_drive(panda):
    viscous, curved = Term("viscous_friction", 1), Term("nonlinear_viscous_friction", 1)
    base = {viscous: np.array([3.0]), curved: np.array([-1.0, 0.0])}
    found = physical_constraints([viscous], [0], 1, base, panda, np.full(7, 2.5))
    # 3 - 2.5 = 0.5 N m s/rad is left at 2.5 rad/s: so much, and not the 3 of the viscous term, may go.
    assert found.satisfied(np.array([-0.49]))
    assert not found.satisfied(np.array([-0.51]))


def test_friction_opposes_at_the_speeds_a_joint_may_do_not_only_at_those_seen(panda):
    """Speeds of 1 rad/s seen of a joint that may do 2: a curve that turns round between the two is none."""
    coulomb, viscous = Term("coulomb_friction", 1), Term("viscous_friction", 1)
    terms = [coulomb, viscous, Term("nonlinear_viscous_friction", 1)]
    found = physical_constraints(terms, [0, 1, 2], 4, {}, panda, np.full(7, 1.0))
    # (Fc, Fv, F2, F3) [N m] at 2 rad/s: 0 + 60 x 4 - 40 x 8 = -80; with 60 x 2 of viscous friction beside it 40.
    assert not found.satisfied(np.array([0.0, 0.0, 60.0, -40.0]))
    assert found.satisfied(np.array([0.0, 60.0, 60.0, -40.0]))
    # 3 x 2 - 2 x 4 = -2 alone: dry friction of 5 carries it there, but not where the joint was seen.
    assert not found.satisfied(np.array([1.0, 3.0, -2.0, 0.0]))
    assert found.satisfied(np.array([5.0, 3.0, -2.0, 0.0]))
    assert not found.satisfied(np.array([5.0, 1.5, -2.0, 0.0]))
    # A starting model that drives at speeds nobody saw (3.2 x 2 - 2 x 4 < 0) lets what was seen become less.
    base = {viscous: np.array([3.2]), terms[2]: np.array([-2.0, 0.0])}
    less = physical_constraints([viscous], [0], 1, base, panda, np.full(7, 1.0))
    assert less.satisfied(np.array([-1.0]))
    assert not less.satisfied(np.array([-1.3]))


def test_friction_opposes_up_to_the_speed_that_the_urdf_allows(panda):
    limit = panda.velocity_limits[1]
    for seen, expected in ((0.4 * limit, limit), (1.5 * limit, 1.5 * limit), (0.1, 0.1 * FAR)):
        assert speeds_to_oppose(panda, np.full(7, seen))[1] == pytest.approx(expected)
    # No limit, or a place-holder, says nothing.
    for without in (0.0, 10.0, 1e3):
        robot = panda.copy()
        robot.model.upperVelocityLimit[:] = without
        assert speeds_to_oppose(robot, np.full(7, 1.0)) == pytest.approx(BEYOND)


@pytest.mark.parametrize("of", ["coulomb", "viscous"])
def test_friction_that_becomes_less_as_a_joint_warms_up_stays_friction(panda, of):
    drift = Term("drift", 1, (("of", of), ("time_constant", 30.0)))
    terms = [Term("coulomb_friction", 1), Term("viscous_friction", 1), drift]
    limits = physical_constraints(terms, [0, 1, 2], 3, {}, panda, np.full(7, 2.0))
    # With 1.5 N m and 2 N m s/rad at most all of the friction goes in the end: of dry friction where the joint is
    # slowest (1.5 + 2 x 0.2 N m), of viscous friction where it is fastest (1.5 / 2 + 2 N m s/rad).
    at = {"coulomb": 1.9, "viscous": 2.75}[of] / 30
    assert limits.satisfied(np.array([1.5, 2.0, -0.99 * at]))
    assert not limits.satisfied(np.array([1.5, 2.0, -1.01 * at]))
    # Friction that grows is friction; an offset may drift where it likes; another joint's friction is no help.
    assert limits.satisfied(np.array([1.5, 2.0, 5.0]))
    offset = Term("drift", 1, (("of", "offset"), ("time_constant", 30.0)))
    free = physical_constraints([terms[0], offset], [0, 1], 2, {}, panda, np.full(7, 2.0))
    assert free.satisfied(np.array([0.0, -5.0]))
    alone = physical_constraints([Term("coulomb_friction", 2), drift], [0, 1], 2, {}, panda, np.full(7, 2.0))
    assert not alone.satisfied(np.array([9.0, -1e-3]))
    # What the starting model has already counts.
    base = {terms[0]: np.array([1.5]), terms[1]: np.array([2.0])}
    on_top = physical_constraints([drift], [0], 1, base, panda, np.full(7, 2.0))
    assert on_top.satisfied(np.array([-0.99 * at]))
    assert not on_top.satisfied(np.array([-1.01 * at]))


def test_a_starting_model_that_drives_at_other_speeds_is_not_made_worse(panda):
    # It was made at 2 rad/s: what goes in the end is most of the friction there and more than there is at slow speeds.
    drift = Term("drift", 1, (("of", "coulomb"), ("time_constant", 30.0)))
    plain = [Term("coulomb_friction", 1), Term("viscous_friction", 1), Term("load_dependent_friction", 1)]
    base = {plain[0]: np.array([1.5]), plain[1]: np.array([2.0]), drift: np.array([-3.0 / 30])}
    for term in [*plain, drift]:
        found = physical_constraints([term], [0], 1, base, panda, np.full(7, 0.5))
        assert found.satisfied(np.zeros(1))
    assert not physical_constraints([drift], [0], 1, base, panda, np.full(7, 0.5)).satisfied(np.array([-1e-3]))


def test_a_sign_that_turns_over_slowly_has_as_much_to_lose(panda):
    drift = Term("drift", 1, (("of", "coulomb"), ("time_constant", 30.0)))
    x = np.array([1.5, -0.99 * 1.5 / 30])
    for width in ((), (("sign_width", 0.08),)):
        dry = Term("coulomb_friction", 1, width)
        limits = physical_constraints([dry, drift], [0, 1], 2, {}, panda, np.full(7, 0.2))
        assert limits.satisfied(x)
        assert not limits.satisfied(x * np.array([1.0, 1.02]))


@pytest.mark.parametrize(
    ("numbers", "allowed"), [((-0.5, 9.0), False), ((-1e-6, 9.0), False), ((0.5, 9.0), True), ((0.5, -0.2), True)]
)
def test_a_curve_without_a_viscous_term_opposes_the_motion_near_rest_too(panda, numbers, allowed):
    """-.5 v + 9 v^2 brakes from a tenth of the fastest speed on, and drives below a twentieth."""
    curve = Term("nonlinear_viscous_friction", 2)
    found = physical_constraints([curve], [0], 2, {}, panda, np.full(7, 1.0))
    assert found.satisfied(np.array(numbers)) is allowed
    # Control: beside a viscous term that carries it there it may bend down.
    viscous = Term("viscous_friction", 2)
    both = physical_constraints([curve, viscous], [0, 2], 3, {}, panda, np.full(7, 1.0))
    assert both.satisfied(np.array([*numbers, 1.0]))
