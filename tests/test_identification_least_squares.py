"""The baseline recovers what was planted, says how sure it is, and does not explain what it cannot."""

from __future__ import annotations

import json

import numpy as np
import pytest
import scipy.signal
from tests.small_arm import arm

from hybrid_dynamics.errors import HybridDynamicsError, InputError
from hybrid_dynamics.identification import LeastSquares, LeastSquaresSettings, base_parameters, is_physical
from hybrid_dynamics.identification.estimate import Problem, choose_widths, estimate
from hybrid_dynamics.identification.factors import _columns, block_factors, low_pass_taps
from hybrid_dynamics.metrics import torque_errors
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory

VISCOUS, COULOMB, OFFSET, ARMATURE = (
    np.array([2.0, 1.0, 0.5]),
    np.array([1.5, 1.0, 0.3]),
    np.array([0.2, -0.1, 0.05]),
    np.array([0.3, 0.2, 0.1]),
)
NOISE = np.array([0.5, 0.2, 0.1])
RATE = 100.0


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    """A spatial arm with three joints."""
    links, joints = ['<link name="base"/>'], []
    for j, axis in enumerate(("0 0 1", "0 1 0", "0 1 0"), start=1):
        links.append(
            f'<link name="l{j}"><inertial><origin xyz="{0.2 / j} 0.02 0.01"/><mass value="{4.0 / j}"/><inertia '
            f'ixx="{0.02 / j}" iyy="{0.05 / j}" izz="{0.06 / j}" ixy="0.001" ixz="0" iyz="0.002"/></inertial></link>'
        )
        joints.append(
            f'<joint name="j{j}" type="revolute"><parent link="{"base" if j == 1 else f"l{j - 1}"}"/>'
            f'<child link="l{j}"/><origin xyz="{"0 0 0.3" if j < 3 else "0.4 0 0"}"/><axis xyz="{axis}"/>'
            '<limit lower="-3" upper="3" velocity="5" effort="100"/></joint>'
        )
    path = tmp_path_factory.mktemp("robot") / "arm.urdf"
    path.write_text('<?xml version="1.0"?><robot name="arm">' + "".join(links + joints) + "</robot>")
    return Robot.from_urdf(path)


