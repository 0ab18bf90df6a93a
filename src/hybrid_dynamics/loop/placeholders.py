"""Dry friction that a URDF gives and the torque does not have: no knowledge to start from.

Descriptions hold placeholders as often as measured friction (10, 1, 20000). What the loop finds comes on top of the
starting model. Of a damping that is as good as anything, since a change of it is a damping; of dry friction it is not:
a sign that turns over at once would stay beside one that turns over slowly. So where the torque of a joint holds less
than half, or more than twice, of the dry friction that is described, that is left out, and what the joint has is found
in full.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hybrid_dynamics.effects import Effect, Term, family
from hybrid_dynamics.loop.diagnosis import predict_run
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array

#: Training error with the description's friction, over that without, beyond which it does harm.
HARM = 1.02
#: Times that dry friction is in the torque, between which the description knows of it.
KNOWS = (0.5, 2.0)


def harmed(robot: Robot, described: Sequence[Effect], runs: Sequence[Run]) -> dict[str, tuple[float, float]]:
    """Joints whose error on ``runs`` the friction ``described`` makes larger: rms [N m] without and with it."""

    def rmse(model: Model) -> Array:
        left = np.concatenate([run.tau - predict_run(model, run) for run in runs])
        return np.asarray(np.sqrt(np.mean(left**2, axis=0)))

    without, with_it = rmse(Model(robot)), rmse(Model(robot, tuple(described)))
    own = {joint for d in described for joint in d.joints}
    return {
        name: (float(a), float(b))
        for name, a, b in zip(robot.joint_names, without, with_it, strict=True)
        if b > HARM * a and name in own
    }


def times_in_torque(robot: Robot, dry: Sequence[Effect], runs: Sequence[Run]) -> list[float]:
    """How many times each of ``dry``, friction of one joint, is in the torque of ``runs`` beside what else turns with
    the joint: a multiple of the rigid body's torque, a damping, a rotor and an offset, all free. 1 where it stands."""
    bare, full = Model(robot), Model(robot, tuple(dry))
    rigid = [predict_run(bare, run) for run in runs]
    friction = [predict_run(full, run) - own for run, own in zip(runs, rigid, strict=True)]
    out = []
    for j in (robot.joint_names.index(effect.joints[0]) for effect in dry):
        parts = [
            np.column_stack([f[:, j], own[:, j], run.dq[:, j], run.ddq[:, j], np.ones(len(own)), run.tau[:, j]])[
                run.mask[:, j]
            ]
            for run, own, f in zip(runs, rigid, friction, strict=True)
        ]
        rows = np.concatenate(parts)
        moves = len(rows) > rows.shape[1] and np.ptp(rows[:, 0]) > 0
        out.append(float(np.linalg.lstsq(rows[:, :-1], rows[:, -1], rcond=None)[0][0]) if moves else 1.0)
    return out


def without_placeholders(start: Model, described: Sequence[Effect], runs: Sequence[Run]) -> Model:
    """``start`` without the dry friction ``described`` of which the torque of ``runs`` holds another multiple than
    :data:`KNOWS`."""
    dry = [d for d in described if family(d.effect).turns_sign]
    times = times_in_torque(start.robot, dry, runs)
    gone = [d for d, share in zip(dry, times, strict=True) if not KNOWS[0] <= share <= KNOWS[1]]
    return replace(start, effects=tuple(e for e in start.effects if e not in gone))


def with_unmatched(given: Model, base: Model, found: Sequence[Term]) -> Model:
    """``base`` with what :func:`without_placeholders` took from ``given`` and nothing ``found`` stands in the place of.

    That no dry friction is there is then found as a change of what was given, and told.
    """
    own = {given.robot.joint_names[t.joint] for t in found if t.joint is not None and t.family().turns_sign}
    kept = (e for e in given.effects if e in base.effects or own.isdisjoint(e.joints))
    return replace(base, effects=tuple(kept))
