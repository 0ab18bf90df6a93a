"""Proof by simulation: an exported MJCF, driven by the recorded torque of a held-out run, must move as the robot did.

Torque in, motion out, in another engine: a check of the whole chain. A window starts at a recorded state and lasts half
a second: longer ones would show how errors of position feed on themselves, not how good the model is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.export import mjcf
from hybrid_dynamics.export.source import Source
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.process import ProcessSettings, process
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

#: Impedance of dry friction: the softer it is, the faster a joint that should stick creeps under load.
HARDEST = 0.9999


@dataclass(frozen=True)
class ResimulationSettings:
    """``window`` [s] of a simulation, ``substep`` [s] at most of MuJoCo's integration; ``stride`` [s] from one window's
    start to the next (None: a window)."""

    window: float = 0.5
    substep: float = 2e-4
    stride: float | None = None

    def __post_init__(self) -> None:
        if not 0 < self.substep <= self.window:
            raise InputError(f"substep is {self.substep} s; expected above 0, up to the window of {self.window} s")


@dataclass(frozen=True)
class StateError:
    """Root mean square over all windows and their samples, each (n,): ``position`` [rad], ``velocity`` [rad/s]; and
    ``windows``, how many there were."""

    position: Array
    velocity: Array
    windows: int


def before_and_after(
    source: Source, runs: Sequence[Trajectory], settings: ResimulationSettings | None = None
) -> tuple[StateError | None, StateError]:
    """State error of the robot without effects and of the completed model against held-out ``runs`` (logs as read).

    Position, velocity and torque pass the loop's filter first, so that they belong together. None before where the URDF
    alone cannot move (a link without inertia turns infinitely fast): that it can now is part of what was added. Raises
    :class:`InputError` where MuJoCo does not take the completed model, or no run is as long as a window.
    """
    smoothed = [_smoothed(run, source.robot) for run in runs]

    def error(xml: str) -> StateError:
        return resimulate(xml, source.robot.joint_names, smoothed, settings)

    after = error(_exported(source, source.kept))
    try:
        alone = _exported(source, Model(source.robot))
    except InputError:
        return None, after
    return error(alone), after


def _exported(source: Source, model: Model) -> str:
    """The MJCF text of ``model``, taken by MuJoCo; :class:`InputError` where it is not."""
    (xml,) = mjcf.render(replace(source, model=model), "robot.xml", []).files.values()
    return xml.decode()


def _smoothed(run: Trajectory, robot: Robot) -> Trajectory:
    processed = process(run, robot, ProcessSettings())
    signals = {"q": processed.q, "dq": processed.dq, "tau": processed.tau}
    return Trajectory(run.name, run.split, processed.time, signals)


def set_for_simulation(model: Any, step: float) -> None:
    """Set a compiled MJCF export for forward simulation with time steps of ``step`` [s].

    The file has dry friction as inverse dynamics needs it, exact at any speed; integrated with a finite step that
    lets a joint chatter about rest (measured: 0.12 rad/s for 2 N m on 0.02 kg m^2 at 1 ms). With these numbers friction
    stops a joint within one step and holds it (2e-6 rad/s).
    """
    model.opt.timestep = step
    dry = model.dof_frictionloss > 0
    model.dof_solref[dry] = (0.0, -1.0 / step)
    model.dof_solimp[dry, :2] = HARDEST


def _compiled(xml: str, joints: tuple[str, ...], step: float) -> Any:
    """The MuJoCo model of an exported MJCF; limits and contacts are off: the recording obeyed the robot's own."""
    try:
        model = mujoco.MjModel.from_xml_string(xml)
    except ValueError as error:
        raise InputError(f"MuJoCo cannot compile the model ({' '.join(str(error).split())})") from None
    known = {model.joint(k).name for k in range(model.njnt)}
    if missing := [joint for joint in joints if joint not in known]:
        raise InputError(f"the MJCF has no joint {missing[0]!r}; it has {', '.join(sorted(known))}")
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT | mujoco.mjtDisableBit.mjDSBL_CONTACT
    set_for_simulation(model, step)
    return model


def resimulate(
    xml: str, joints: tuple[str, ...], runs: Sequence[Trajectory], settings: ResimulationSettings | None = None
) -> StateError:
    """State error of the MJCF text ``xml`` against ``runs`` (signals q, dq, tau of ``joints``), in short windows.

    The torque of row k is applied from there to the next row, linearly interpolated (as measured torque is, sampled).
    """
    settings = settings or ResimulationSettings()
    squares, count, windows = np.zeros((2, len(joints))), 0, 0
    for run in runs:
        rows = max(round(settings.window / run.dt), 1)
        stride = rows if settings.stride is None else max(round(settings.stride / run.dt), 1)
        parts = max(int(np.ceil(run.dt / settings.substep - 1e-9)), 1)
        model = _compiled(xml, joints, run.dt / parts)
        for first in range(0, len(run.time) - rows, stride):
            own = run.rows(slice(first, first + rows + 1))
            q, dq = _window(model, joints, own, parts)
            squares += np.sum([(q - own["q"][1:]) ** 2, (dq - own["dq"][1:]) ** 2], axis=1)
            count += rows
            windows += 1
    if not windows:
        raise InputError(f"no run is as long as a window of {settings.window} s; give longer runs or a shorter window")
    position, velocity = np.sqrt(squares / count)
    return StateError(position, velocity, windows)


def _window(model: Any, joints: tuple[str, ...], run: Trajectory, parts: int) -> tuple[Array, Array]:
    """Positions and velocities (T - 1, n) at the rows after the first, each reached in ``parts`` steps a row."""
    data = mujoco.MjData(model)
    at_q = np.array([model.joint(joint).qposadr[0] for joint in joints])
    at_dq = np.array([model.joint(joint).dofadr[0] for joint in joints])
    drive = np.array([model.actuator(f"drive_{joint}").id for joint in joints])
    data.qpos[at_q], data.qvel[at_dq] = run["q"][0], run["dq"][0]
    tau = run["tau"]
    q, dq = np.empty((2, len(tau) - 1, len(joints)))
    for k in range(len(tau) - 1):
        for part in range(parts):
            data.ctrl[drive] = tau[k] + (part + 0.5) / parts * (tau[k + 1] - tau[k])
            mujoco.mj_step(model, data)
        q[k], dq[k] = data.qpos[at_q], data.qvel[at_dq]
    return q, dq