def motion(seed: int, seconds: float, rate: float = RATE) -> tuple[np.ndarray, ...]:
    """Time and multi-sine ``q dq ddq``; joints differ."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 1 / rate)
    q, dq, ddq = np.zeros((3, len(t), 3))
    for k in range(1, 6):
        w = 2 * np.pi * k / 10
        a, b = rng.normal(size=(2, 3)) * 0.8 / k
        s, c = np.sin(w * t)[:, None], np.cos(w * t)[:, None]
        q += a * s + b * c
        dq += w * (a * c - b * s)
        ddq -= w * w * (a * s + b * c)
    return t, q, dq, ddq


def planted_torque(robot: Robot, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
    rigid = robot.inverse_dynamics(q, dq, ddq)
    return rigid + ARMATURE * ddq + VISCOUS * dq + COULOMB * np.sign(dq) + OFFSET


def coloured(rng: np.random.Generator, rows: int, correlation: float) -> np.ndarray:
    """First-order autoregressive noise (rows, 3) of unit variance, by recursion over the lag weights."""
    length = 60
    weights = correlation ** np.arange(length)
    white = rng.normal(size=(rows + length - 1, 3))
    out = np.column_stack([np.convolve(white[:, j], weights, mode="valid") for j in range(3)])
    return out / np.sqrt(np.sum(weights**2))


def record(robot: Robot, seed: int, *, seconds: float = 20.0, noise: float = 1.0, extra: np.ndarray | float = 0.0):
    t, q, dq, ddq = motion(seed, seconds)
    rng = np.random.default_rng(seed + 1000)
    tau = planted_torque(robot, q, dq, ddq) + noise * NOISE * coloured(rng, len(t), 0.8) + extra * q
    return Trajectory(f"run{seed}", "train", t, {"q": q, "dq": dq, "ddq": ddq, "tau": tau})


def description(robot: Robot) -> Robot:
    """What the manufacturer says: wrong masses, no friction, no rotors."""
    wrong = robot.copy()
    for i in wrong.joint_ids:
        wrong.model.inertias[i].mass *= 1.5
    return wrong


def truth(model: LeastSquares, robot: Robot) -> np.ndarray:
    base = model.base.grouping @ np.append(robot.inertial_parameters, ARMATURE)
    return np.concatenate([base, VISCOUS, COULOMB, OFFSET])


def column(model: LeastSquares, name: str) -> np.ndarray:
    return np.array([np.nan if row[name] is None else row[name] for row in model.parameters_], float)


def test_recovers_what_was_planted(robot: Robot) -> None:
    runs = [record(robot, seed) for seed in range(3)]
    model = LeastSquares(description(robot)).fit(runs)
    true, error = truth(model, robot), column(model, "std_error")
    # 19 values within four standard errors, and standard errors small enough to mean something.
    for name in ("ordinary", "value"):
        assert (np.abs(column(model, name) - true) < 4 * error).all()
    strong = np.abs(true) > 0.2
    assert (error[strong] < 0.1 * np.abs(true[strong])).all()
    np.testing.assert_allclose(model.noise_, NOISE, rtol=0.1)
    assert is_physical(model.inertial_parameters_)
    assert 1 < model.condition_number_ < 100
    assert 1 < model.base_condition_number_ < 1000


def test_held_out_error_is_the_noise(robot: Robot) -> None:
    model = LeastSquares(description(robot)).fit([record(robot, seed) for seed in range(3)])
    clean = record(robot, 50, noise=0.0)
    error = np.sqrt(np.mean((clean["tau"] - model.predict(clean)) ** 2, axis=0))
    described = np.sqrt(
        np.mean(
            (clean["tau"] - description(robot).inverse_dynamics(*(clean[s] for s in ("q", "dq", "ddq")))) ** 2, axis=0
        )
    )
    assert (error < 0.2 * NOISE).all()
    assert (described > 2 * NOISE).all()


def test_a_cause_it_lacks_stays_unexplained(robot: Robot) -> None:
    """Control: a spring on joint 1 (which gravity does not load) is no mass, friction or rotor."""
    model = LeastSquares(description(robot)).fit(
        [record(robot, seed, extra=np.array([5.0, 0, 0])) for seed in range(3)]
    )
    assert model.noise_[0] > 3 * NOISE[0]
    np.testing.assert_allclose(model.noise_[1:], NOISE[1:], rtol=0.1)


def test_no_friction_is_found_where_none_was_planted(robot: Robot) -> None:
    runs = []
    for seed in range(3):
        run = record(robot, seed)
        runs.append(run.with_signals(tau=run["tau"] - COULOMB * np.sign(run["dq"]) - OFFSET))
    model = LeastSquares(description(robot)).fit(runs)
    rows = {row["parameter"]: row for row in model.parameters_}
    for j in (1, 2, 3):
        for name in (f"fc{j}", f"fo{j}"):
            assert abs(rows[name]["ordinary"]) < 4 * rows[name]["std_error"]


def test_plain_sign_is_chosen_for_dry_friction_and_a_width_for_a_smooth_one(robot: Robot) -> None:
    sharp = [record(robot, seed, noise=0.1) for seed in range(3)]
    smooth = [
        run.with_signals(tau=run["tau"] + COULOMB * (np.tanh(run["dq"] / 0.08) - np.sign(run["dq"]))) for run in sharp
    ]
    assert (LeastSquares(robot).fit(sharp).sign_width_ == 0).all()
    assert (LeastSquares(robot).fit(smooth).sign_width_ == 0.08).all()


@pytest.mark.slow
def test_standard_errors_cover_the_truth_under_autocorrelated_noise(robot: Robot) -> None:
    settings = LeastSquaresSettings(physical=False, sign_widths=(0.0,), reweightings=1)
    t, q, dq, ddq = motion(7, 40.0, rate=50.0)
    clean = planted_torque(robot, q, dq, ddq)
    inside, estimates, errors = [], [], []
    for seed in range(60):
        noise = NOISE * coloured(np.random.default_rng(seed), len(t), 0.8)
        run = Trajectory("run", "train", t, {"q": q, "dq": dq, "ddq": ddq, "tau": clean + noise})
        model = LeastSquares(robot, settings).fit([run])
        estimates.append(column(model, "ordinary"))
        errors.append(column(model, "std_error"))
        inside.append(np.abs(estimates[-1] - truth(model, robot)) < 1.96 * errors[-1])
    assert 0.90 < np.mean(inside) < 0.99
    # The scatter of the estimates is what the standard errors say it is.
    ratio = np.mean(errors, axis=0) / np.std(estimates, axis=0)
    assert 0.85 < np.median(ratio) < 1.25
    # Control: the textbook's formula, which takes samples for independent, is far too sure.
    blocks = block_factors(
        robot,
        model.base,
        [run],
        widths=(0.0,),
        min_speed=0.02,
        block_seconds=1.0,
        max_rows=60_000,
        filter_cutoff=0.0,
    )
    factor = estimate(blocks, model.base.size, reweightings=1).factor
    independent = np.sqrt(np.diag(np.linalg.inv(factor.T @ factor)))
    assert np.median(independent / np.std(estimates, axis=0)) < 0.6


def test_blocks_hold_every_row_that_counts_once_and_are_as_long_as_asked(robot: Robot) -> None:
    t, q, dq, ddq = motion(3, 40.0)
    tau = planted_torque(robot, q, dq, ddq) + NOISE * np.random.default_rng(1).normal(size=q.shape)
    run = Trajectory("run", "train", t, {"q": q, "dq": dq, "ddq": ddq, "tau": tau})
    options = {"widths": (0.0,), "min_speed": 0.02, "max_rows": 60_000, "filter_cutoff": 0.0}
    base = LeastSquares(robot, LeastSquaresSettings(physical=False)).fit([run]).base
    blocks = block_factors(robot, base, [run], block_seconds=2.0, **options)
    assert len(blocks.factors) == 20
    np.testing.assert_array_equal(blocks.rows.sum(axis=0), (np.abs(dq) >= 0.02).sum(axis=0))
    # One re-weighting has looked at what every joint leaves.
    once = estimate(blocks, base.size, reweightings=1)
    np.testing.assert_allclose(once.noise, NOISE, rtol=0.05)


def test_on_processed_data_it_is_as_good_as_the_true_model(robot: Robot) -> None:
    """Encoder steps, torque noise, one low-pass: what is left is the processing's error, for the true model as well."""
    rate, low = 500.0, scipy.signal.butter(4, 10 / 250)
    runs = []
    for seed in range(4):
        t, q, dq, ddq = motion(seed, 20.0, rate)
        rng = np.random.default_rng(seed)
        tau = planted_torque(robot, q, dq, ddq) + NOISE * rng.normal(size=q.shape)
        step = 2 * np.pi / 40000
        position = scipy.signal.filtfilt(*low, np.round(q / step) * step, axis=0)
        velocity = np.gradient(position, 1 / rate, axis=0)
        signals = {
            "q": position,
            "dq": velocity,
            "ddq": np.gradient(velocity, 1 / rate, axis=0),
            "tau": scipy.signal.filtfilt(*low, tau, axis=0),
        }
        runs.append(Trajectory(f"run{seed}", "train", t, signals).rows(slice(200, -200)))
    held_out = runs.pop()
    states = [held_out[s] for s in ("q", "dq", "ddq")]
    learned = LeastSquares(description(robot)).fit(runs).predict(held_out)
    true = torque_errors(held_out["tau"], planted_torque(robot, *states))
    assert (torque_errors(held_out["tau"], learned).rmse < 1.1 * true.rmse).all()
    # Control: the description alone is several times worse.
    described = description(robot).inverse_dynamics(*states)
    assert (torque_errors(held_out["tau"], described).rmse > 4 * true.rmse).all()


