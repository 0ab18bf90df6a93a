"""Pinocchio: the completed model beside the URDF's own, for a controller or an observer written in Python.

    python examples/pinocchio_predict.py

`Model.predict` takes whole runs; `completed_robot.model` is a `pinocchio.Model` for everything else Pinocchio does.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import demo_arm
import numpy as np
import pinocchio as pin

from hybrid_dynamics import Robot, close_loop, load_model
from hybrid_dynamics.loop.process import ProcessSettings, process


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        urdf = demo_arm.write_urdf(folder)
        robot = Robot.from_urdf(urdf)
        train, test = demo_arm.record(robot)
        close_loop(robot, train, test).model.save(folder / "model.json")

        model = load_model(folder / "model.json", robot)
        run = process(test[0], robot, ProcessSettings())  # positions, speeds and accelerations at one bandwidth
        motion = run.motion
        alone = robot.inverse_dynamics(motion.q, motion.dq, motion.ddq)
        completed = model.predict(motion.q, motion.dq, motion.ddq, motion.time)
        print("held-out torque error, rms [N m]")
        for k, joint in enumerate(robot.joint_names):
            errors = [np.sqrt(np.mean((run.tau[:, k] - run.smooth(tau)[:, k]) ** 2)) for tau in (alone, completed)]
            print(f"  {joint}: {errors[0]:.3g} with the URDF alone, {errors[1]:.3g} with the completed model")

        # The rigid body of the completed model is an ordinary Pinocchio model: mass matrix, Jacobians, gravity ...
        pinocchio = model.completed_robot.model
        q = motion.q[0]
        print(f"mass matrix at the first row:\n{np.round(pin.crba(pinocchio, pinocchio.createData(), q), 3)}")


if __name__ == "__main__":
    main()
