"""Units at joints that slide: positions in metres, forces in newtons."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

from hybrid_dynamics.effects.base import Family
from hybrid_dynamics.effects.keys import split_key


def on_a_slide(unit: str) -> str:
    """What ``unit`` of a joint that turns is at one that slides.

    >>> [on_a_slide(unit) for unit in ("N m", "N m s^2/rad^2", "1/rad", "kg m^2", "s")]
    ['N', 'N s^2/m^2', '1/m', 'kg', 's']
    """
    return unit.replace("N m", "N").replace("rad", "m").replace("kg m^2", "kg")


def unit_of(
    kind: Family, key: str, settings: Mapping[str, Any], joints: Collection[str], slides: Collection[str]
) -> str:
    """Unit of the published parameter ``key`` of an effect at ``joints``; ``slides`` are the prismatic joints."""
    unit = kind.unit(key, settings)
    fixed = {p.name for p in kind.parameters if p.angle}
    changes = kind.scope == "joint" and not kind.is_body and split_key(key)[1] not in fixed
    return on_a_slide(unit) if changes and any(joint in slides for joint in joints) else unit
