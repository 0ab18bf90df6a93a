"""What the settings of an effect may be: each by its name, wherever it comes from (a file may hold anything)."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from itertools import pairwise
from numbers import Real
from typing import Any

from hybrid_dynamics.effects.state import Refined
from hybrid_dynamics.errors import InputError

Check = Callable[[Any], bool]


def check_settings(effect: str, settings: Mapping[str, Any], known: Collection[str]) -> None:
    """Raise :class:`InputError` naming the first of ``settings`` that ``effect`` does not have or that cannot be."""
    for name, value in settings.items():
        if name not in known:
            raise InputError(
                f"effect {effect}: setting {name!r} is unknown; known are {', '.join(sorted(known)) or 'none'}"
            )
        check, expected = KINDS[name]
        if not check(value):
            raise InputError(f"effect {effect}: setting {name} is {value!r}; expected {expected}")


def check_refined(
    effect: str,
    refined: Sequence[Refined],
    values_of: Callable[[Mapping[str, float]], Mapping[str, float]],
    parameters: Mapping[str, float],
) -> None:
    """Raise :class:`InputError` where ``parameters`` make a nonlinear one (a speed, a distance) zero or negative."""
    try:
        values = values_of(parameters) if refined else {}
    except ZeroDivisionError:
        values = {}
    for r in refined:
        value = values.get(r.name, 0.0)
        if r.log and not (math.isfinite(value) and value > 0):
            given = ", ".join(f"{k} = {v:g}" for k, v in parameters.items())
            raise InputError(f"effect {effect}: {given}; expected a {r.name.replace('_', ' ')} > 0")


def _number(value: Any) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)


def _positive(value: Any) -> bool:
    return _number(value) and value > 0


def _not_negative(value: Any) -> bool:
    return _number(value) and value >= 0


def _text(value: Any) -> bool:
    return isinstance(value, str) and bool(value)


def _rising(value: Any) -> bool:
    return (
        isinstance(value, tuple)
        and len(value) >= 2
        and all(map(_number, value))
        and all(a < b for a, b in pairwise(value))
    )


def _names(value: Any) -> bool:
    return isinstance(value, tuple) and len(value) > 0 and all(map(_text, value)) and len(set(value)) == len(value)


def _spans(value: Any) -> bool:
    return isinstance(value, tuple) and len(value) > 0 and all(_rising(v) and len(v) == 2 for v in value)


def _one_of(*words: str) -> tuple[Check, str]:
    return lambda value: isinstance(value, str) and value in words, f"one of {', '.join(words)}"


#: Setting -> what it may be. Lists are tuples here.
KINDS: Mapping[str, tuple[Check, str]] = {
    "sign_width": (_not_negative, "a speed >= 0 rad/s"),
    "sign_displacement": (_positive, "a distance > 0 rad"),
    "held_within": (_positive, "a number > 0"),
    "only_run": (lambda value: _text(value) or _names(value), "the name of a run, or names of several"),
    "from_joint": (_text, "the name of a joint"),
    "rows": _one_of("own", "both"),
    "sign_of": _one_of("partner", "sum", "difference"),
    "law": _one_of("dahl", "damped", "lugre"),
    "of": _one_of("offset", "coulomb", "viscous"),
    "at_rest": _one_of("middle"),
    "response": _one_of("delay", "lag"),
    "shape": _one_of("linear", "sine", "piecewise"),
    "knots": (_rising, "positions [rad] that rise, two or more"),
    "intervals": (_spans, "pairs of times [s], the earlier first"),
    "links": (_names, "names of joints, each once"),
    "expression": (_text, "a law as text"),
}
