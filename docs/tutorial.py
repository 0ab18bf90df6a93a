"""Tutorial: find what a model lacks, from Python. Run it: ``python docs/tutorial.py``.

Every step prints what it found. The arm is simulated, so that the truth is known.
"""

from pathlib import Path
from tempfile import mkdtemp

import numpy as np

from hybrid_dynamics import LoopSettings, Model, Robot, close_loop
from hybrid_dynamics.effects import Effect
from hybrid_dynamics.loop_report import write_result
from hybrid_dynamics.simulation.excitation import excitations

# 1. A robot is a URDF. This one has two joints.
URDF = """<robot name="arm">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0 0 0.2"/><mass value="4"/>
    <inertia ixx="0.06" iyy="0.06" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="fore"><inertial><origin xyz="0 0 0.15"/><mass value="2"/>
    <inertia ixx="0.02" iyy="0.02" izz="0.004" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
    <limit lower="-2.5" upper="2.5" velocity="4" effort="60"/></joint>
  <joint name="elbow" type="revolute"><origin xyz="0 0 0.4"/><parent link="upper"/><child link="fore"/>
    <axis xyz="0 1 0"/><limit lower="-2.5" upper="2.5" velocity="4" effort="30"/></joint>
</robot>
"""
robot = Robot.from_text(URDF, "arm")

# 2. Logs. Yours come from `read_log("run.csv", robot.joint_names)`; these are made, with friction that the URDF lacks.
hidden = [
    Effect("viscous_friction", ("shoulder",), {"viscous_coefficient": 3.0}),
    Effect("coulomb_friction", ("elbow",), {"coulomb_torque": 1.5}),
]
train, test = excitations(robot, hidden, train=2, test=1, duration=6.0, rate=400.0)

# 3. Close the loop: name what is missing, one effect after the other, until what is left is noise. To save time only
#    friction is asked for here; without settings every effect of the catalogue competes.
settings = LoopSettings(effects=("viscous_friction", "coulomb_friction"))
result = close_loop(robot, train, test, settings)
print("verdict:", result.diagnosis.verdict)
for effect in result.model.effects:
    values = ", ".join(
        f"{name} = {value:.3f} ± {effect.std_errors[name]:.3f}" for name, value in effect.parameters.items()
    )
    print(f"  {effect.effect} on {', '.join(effect.joints)}: {values}")

# 4. The proof: torque on the run that took no part, before and after.
run = result.test[0]
states = run.motion.q, run.motion.dq, run.motion.ddq
for name, model in (("before", Model(robot)), ("after", result.model)):
    error = run.tau - run.smooth(model.predict(*states))
    print(f"{name}: rms error", np.round(np.sqrt(np.mean(error**2, axis=0)), 3), "N m")

# 5. Keep it: the page to read, the numbers, the model.
folder = Path(mkdtemp()) / "result"
folder.mkdir()
write_result(folder, result)
print("written:", ", ".join(sorted(path.name for path in folder.iterdir())))
