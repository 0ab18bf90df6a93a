"""Learned expressions as people read them: their terms, MathML for the page, LaTeX for the notebook."""

from __future__ import annotations

import ast
import re
from functools import lru_cache
from typing import Any

import sympy
from sympy.printing.latex import LatexPrinter
from sympy.printing.mathml import MathMLPresentationPrinter

from hybrid_dynamics.models.expressions import parse_expression

#: Expressions with more characters are described (number of terms), not typeset.
LONGEST = 2000
_WORD = re.compile(r"[A-Za-z_]\w*")
_NAME = re.compile(r"^(tau_inertia|tau_coriolis|tau_gravity|dddq|ddq|dq|q)([0-9]+)$")
_SYMBOLS = {
    "q": ("q", ""),
    # Plain dots in a row: browsers print the accents proper (U+02D9, U+00A8, U+20DB) into the letter.
    "dq": ("q", "·"),
    "ddq": ("q", "··"),
    "dddq": ("q", "···"),
    "tau_inertia": ("τ", "i"),
    "tau_coriolis": ("τ", "c"),
    "tau_gravity": ("τ", "g"),
}
#: Between factors: a thin space instead of an invisible operator, which browsers set without any space.
_PRODUCT = '<mspace width="0.17em"></mspace>'
_LATEX = {
    "q": "q_{%s}",
    "dq": r"\dot{q}_{%s}",
    "ddq": r"\ddot{q}_{%s}",
    "dddq": r"\dddot{q}_{%s}",
    "tau_inertia": r"\tau_{i,%s}",
    "tau_coriolis": r"\tau_{c,%s}",
    "tau_gravity": r"\tau_{g,%s}",
}


@lru_cache(maxsize=512)
def parse(expression: str) -> sympy.Expr:
    """The SymPy form of ``expression``, whatever its variables are called; nothing is evaluated."""
    return parse_expression(expression, set(_WORD.findall(expression)), real=True)


def number_of_terms(expression: str) -> int:
    """Number of summands as written; cheap, for expressions too long to typeset."""
    node: ast.AST = ast.parse(expression.strip(), mode="eval").body
    count = 1
    while isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Sub):
        node, count = node.left, count + 1
    return 0 if count == 1 and isinstance(node, ast.Constant) and node.value == 0 else count


def terms(expression: str) -> dict[str, float]:
    """The expanded expression as {term: coefficient}; the constant stands under ``"1"``."""
    expanded = sympy.expand(parse(expression))
    out = {str(term): float(value) for term, value in _coefficients(expanded).items()}
    return {term: value for term, value in out.items() if value != 0}


def _coefficients(expanded: sympy.Expr) -> dict[sympy.Expr, sympy.Expr]:
    out: dict[sympy.Expr, sympy.Expr] = {}
    for summand in sympy.Add.make_args(expanded):
        value, rest = summand.as_coeff_Mul()
        out[rest] = out.get(rest, sympy.Integer(0)) + value
    return out


def round_floats(expression: sympy.Expr, digits: int) -> sympy.Expr:
    """A copy whose floating-point numbers have at most ``digits`` significant digits."""
    return expression.xreplace({value: sympy.Float(value, digits) for value in expression.atoms(sympy.Float)})


class _MathML(MathMLPresentationPrinter):
    """Dots over q, rigid-body torques with i, c, g as in the paper, numbers in readable form."""

    def _print_Symbol(self, symbol: sympy.Symbol, style: str = "plain") -> Any:
        match = _NAME.match(symbol.name)
        if match is None:
            return super()._print_Symbol(symbol, style)
        kind, joint = match.groups()
        letter, mark = _SYMBOLS[kind]
        base = self._leaf("mi", letter)
        subscript: Any = self._leaf("mn", joint)
        if kind.startswith("tau"):
            subscript = self.dom.createElement("mrow")
            for tag, text in (("mi", mark), ("mo", ","), ("mn", joint)):
                subscript.appendChild(self._leaf(tag, text))
        elif mark:
            over = self.dom.createElement("mover")
            over.appendChild(base)
            over.appendChild(self._leaf("mtext", mark))
            base = over
        out = self.dom.createElement("msub")
        out.appendChild(base)
        out.appendChild(subscript)
        return out

    def _print_Float(self, value: sympy.Float) -> Any:
        mantissa, _, exponent = f"{float(value):.5g}".partition("e")
        if not exponent:
            return self._leaf("mn", mantissa)
        row = self.dom.createElement("mrow")
        power = self.dom.createElement("msup")
        power.appendChild(self._leaf("mn", "10"))
        power.appendChild(self._leaf("mn", str(int(exponent))))
        for element in (self._leaf("mn", mantissa), self._leaf("mo", "·"), power):
            row.appendChild(element)
        return row

    def _leaf(self, tag: str, text: str) -> Any:
        element = self.dom.createElement(tag)
        element.appendChild(self.dom.createTextNode(text))
        return element


class _Latex(LatexPrinter):
    def _print_Symbol(self, symbol: sympy.Symbol, style: str = "plain") -> str:
        match = _NAME.match(symbol.name)
        return _LATEX[match.group(1)] % match.group(2) if match else super()._print_Symbol(symbol, style)


def to_mathml(expression: str, digits: int = 5) -> str:
    """``<math>`` element of the expression, or one line with its number of terms where it is too long to print."""
    if len(expression) > LONGEST:
        return f"<span class='muted'>{number_of_terms(expression)} terms, see expressions.csv</span>"
    printer = _MathML()
    text = printer._print(round_floats(parse(expression), digits)).toxml()
    return f"<math>{text.replace('<mo>&InvisibleTimes;</mo>', _PRODUCT)}</math>"


def to_latex(expression: str, digits: int = 6) -> str:
    """LaTeX of the expression in the paper's notation."""
    return str(_Latex().doprint(round_floats(parse(expression), digits)))
