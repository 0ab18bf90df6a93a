"""Are the links' centres of mass given in the frames of their links?

A URDF has them there. CAD programs export them in the frame of the assembly, all joints at zero, and descriptions with
such numbers are in circulation (a maker's own of a collaborative arm): every link then has a lever of up to the arm's
length, and no effect explains the torque.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from hybrid_dynamics.check.findings import Finding
from hybrid_dynamics.robots import Robot

#: No centre of mass lies further from its link's joint than so many times the longest way from one joint (or the base)
#: to the next; of so many links at least.
FAR, FEWEST = 1.5, 2


def check_centres(robot: Robot) -> list[Finding]:
    """A warning where links' centres of mass lie beyond the arm, and at them if read in the base's frame."""
    model = robot.model
    data = model.createData()
    pin.forwardKinematics(model, data, pin.neutral(model))
    lengths = [np.linalg.norm(model.jointPlacements[j].translation) for j in range(1, model.njoints)]
    heavy = [j for j in range(1, model.njoints) if model.inertias[j].mass > 0]
    given = np.array([np.linalg.norm(model.inertias[j].lever) for j in heavy])
    in_base = np.array([np.linalg.norm(data.oMi[j].actInv(model.inertias[j].lever)) for j in heavy])
    longest = float(max(lengths, default=0.0))
    if longest == 0.0 or np.sum(given > FAR * longest) < FEWEST or np.any(in_base > FAR * longest):
        return []
    worst = model.names[heavy[int(given.argmax())]]
    text = (
        f"the URDF has centres of mass up to {given.max():.3g} m from their joints (the link of {worst}; no joint is "
        f"further than {longest:.3g} m from the one before); read in the base's frame, all joints at zero, they lie "
        f"within {in_base.max():.3g} m: expected each in the frame of its own link (origin of its inertial)"
    )
    return [Finding("centres_in_base", "warning", text)]
