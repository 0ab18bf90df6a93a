"""One effect on a seven-joint arm: ours finds which of three it is; mujoco.sysid is told and fits its parameter.

Imports count on both sides (the case is timed as a whole process). The peer's residual is ``mj_inverse`` along the
measured motion: its own rollouts take ten times as long and are less accurate.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

JOINTS, JOINT, RATE = 7, 1, 500.0
TRUTH = {"viscous_friction": 1.5, "coulomb_friction": 2.0, "payload": 1.2}


def viscous_friction(side: str, seconds: int) -> Callable[[], dict[str, Any]]:
    return _case("viscous_friction", side, seconds)


def coulomb_friction(side: str, seconds: int) -> Callable[[], dict[str, Any]]:
    return _case("coulomb_friction", side, seconds)


def payload(side: str, seconds: int) -> Callable[[], dict[str, Any]]:
    return _case("payload", side, seconds)


def _runs(effect: str, seconds: int) -> list[dict[str, np.ndarray]]:
    """Two runs ``time q dq ddq tau`` with the effect: friction on one joint, or a heavier last link."""
    from benchmarks.data import arm, motion

    robot = arm(JOINTS)
    true = robot.copy()
    if effect == "payload":
        import pinocchio as pin

        last = robot.joint_ids[-1]
        lump = pin.Inertia(TRUTH[effect], np.array([0.02, -0.01, 0.15]), np.zeros((3, 3)))
        true.model.inertias[last] = true.model.inertias[last] + lump
    runs = []
    for seed in range(2):
        time, q, dq, ddq = motion(robot, seconds, RATE, seed)
        tau = true.inverse_dynamics(q, dq, ddq)
        if effect == "viscous_friction":
            tau[:, JOINT] += TRUTH[effect] * dq[:, JOINT]
        if effect == "coulomb_friction":
            tau[:, JOINT] += TRUTH[effect] * np.sign(dq[:, JOINT])
        rng = np.random.default_rng(10 + seed)
        tau += 0.02 * rng.normal(size=tau.shape)
        runs.append({"time": time, "q": q, "dq": dq, "ddq": ddq, "tau": tau})
    return runs


def _case(effect: str, side: str, seconds: int) -> Callable[[], dict[str, Any]]:
    """Robot and runs in a folder; what is timed is a program that reads them, so that its imports count."""
    from benchmarks.data import arm_urdf

    folder = Path(tempfile.mkdtemp(prefix="bench-"))
    (folder / "arm.urdf").write_text(arm_urdf(JOINTS))
    for k, arrays in enumerate(_runs(effect, seconds)):
        np.savez(folder / f"run{k}.npz", **arrays)  # type: ignore[arg-type]
    command = [sys.executable, "-W", "ignore", "-m", "benchmarks.cases.declared", effect, side, str(folder)]

    def run() -> dict[str, Any]:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(done.stderr.strip().splitlines()[-1])
        return dict(json.loads(done.stdout.splitlines()[-1]))

    return run


def _ours(effect: str, folder: Path) -> float:
    from hybrid_dynamics import LoopSettings, Robot, close_loop
    from hybrid_dynamics.trajectory import Trajectory

    logs = []
    for k, split in enumerate(("train", "test")):
        run = np.load(folder / f"run{k}.npz")
        logs.append(Trajectory(f"run{k}", split, run["time"], {"q": run["q"], "tau": run["tau"]}))
    robot = Robot.from_urdf(folder / "arm.urdf")
    diagnosis = close_loop(robot, logs[:1], logs[1:], LoopSettings(effects=tuple(TRUTH))).diagnosis
    values = [e.effect.parameters for e in diagnosis.effects if e.effect.effect == effect]
    return float(next(iter(values[0].values()))) if values else float("nan")


def _peer(effect: str, folder: Path) -> float:
    import mujoco
    from mujoco import sysid

    model = mujoco.MjModel.from_xml_path(str(folder / "arm.urdf"))
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT | mujoco.mjtDisableBit.mjDSBL_CONTACT)
    # Coulomb friction in mj_inverse is exact only where the constraint is rigid.
    model.dof_solref[:] = (0.0, -1e9)
    data = mujoco.MjData(model)
    # The payload's place is declared, its mass is sought.
    mass, centre, inertia = model.body_mass[-1], model.body_ipos[-1].copy(), model.body_inertia[-1].copy()
    run = np.load(folder / "run0.npz")
    q, dq, ddq, tau = (run[name] for name in ("q", "dq", "ddq", "tau"))

    def predicted(value: float) -> np.ndarray:
        if effect == "viscous_friction":
            model.dof_damping[JOINT] = value
        elif effect == "coulomb_friction":
            model.dof_frictionloss[JOINT] = value
        else:  # at the centre of the link, so only its mass changes
            model.body_mass[-1], model.body_ipos[-1], model.body_inertia[-1] = mass + value, centre, inertia
            mujoco.mj_setConst(model, data)
        out = np.empty_like(tau)
        for row in range(len(q)):
            data.qpos, data.qvel, data.qacc = q[row], dq[row], ddq[row]
            mujoco.mj_inverse(model, data)
            out[row] = data.qfrc_inverse
        return np.asarray(out)

    def residual(x: np.ndarray, params: Any) -> tuple[list[np.ndarray], None, None]:
        # ``x`` is one point, or (parameters, points) for finite differences.
        columns = [(predicted(float(v)) - tau).ravel() for v in np.atleast_2d(x)[0]]
        return [np.stack(columns, 1) if np.ndim(x) == 2 else columns[0]], None, None

    params = sysid.ParameterDict()
    params.add(sysid.Parameter("value", 0.5, 0.0, 10.0))
    fitted, _ = sysid.optimize(params, residual, optimizer="mujoco", verbose=False)
    return float(fitted.as_vector()[0])


if __name__ == "__main__":
    name, who, where = sys.argv[1:]
    found = (_ours if who == "ours" else _peer)(name, Path(where))
    print(json.dumps({"found": found, "parameter_error": abs(found / TRUTH[name] - 1)}))
