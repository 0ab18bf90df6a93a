"""Laws written as text: a small grammar, read without ever being executed.

Numbers, + - * /, parentheses, the states ``q1 dq1 ddq1`` ... of any joint (numbered from 1) and the functions sign abs
sin cos exp tanh. Python's parser reads it; every node is checked against a whitelist and translated.
"""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable
from functools import lru_cache
from typing import Any

from hybrid_dynamics.effects.state import State
from hybrid_dynamics.errors import InputError

FUNCTIONS = ("sign", "abs", "sin", "cos", "exp", "tanh")
_OPERATORS: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}
_VARIABLE = re.compile(r"(q|dq|ddq)([1-9][0-9]?)")
_LONGEST = 2000

#: ``law(xp, at) -> torque``.
Compiled = Callable[[Any, State], Any]


@lru_cache(maxsize=256)
def compile_law(text: str) -> Compiled:
    """The law ``text`` over an array namespace; :class:`InputError` names what the grammar does not have."""
    return _translate(_parsed(text).body, text)


def variables_of(text: str) -> tuple[tuple[str, int], ...]:
    """States that ``text`` uses: (``q``, ``dq`` or ``ddq``; 0-based joint), sorted."""
    names = {node.id for node in ast.walk(_parsed(text)) if isinstance(node, ast.Name)}
    found = [match for name in names if (match := _VARIABLE.fullmatch(name))]
    return tuple(sorted((m.group(1), int(m.group(2)) - 1) for m in found))


def _parsed(text: str) -> ast.Expression:
    if len(text) > _LONGEST:
        raise InputError(f"expression of {len(text)} characters; expected at most {_LONGEST}")
    try:
        return ast.parse(text.strip(), mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise InputError(f"expression {text!r} cannot be read; expected e.g. 0.5 * sign(dq2) * abs(q3)") from None


def _translate(node: ast.expr, text: str) -> Compiled:
    if isinstance(node, ast.Constant) and _is_number(node.value):
        value = float(str(node.value))
        return lambda xp, at: value
    if isinstance(node, ast.Name) and (match := _VARIABLE.fullmatch(node.id)):
        kind, joint = match.group(1), int(match.group(2)) - 1
        return lambda xp, at: _state(at, kind, joint, text)
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.UAdd | ast.USub):
        inner, factor = _translate(node.operand, text), -1.0 if isinstance(node.op, ast.USub) else 1.0
        return lambda xp, at: factor * inner(xp, at)
    if isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
        apply = _OPERATORS[type(node.op)]
        left, right = _translate(node.left, text), _translate(node.right, text)
        return lambda xp, at: apply(left(xp, at), right(xp, at))
    if isinstance(node, ast.Call) and _is_known(node):
        name, argument = ast.unparse(node.func), _translate(node.args[0], text)
        return lambda xp, at: getattr(xp, name)(argument(xp, at))
    shown = ast.get_source_segment(text.strip(), node) or type(node).__name__
    raise InputError(
        f"expression {text!r}: {shown!r} is not allowed; expected numbers, + - * /, q1 dq1 ddq1 ..., and "
        f"{' '.join(FUNCTIONS)} of one argument"
    )


def _is_number(value: object) -> bool:
    """A finite real number; True and False are none."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _is_known(node: ast.Call) -> bool:
    """A function of the grammar with one argument."""
    known = isinstance(node.func, ast.Name) and node.func.id in FUNCTIONS
    return known and len(node.args) == 1 and not node.keywords


def _state(at: State, kind: str, joint: int, text: str) -> Any:
    values = getattr(at, kind)
    if values is None:
        raise InputError(f"expression {text!r} follows accelerations, and none are given; give ddq")
    try:
        return values[joint]
    except IndexError:
        raise InputError(f"expression {text!r}: {kind}{joint + 1} is no joint of this robot") from None
