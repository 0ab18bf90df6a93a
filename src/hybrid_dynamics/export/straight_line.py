"""CasADi functions as straight-line source text, in C99 or in NumPy: one table of operations, two spellings.

CasADi has a generator of its own; its C comes with an interface of pointers to pointers, work arrays and a dozen
service functions that a controller has no use for (and that -Wextra complains about), and it writes no NumPy. The
instructions themselves are CasADi's: simplified, shared subexpressions computed once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi as cs

Write = Callable[..., str]


def _call(name: str) -> Write:
    return lambda *a: f"{name}({', '.join(a)})"


def _between(sign: str) -> Write:
    return lambda a, b: f"({a} {sign} {b})"


#: Operations that are spelt alike in both languages.
_COMMON: dict[int, Write] = {
    cs.OP_ASSIGN: lambda a: a,
    cs.OP_ADD: _between("+"),
    cs.OP_SUB: _between("-"),
    cs.OP_MUL: _between("*"),
    cs.OP_DIV: _between("/"),
    cs.OP_NEG: lambda a: f"(-{a})",
    cs.OP_SQ: lambda a: f"({a} * {a})",
    cs.OP_TWICE: lambda a: f"(2.0 * {a})",
    cs.OP_INV: lambda a: f"(1.0 / {a})",
}
_C: dict[int, Write] = _COMMON | {
    cs.OP_LT: _between("<"),
    cs.OP_LE: _between("<="),
    cs.OP_EQ: _between("=="),
    cs.OP_NE: _between("!="),
    cs.OP_AND: lambda a, b: f"(({a} != 0.0) && ({b} != 0.0))",
    cs.OP_OR: lambda a, b: f"(({a} != 0.0) || ({b} != 0.0))",
    cs.OP_NOT: lambda a: f"({a} == 0.0)",
    cs.OP_IF_ELSE_ZERO: lambda a, b: f"(({a} != 0.0) ? {b} : 0.0)",
    cs.OP_SIGN: lambda a: f"(({a} > 0.0) - ({a} < 0.0))",
    cs.OP_CONSTPOW: _call("pow"),
    cs.OP_POW: _call("pow"),
}
_NUMPY: dict[int, Write] = _COMMON | {
    cs.OP_LT: lambda a, b: f"np.less({a}, {b}).astype(float)",
    cs.OP_LE: lambda a, b: f"np.less_equal({a}, {b}).astype(float)",
    cs.OP_EQ: lambda a, b: f"np.equal({a}, {b}).astype(float)",
    cs.OP_NE: lambda a, b: f"np.not_equal({a}, {b}).astype(float)",
    cs.OP_AND: lambda a, b: f"np.logical_and({a}, {b}).astype(float)",
    cs.OP_OR: lambda a, b: f"np.logical_or({a}, {b}).astype(float)",
    cs.OP_NOT: lambda a: f"np.equal({a}, 0.0).astype(float)",
    cs.OP_IF_ELSE_ZERO: lambda a, b: f"np.where({a} != 0.0, {b}, 0.0)",
    cs.OP_CONSTPOW: lambda a, b: f"({a} ** {b})",
    cs.OP_POW: lambda a, b: f"({a} ** {b})",
}
for _op, _in_c, _in_numpy in (
    (cs.OP_SIN, "sin", "sin"),
    (cs.OP_COS, "cos", "cos"),
    (cs.OP_TAN, "tan", "tan"),
    (cs.OP_ASIN, "asin", "arcsin"),
    (cs.OP_ACOS, "acos", "arccos"),
    (cs.OP_ATAN, "atan", "arctan"),
    (cs.OP_ATAN2, "atan2", "arctan2"),
    (cs.OP_SINH, "sinh", "sinh"),
    (cs.OP_COSH, "cosh", "cosh"),
    (cs.OP_TANH, "tanh", "tanh"),
    (cs.OP_EXP, "exp", "exp"),
    (cs.OP_LOG, "log", "log"),
    (cs.OP_SQRT, "sqrt", "sqrt"),
    (cs.OP_FABS, "fabs", "abs"),
    (cs.OP_FLOOR, "floor", "floor"),
    (cs.OP_CEIL, "ceil", "ceil"),
    (cs.OP_FMIN, "fmin", "minimum"),
    (cs.OP_FMAX, "fmax", "maximum"),
    (cs.OP_FMOD, "fmod", "fmod"),
    (cs.OP_COPYSIGN, "copysign", "copysign"),
    (cs.OP_HYPOT, "hypot", "hypot"),
    (cs.OP_LOG1P, "log1p", "log1p"),
    (cs.OP_EXPM1, "expm1", "expm1"),
):
    _C[_op] = _call(_in_c)
    _NUMPY[_op] = _call(f"np.{_in_numpy}")
_NUMPY[cs.OP_SIGN] = _call("np.sign")


@dataclass(frozen=True)
class Language:
    """How a language spells operations, elements of its inputs and outputs, and the end of a statement."""

    operations: dict[int, Write]
    element: str
    end: str


C99 = Language(_C, "{0}[{1}]", ";")
NUMPY = Language(_NUMPY, "{0}[..., {1}]", "")


def statements(function: cs.Function, language: Language) -> tuple[list[str], list[str]]:
    """Statements that compute ``function`` (one SX function with dense inputs and outputs), and the variables they use.

    Inputs and outputs bear the function's own names. Raises ``NotImplementedError`` for an operation that is in no
    table: a law uses something that no export has needed so far.
    """
    names_in = [function.name_in(k) for k in range(function.n_in())]
    names_out = [function.name_out(k) for k in range(function.n_out())]
    lines: list[str] = []
    used: dict[str, None] = {}
    for k in range(function.n_instructions()):
        op = function.instruction_id(k)
        into, of = function.instruction_output(k), function.instruction_input(k)
        if op == cs.OP_OUTPUT:
            target = language.element.format(names_out[into[0]], into[1])
            lines.append(f"{target} = {_variable(of[0])}{language.end}")
            continue
        if op == cs.OP_CONST:
            value = number(function.instruction_constant(k))
        elif op == cs.OP_INPUT:
            value = language.element.format(names_in[of[0]], of[1])
        elif op in language.operations:
            value = language.operations[op](*(_variable(i) for i in of))
        else:
            raise NotImplementedError(f"no spelling for CasADi operation {op} in {function.name()}")
        used[_variable(into[0])] = None
        lines.append(f"{_variable(into[0])} = {value}{language.end}")
    return lines, list(used)


def _variable(index: int) -> str:
    return f"a{index}"


def number(value: float) -> str:
    """A constant with all its 17 digits."""
    text = repr(float(value))
    return text if any(c in text for c in ".en") else f"{text}.0"


def inputs_used(function: cs.Function) -> Sequence[bool]:
    """Which of the function's inputs its instructions read."""
    read = {
        function.instruction_input(k)[0]
        for k in range(function.n_instructions())
        if function.instruction_id(k) == cs.OP_INPUT
    }
    return [k in read for k in range(function.n_in())]
