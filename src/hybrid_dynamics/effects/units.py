"""Units at joints that slide: positions in metres, forces in newtons."""

from __future__ import annotations

from collections.abc import Collection

from hybrid_dynamics.effects.base import Effect, family
from hybrid_dynamics.effects.keys import split_key


def on_a_slide(unit: str) -> str:
    """What ``unit`` of a joint that turns is at one that slides.

    >>> [on_a_slide(unit) for unit in ("N m", "N m s^2/rad^2", "1/rad", "kg m^2", "s")]
    ['N', 'N s^2/m^2', '1/m', 'kg', 's']
    """
    return unit.replace("N m", "N").replace("rad", "m").replace("kg m^2", "kg")


def unit_at(unit: str, joint: str, slides: Collection[str]) -> str:
    """``unit`` of a joint that turns, at ``joint``; ``slides`` are the prismatic joints."""
    return on_a_slide(unit) if joint in slides else unit


def with_unit(joint: str, slides: Collection[str]) -> str:
    """``joint`` for a table in N m; where it slides, with the unit of its row."""
    return f"{joint} [{on_a_slide('N m')}]" if joint in slides else joint


def unit_of(effect: Effect, key: str, slides: Collection[str]) -> str:
    """Unit of the published parameter ``key`` of ``effect``; ``slides`` are the prismatic joints."""
    kind = family(effect.effect)
    unit = kind.unit(key, effect.settings)
    fixed = {p.name for p in kind.parameters if p.angle}
    changes = kind.scope == "joint" and not kind.is_body and split_key(key)[1] not in fixed
    return on_a_slide(unit) if changes and any(joint in slides for joint in effect.joints) else unit
