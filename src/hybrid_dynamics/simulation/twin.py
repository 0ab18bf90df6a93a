"""Simulated twins: published friction and realistic sensors, in place of a recording that cannot be had."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid_dynamics.errors import InputError, require
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.simulation.controller import ControllerSettings, make_controller
from hybrid_dynamics.simulation.dataset import run_until_accepted
from hybrid_dynamics.simulation.effects import JointEffects, coulomb, offset, viscous
from hybrid_dynamics.simulation.references import Reference, ReferenceSettings, derive_seed, multi_sine
from hybrid_dynamics.simulation.rollout import Refusal, Rollout, SimulationSettings, simulate
from hybrid_dynamics.simulation.sensors import SensorSettings, record, true_run
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Progress

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class DriveFriction:
    """Drive losses per joint (empty: none): ``viscous`` [N m s/rad], ``coulomb`` [N m], ``offset`` [N m] and the
    rotors' ``armature`` [kg m^2] seen at the joint."""

    viscous: tuple[float, ...] = ()
    coulomb: tuple[float, ...] = ()
    offset: tuple[float, ...] = ()
    armature: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        for name in ("viscous", "coulomb", "armature"):
            values = getattr(self, name)
            require(all(x >= 0 for x in values), f"friction.{name} = {list(values)}; expected numbers >= 0")

    def check(self, robot: Robot) -> None:
        """Raise :class:`ConfigError` unless every list has one number per joint of ``robot``."""
        for name in ("viscous", "coulomb", "offset", "armature"):
            count = len(getattr(self, name))
            require(
                count in (0, robot.n_joints),
                f"friction.{name} holds {count} numbers; robot {robot.name} has {robot.n_joints} joints",
            )

    def effects(self, robot: Robot) -> JointEffects:
        """Viscous, Coulomb and offset torques as simulated effects."""
        self.check(robot)
        out = JointEffects()
        if self.viscous:
            out += viscous(self.viscous)
        if self.coulomb:
            out += coulomb(self.coulomb)
        if self.offset:
            out += offset(self.offset)
        return out


def with_armature(robot: Robot, armature: Sequence[float]) -> Robot:
    """A copy of ``robot`` with rotor inertias ``armature`` (n,) [kg m^2] (in the robot's joint order) added."""
    out = robot.copy()
    values = np.array(out.model.armature)
    values[out._v] += np.asarray(armature, float)
    out.model.armature = values
    return out


@dataclass(frozen=True)
class Recording:
    """A simulated log: ``recorded`` (q, tau, dq where measured) and the noise-free ``truth`` (q dq ddq dddq tau)."""

    recorded: Trajectory
    truth: Trajectory


def simulate_recordings(
    robot: Robot,
    settings: SimulationSettings,
    sensors: SensorSettings,
    references: ReferenceSettings | Sequence[Reference] | None = None,
    *,
    effects: JointEffects | None = None,
    true_robot: Robot | None = None,
    control: ControllerSettings | None = None,
    n_train: int = 3,
    n_test: int = 1,
    seed: int = 0,
    names: Sequence[str] = (),
    progress: Progress | None = None,
) -> list[Recording]:
    """Simulate ``true_robot`` (default: ``robot``) with ``effects`` and record it; training runs first.

    The controller compensates the gravity of ``robot``, and knows nothing else of the truth (its gains suit both).
    ``references``: how to draw multi-sines (``n_train`` + ``n_test`` of ``settings.duration``), or the references to
    follow (the first ``n_train`` train, the others test; sampled at ``settings.control_period``). Drawn runs that are
    refused are drawn again; a given reference that cannot be followed raises :class:`InputError` naming the joint.
    """
    plant = true_robot or robot
    controller = make_controller(robot, control or ControllerSettings(), settings.control_period, (plant,))
    if references is None or isinstance(references, ReferenceSettings):
        shape = references or ReferenceSettings()

        def draw(index: int, attempt: int) -> Reference:
            number = derive_seed("recording", seed, index, attempt)
            return multi_sine(robot, shape, settings.duration, settings.control_period, number)

        done: dict[int, Rollout] = {}
        total = n_train + n_test
        for first in range(0, total, settings.lockstep):
            wanted = list(range(first, min(first + settings.lockstep, total)))
            done.update(run_until_accepted(wanted, draw, plant, controller, settings, effects, progress))
        rollouts = [done[i] for i in range(total)]
    else:
        rollouts = []
        for result in simulate(plant, list(references), controller, settings.substep, effects, progress):
            if isinstance(result, Refusal):
                raise InputError(
                    f"robot {robot.name}: reference {result.reference.seed or len(rollouts) + 1} cannot be followed: "
                    f"{result.why}; check the robot's limits, the friction and the reference"
                )
            rollouts.append(result)
    out = []
    for i, rollout in enumerate(rollouts):
        split = "train" if i < n_train else "test"
        name = names[i] if names else f"{split}_{(i if i < n_train else i - n_train) + 1:02d}"
        recorded = record(rollout, robot, sensors, name, split, seed)
        out.append(Recording(recorded, true_run(rollout, name, split, sensors.record_every)))
    return out


def simulate_twin(
    robot: Robot,
    settings: SimulationSettings,
    friction: DriveFriction,
    sensors: SensorSettings,
    references: ReferenceSettings | Sequence[Reference] | None = None,
    *,
    control: ControllerSettings | None = None,
    n_train: int = 3,
    n_test: int = 1,
    seed: int = 0,
    names: Sequence[str] = (),
    progress: Progress | None = None,
) -> list[Recording]:
    """:func:`simulate_recordings` of ``robot`` with drive losses; its controller knows the rotors' inertia."""
    friction.check(robot)
    plant = with_armature(robot, friction.armature) if friction.armature else robot
    return simulate_recordings(
        plant,
        settings,
        sensors,
        references,
        effects=friction.effects(robot),
        control=control,
        n_train=n_train,
        n_test=n_test,
        seed=seed,
        names=names,
        progress=progress,
    )
