"""Whole datasets: draw references, run them, refuse the bad ones by name and redraw them with the next seed."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator

import numpy as np

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.simulation.controller import Controller, ControllerSettings, make_controller
from hybrid_dynamics.simulation.effects import JointEffects
from hybrid_dynamics.simulation.references import Reference, ReferenceSettings, derive_seed, multi_sine
from hybrid_dynamics.simulation.rollout import Refusal, Rollout, SimulationSettings, simulate
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Progress

log = logging.getLogger(__name__)


def simulate_dataset(
    robot: Robot,
    settings: SimulationSettings | None = None,
    *,
    references: ReferenceSettings | None = None,
    control: ControllerSettings | None = None,
    damping: tuple[float, ...] = (),
    effects: JointEffects | None = None,
    true_robot: Robot | None = None,
    n_train: int = 10,
    n_test: int = 10,
    seed: int = 0,
    progress: Progress | None = None,
) -> Iterator[Trajectory]:
    """Yield ``n_train`` training then ``n_test`` test rollouts; signals q dq tau q_ref dq_ref, tau held over [k, k+1).

    ``damping`` (n,) [N m s/rad] and ``effects`` act on ``true_robot`` (default: ``robot``), which the controller, that
    knows ``robot``, must follow references with. Refused rollouts are logged (joint and reason) and redrawn. Same
    arguments, same bytes. Raises :class:`InputError` when one rollout is refused ``settings.attempts`` times.
    """
    settings = settings or SimulationSettings()
    plant = true_robot or robot
    if damping:
        if len(damping) != robot.n_joints:
            raise InputError(f"damping holds {len(damping)} numbers; robot {robot.name} has {robot.n_joints} joints")
        effects = (effects or JointEffects()) + JointEffects(damping=np.asarray(damping, float))
    controller = make_controller(robot, control or ControllerSettings(), settings.control_period, (plant,))
    shape = references or ReferenceSettings()

    def draw(rollout: int, attempt: int) -> Reference:
        return multi_sine(robot, shape, settings.duration, settings.control_period, derive_seed(seed, rollout, attempt))

    total = n_train + n_test
    for first in range(0, total, settings.lockstep):
        wanted = range(first, min(first + settings.lockstep, total))

        def report(fraction: float, text: str, first: int = first, count: int = len(wanted)) -> None:
            if progress is not None:
                progress((first + fraction * count) / total, text)

        done = run_until_accepted(list(wanted), draw, plant, controller, settings, effects, report)
        for index in wanted:
            split = "train" if index < n_train else "test"
            number = index if index < n_train else index - n_train
            yield as_trajectory(done.pop(index), f"{split}_{number + 1:02d}", split)


def run_until_accepted(
    wanted: list[int],
    draw: Callable[[int, int], Reference],
    plant: Robot,
    controller: Controller,
    settings: SimulationSettings,
    effects: JointEffects | None,
    progress: Progress | None = None,
) -> dict[int, Rollout]:
    """Simulate ``draw(rollout, 0)`` for every wanted rollout, the refused ones again with ``draw(rollout, 1)``, ..."""
    done: dict[int, Rollout] = {}
    open_ = list(wanted)
    for attempt in range(settings.attempts):
        results = simulate(plant, [draw(i, attempt) for i in open_], controller, settings.substep, effects, progress)
        last = ""
        for i, result in zip(open_, results, strict=True):
            if isinstance(result, Refusal):
                last = f"rollout {i} (attempt {attempt + 1}, seed {result.reference.seed}) refused: {result.why}"
                log.warning("%s; drawn again", last)
            else:
                done[i] = result
        open_ = [i for i in open_ if i not in done]
        if not open_:
            return done
    raise InputError(
        f"robot {plant.name}: {last}; gave up after {settings.attempts} attempts, consider a smaller "
        "reference.velocity_share or frequency, or a larger reference.margin"
    )


def as_trajectory(rollout: Rollout, name: str, split: str) -> Trajectory:
    """The rollout as recorded: state at instant k, torque held from there to the next."""
    signals = {
        "q": rollout.q,
        "dq": rollout.dq,
        "tau": rollout.tau,
        "q_ref": rollout.reference.q,
        "dq_ref": rollout.reference.dq,
    }
    return Trajectory(name, split, rollout.time, signals)
