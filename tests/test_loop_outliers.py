"""Outlier segments by themselves: what surprises most joints at once, and jolts that the filters do not resolve."""

from __future__ import annotations

import numpy as np
import pytest
from tests.panda_arm import FRICTION, load_panda, recorded

from hybrid_dynamics.loop import LoopSettings
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.noise import _ridge, rich_residuals
from hybrid_dynamics.loop.outliers import OutlierSegment, outlier_segments
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.simulation.excitation import excitation
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

JOINTS, RATE, SECONDS = 6, 100.0, 20.0
TIME = np.arange(0.0, SECONDS, 1.0 / RATE)


def motion(jolts: tuple[float, ...], joints: int = JOINTS) -> Array:
    """Smooth accelerations, and at each of ``jolts`` [s] a spike of 50 ms on the first ``joints``."""
    rng = np.random.default_rng(0)
    ddq = np.sin(TIME[:, None] * rng.uniform(0.5, 2.0, JOINTS) + rng.uniform(0, 6, JOINTS))
    for at in jolts:
        ddq[np.abs(TIME - at) < 0.025, :joints] += 20.0
    return ddq


def residual(at: float, joints: int) -> Array:
    """Unit noise; at ``at`` [s] the first ``joints`` depart by 20, each a little after the other."""
    out = np.random.default_rng(1).normal(size=(len(TIME), JOINTS))
    for j in range(joints):
        out[np.abs(TIME - at - 0.02 * j) < 0.01, j] += 20.0
    return out


def found(ddq: Array, left: Array) -> list[OutlierSegment]:
    return outlier_segments(0, TIME, ddq, left, np.ones(left.shape, bool), pad=0.08)


def test_two_joints_that_depart_in_a_jolt_are_an_outlier_segment() -> None:
    (segment,) = found(motion((8.2,)), residual(8.2, 2))
    assert TIME[segment.start] < 8.2 < TIME[segment.stop]
    assert segment.joints == 2
    assert segment.size > 10.0


@pytest.mark.parametrize(
    ("jolts", "shaken", "departing"),
    [((), JOINTS, 2), ((8.2,), 2, 2), ((8.2,), JOINTS, 1), ((4.0,), JOINTS, 2)],
    ids=["smooth", "two joints jolt", "one joint departs", "the jolt is elsewhere"],
)
def test_friction_that_surprises_some_joints_is_none(jolts: tuple[float, ...], shaken: int, departing: int) -> None:
    assert found(motion(jolts, shaken), residual(8.2, departing)) == []


def test_jolts_that_come_often_are_the_motion_itself() -> None:
    every = tuple(np.arange(0.5, SECONDS, 0.2))
    assert found(motion(every), sum(residual(float(at), 2) for at in every)) == []
    # What surprises every joint at once is left out all the same.
    knock = residual(8.3, 0)
    knock[np.abs(TIME - 8.3) < 0.02] += 20.0
    assert len(found(motion(every), knock)) == 1


def test_knocks_that_come_often_ask_for_an_explanation() -> None:
    # A tenth of a second of all joints: now and then it is left out, every .4 s it is what the log is made of.
    def knocks(every: float) -> Array:
        out = residual(8.2, 0)
        out[(TIME % every > 0.2) & (TIME % every < 0.3)] += 20.0
        return out

    assert len(found(motion(()), knocks(5.0))) == 4
    assert found(motion(()), knocks(0.4)) == []


@pytest.mark.parametrize("rate", [100.0, 400.0])
@pytest.mark.parametrize("pad", [0.03, 0.2])
def test_as_much_is_left_out_to_either_side_as_the_filters_carry_a_moment(rate: float, pad: float) -> None:
    rows, knock = round(SECONDS * rate), round(8.2 * rate)
    left = np.random.default_rng(1).normal(size=(rows, JOINTS))
    left[knock] += 20.0
    (segment,) = outlier_segments(0, np.arange(rows) / rate, 0 * left, left, np.ones(left.shape, bool), pad)
    assert (segment.start, segment.stop) == (knock - round(pad * rate), knock + 1 + round(pad * rate))


@pytest.mark.parametrize("joints", [range(7), range(0)], ids=["a knock", "none"])
def test_a_knock_in_a_log_of_seconds_is_left_out(joints: range) -> None:
    # Five seconds have too few rows for all columns of the rich model on the first joints, on which all links act.
    robot, settings = load_panda(), LoopSettings()
    log = recorded(robot, FRICTION, 5.0, 0)
    tau, moment = log["tau"].copy(), np.abs(log.time - log.time[0] - 2.5) < 0.05
    tau[np.ix_(moment, list(joints))] += 30.0
    logs = read_motion(robot, [log.with_signals(tau=tau)], [], settings)
    judge, _, notes = gather(Model(robot), logs, settings)
    told = [note for note in notes if "outlier segment" in note]
    if joints:
        (line,) = told
        assert "around 2.5" in line
    else:
        # The control: friction that turns over on many joints is none.
        assert told == []
    # White noise of .05 N m, smoothed, and what friction leaves where the model of few columns is as poor as it is.
    assert np.all(judge.floor < 0.6)


def test_a_log_of_seconds_has_a_rich_model_that_leaves_the_noise() -> None:
    # Of some hundred columns and little more rows: with all of them next to nothing would be left, and no knock seen.
    robot, settings = load_panda(), LoopSettings()

    def smoothed(log: Trajectory) -> Run:
        return read_motion(robot, [log], [log], settings).train[0]

    noisy, clean = recorded(robot, [], 1.6, 0), excitation(robot, [], duration=1.6, rate=200.0)
    evidence = gather(Model(robot), read_motion(robot, [noisy], [noisy], settings), settings)[0].evidence
    (left,), (moving,) = rich_residuals(evidence), evidence.mask
    noise = smoothed(noisy).tau - smoothed(clean).tau
    assert all(np.std(left[moving[:, j], j]) > 0.9 * np.std(noise[moving[:, j], j]) for j in range(7))


def test_as_many_directions_as_there_are_rows_for_are_those_that_vary_most() -> None:
    rng = np.random.default_rng(0)
    wide, narrow, target = rng.normal(size=(3, 500))
    columns = np.column_stack([wide, wide + 0.1 * narrow, narrow, 2.0 * wide + narrow])
    rows = np.column_stack([columns, 3.0 * wide + 1e-3 * target])
    gram = rows.T @ rows
    left = [np.std(rows[:, -1] - columns @ _ridge(gram, 1e-9, most)) for most in (1, 2, 4)]
    assert left[0] > 0.3, "one direction is a mixture"
    assert left[1] == pytest.approx(1e-3, rel=0.1), "there are two"
    np.testing.assert_allclose(columns @ _ridge(gram, 1e-9, 4), columns @ _ridge(gram, 1e-9), atol=1e-6)
