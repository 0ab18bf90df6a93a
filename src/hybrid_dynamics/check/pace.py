"""Is time counted right? What gravity does knows no clock; what inertia does follows its square.

A log of 250 samples a second that is read as one of 125 moves half as fast as the robot did: its inertia is in the
torque four times, its weight once. Masses that are off change both. So the multiple of the links' inertia (beside
rotors and friction, which are free) is compared with that of their weight, on the joints that hold this, or lift
nothing and show inertia: a wrist whose current is in another unit, or hardly ever more than nothing, holds none by any
clock.
"""

from __future__ import annotations

import numpy as np

from hybrid_dynamics.check.columns import Columns
from hybrid_dynamics.check.findings import Finding
from hybrid_dynamics.check.weight import ERRORS, WEIGHS, weigh
from hybrid_dynamics.types import Array

#: Clocks that are surely off by more than the first are doubted. By more than the second, and by about two as rates are
#: taken for each other, they are refused: links of three times the inertia, of the weight that the URDF says, look like
#: 1.7, and no motion tells them from it. (Of 133 simulated logs with all the catalogue hidden in them, and 44 cuts of
#: 6 s of the five recorded arms, none is told.)
DOUBTED, REFUSED, TWICE = 1.25, 1.5, 1.85
#: Stamps in another unit are off by more; so is a torque without any inertia, which is no matter of the clock.
FARTHEST = 30.0
#: Where joints that hold their weight lift less than this share of all of it (mean square), the clock is only doubted.
MOSTLY = 0.5


def check_pace(columns: Columns, gravity: Array) -> list[Finding]:
    """A clock that is off, where the torque shows inertia and weight under ``gravity`` (3,) [m/s^2] clearly enough."""
    found = weigh(columns, gravity)
    if found is None or found.clear_motion <= 0:
        return []
    lifting = (WEIGHS[0] < found.weight) & (found.weight < WEIGHS[1])
    own = np.where(lifting, found.modelled**2, 0.0)
    if not lifting.any():
        return []
    share = own / own.sum()
    weight = float(share @ found.weight)
    weight_error = float(np.linalg.norm(share * found.weight_error))
    pace = float(np.sqrt(found.clear_motion / weight))
    # As little off as both may be by their errors.
    out = ERRORS * np.array([found.clear_motion_error, weight_error]) + [found.clear_off, 0.0]
    if pace > 1:
        least = float(np.sqrt(max(found.clear_motion - out[0], 0.0) / (weight + out[1])))
    else:
        least = float(np.sqrt(max(weight - out[1], 0.0) / (found.clear_motion + out[0])))
    if least < DOUBTED:
        return []
    factor = max(pace, 1 / pace)
    if factor > FARTHEST:
        return []
    text = (
        f"time stamps run about {factor:.2g} times too {'slow' if pace > 1 else 'fast'}: the torque holds "
        f"{found.clear_motion:.2f} +- {found.clear_motion_error:.2f} times the inertia that the links have in this "
        f"motion, and {weight:.2f} +- {weight_error:.2f} times their weight; expected seconds: "
        f"{'divide' if pace > 1 else 'multiply'} them by {factor:.2g} (250 Hz read as 125 Hz are 2 times too slow)"
    )
    mostly = own.sum() >= MOSTLY * np.sum(found.modelled**2)
    certain = mostly and least > REFUSED and factor > TWICE
    if not certain:
        text = f"it looks as if {text}; links whose inertia is off by as much, and whose weight is not, look the same"
    return [Finding("time_scale", "hard" if certain else "warning", text)]
