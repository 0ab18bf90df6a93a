"""Something that pushes against the arm for a while: told as that, not as a law of the motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.small_arm import arm, noisy_log

from hybrid_dynamics import predict
from hybrid_dynamics.effects import Effect
from hybrid_dynamics.loop import LoopResult, LoopSettings, Model, close_loop
from hybrid_dynamics.loop.boxes import STEP, Interval, Stretch, boxes
from hybrid_dynamics.loop.contact import Contact, _sharpened, named
from hybrid_dynamics.loop.prepare import read_motion
from hybrid_dynamics.loop_report.gather import gather
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

ROBOT = arm()
SHOULDER, ELBOW = ROBOT.joint_names
GREASE = Effect("viscous_friction", (ELBOW,), {"viscous_coefficient": 1.5})
#: Of the torque [N m], white.
NOISE = 0.1
PUSH, START, END = 0.8, 6.0, 9.0
LAWS = LoopSettings(effects=("viscous_friction", "torque_offset", "external_contact"))


def _pushed(log: Trajectory, torque: float = PUSH, joint: int = 1) -> Trajectory:
    """``log`` with a constant push from START to END [s]."""
    tau = log["tau"].copy()
    tau[(log.time >= START) & (log.time <= END), joint] += torque
    return replace(log, signals={**log.signals, "tau": tau})


def _logs(*pushed: str) -> tuple[list[Trajectory], list[Trajectory]]:
    """Two training runs and a test run; of those named ``pushed`` something pushes against the elbow."""
    every = [noisy_log([GREASE], seed, split, NOISE) for seed, split in ((1, "train"), (2, "train"), (51, "test"))]
    every = [_pushed(log) if log.name in pushed else log for log in every]
    return every[:2], every[2:]


def _contacts(result: LoopResult) -> list[Effect]:
    return [e for e in result.model.effects if e.effect == "external_contact"]


def _is_the_push(effect: Effect) -> None:
    assert effect.joints == (ELBOW,)
    ((start, end),) = effect.settings["intervals"]
    # Within the filter's window.
    assert (start, end) == pytest.approx((START, END), abs=0.06)
    assert abs(effect.parameters["torque"] - PUSH) < 3 * effect.std_errors["torque"]
    assert effect.std_errors["torque"] < 0.1 * PUSH


def test_a_push_in_one_run_is_told_with_its_time_and_its_run() -> None:
    result = close_loop(ROBOT, *_logs("train_1"))
    (contact,) = _contacts(result)
    _is_the_push(contact)
    assert contact.settings["only_run"] == "train_1"
    assert [(e.effect, e.joints) for e in result.model.effects if e != contact] == [("viscous_friction", (ELBOW,))]
    assert [e.confirmed for e in result.diagnosis.effects] == [True, True]
    assert result.diagnosis.verdict == "explained"
    # It says nothing of another run: nor of one of the same name that is predicted later.
    still = noisy_log([GREASE], 7, "train", NOISE)
    error = predict(result.model, replace(still, name="train_1")).rmse()
    assert error == pytest.approx(predict(result.model, still).rmse(), abs=1e-12)
    assert max(error) < 0.1 * PUSH


def test_the_page_shows_a_push_where_it_was() -> None:
    content = gather(close_loop(ROBOT, *_logs("train_1"), LAWS))
    (group,) = (g for g in content.groups if g.kind == "moment")
    assert (group.where, group.runs) == (ELBOW, ("train_1",))
    (curve,) = group.curves
    during = np.array(curve.added) != 0.0
    assert curve.axis == "time"
    assert np.median(np.array(curve.missing)[during]) == pytest.approx(PUSH, rel=0.05)
    # Of the whole run, as of other effects.
    assert group.contribution[0] == pytest.approx(PUSH * np.sqrt(during.mean()), rel=0.1)
    # Control: what acts in every run stands on the held-out ones.
    others = [g for g in content.groups if g is not group]
    assert others
    assert all(g.runs == () for g in others)


def test_a_push_in_every_run_acts_in_every_run() -> None:
    result = close_loop(ROBOT, *_logs("train_1", "train_2", "test_51"))
    (contact,) = _contacts(result)
    _is_the_push(contact)
    assert "only_run" not in contact.settings
    assert result.diagnosis.verdict == "explained"
    before, after = (getattr(result.diagnosis.error["test"], when).rmse[1] for when in ("before", "after"))
    # But for its edges, which are a sample off.
    assert after < 0.1 * before
    # What it takes of what the law before it left: all but these.
    (told,) = (e for e in result.diagnosis.to_json()["effects"] if e["effect"] == "external_contact")
    shares = [np.sum(np.square(told[f"test_rmse_{when}"])) for when in ("before", "after")]
    assert told["test_change"]["value"] == pytest.approx(shares[1] / shares[0] - 1.0, abs=1e-9)
    assert -1.0 < told["test_change"]["value"] < -0.9


def test_a_push_in_every_training_run_but_in_no_test_run_is_told_run_by_run() -> None:
    contacts = _contacts(close_loop(ROBOT, *_logs("train_1", "train_2")))
    assert sorted(c.settings["only_run"] for c in contacts) == ["train_1", "train_2"]
    for contact in contacts:
        _is_the_push(contact)


def test_runs_of_different_rates_are_scanned_each_at_its_own() -> None:
    (first, second), test = _logs("train_1", "train_2", "test_51")
    every_third = np.arange(0, len(second.time), 3)
    thin = replace(
        second, time=second.time[every_third], signals={k: v[every_third] for k, v in second.signals.items()}
    )
    contacts = _contacts(close_loop(ROBOT, [first, thin], test, LAWS))
    assert {c.settings.get("only_run", "every") for c in contacts} in ({"every"}, {"train_1", "train_2"})
    for contact in contacts:
        _is_the_push(contact)


def test_a_push_in_a_test_run_is_told_with_its_time() -> None:
    result = close_loop(ROBOT, *_logs("test_51"), LAWS)
    assert not _contacts(result)
    (line,) = [n for n in result.diagnosis.notes if "pushed" in n]
    assert f"run test_51: from {START:.1f}" in line
    assert ELBOW in line
    assert [(e.effect, e.joints) for e in result.model.effects] == [("viscous_friction", (ELBOW,))]


@pytest.mark.parametrize(
    ("size", "seconds", "is_one"),
    [(2.0, 1.0, True), (0.01, 1.0, False), (2.0, 0.2, False)],
    ids=["a push", "too weak", "too short"],
)
def test_a_contact_is_named_where_it_is_strong_and_lasts(size: float, seconds: float, is_one: bool) -> None:
    train, test = _logs()
    runs = read_motion(ROBOT, train, test, LoopSettings()).train
    dt = float(np.median(np.diff(runs[0].time)))
    start, rows = len(runs[0].time) // 2, round(seconds / dt)
    tau = runs[0].tau.copy()
    tau[start : start + rows, 1] += size
    pushed = [replace(runs[0], tau=tau), *runs[1:]]
    mask = [run.mask.copy() for run in pushed]
    mask[0][start - 30 : start + rows + 30, 1] = False
    contact = Contact(1, Interval(0, start, start + rows))
    found = named(Model(ROBOT, (GREASE,)), pushed, mask, [contact], "external_contact")
    assert [e.joints for e in found] == ([(ELBOW,)] if is_one else [])


def test_without_a_push_and_where_none_is_asked_for_none_is_told() -> None:
    assert not _contacts(close_loop(ROBOT, *_logs()))
    asked = close_loop(ROBOT, *_logs("train_1"), LoopSettings(effects=("viscous_friction", "torque_offset")))
    assert not _contacts(asked)
    assert asked.diagnosis.verdict != "explained"


# -- boxes alone --------------------------------------------------------------------------------------------------
DT, WINDOW = 0.01, 0.05

#: A motion that never returns, and what a law of it may be made of.
CLOCK = np.arange(2000) * DT
STATES = np.column_stack([np.sin(0.7 * CLOCK), np.cos(1.9 * CLOCK), np.sin(3.1 * CLOCK + 1), CLOCK / 5])
COLUMNS = np.column_stack([np.ones(2000), STATES[:, :3], np.sign(STATES[:, 1])])


def _stretch(left: Array, states: Array = STATES) -> Stretch:
    return Stretch(COLUMNS, left, np.ones(2000, bool), states)


def _box(start: float, length: float) -> Array:
    return ((start <= CLOCK) & (start + length > CLOCK)).astype(float)


@given(
    start=st.floats(1.0, 12.0), length=st.floats(0.8, 6.0), size=st.floats(0.5, 50.0), sign=st.sampled_from([-1.0, 1.0])
)
def test_a_box_above_the_noise_is_found_to_a_step(start: float, length: float, size: float, sign: float) -> None:
    noise = 0.1 * np.random.default_rng(1).normal(size=2000)
    law = COLUMNS @ np.array([1.0, -2.0, 0.5, 1.5, 0.7])
    (found,) = boxes([_stretch(law + sign * size * _box(start, length) + noise)], DT, WINDOW)
    ends = np.array([found.start, found.stop]) * DT
    assert np.abs(ends - [start, start + length]).max() <= STEP + DT


@pytest.mark.parametrize("seed", range(20))
def test_noise_however_it_is_coloured_is_no_box(seed: int) -> None:
    rng = np.random.default_rng(seed)
    white = rng.normal(size=2000)
    slow = np.convolve(rng.normal(size=2400), np.exp(-np.arange(400) / 40.0))[400:2400]
    for left in (white, slow, np.cumsum(white) / 20, white + 3 * np.sin(2.3 * CLOCK)):
        assert boxes([_stretch(left)], DT, WINDOW) == []


def test_what_comes_gradually_or_returns_with_the_motion_is_no_box() -> None:
    noise = 0.05 * np.random.default_rng(4).normal(size=2000)
    hill = np.exp(-0.5 * ((CLOCK - 8.0) / 0.8) ** 2)
    assert boxes([_stretch(2 * hill + noise)], DT, WINDOW) == []
    both = _box(3.0, 1.0) + _box(13.0, 1.0)
    twice = [Interval(None, 300, 400), Interval(None, 1300, 1400)]
    assert sorted(boxes([_stretch(both + noise)], DT, WINDOW), key=lambda i: i.start) == twice
    # Control: the same where the motion repeats after 10 s.
    again = np.column_stack([np.sin(2 * np.pi * CLOCK / 10), np.cos(2 * np.pi * CLOCK / 10)])
    assert boxes([_stretch(both + noise, again)], DT, WINDOW) == []


def test_boxes_at_the_same_time_of_every_run_are_one() -> None:
    runs = [_stretch(_box(4.0, 2.0) + 0.3 * np.random.default_rng(s).normal(size=2000)) for s in (1, 2)]
    turned = replace(runs[1], states=-runs[1].states[::-1])
    (found,) = boxes([runs[0], turned], DT, WINDOW)
    assert found.run is None
    assert [found.start, found.stop] == pytest.approx([400, 600], abs=2)


@pytest.mark.parametrize(("steps", "is_found"), [(0.5, True), (1.8, True), (3.0, False)])
@pytest.mark.parametrize("dt", [0.01, 0.002])
def test_ends_of_a_push_are_found_to_a_row_where_they_lie_within_two_steps(
    dt: float, steps: float, is_found: bool
) -> None:
    off, start, stop = round(steps * STEP / dt), 2000, 3000
    left = 0.01 * np.random.default_rng(0).normal(size=5000)
    left[start:stop] += 1.0
    seen = np.ones(5000, bool)
    seen[2400:2450] = False
    for own in (Interval(0, start - off, stop + off), Interval(0, start + off, stop - off)):
        assert (_sharpened([left], [seen], own, dt) == Interval(0, start, stop)) is is_found
