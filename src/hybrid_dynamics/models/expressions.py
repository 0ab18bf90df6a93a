"""Expressions that were learned: reading them safely, writing them exactly, evaluating them fast.

Only arithmetic, named variables and a short list of functions exist here. A text is read through Python's ``ast`` and
never evaluated, so an expression from a file or from a search engine cannot run code.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
import sympy as sp
from sympy.printing.str import StrPrinter

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.types import Array

_FUNCTIONS: dict[str, Callable[..., sp.Expr]] = {
    "sin": sp.sin,
    "cos": sp.cos,
    "tan": sp.tan,
    "tanh": sp.tanh,
    "exp": sp.exp,
    "log": sp.log,
    "sqrt": sp.sqrt,
    "abs": sp.Abs,
    "Abs": sp.Abs,
    "sign": sp.sign,
    "neg": lambda x: -x,
    "square": lambda x: x**2,
    "cube": lambda x: x**3,
}
_NODES = (sp.Add, sp.Mul, sp.Pow, sp.Symbol, sp.Number, sp.NumberSymbol)
_CALLS = (sp.sin, sp.cos, sp.tan, sp.tanh, sp.exp, sp.log, sp.Abs, sp.sign)
_MAX_LENGTH = 200_000
_CHUNK_ROWS = 20_000


class _ExactPrinter(StrPrinter):
    """Prints floats with the digits that give the same number back."""

    def _print_Float(self, expr: sp.Float) -> str:
        return repr(float(expr))


def format_expression(expression: sp.Expr) -> str:
    """The text of ``expression``; :func:`parse_expression` gives back the same numbers to the last bit."""
    return str(_ExactPrinter().doprint(expression))


def parse_expression(text: str, names: Iterable[str], *, real: bool = False) -> sp.Expr:
    """Read arithmetic over the variables ``names``; ``^`` may stand for ``**``.

    Raises :class:`InputError` for anything that is not a number, a known variable, ``+ - * / **`` or one of the listed
    functions. With ``real`` the symbols are declared real, which lets SymPy simplify more.
    """
    symbols = {name: sp.Symbol(name, real=True if real else None) for name in names}
    if len(text) > _MAX_LENGTH:
        raise InputError(f"expression of {len(text)} characters; at most {_MAX_LENGTH} are read")
    try:
        tree = ast.parse(text.strip().replace("^", "**"), mode="eval")
        return _build(tree.body, symbols)
    except (SyntaxError, RecursionError, MemoryError, ValueError) as error:
        raise InputError(f"expression {text[:80]!r} cannot be read ({error}); expected arithmetic") from None


def _build(node: ast.expr, symbols: dict[str, sp.Symbol]) -> sp.Expr:
    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        return sp.Integer(node.value) if type(node.value) is int else sp.Float(node.value)
    if isinstance(node, ast.Name):
        if node.id in symbols:
            return symbols[node.id]
        raise InputError(f"expression names {node.id!r}, which is no feature; expected one of {_some(symbols)}")
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        value = _build(node.operand, symbols)
        return -value if isinstance(node.op, ast.USub) else value
    if isinstance(node, ast.BinOp):
        return _binary(node, symbols)
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords and len(node.args) == 1:
        if node.func.id in _FUNCTIONS:
            return _FUNCTIONS[node.func.id](_build(node.args[0], symbols))
        raise InputError(f"expression calls {node.func.id!r}; expected one of {', '.join(_FUNCTIONS)}")
    raise InputError(
        f"expression holds {ast.unparse(node)[:60]!r}; expected numbers, variables, + - * / ** and functions"
    )


def _binary(node: ast.BinOp, symbols: dict[str, sp.Symbol]) -> sp.Expr:
    left, right = _build(node.left, symbols), _build(node.right, symbols)
    if isinstance(node.op, ast.Add):
        return left + right
    if isinstance(node.op, ast.Sub):
        return left - right
    if isinstance(node.op, ast.Mult):
        return left * right
    if isinstance(node.op, ast.Div):
        return left / right
    if isinstance(node.op, ast.Pow):
        if not right.is_number or abs(float(right)) > 64:
            raise InputError(f"expression holds the power {ast.unparse(node)[:60]!r}; expected a number of at most 64")
        return left**right
    raise InputError(f"expression holds {ast.unparse(node)[:60]!r}; expected + - * / **")


def _some(symbols: dict[str, sp.Symbol]) -> str:
    names = list(symbols)
    return ", ".join(names[:3]) + (f", ... {names[-1]}" if len(names) > 3 else "")


def plain_symbols(expression: sp.Expr) -> sp.Expr:
    """``expression`` over symbols without assumptions, as anyone gets them from ``sympy.Symbol(name)``."""
    return expression.xreplace({s: sp.Symbol(s.name) for s in expression.free_symbols})


def canonical(expression: sp.Expr, names: Sequence[str]) -> sp.Expr:
    """``expression`` in the form that survives writing and reading (so that its values do, to the last bit)."""
    for _ in range(5):
        again = parse_expression(format_expression(plain_symbols(expression)), names)
        if again == expression:
            break
        expression = again
    return expression


def complexity(expression: sp.Expr) -> int:
    """Number of nodes of the expression tree (operators count by arity less one, so a + b + c has 5)."""
    if not expression.args:
        return 1
    inner = sum(complexity(argument) for argument in expression.args)
    return inner + (len(expression.args) - 1 if isinstance(expression, sp.Add | sp.Mul) else 1)


class CompiledExpressions:
    """Several expressions over the columns ``names``, evaluated on (N, len(names)) arrays; gives (N, count)."""

    def __init__(self, expressions: Sequence[sp.Expr], names: Sequence[str]) -> None:
        for expression in expressions:
            _check(expression, set(names))
        used = {s.name for expression in expressions for s in expression.free_symbols}
        self._columns = [k for k, name in enumerate(names) if name in used]
        symbols = [sp.Symbol(names[k]) for k in self._columns]
        bare = [plain_symbols(expression) for expression in expressions]
        self._call: Callable[..., Any] = sp.lambdify(symbols, bare, modules="numpy", cse=len(bare) > 0)
        self._count = len(bare)

    def __call__(self, X: Array) -> Array:
        """Value of each expression (N, count) at the features ``X`` (N, 7n)."""
        out = np.empty((len(X), self._count))
        for start in range(0, len(X), _CHUNK_ROWS):
            rows = slice(start, start + _CHUNK_ROWS)
            with np.errstate(all="ignore"):
                values = self._call(*(np.ascontiguousarray(X[rows, k]) for k in self._columns))
            for k, value in enumerate(values):
                out[rows, k] = value
        return out


def _check(expression: sp.Expr, names: set[str]) -> None:
    for node in sp.preorder_traversal(expression):
        if isinstance(node, sp.Symbol) and node.name not in names:
            raise InputError(f"expression names {node.name!r}, which is no feature")
        if not isinstance(node, _NODES) and node.func not in _CALLS:
            raise InputError(f"expression holds {node.func.__name__!r}; expected arithmetic and simple functions")
