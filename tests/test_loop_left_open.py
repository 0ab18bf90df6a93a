"""What runs leave open is said, however sure the fit's own scatter is of it."""

import numpy as np
import pytest
from tests.two_links import two_links

from hybrid_dynamics.effects import Effect
from hybrid_dynamics.loop import LoopSettings, Model
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.identifiability import undetermined
from hybrid_dynamics.loop.process import ProcessSettings, process
from hybrid_dynamics.trajectory import Trajectory

ROBOT = two_links()
COULOMB = Effect("coulomb_friction", ("elbow",), {"coulomb_torque": 2.0})
OFFSET = Effect("torque_offset", ("elbow",), {"offset": 0.5})
VISCOUS = Effect("viscous_friction", ("elbow",), {"viscous_coefficient": 1.0})


def open_of(back: float, *effects: Effect) -> list[list[str]]:
    """What a run of the elbow leaves open that turns on at .2 rad/s, give or take ``back`` rad/s, of each effect."""
    time = np.arange(0.0, 8.0, 0.005)
    elbow = 0.2 * time - back / 3.0 * np.cos(3.0 * time)
    q = np.column_stack([np.sin(time), elbow - elbow.mean()])
    dq = np.gradient(q, time, axis=0)
    tau = Model(ROBOT, effects).predict(q, dq, np.gradient(dq, time, axis=0), time)
    run = process(Trajectory("run", "train", time, {"q": q, "tau": tau}), ROBOT, ProcessSettings())
    terms = [e.term(ROBOT) for e in effects]
    evidence = Evidence(Model(ROBOT), [run], terms, LoopSettings())
    return [undetermined(evidence, terms, term) for term in terms]


def test_on_a_joint_that_turns_one_way_friction_and_offset_are_one_constant() -> None:
    assert open_of(0.1, COULOMB, OFFSET, VISCOUS) == [["coulomb_torque"], ["offset"], []]


@pytest.mark.parametrize("effects", [(COULOMB, VISCOUS), (OFFSET, VISCOUS)])
def test_one_of_them_alone_is_known(effects: tuple[Effect, ...]) -> None:
    assert open_of(0.1, *effects) == [[], []]


def test_a_joint_that_turns_back_tells_them_apart() -> None:
    # Control: a tenth of the time backwards.
    assert open_of(0.25, COULOMB, OFFSET, VISCOUS) == [[], [], []]
