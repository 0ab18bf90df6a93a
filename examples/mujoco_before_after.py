"""MuJoCo: the same commanded torque, the URDF alone and the completed model, against what the robot did.

    python examples/mujoco_before_after.py                        # prints the errors, writes before_after.png

Needs, in a clone: pip install '.[export]' matplotlib
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
from hybrid_dynamics.loop.process import ProcessSettings, Run, process

#: An arm that is not controlled falls: errors grow by themselves. So every half second starts where the robot was.
WINDOW = 0.5


def simulate(mjcf: Path, run: Run) -> np.ndarray:
    """Positions (T, n) [rad] of the model in ``mjcf`` under the recorded torque; NaN where a window begins."""
    model = mujoco.MjModel.from_xml_path(str(mjcf))
    dt = float(run.time[1] - run.time[0])
    substeps = 20
    set_for_simulation(model, dt / substeps)
    data = mujoco.MjData(model)
    positions = np.full_like(run.q, np.nan)
    for k in range(len(run.time)):
        if k % round(WINDOW / dt) == 0:
            data.qpos[:], data.qvel[:] = run.q[k], run.dq[k]
        else:
            positions[k] = data.qpos
        data.ctrl[:] = run.tau[k : k + 2].mean(axis=0)
        mujoco.mj_step(model, data, substeps)
    return positions


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
            # A URDF with a link of no inertia cannot be simulated by itself.
            alone = "no motion" if before is None else f"{before.position[k]:.3g} rad"
            print(f"  {joint}: {alone} with the URDF alone, {after.position[k]:.3g} rad with the completed model")

        # 2. The same as a picture, from files that any MuJoCo program can load.
        run = process(test[0], robot, ProcessSettings())  # positions, speeds and torques at one bandwidth
        traces = {}
        for label, model in (("URDF alone", Model(robot)), ("completed model", completed)):
            path = folder / f"{label.replace(' ', '_')}.xml"
            model.save(folder / "model.json")
            export(folder / "model.json", urdf, "mjcf", path, force=True)
            traces[label] = simulate(path, run)
        figure, axes = plt.subplots(robot.n_joints, 1, sharex=True, figsize=(7, 5), layout="constrained")
        for k, (axis, joint) in enumerate(zip(axes, robot.joint_names, strict=True)):
            axis.plot(run.time, run.q[:, k], color="black", label="recorded")
            for (label, q), line in zip(traces.items(), (":", "-"), strict=True):
                axis.plot(run.time, q[:, k], line, label=f"{label}, restarted every {WINDOW} s")
            axis.set_ylim(run.q[:, k].min() - 0.5, run.q[:, k].max() + 0.5)
            axis.set_ylabel(f"{joint} [rad]")
        axes[0].legend()
        axes[-1].set_xlabel("time [s]")
        figure.savefig(given.out, dpi=120)
        print(f"{given.out}: written")


if __name__ == "__main__":
    main()
