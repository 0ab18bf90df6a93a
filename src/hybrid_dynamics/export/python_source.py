"""A Python file that needs NumPy only: the same functions as the C export, over arrays of any number of samples."""

from __future__ import annotations

import textwrap

import casadi as cs

from hybrid_dynamics.export.source import Rendered, Source
from hybrid_dynamics.export.straight_line import NUMPY, statements

_WORDS = {
    "rigid_body": "Rigid-body torque (..., n) [N m] of the robot before any effect: the tau_model of `residual`.",
    "residual": "What the drive must add (..., n) [N m] to ``tau_model``, the rigid-body torque before any effect.",
    "torque": "Drive torque (..., n) [N m] of the completed model.",
    "torque_std": "Standard deviation (..., n) [N m] of `torque`: {deviation}.",
    "advance": "The state after ``dt`` [s] at joint speeds ``dq``.",
}


def render(source: Source, name: str, head: list[str]) -> Rendered:
    """The importable file."""
    model = source.symbolic
    functions = [model.rigid_body, model.residual, model.torque, model.deviation]
    functions += [model.advance] if model.memories else []
    text = "\n".join(head).replace("\\", "/").replace('"""', "'''")
    state = f"(..., {len(model.memories)}), zero at the start: {', '.join(m.name for m in model.memories)}"
    lines = [
        f'"""{text}',
        "",
        "Arrays are (..., n): one number a joint last, any number of samples before. SI units; torque is what the",
        "drive delivers, positive along the joint axis." + (f" ``state`` is {state}." if model.memories else ""),
        '"""',
        "",
        "import numpy as np",
        "",
        f"JOINTS = {model.model.robot.joint_names!r}",
        f"STATES = {tuple(memory.name for memory in model.memories)!r}",
        "",
    ]
    for function in functions:
        words = _WORDS[function.name()].format(deviation=model.deviation_words)
        lines += ["", *_definition(function, words), ""]
    return Rendered({name: "\n".join(lines).encode()})


def _definition(function: cs.Function, words: str) -> list[str]:
    names = [function.name_in(k) for k in range(function.n_in())]
    lines, _ = statements(function, NUMPY)
    shape = ", ".join(f"{name}[..., 0]" for name in names if name != "dt")
    convert = [f"{name} = np.asarray({name}, float)" for name in names if name != "dt"]
    lines = [line.replace("dt[..., 0]", "dt") for line in lines]
    size = function.size1_out(0)
    return [
        f"def {function.name()}({', '.join(names)}):",
        textwrap.fill(f'    """{words}"""', 110, subsequent_indent="    "),
        *(f"    {line}" for line in convert),
        f"    out = np.empty((*np.broadcast({shape}).shape, {size}))",
        *(f"    {line}" for line in lines),
        "    return out",
    ]
