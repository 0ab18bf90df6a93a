"""Selection by itself: what counts as good as, and what may replace what, on held-out errors written by hand."""

from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
import pytest

from hybrid_dynamics.effects import Effect, Slot, family
from hybrid_dynamics.effects.inertia import BODY_PARAMETERS, to_body, to_dynamic
from hybrid_dynamics.loop import LoopSettings, Model
from hybrid_dynamics.loop.augment import _replace, search
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.exercise import exercises
from hybrid_dynamics.loop.noise import noise_floor
from hybrid_dynamics.loop.process import process
from hybrid_dynamics.loop.trace import Judge, rank
from hybrid_dynamics.robots import Robot, find_description

VISCOUS, CURVED = Slot("viscous_friction", 0), Slot("nonlinear_viscous_friction", 0)
OTHER = Slot("coulomb_friction", 1)
BLOCKS = 20


@dataclass
class Told:
    """Stands for the evidence: squared errors (blocks, 1 joint) of every set of slots, ten samples a block."""

    errors: dict[frozenset[Slot], np.ndarray]
    weights: np.ndarray = field(default_factory=lambda: np.ones(1))
    samples: np.ndarray = field(default_factory=lambda: np.array([10.0 * BLOCKS]))
    n: int = 1

    def held_out(self, slots: Any, physical: bool = False) -> np.ndarray:
        return self.errors[frozenset(slots)][:, None]

    def acts(self, slot: Slot) -> np.ndarray:
        return np.ones(1, bool)

    def constrained(self, slots: Any) -> bool:
        return False


def judge(errors: dict[frozenset[Slot], np.ndarray]) -> Judge:
    """Noise floor 1 N m: ten samples a block make 10 (N m)^2 of noise."""
    return Judge(cast(Evidence, Told(errors)), LoopSettings(), np.ones(1), np.ones(1))


def wavering(mean: float, by: float) -> np.ndarray:
    return mean + by * np.where(np.arange(BLOCKS) % 2, 1.0, -1.0)


@pytest.mark.parametrize(("worse_by", "first"), [(0.5, VISCOUS), (4.0, CURVED)])
def test_of_two_that_may_be_named_the_simpler_wins_unless_the_loss_matters(worse_by, first):
    nothing, curved = wavering(60, 1), wavering(11, 1)
    # Worse in every block by the same: certain. 0.5 of 10 is below keep_share (0.1) of a squared floor, 4 is above.
    told = {frozenset(): nothing, frozenset([CURVED]): curved, frozenset([VISCOUS]): curved + worse_by}
    table = rank(judge(told), [], [VISCOUS, CURVED], nothing[:, None])
    assert table[0].slot == first
    assert all(c.accepted for c in table)


@pytest.mark.parametrize(("wavers", "enters"), [(30.0, False), (0.1, True)])
def test_being_simpler_lets_nothing_in_that_explains_nothing_surely(wavers, enters):
    nothing, curved = wavering(20, 0), wavering(15, 0)
    told = {frozenset(): nothing, frozenset([CURVED]): curved, frozenset([OTHER]): wavering(15, wavers)}
    replaced = _replace(judge(told), [CURVED], [CURVED, OTHER], curved[:, None], {frozenset([CURVED])})
    assert (replaced == [OTHER]) is enters


FAMILIES = ("armature", "link_inertia", "torque_offset")


def start_from_body(robot: Robot, effects: list[Effect]) -> list[Slot]:
    """What a search ends with that begins where the inertia of the second link has been named."""
    runs = [
        process(t, robot, LoopSettings().process) for t in exercises(robot, effects, train=3, test=1, duration=8.0)[0]
    ]
    moving = np.ones(robot.n_joints, bool)
    slots = [s for name in FAMILIES for s in family(name).slots(robot, moving, LoopSettings().options)]
    evidence = Evidence(Model(robot), runs, slots, LoopSettings())
    floor = noise_floor(evidence)
    evidence.weights = 1 / floor**2
    torque = np.concatenate([run.tau for run in runs]).var(axis=0)
    steps = search(Judge(evidence, LoopSettings(), floor, torque), slots, lambda step: None, [Slot("link_inertia", 1)])
    return sorted(steps[-1].slots)


def test_a_body_gives_way_to_two_simple_effects_that_explain_as_much_and_a_true_one_stays():
    robot = Robot.from_urdf(find_description("panda.urdf"), lock=("panda_finger_joint1", "panda_finger_joint2"))
    joint = robot.joint_names[1]
    simple = [Effect("armature", (name,), {"armature": 0.3}) for name in robot.joint_names[:2]]
    assert start_from_body(robot, simple) == [Slot("armature", 0), Slot("armature", 1)]
    own = np.asarray(robot.model.inertias[robot.joint_ids[1]].toDynamicParameters())
    heavier = own + to_dynamic({p.name: 0.0 for p in BODY_PARAMETERS} | {"mass": 2.0, "com_z": -0.1, "com_x": 0.1,
                               "inertia_xx": 0.01, "inertia_yy": 0.01, "inertia_zz": 0.01})  # fmt: skip
    assert start_from_body(robot, [Effect("link_inertia", (joint,), to_body(heavier))]) == [Slot("link_inertia", 1)]