def test_thinning_and_blocks_do_not_change_the_estimate_much(robot: Robot) -> None:
    runs = [record(robot, seed) for seed in range(3)]
    full = LeastSquares(robot).fit(runs)
    thin = LeastSquares(robot, LeastSquaresSettings(max_rows=2000)).fit(runs)
    assert thin.rows_ < full.rows_ / 2
    difference = np.abs(column(full, "ordinary") - column(thin, "ordinary"))
    assert (difference < 4 * column(thin, "std_error")).all()


def test_parallel_filtering_keeps_dry_friction_unbiased(robot: Robot) -> None:
    """Torque through a low-pass against unfiltered columns loses Coulomb torque; the same filter on both does not."""
    runs = [record(robot, seed, noise=0.0) for seed in range(3)]
    taps = low_pass_taps(1.0, 1 / RATE)
    filtered = []
    for run in runs:
        low = np.column_stack([np.convolve(run["tau"][:, j], taps, mode="same") for j in range(3)])
        filtered.append(run.with_signals(tau=low).rows(slice(len(taps), -len(taps))))
    plain = LeastSquaresSettings(sign_widths=(0.0,))
    alone = LeastSquares(robot, plain).fit(filtered)
    together = LeastSquares(robot, LeastSquaresSettings(sign_widths=(0.0,), filter_cutoff=1.0)).fit(runs)
    assert np.max(np.abs(alone.coulomb_ / COULOMB - 1)) > 0.05
    np.testing.assert_allclose(together.coulomb_, COULOMB, rtol=1e-3)
    predicted = together.predict(runs[0])
    assert predicted.shape == runs[0]["tau"].shape
    inner = slice(len(taps), -len(taps))
    np.testing.assert_allclose(predicted[inner], filtered[0]["tau"], atol=0.02)


