"""C99 for controllers: one file and its header, no allocation, no library but the C standard's mathematics."""

from __future__ import annotations

import re
import textwrap
from pathlib import Path

import casadi as cs

from hybrid_dynamics.export.source import Rendered, Source
from hybrid_dynamics.export.straight_line import C99, inputs_used, statements
from hybrid_dynamics.export.symbolic import SymbolicModel

_SCALARS = ("dt",)
_WORDS = {
    "rigid_body": "Rigid-body torque [N m] of the robot before any effect: the tau_model that residual adds to.",
    "residual": "What the drive must add [N m] to tau_model, the rigid-body torque of the robot before any effect.",
    "torque": "Drive torque [N m] of the completed model.",
    "torque_std": "Standard deviation [N m] of torque: {deviation}.",
    "advance": "The state after dt [s] at joint speeds dq; out may be state itself.",
}


def render(source: Source, name: str, head: list[str]) -> Rendered:
    """The source file and the header beside it."""
    model = source.symbolic
    header = f"{Path(name).stem}.h"
    stem = re.sub(r"\W", "_", Path(name).stem)
    functions = [model.rigid_body, model.residual, model.torque, model.deviation]
    functions += [model.advance] if model.memories else []
    comment = "/*\n" + "\n".join(f"   {line}" for line in head).replace("*/", "* /") + "\n*/\n"
    body = "\n".join(_definition(function) for function in functions)
    text = f'{comment}#include "{header}"\n\n#include <math.h>\n\n{body}'
    return Rendered({name: text.encode(), header: (comment + _header(stem, model, functions)).encode()})


def _header(stem: str, model: SymbolicModel, functions: list[cs.Function]) -> str:
    guard = f"{stem.upper()}_H"
    lines = [
        f"#ifndef {guard}",
        f"#define {guard}",
        "",
        "/* Define HYBRID_DYNAMICS_PREFIX (arm_, say) for all files where one program holds several models. */",
        "#ifdef HYBRID_DYNAMICS_PREFIX",
        "#define HYBRID_DYNAMICS_JOIN_(a, b) a##b",
        "#define HYBRID_DYNAMICS_JOIN(a, b) HYBRID_DYNAMICS_JOIN_(a, b)",
        *(f"#define {f.name()} HYBRID_DYNAMICS_JOIN(HYBRID_DYNAMICS_PREFIX, {f.name()})" for f in functions),
        "#endif",
        "",
        f"enum {{ {stem.upper()}_JOINTS = {model.n}, {stem.upper()}_STATES = {len(model.memories)} }};",
        "",
        "/* Arrays hold one number a joint, in the order " + ", ".join(model.model.robot.joint_names) + ".",
        "   SI units; torque is what the drive delivers, positive along the joint axis. Nothing is kept between calls.",
    ]
    if model.memories:
        states = ", ".join(f"[{k}] {memory.name}" for k, memory in enumerate(model.memories))
        lines += [f"   state: {states}; all zero at the start. Call advance once a control period, then", "   torque."]
    lines[-1] += " */"
    lines += ["#ifdef __cplusplus", 'extern "C" {', "#endif", ""]
    for function in functions:
        words = _WORDS[function.name()].format(deviation=model.deviation_words)
        comment = textwrap.fill(f"/* {words} */", 110, subsequent_indent="   ")
        lines += [comment, f"{_signature(function)};", ""]
    return "\n".join([*lines, "#ifdef __cplusplus", "}", "#endif", "", "#endif", ""])


def _signature(function: cs.Function) -> str:
    names = [function.name_in(k) for k in range(function.n_in())]
    inputs = [f"double {name}" if name in _SCALARS else f"const double {name}[]" for name in names]
    return f"void {function.name()}({', '.join([*inputs, 'double out[]'])})"


def _definition(function: cs.Function) -> str:
    lines, variables = statements(function, C99)
    names = [function.name_in(k) for k in range(function.n_in())]
    for name in _SCALARS:
        lines = [line.replace(f"{name}[0]", name) for line in lines]
    unused = [f"(void){name};" for name, used in zip(names, inputs_used(function), strict=True) if not used]
    declared = [f"double {', '.join(variables[k : k + 12])};" for k in range(0, len(variables), 12)]
    inner = "\n".join(f"  {line}" for line in [*declared, *unused, *lines])
    return f"{_signature(function)} {{\n{inner}\n}}\n"
