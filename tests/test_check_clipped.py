"""Torque that is cut off at the end of what is measured: seen, told, and no evidence for anything."""

from dataclasses import replace

import numpy as np
import pytest
from tests.small_arm import HIDDEN, arm, runs, write_logs

from hybrid_dynamics import close_loop
from hybrid_dynamics.check import checked
from hybrid_dynamics.check.clipped import check_clipped, clipped_samples
from hybrid_dynamics.cli import main
from hybrid_dynamics.loop.model import Model, save_model
from hybrid_dynamics.loop.process import ProcessSettings, process
from hybrid_dynamics.readers import write_log
from hybrid_dynamics.readers.resample import resample
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory

ONE_JOINT = Robot.from_text(
    """<robot name="rotor"><link name="base"/><link name="a"><inertial><mass value="1"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
    <joint name="a" type="continuous"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/></joint></robot>""",
    "one joint",
)


@pytest.fixture(scope="module")
def run() -> Trajectory:
    return runs(train=1, test=1)[0][0]


def cut_off(run: Trajectory, share: float = 0.6) -> Trajectory:
    limit = share * np.abs(run["tau"]).max(axis=0)
    return run.with_signals(tau=np.clip(run["tau"], -limit, limit))


@pytest.mark.parametrize("cycles", [1, 3, 40])
@pytest.mark.parametrize("levels", [6, 9, 20, 90])
def test_a_wave_on_a_coarse_converter_is_clipped_only_where_it_is_cut_off(cycles, levels):
    wave = np.sin(2 * np.pi * cycles * np.arange(4000) / 4000 + 0.1)

    def found(tau):
        log = Trajectory("run", "train", np.arange(4000) / 200, {"q": wave[:, None], "tau": tau[:, None]})
        return bool(check_clipped(log, ONE_JOINT))

    step = 2 / levels
    assert not found(np.round(wave / step) * step)
    assert not found(wave)
    # Of a handful of levels the last may hold as much by itself.
    assert levels < 20 or found(np.clip(np.round(wave / step) * step, -0.7, 0.7))
    assert found(np.clip(wave, -0.7, 0.7))


def test_a_torque_that_is_cut_off_is_told_by_the_loop_too_and_one_of_a_rest_is_none(run, tmp_path, capsys):
    logs, clipped = write_logs(tmp_path), cut_off(run)
    limit = np.abs(clipped["tau"]).max(axis=0)

    def told(log):
        return [f.line for f in checked(arm(), [log], [], refuse=False).findings if f.code == "saturation"]

    (line,) = told(clipped)
    assert f"at {limit[0]:.4g} N m" in line or f"at {-limit[0]:.4g} N m" in line
    assert told(run) == []
    # Where the arm holds its largest torque at rest, nothing is cut off.
    most = int(np.argmax(np.abs(run["tau"][:, 0])))
    still = np.concatenate([np.arange(most), np.full(400, most), np.arange(most, len(run.time))])
    waits = replace(
        run, time=run.time[0] + run.dt * np.arange(len(still)), signals={s: x[still] for s, x in run.signals.items()}
    )
    assert told(waits.with_signals(dq=np.gradient(waits["q"], waits.dt, axis=0))) == []
    # By check it is told once, of the log as it was recorded.
    write_log(tmp_path / "clipped.parquet", clipped, arm().joint_names)
    with pytest.raises(SystemExit):
        main(["check", "--robot", str(logs / "robot.urdf"), "--data", str(tmp_path / "clipped.parquet")])
    assert capsys.readouterr().out.count("saturation") == 1


def test_of_a_torque_that_is_cut_off_no_row_counts_whose_window_holds_such_samples(run):
    settings = ProcessSettings()
    whole, cut = process(run, arm(), settings), process(cut_off(run), arm(), settings)
    away = whole.mask & ~cut.mask
    assert not np.any(cut.mask & ~whole.mask)
    limit = np.abs(cut_off(run)["tau"]).max(axis=0)
    # Where the smoothed torque is not the true one, samples were cut off; a window further away is none the worse.
    wrong = np.abs(whole.tau - cut.tau) > 1e-6 * limit
    assert away.any(axis=0).all()
    assert not np.any(wrong & cut.mask)
    assert np.mean(away) < 2 * np.mean(wrong)


def test_samples_that_are_cut_off_are_seen_after_a_log_of_uneven_stamps_is_resampled(run):
    rng = np.random.default_rng(0)
    time = run.time + 0.2 * run.dt * rng.uniform(-1, 1, len(run.time))
    clipped = cut_off(run)
    (even,) = resample(replace(clipped, time=time), notify=lambda text: None)
    was = clipped_samples(clipped, arm())
    seen = clipped_samples(even, arm())
    assert not clipped_samples(resample(replace(run, time=time), notify=lambda text: None)[0], arm()).any()
    # But for some samples beside a corner, at which the spline rings.
    assert abs(seen.mean() - was.mean()) < 0.2 * was.mean()


