"""The exported C: one call of ``torque`` on a seven-joint arm with twenty effects, as a controller makes it."""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

JOINTS = 7
#: Calls in one go, with a state that changes; the sum keeps the compiler from leaving calls out.
LOOP = """
#include "arm.h"
double many(int calls, double *tau) {
  double q[ARM_JOINTS], dq[ARM_JOINTS], ddq[ARM_JOINTS], sum = 0.0;
  for (int k = 0; k < calls; k++) {
    for (int j = 0; j < ARM_JOINTS; j++) {
      q[j] = 1e-6 * k + 0.1 * j; dq[j] = 0.5 - 1e-6 * k; ddq[j] = 0.1 * j;
    }
    torque(q, dq, ddq, tau);
    sum += tau[0];
  }
  return sum;
}
"""


def c_torque(side: str, calls: int) -> Callable[[], dict[str, Any]]:
    import numpy as np

    from benchmarks.data import arm_urdf
    from hybrid_dynamics.effects import Effect
    from hybrid_dynamics.effects.inertia import to_body
    from hybrid_dynamics.export.writing import export
    from hybrid_dynamics.loop.model import Model
    from hybrid_dynamics.robots import Robot

    folder = Path(tempfile.mkdtemp(prefix="bench-"))
    (folder / "arm.urdf").write_text(arm_urdf(JOINTS))
    robot = Robot.from_urdf(folder / "arm.urdf")
    body = to_body(np.array([1.5, 0, 0, 0.3, 0.075, 0, 0.075, 0, 0, 0.01]))
    effects = [Effect("payload", (), body), Effect("gravity_tilt", (), {"roll": 0.01, "pitch": -0.02})]
    for k, joint in enumerate(robot.joint_names):
        stribeck = {"coulomb_torque": 1.0, "static_torque": 2.0, "stribeck_velocity": 0.1}
        effects += [
            Effect("viscous_friction", (joint,), {"viscous_coefficient": 1.0 + k}),
            Effect("stribeck_friction", (joint,), stribeck, {"sign_width": 0.03}),
        ]
        if k < 4:
            effects.append(Effect("torque_ripple", (joint,), {"amplitude": 0.5, "harmonic": 12.0, "phase": 0.1}))
    assert len(effects) == 20
    Model(robot, tuple(effects)).save(folder / "model.json")
    export(folder / "model.json", folder / "arm.urdf", "c", folder / "arm.c")
    (folder / "many.c").write_text(LOOP)
    flags = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC"]
    subprocess.run(["gcc", *flags, "arm.c", "many.c", "-lm", "-o", "arm.so"], cwd=folder, check=True)
    many = ctypes.CDLL(str(folder / "arm.so")).many
    many.restype = ctypes.c_double

    def run() -> dict[str, Any]:
        tau = (ctypes.c_double * JOINTS)()
        return {"sum": float(many(calls, tau))}

    return run
