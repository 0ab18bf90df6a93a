"""What is timed. A case is a function of ``(side, size)`` that prepares its data and returns what is to be timed.

What is returned is a function without arguments; its result is a dictionary of what shows that both sides solved the
same problem (an error, an objective). ``side`` is ``ours`` or ``peer``; both get the same data from the same seed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from benchmarks.cases import declared, derivative, dynamics, export, loop, sindy, symbolic

Case = Callable[[str, int], Callable[[], dict[str, Any]]]

CASES: dict[str, Case] = {
    "sindy": sindy.fit,
    "rigid_body": dynamics.rigid_body,
    "regressor_loop": dynamics.regressor_loop,
    "regressor_call": dynamics.regressor_call,
    "total_variation": derivative.total_variation,
    "symbolic": symbolic.residual,
    "viscous_friction": declared.viscous_friction,
    "coulomb_friction": declared.coulomb_friction,
    "payload": declared.payload,
    "help": loop.show_help,
    "small": loop.small,
    "arm_500_hz": loop.arm_500_hz,
    "arm_1_khz": loop.arm_1_khz,
    "loop_samples": loop.samples,
    "loop_runs": loop.runs,
    "loop_joints": loop.joints,
    "predict": loop.predict,
    "c_torque": export.c_torque,
    "many_hours": loop.many_hours,
}
