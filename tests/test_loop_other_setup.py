"""Test runs of another tool, mounting or clock than the training runs: told, beside what they contradict."""

from dataclasses import replace

import numpy as np
import pytest
from tests.small_arm import HIDDEN, arm

from hybrid_dynamics import close_loop
from hybrid_dynamics.effects import Effect, predict
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.simulation.excitation import excitations
from hybrid_dynamics.trajectory import Trajectory

ROBOT = arm()
TOOL = Effect(
    "payload",
    (),
    {
        "mass": 1.5,
        **{"com_x": 0.02, "com_y": 0.0, "com_z": 0.35},
        **{"inertia_xx": 0.01, "inertia_yy": 0.01, "inertia_zz": 0.002},
        **dict.fromkeys(("inertia_xy", "inertia_xz", "inertia_yz"), 0.0),
    },
)
TILT = Effect("gravity_tilt", (), {"roll": 0.0, "pitch": 0.2})
LATE = Effect("time_delay", (), {"delay": 0.03})


def logs(train, test):
    """Two training runs with the effects ``train`` and a test run with those of ``test``, beside what is hidden."""
    options = {"duration": 8.0, "rate": 400.0}
    learned = excitations(ROBOT, [*HIDDEN, *train], train=2, test=1, **options)[0]
    return learned, excitations(ROBOT, [*HIDDEN, *test], train=2, test=1, **options)[1]


def told(result) -> list[str]:
    return [note for note in result.diagnosis.notes if "than in the training runs" in note and "learn from and" in note]


@pytest.mark.parametrize(
    ("train", "test", "words"),
    [
        ([TOOL], [], "carried another load"),
        ([], [TOOL], "carried another load"),
        ([], [TILT], "was mounted otherwise"),
        ([], [LATE], "recorded later or earlier"),
    ],
    ids=["tool taken off", "tool put on", "tilted", "late"],
)
def test_test_runs_of_another_set_up_are_told_as_that(train, test, words):
    result = close_loop(ROBOT, *logs(train, test))
    (note,) = told(result)
    assert words in note
    assert result.diagnosis.verdict != "explained"
    refused = [e for e in result.diagnosis.to_json()["effects"] if not e["confirmed"]]
    assert all(e["why_not"] in note for e in refused), "names that only the other set-up contradicts say so"
    assert bool(refused) == (train != [])
    values = {word: float(note.split(f"{word} ")[1].split(" ")[0]) for word in ("pitch", "delay") if word in note}
    assert all(value == pytest.approx({"pitch": 0.2, "delay": 0.03}[word], rel=0.1) for word, value in values.items())


def test_a_tool_that_was_exchanged_is_no_wrong_unit():
    light = replace(TOOL, parameters={**TOOL.parameters, "mass": 0.5})
    (note,) = told(close_loop(ROBOT, *logs([TOOL], [light])))
    assert "carried another load" in note
    train, test = logs([], [])
    scaled = [run.with_signals(tau=0.6 * run["tau"]) for run in test]
    with pytest.raises(InputError, match="N m"):
        close_loop(ROBOT, train, scaled)


def test_one_test_run_of_another_set_up_is_named():
    options = {"duration": 8.0, "rate": 400.0}
    train = excitations(ROBOT, HIDDEN, train=2, test=2, **options)
    other = excitations(ROBOT, [*HIDDEN, TOOL], train=2, test=2, **options)
    (note,) = told(close_loop(ROBOT, train[0], [train[1][0], other[1][1]]))
    assert note.startswith("run test_2 looks as if the arm carried another load")


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("law", ["cubic spring", "coupling"])
def test_a_missing_law_elsewhere_is_no_other_set_up(seed, law):
    """Learned from on one side and tested on the other, a payload fits what is missing; there nobody has been."""

    def at(split, centre, number):
        rng = np.random.default_rng(10 * seed + number)
        time = np.arange(3200) / 400.0
        waves = sum(np.sin(2 * np.pi * f * time[:, None] + rng.uniform(0, 6.28, 2)) / f for f in (0.3, 0.5, 0.8))
        q = np.array(centre) + 0.1 * waves
        dq = np.gradient(q, time, axis=0)
        tau = predict(ROBOT, HIDDEN, q, dq, np.gradient(dq, time, axis=0), time)
        tau += 3.0 * q**3 if law == "cubic spring" else 3.0 * np.sin(q.sum(axis=1, keepdims=True)) * [1.0, 1.0]
        return Trajectory(f"{split}_{number}", split, time, {"q": q, "tau": tau + 0.02 * rng.normal(size=q.shape)})

    train = [at("train", (-0.8, -0.5), k) for k in (1, 2)]
    assert told(close_loop(ROBOT, train, [at("test", (0.8, 0.7), 3)])) == []


@pytest.mark.parametrize("both", [[], [TOOL], [TILT]], ids=["nothing", "a tool", "tilted"])
def test_runs_of_one_set_up_are_none_of_two(both):
    assert told(close_loop(ROBOT, *logs(both, both))) == []


def test_a_law_that_the_model_lacks_is_no_other_set_up():
    """Friction that grows with the position, ten times as much in the test run: the model does not carry over."""

    def with_law(run, strength):
        return run.with_signals(tau=run["tau"] + strength * np.sign(np.gradient(run["q"], axis=0)) * run["q"] ** 2)

    train, test = logs([], [])
    result = close_loop(ROBOT, [with_law(r, 0.5) for r in train], [with_law(r, 5.0) for r in test])
    assert result.diagnosis.verdict != "explained"
    assert told(result) == []
