"""Positions in coarse steps: accelerations that nobody moved with are no fault of the clock."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.small_arm import HIDDEN, arm, noisy_log

from hybrid_dynamics.check import check_before_fit, checked, samples
from hybrid_dynamics.check.samples import CUTOFF, LEAST_KEPT, LOWEST, NOISE, Stretch, stretches
from hybrid_dynamics.differentiate.butterworth import lowpass
from hybrid_dynamics.differentiate.scatter import position_noise, steps
from hybrid_dynamics.effects import predict
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.simulation.excitation import excitation
from hybrid_dynamics.trajectory import Trajectory

ROBOT = arm()
#: Ten bits over 300 degrees, as servos of small arms have them [rad].
SERVO = np.deg2rad(300.0) / 1024


def log(step: float, seed: int = 1, noise: float = 0.02) -> Trajectory:
    """An easy motion, which has its last sine below .6 Hz."""
    return _rounded(noisy_log(HIDDEN, seed, "train", noise), step)


def _rounded(run: Trajectory, step: float) -> Trajectory:
    q = np.round(run["q"] / step) * step if step else run["q"]
    return replace(run, signals={"q": q, "tau": run["tau"]})


def made(run: Trajectory) -> Stretch:
    (one,) = stretches([run])
    return one


CLOCK = {"time_scale", "torque_weight", "torque_unit", "torque_delay"}


@pytest.mark.parametrize("times", [1.0, 2.0, 4.0])
def test_a_right_log_of_coarse_positions_is_not_refused_for_its_clock(times: float) -> None:
    found = check_before_fit(ROBOT, [log(times * SERVO)])
    assert {f.code for f in found}.isdisjoint(CLOCK)


def test_with_the_filter_of_fine_positions_it_would_be(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(samples, "NOISE", np.inf)
    with pytest.raises(InputError, match="time stamps run about"):
        check_before_fit(ROBOT, [log(4 * SERVO)])


def test_a_clock_that_is_off_is_told_all_the_same() -> None:
    fast = _rounded(excitation(ROBOT, HIDDEN, seed=1, duration=20.0, rate=200.0), SERVO)
    assert {f.code for f in check_before_fit(ROBOT, [fast])}.isdisjoint(CLOCK)
    with pytest.raises(InputError, match="time stamps run about 2"):
        check_before_fit(ROBOT, [replace(fast, time=0.5 * fast.time)])


def test_the_filter_is_lowered_until_noise_is_a_small_part_of_what_accelerates_and_no_further() -> None:
    fine, coarse = log(0.0), log(2 * SERVO)
    assert made(fine).cutoff == CUTOFF
    low = made(coarse)
    assert LOWEST <= low.cutoff < CUTOFF
    true = np.gradient(np.gradient(fine["q"], fine.dt, axis=0), fine.dt, axis=0)
    rows = np.searchsorted(fine.time, fine.time[0] + low.time)
    off = low.ddq - true[np.minimum(rows, len(true) - 1)]
    # What the filter takes of the motion counts, too.
    assert off.var() < 3 * NOISE * low.ddq.var()
    # Unfiltered but for what all logs pass it is another matter.
    noise = np.sum(position_noise(coarse["q"], coarse.dt)) * (2 * np.pi) ** 4 * CUTOFF**5 / 5
    assert noise > 3 * NOISE * true.var(axis=0).sum()


def test_a_filter_is_lowered_no_further_than_checks_have_rows_left() -> None:
    run = log(4 * SERVO)
    short = run.rows(slice(200, 800))
    assert made(run).cutoff < made(short).cutoff
    # Three seconds leave enough to see that all torques are turned round, as on fine positions.
    with pytest.raises(InputError, match="wrong sign"):
        check_before_fit(ROBOT, [replace(run, signals={"q": run["q"], "tau": -run["tau"]})])
    assert len(made(short).q) >= min(LEAST_KEPT, len(made(log(0.0).rows(slice(200, 800))).q))


def test_all_runs_pass_one_filter_or_their_delay_would_be_that_of_the_longest_step() -> None:
    """A slow run beside a quick one: rows are shifted by, and rows of both are as long."""
    quick = _rounded(excitation(ROBOT, HIDDEN, seed=1, duration=20.0, rate=200.0), 2 * SERVO)
    slow = replace(log(2 * SERVO), name="slow")
    assert made(slow).dt > made(quick).dt
    assert len({(part.dt, part.cutoff) for part in stretches([quick, slow])}) == 1


@pytest.mark.parametrize(("rate", "held"), [(1000.0, 1), (1000.0, 20), (200.0, 4)])
def test_positions_that_are_held_or_take_many_samples_to_a_step_are_as_coarse(rate: float, held: int) -> None:
    run = excitation(ROBOT, HIDDEN, seed=1, duration=20.0, rate=rate)
    slow = replace(run, time=3.0 * run.time)
    q = np.round(slow["q"] / (4 * SERVO)) * 4 * SERVO
    dq = np.gradient(slow["q"], slow.dt, axis=0)
    tau = predict(ROBOT, list(HIDDEN), slow["q"], dq, np.gradient(dq, slow.dt, axis=0), slow.time)
    rows = np.arange(len(q)) // held * held
    found = check_before_fit(ROBOT, [replace(slow, signals={"q": q[rows], "tau": tau})])
    assert {f.code for f in found}.isdisjoint(CLOCK)


def test_a_log_that_is_far_too_slow_is_told_so_and_nothing_breaks() -> None:
    run = log(SERVO)
    for times in (300.0, 1000.0):
        found = checked(ROBOT, [replace(run, time=times * run.time)], [], refuse=False).findings
        assert "too_slow" in {f.code for f in found}


def test_steps_are_a_sensors_where_values_repeat_in_motion() -> None:
    time = np.arange(0.0, 10.0, 0.005)
    q = np.sin(time)[:, None]
    step, interval = steps(np.round(q / 0.01) * 0.01)
    assert step == pytest.approx([0.01], rel=1e-6)
    assert 2.0 < interval[0] < 11.0
    # What turns by more than a step a sample shows its steps at the turning points alone; fine positions show none.
    assert [x.tolist() for x in steps(q)] == [[0.0], [1.0]]
    held = position_noise(np.round(q / 0.01) * 0.01, 0.005, held=True)
    assert held == pytest.approx(interval * 0.01**2 / 12 * 2 * 0.005, rel=0.5)
    # The noise of rounding is a twelfth of the square of a step, spread up to half the rate.
    density = position_noise(np.round(q / 0.01) * 0.01, 0.005)
    assert density == pytest.approx([0.01**2 / 12 * 2 * 0.005], rel=0.5)


def test_of_hours_no_more_is_filtered_than_is_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    run = log(SERVO)
    filtered: list[int] = []

    def counted(x: np.ndarray, dt: float, cutoff: float) -> np.ndarray:
        filtered.append(len(x))
        return lowpass(x, dt, cutoff)

    monkeypatch.setattr(samples, "MOST_ROWS", 200)
    monkeypatch.setattr(samples, "lowpass", counted)
    one, *more = stretches([run, replace(run, name="again")])
    assert not more
    assert len(one.q) <= 200
    # Of positions as fine as may be every fourth of 200 samples a second is kept.
    assert max(filtered) <= 200 * 4 * CUTOFF / one.cutoff + 1
