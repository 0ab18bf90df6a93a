"""MuJoCo: the same commanded torque, the URDF alone and the completed model, against what the robot did.

    python examples/mujoco_before_after.py                        # prints the errors, writes before_after.png

Needs the extra: pip install 'hybrid-dynamics[export]'.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import demo_arm
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import mujoco
import numpy as np

from hybrid_dynamics import Model, Robot, close_loop
from hybrid_dynamics.export.resimulate import before_and_after, set_for_simulation
from hybrid_dynamics.export.source import Source
from hybrid_dynamics.export.writing import export
from hybrid_dynamics.trajectory import Trajectory

WINDOW = 2.0


def simulate(mjcf: Path, joints: tuple[str, ...], run: Trajectory, seconds: float) -> np.ndarray:
    """Positions (T, n) [rad] of the model in ``mjcf`` under the recorded torque, from the first recorded position."""
    model = mujoco.MjModel.from_xml_path(str(mjcf))
    set_for_simulation(model, run.dt)
    data = mujoco.MjData(model)
    data.qpos[:] = run["q"][0]
    positions = []
    for tau in run["tau"][: round(seconds / run.dt)]:
        positions.append(data.qpos.copy())
        data.ctrl[:] = tau
        mujoco.mj_step(model, data)
    return np.array(positions)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("before_after.png"))
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        urdf = demo_arm.write_urdf(folder)
        robot = Robot.from_urdf(urdf)
        train, test = demo_arm.record(robot)
        completed = close_loop(robot, train, test).model

        # 1. In short windows, over the whole held-out run: how far does the state go astray?
        before, after = before_and_after(Source(completed, urdf), test)
        print(f"state error after up to 0.5 s, rms over {after.windows} windows of a held-out run")
        for k, joint in enumerate(robot.joint_names):
            pair = (before.position[k], after.position[k])
            print(f"  {joint}: {pair[0]:.3g} rad with the URDF alone, {pair[1]:.3g} rad with the completed model")

        # 2. One long window, as files that any MuJoCo program can load.
        traces = {}
        for label, model in (("URDF alone", Model(robot)), ("completed model", completed)):
            path = folder / f"{label.replace(' ', '_')}.xml"
            model.save(folder / "model.json")
            export(folder / "model.json", urdf, "mjcf", path, force=True)
            traces[label] = simulate(path, robot.joint_names, test[0], WINDOW)
        figure, axes = plt.subplots(robot.n_joints, 1, sharex=True, figsize=(7, 5), layout="constrained")
        for k, (axis, joint) in enumerate(zip(axes, robot.joint_names, strict=True)):
            rows = len(traces["completed model"])
            axis.plot(test[0].time[:rows], test[0]["q"][:rows, k], color="black", label="recorded")
            for (label, q), line in zip(traces.items(), ("--", "-"), strict=True):
                axis.plot(test[0].time[:rows], q[:, k], line, label=label)
            axis.set_ylabel(f"{joint} [rad]")
        axes[0].legend()
        axes[-1].set_xlabel("time [s]")
        figure.savefig(given.out, dpi=120)
        print(f"{given.out}: written")


if __name__ == "__main__":
    main()
