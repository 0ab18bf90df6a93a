"""A log against a completed model: what the model knows is no fault, and what it hits only read otherwise is one."""

import numpy as np
import pytest
from tests.small_arm import HIDDEN, arm

from hybrid_dynamics.check import checked_log
from hybrid_dynamics.effects import Effect
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.simulation.excitation import excitation
from hybrid_dynamics.trajectory import Trajectory

#: A strong spring against gravity, a base on a wall, and readings that are off: none of it is in the URDF.
SPRING = Effect("joint_spring", ("elbow",), {"stiffness": 25.0, "rest_position": 0.4}, {"shape": "linear"})
WALL = Effect("gravity_tilt", (), {"roll": 0.0, "pitch": np.pi / 2})
READINGS = (
    Effect("position_offset", ("shoulder",), {"offset": 0.3}),
    Effect("torque_gain", ("elbow",), {"gain": 1.8}),
    Effect("time_delay", (), {"delay": 0.09}),
)


def log(*effects: Effect, seed: int = 1, duration: float = 8.0) -> Trajectory:
    return excitation(arm(), effects, seed=seed, duration=duration, rate=200.0)


def doubts(model: Model, run: Trajectory) -> list[str]:
    """What is found but limits; refused: its line."""
    try:
        return [f.code for f in checked_log(model, run)[1] if not f.code.startswith("beyond")]
    except InputError as error:
        return [str(error)]


@pytest.mark.parametrize("effects", [HIDDEN, (SPRING,), (WALL,), READINGS], ids=["friction", "spring", "wall", "read"])
@pytest.mark.parametrize("duration", [3.0, 12.0])
def test_what_the_model_knows_is_no_fault(effects, duration):
    run = log(*effects, duration=duration)
    assert doubts(Model(arm(), effects), run) == []
    for name, signs in {"tau": (-1.0, 1.0), "q": (1.0, -1.0)}.items():
        (line,) = doubts(Model(arm(), effects), run.with_signals(**{name: run[name] * signs}))
        assert "sign" in line, "the control"


def test_a_base_that_stands_otherwise_than_the_models_is_refused():
    (line,) = doubts(Model(arm()), log(WALL, *HIDDEN))
    assert line.startswith("the base does not stand as the model says: gravity is found at ")
    assert "run close-loop on logs of this one" in line


@pytest.mark.parametrize("seed", range(6))
def test_columns_of_a_small_arm_in_another_order_are_refused(seed):
    """Two joints in parallel: a robot with springs and tools could explain some of these logs, its model cannot."""
    run, model = log(*HIDDEN, seed=seed), Model(arm(), HIDDEN)
    assert doubts(model, run) == []
    for signals in (("q", "tau"), ("tau",), ("q",)):
        (line,) = doubts(model, run.with_signals(**{s: run[s][:, ::-1] for s in signals}))
        assert "exchange the columns" in line or "wrong sign" in line or "turned round" in line, line


def test_what_a_model_lacks_is_no_fault():
    """A payload and a spring that came later: the prediction is off, and the log is right."""
    inertia = {f"inertia_{i}": 0.0 for i in ("xx", "xy", "yy", "xz", "yz", "zz")}
    later = (Effect("payload", (), {"mass": 2.0, "com_x": 0.0, "com_y": 0.0, "com_z": 0.1, **inertia}), SPRING)
    for seed in range(4):
        for effects in (later, later[:1], later[1:]):
            assert not any(" " in line for line in doubts(Model(arm(), HIDDEN), log(*HIDDEN, *effects, seed=seed)))


def test_a_constant_torque_and_one_that_is_missing_say_nothing():
    run = log(*HIDDEN)
    swapped = run.with_signals(q=run["q"][:, ::-1])
    still = swapped.with_signals(tau=np.full_like(run["tau"], 2.0))
    bare = Trajectory("bare", "test", run.time, {"q": swapped["q"]})
    assert doubts(Model(arm(), HIDDEN), still) == doubts(Model(arm(), HIDDEN), bare) == []