@pytest.mark.parametrize("share", [0.8, 0.6])
def test_nothing_is_named_for_torque_that_is_cut_off(share):
    train, test = runs()
    found = close_loop(arm(), [cut_off(r, share) for r in train], [cut_off(r, share) for r in test])
    hidden = {(e.effect, e.joints): e.parameters for e in HIDDEN}
    assert {(e.effect, e.joints) for e in found.model.effects} == set(hidden)
    assert found.diagnosis.verdict == "explained"
    for effect in found.model.effects:
        for name, value in hidden[effect.effect, effect.joints].items():
            assert abs(effect.parameters[name] - value) < 4 * effect.std_errors[name] + 0.003 * abs(value)
    assert any("close-loop leaves these stretches out" in note for note in found.diagnosis.notes)
    # All samples or those in motion: of what was cut off no error says anything.
    for errors in (found.diagnosis.error, found.diagnosis.error_moving):
        left = errors["test"].after.relative_error
        assert left is not None
        assert left < 0.03


def test_what_is_cut_off_at_rest_is_no_push_against_the_arm():
    def rests(run):
        """``run`` that stops for a second, four times, where it is."""
        at = np.linspace(0, len(run.time) - 1, 6).astype(int)[1:-1]
        rows = np.sort(np.concatenate([np.arange(len(run.time)), *(np.full(400, k) for k in at)]))
        noise = np.random.default_rng(0).normal(size=(len(rows), 2))
        q = run["q"][rows] + 1e-5 * noise
        tau = arm().inverse_dynamics(q, np.zeros_like(q), np.zeros_like(q)) + 0.02 * noise
        still = np.concatenate([[False], np.diff(rows) == 0])
        tau = np.where(still[:, None], tau, run["tau"][rows])
        return Trajectory(run.name, run.split, run.dt * np.arange(len(rows)), {"q": q, "tau": tau})

    train, test = runs()
    pairs = [[cut_off(rests(r), 0.4) for r in part] for part in (train, test)]
    notes = close_loop(arm(), *pairs).diagnosis.notes
    assert not [note for note in notes if "while it stands" in note]


def test_even_acceleration_asks_for_an_even_torque():
    """Along trapezoidal speeds, the way of most controllers, torque stands at two values and nothing is cut off."""
    time = np.arange(4000) / 400.0
    ddq = 4.0 * np.select([time % 2 < 0.5, time % 2 > 1.5], [1.0, 1.0], -1.0) * (np.abs(time % 1 - 0.5) > 0.15)
    dq = np.cumsum(ddq) / 400.0
    q = np.cumsum(dq - dq.mean()) / 400.0 + 1e-5 * np.random.default_rng(0).normal(size=len(time))
    tau = ddq + 0.4 * np.sign(dq) + 1e-3 * np.random.default_rng(1).normal(size=len(time))
    log = Trajectory("run", "train", time, {"q": q[:, None], "tau": np.round(tau, 2)[:, None]})
    assert not clipped_samples(log, ONE_JOINT).any()
    # The control: a wave whose tops are cut off.
    wave = 2.0 * np.sin(3.0 * time)
    cut = log.with_signals(q=(-wave / 9.0)[:, None], tau=np.clip(wave, -1.75, 1.75)[:, None])
    assert clipped_samples(cut, ONE_JOINT).any()


def test_predict_tells_of_a_torque_that_is_cut_off(run, tmp_path, capsys):
    logs = write_logs(tmp_path)
    write_log(tmp_path / "cut.parquet", cut_off(run), arm().joint_names)
    save_model(tmp_path / "model.json", Model(arm(), HIDDEN))
    asked = ["predict", "--robot", logs / "robot.urdf", "--model", tmp_path / "model.json", "--out", tmp_path / "t.csv"]
    with pytest.raises(SystemExit) as stop:
        main([*map(str, asked), "--data", str(tmp_path / "cut.parquet")])
    assert stop.value.code in (None, 0)
    said = capsys.readouterr()
    assert "clipped" in said.out + said.err


def test_dry_friction_without_noise_is_constant_and_not_cut_off():
    """A light joint in a simulator: its torque is at one of two values, and that is all there is to learn from it."""
    time = np.arange(4000) / 200.0
    q = np.sin(1.3 * time)
    log = Trajectory("run", "train", time, {"q": q[:, None], "tau": np.sign(np.gradient(q))[:, None]})
    assert not clipped_samples(log, ONE_JOINT).any()
    # The control: with the torque of a rotor on top, of which the peaks are cut off.
    inertia = log.with_signals(tau=np.clip(log["tau"] - 0.8 * q[:, None], -1.6, 1.6))
    assert 0.0 < clipped_samples(inertia, ONE_JOINT).mean() < 1 / 3
    # And one that is cut off for most of the time: told, and kept.
    most = log.with_signals(tau=np.clip(q[:, None], -0.7, 0.7))
    (told,) = check_clipped(most, ONE_JOINT)
    assert "too much to be left out" in told.text
    assert not clipped_samples(most, ONE_JOINT).any()


@pytest.mark.parametrize("hold", [1, 4, 13])
def test_a_torque_that_comes_more_slowly_than_the_rows_repeats_each_value(run, hold):
    slow = np.arange(len(run.time)) // hold * hold
    held = run.with_signals(tau=run["tau"][slow])
    assert not clipped_samples(held, arm()).any()
    cut = cut_off(run)
    assert clipped_samples(cut.with_signals(tau=cut["tau"][slow]), arm()).any(axis=0).all()
