"""Names of base and friction parameters (``lx1``, ``Fc2``) in words, for findings."""

from __future__ import annotations

import re
from collections.abc import Sequence

#: Numbered joint by joint in the order of the robot; the first group of a pattern is an axis or two.
_WORDS = (
    (r"m", "mass of {link}"),
    (r"l([xyz])", "mass times {axis} of the centre of {link}"),
    (r"L([xyz]{2})", "moment of inertia {axis} of {link}"),
    (r"Ia", "rotor inertia of {joint}"),
    (r"Fv", "viscous friction of {joint}"),
    (r"Fc", "Coulomb friction of {joint}"),
    (r"b", "torque offset of {joint}"),
)


def in_words(name: str, joint_names: Sequence[str]) -> str:
    """``Fc2`` as ``Coulomb friction of elbow``; a name of another form stays as it is."""
    for pattern, words in _WORDS:
        found = re.fullmatch(rf"{pattern}(\d+)", name)
        if found is None or not 1 <= int(found[found.re.groups]) <= len(joint_names):
            continue
        joint = joint_names[int(found[found.re.groups]) - 1]
        return words.format(joint=joint, link=f"the link of {joint}", axis=found[1])
    return name