def test_a_joint_that_stands_still_has_no_friction_and_no_error_bar(robot: Robot) -> None:
    t, q, dq, ddq = motion(1, 20.0)
    for signal in (q, dq, ddq):
        signal[:, 1] = 0.0
    tau = planted_torque(robot, q, dq, ddq) + 0.01 * np.random.default_rng(0).normal(size=q.shape)
    model = LeastSquares(robot).fit([Trajectory("still", "train", t, {"q": q, "dq": dq, "ddq": ddq, "tau": tau})])
    rows = {row["parameter"]: row for row in model.parameters_}
    assert rows["fv2"]["std_error"] is None
    assert rows["fv2"]["value"] == 0.0
    assert rows["fv1"]["std_error"] is not None
    json.dumps(model.to_json(), allow_nan=False)


def test_ordinary_estimate_predicts_like_the_physical_one_where_the_data_is_rich(robot: Robot) -> None:
    runs = [record(robot, seed, noise=0.01) for seed in range(3)]
    plain = LeastSquares(description(robot), LeastSquaresSettings(physical=False)).fit(runs)
    physical = LeastSquares(description(robot)).fit(runs)
    np.testing.assert_allclose(plain.predict(runs[0]), physical.predict(runs[0]), atol=0.05)
    with pytest.raises(HybridDynamicsError, match="not a robot"):
        plain.identified_robot()


def test_json_round_trip_is_exact_and_fits_are_deterministic(robot: Robot) -> None:
    runs = [record(robot, seed) for seed in range(2)]
    model = LeastSquares(description(robot)).fit(runs)
    text = json.dumps(model.to_json(), allow_nan=False)
    assert text == json.dumps(LeastSquares(description(robot)).fit(runs).to_json(), allow_nan=False)
    again = LeastSquares.from_json(json.loads(text), description(robot))
    np.testing.assert_array_equal(again.predict(runs[0]), model.predict(runs[0]))
    assert again.to_json() == model.to_json()


def test_json_that_does_not_fit_is_refused_by_name(robot: Robot) -> None:
    document = LeastSquares(robot).fit([record(robot, 0)]).to_json()
    with pytest.raises(InputError, match="schema"):
        LeastSquares.from_json({**document, "schema": 2}, robot)
    with pytest.raises(InputError, match="viscous"):
        LeastSquares.from_json({k: v for k, v in document.items() if k != "viscous"}, robot)
    with pytest.raises(InputError, match="joints a, b"):
        LeastSquares.from_json({**document, "joints": ["a", "b"]}, robot)
    with pytest.raises(InputError, match=r"settings.*speling"):
        LeastSquares.from_json({**document, "settings": {"speling": 1}}, robot)
    with pytest.raises(InputError, match="inertial_parameters"):
        LeastSquares.from_json({**document, "inertial_parameters": document["inertial_parameters"][:2]}, robot)


