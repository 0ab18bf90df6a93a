"""Positions that come more slowly than what is logged beside them: a logger writes the latest of several streams."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from tests.small_arm import HIDDEN, arm, noisy_log

from hybrid_dynamics import close_loop
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.readers.log import pieces_of, read_raw
from hybrid_dynamics.readers.repeats import as_sampled, at_pace_of_positions
from hybrid_dynamics.readers.resample import resample
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

STEP, ROWS = 0.004, 3000
NOISE = 0.01


def positions(time: Array) -> Array:
    return np.stack([0.5 * np.sin(1.3 * time), 0.3 * np.sin(2.1 * time + 1.0)], axis=1)


def torque(time: Array) -> Array:
    return 2.0 * np.cos(positions(time))


def latest(time: Array, taken: Array) -> NDArray[np.intp]:
    """Which of the samples ``taken`` [s] is the latest at each ``time``."""
    return np.maximum(np.searchsorted(taken, time + 1e-9, side="right") - 1, 0)


@settings(max_examples=20, deadline=None)
@given(period=st.floats(1.3 * STEP, 12 * STEP))
def test_all_signals_are_taken_at_the_instants_of_the_positions(period: float) -> None:
    time = STEP * np.arange(ROWS)
    taken: Array = np.arange(0.0, time[-1], period)
    noise = NOISE * np.random.default_rng(0).normal(size=(ROWS, 2))
    log = Trajectory("log", "train", time, {"q": positions(taken)[latest(time, taken)], "tau": torque(time) + noise})
    lines: list[str] = []
    out = as_sampled(log, lines.append)
    assert len(out.time) == pytest.approx(len(taken), abs=2)
    # When the first was taken nobody knows.
    np.testing.assert_array_equal(out["q"], positions(taken)[1 : len(out.time) + 1])
    # What was written at a row was taken within the step before it.
    assert np.abs(out.time - taken[1 : len(out.time) + 1]).max() < 1.01 * STEP
    assert np.abs(out["tau"] - torque(out.time)).max() < 6 * NOISE
    assert len(lines) == 1
    assert "all signals are taken at the instants of the positions" in lines[0]
    assert as_sampled(out) is out


def test_two_streams_that_are_written_as_they_come_are_each_known_at_their_own_instants() -> None:
    of_q, of_tau = np.arange(0.0, 12.0, 0.010), np.arange(0.003, 12.0, 0.0076)
    time = np.unique(np.concatenate([of_q, of_tau]))[1:]
    small = 1e-4
    noise = small * np.random.default_rng(0).normal(size=(len(of_tau), 2))
    signals = {
        "q": positions(of_q)[latest(time, of_q)],
        "dq": np.gradient(positions(of_q), 0.01, axis=0)[latest(time, of_q)],
        "tau": (torque(of_tau) + noise)[latest(time, of_tau)],
    }
    out = at_pace_of_positions(Trajectory("log", "train", time, signals))
    inside = slice(2, -2)
    np.testing.assert_allclose(out["q"][inside], positions(out.time)[inside], atol=1e-9)
    np.testing.assert_allclose(
        out["dq"][inside], np.gradient(positions(of_q), 0.01, axis=0)[1:][: len(out.time)][inside]
    )
    assert np.abs(out["tau"] - torque(out.time))[inside].max() < 6 * small
    # The control: row by row the torque is as old as its stream is slow.
    assert np.abs(signals["tau"][latest(out.time, time)] - torque(out.time))[inside].max() > 20 * small


@pytest.mark.parametrize("step", [2 * np.pi / 4096, 0.01])
def test_coarse_positions_beside_a_fresh_torque_are_no_slow_stream(step: float) -> None:
    time = STEP * np.arange(ROWS)
    noise = NOISE * np.random.default_rng(0).normal(size=(ROWS, 2))
    log = Trajectory("log", "train", time, {"q": np.round(positions(time) / step) * step, "tau": torque(time) + noise})
    assert at_pace_of_positions(log) is log


@pytest.mark.parametrize("bits", [10, 11, 12, 13, 14, 16])
@pytest.mark.parametrize("rate", [200.0, 500.0, 1000.0])
def test_an_encoder_that_repeats_in_slow_motion_is_no_slow_stream(bits: int, rate: float) -> None:
    """Joints that are fast and slow together repeat together, too, and by several steps."""
    step = 2 * np.pi / 2**bits
    for seed in (1, 2, 3):
        log = noisy_log(HIDDEN, seed, "train", 0.02)
        time = log.time[0] + np.arange(len(log.time)) / rate
        q = np.stack([np.interp(time, log.time, column) for column in log["q"].T], axis=1)
        coarse = Trajectory("log", "train", time, {"q": np.round(q / step) * step, "tau": log["tau"]})
        assert at_pace_of_positions(coarse) is coarse


def test_joints_that_move_in_turn_and_rests_are_no_slow_stream() -> None:
    time = STEP * np.arange(ROWS)
    q = positions(time) * np.stack([time < 5.0, (time > 5.0) & (time < 8.0)], axis=1)
    noise = NOISE * np.random.default_rng(0).normal(size=(ROWS, 2))
    log = Trajectory("log", "train", time, {"q": q, "tau": torque(time) + noise})
    assert at_pace_of_positions(log) is log


def test_what_is_hidden_is_found_in_a_log_of_two_streams() -> None:
    """Without, the small arm had links and springs named for the staircase."""

    def streams(run: Trajectory) -> Trajectory:
        of_q, of_tau = np.arange(0.0, run.time[-1], 0.0133), np.arange(0.004, run.time[-1], 0.008)
        time = np.unique(np.concatenate([of_q, of_tau]))[1:]
        at = [
            np.stack([np.interp(taken, run.time, x) for x in run[name].T], axis=1)
            for name, taken in (("q", of_q), ("tau", of_tau))
        ]
        joined = {"q": at[0][latest(time, of_q)], "tau": at[1][latest(time, of_tau)]}
        (part,) = resample(Trajectory(run.name, run.split, time, joined))
        return part

    train = [streams(noisy_log(HIDDEN, seed, "train", 0.02)) for seed in (1, 2)]
    result = close_loop(arm(), train, [streams(noisy_log(HIDDEN, 3, "test", 0.02))])
    assert {(e.effect, e.joints) for e in result.model.effects} == {(e.effect, e.joints) for e in HIDDEN}


def _outer_join(streams: dict[str, tuple[Array, Array]]) -> pd.DataFrame:
    """``{signal: (stamps, values)}`` as one table with blanks, as pandas joins them."""
    tables = [
        pd.DataFrame(values, index=pd.Index(stamps, name="time"), columns=[f"{name}{j + 1}" for j in range(2)])
        for name, (stamps, values) in streams.items()
    ]
    return pd.concat(tables, axis=1).sort_index().reset_index()


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_streams_that_were_joined_with_blanks_are_read(tmp_path: Path, suffix: str) -> None:
    of_q, of_tau = np.arange(0.0, 6.0, 0.010), np.arange(0.003, 6.0, 0.0076)
    table = _outer_join({"q": (of_q, positions(of_q)), "tau": (of_tau, torque(of_tau))})
    file = tmp_path / f"log.{suffix}"
    write = {"csv": lambda t: t.to_csv(file, index=False), "parquet": lambda t: t.to_parquet(file)}[suffix]
    write(table)
    lines: list[str] = []
    raw = read_raw(file, ("a", "b"), notify=lines.append)
    assert raw.time[0] == of_tau[0], "before that there is no torque"
    assert ["q is blank in" in lines[0], "tau is blank in" in lines[1]] == [True, True]
    (run,) = pieces_of(file, raw, ("a", "b"))
    np.testing.assert_allclose(run["q"], positions(run.time), atol=1e-7)
    np.testing.assert_allclose(run["tau"][2:-2], torque(run.time)[2:-2], atol=1e-5)
    # What is blank otherwise is a fault of the log.
    for fault in (table.index % 2 == 0, table.index % 50 == 0):
        broken = table.ffill().dropna()
        columns = ["tau1"] if fault.sum() > len(broken) / 4 else ["tau1", "tau2"]
        broken.loc[fault[broken.index], columns] = np.nan
        write(broken)
        with pytest.raises(InputError, match=r"tau1', row .* expected a finite number"):
            read_raw(file, ("a", "b"))