def test_unusable_data_is_refused_by_name(robot: Robot) -> None:
    good = record(robot, 0)
    with pytest.raises(InputError, match="no trajectory"):
        LeastSquares(robot).fit([])
    without = Trajectory("bare", "train", good.time, {"q": good["q"]})
    with pytest.raises(InputError, match="bare: no signal 'dq'"):
        LeastSquares(robot).fit([without])
    bad = good["tau"].copy()
    bad[5, 1] = np.nan
    with pytest.raises(InputError, match=r"run0.*tau2.*row 6"):
        LeastSquares(robot).fit([good.with_signals(tau=bad)])
    narrow = Trajectory("narrow", "train", good.time, {s: good[s][:, :2] for s in ("q", "dq", "ddq", "tau")})
    with pytest.raises(InputError, match="narrow: 2 joints"):
        LeastSquares(robot).fit([narrow])
    with pytest.raises(InputError, match="filter_cutoff"):
        LeastSquares(robot, LeastSquaresSettings(filter_cutoff=0.01)).fit([good])
    with pytest.raises(HybridDynamicsError, match="not fitted"):
        LeastSquares(robot).predict(good)


def test_the_scale_of_rotors_is_the_largest_mean_own_inertia() -> None:
    # Every joint of it carries weight: gravity would count.
    robot = arm()
    scale = LeastSquares(robot, LeastSquaresSettings())._armature_scale()
    q = np.random.default_rng(LeastSquaresSettings().seed).uniform(-np.pi, np.pi, (64, 2))
    still = np.zeros_like(q)
    # What accelerates the other way takes gravity out.
    own = [
        np.mean([robot.inverse_dynamics(q, still, s * still + s * np.eye(2)[j])[:, j] * s / 2 for s in (1, -1)]) * 2
        for j in range(2)
    ]
    np.testing.assert_allclose(scale, max(own), rtol=1e-9)


def test_a_filter_leaves_a_straight_line_where_it_is() -> None:
    """A symmetric filter of unit sum neither delays nor bends it: rows of a block are those of its own time."""
    robot = arm()
    t = np.arange(400) / RATE
    line = np.column_stack([1.0 + 2.0 * t, 3.0 - 0.5 * t])
    run = Trajectory("run", "train", t, {"q": 0 * line, "dq": line, "ddq": 0 * line, "tau": -4.0 * line})
    base = base_parameters(robot)
    taps, centre = low_pass_taps(5.0, 1 / RATE), np.arange(100, 300, 3)
    assert len(taps) > 10
    columns = _columns(robot, base, run, centre, taps, (0.0,))
    dq, offset, tau = columns[..., base.size], columns[..., -2], columns[..., -1]
    np.testing.assert_allclose(dq, line[centre], atol=1e-9)
    np.testing.assert_allclose(offset, 1.0, atol=1e-12)
    np.testing.assert_allclose(tau, -4.0 * line[centre], atol=1e-9)


def test_a_joint_that_tells_no_width_from_another_keeps_that_of_the_others() -> None:
    """The elbow never slows down: all widths of its sign are the same to it."""
    robot, widths = arm(), (0.0, 0.02, 0.08)
    t, *states = motion(4, 30.0)
    q, dq, ddq = (own[:, :2].copy() for own in states)
    q[:, 1], dq[:, 1], ddq[:, 1] = 3.0 * t, 3.0, 0.0
    noise = 0.05 * np.random.default_rng(0).normal(size=q.shape)
    smooth = np.array([1.5, 0.0]) * np.tanh(dq / 0.02)
    run = Trajectory("r", "train", t, {"q": q, "dq": dq, "ddq": ddq})
    run = run.with_signals(tau=robot.inverse_dynamics(q, dq, ddq) + smooth + noise)
    base = base_parameters(robot)
    options = {"min_speed": 0.02, "max_rows": 60_000, "filter_cutoff": 0.0, "block_seconds": 1.0}
    problem = Problem(block_factors(robot, base, [run], widths=widths, **options), base.size)
    assert choose_widths(problem, np.full(2, 0.05)).tolist() == [1, 1]
