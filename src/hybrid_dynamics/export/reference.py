"""The tables of ``docs/export.md``: ``python -m hybrid_dynamics.export.reference docs/export.md`` writes them from the
code, behind the line that says so."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from hybrid_dynamics.effects import Effect, catalogue, family
from hybrid_dynamics.errors import ConfigError, run_main
from hybrid_dynamics.export import NETWORK
from hybrid_dynamics.export.carry import CARRIES
from hybrid_dynamics.export.terms import WORDS, terms
from hybrid_dynamics.files import atomic_path
from hybrid_dynamics.robots import Robot

_LINK = (
    '<link name="l{k}"><inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>'
    '</inertial></link><joint name="j{k}" type="revolute"><parent link="l{below}"/><child link="l{k}"/>'
    '<origin xyz="0 0 0.3"/><axis xyz="0 1 0"/><limit lower="-2" upper="2" velocity="1" effort="1"/></joint>'
)
#: The line of the page behind which all is written.
FROM_HERE = "<!-- from here on: make pages -->"
#: Members drawn of each family.
_DRAWS = 12


def term_table() -> str:
    """What each format does with each term an effect may have."""
    forms = list(CARRIES)
    lines = ["| term | " + " | ".join(forms) + " |", "|---" * (len(forms) + 1) + "|"]
    for term, words in WORDS.items():
        cells = [CARRIES[form].get(term, "–").replace("|", "\\|") for form in forms]
        lines.append(f"| {words} | " + " | ".join(f"`{c}`" if "<" in c else c for c in cells) + " |")
    return "\n".join(lines)


def effect_table() -> str:
    """The terms of each effect, and what of them each description format keeps."""
    forms = [form for form in CARRIES if CARRIES[form] is not CARRIES["c"]]
    lines = ["| effect | terms | " + " | ".join(forms) + " | programs |", "|---" * (len(forms) + 3) + "|"]
    for name, variants in _terms_of_all().items():
        words = " or ".join("; ".join(WORDS[t] for t in own) for own in variants)
        cells = [" or ".join(dict.fromkeys(_share(own, form) for own in variants)) for form in [*forms, "c"]]
        lines.append(f"| `{name}` | {words} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _share(own: tuple[str, ...], form: str) -> str:
    kept = [term for term in own if term in CARRIES[form]]
    return "yes" if len(kept) == len(own) else "in part" if kept else "no"


def _terms_of_all() -> dict[str, list[tuple[str, ...]]]:
    """Terms of the members of every family of the catalogue, as a study draws them; alike ones once."""
    text = "".join(_LINK.format(k=k, below=k - 1) for k in (1, 2, 3))
    robot = Robot.from_text(f'<robot name="example"><link name="l0"/>{text}</robot>', "example")
    out: dict[str, list[tuple[str, ...]]] = {}
    for name in catalogue(everything=True):
        kind, found = family(name), set()
        for seed in range(_DRAWS):
            rng = np.random.default_rng(seed)
            term = kind.draw_term(robot, np.ones(3, bool), rng)
            parameters, settings = kind.at_term(term, kind.draw(robot, term, rng), robot)
            joints = () if term.joint is None else (robot.joint_names[term.joint],)
            found.add(tuple(terms(Effect(name, joints, parameters, settings), robot)))
        out[name] = sorted(found)
    return out


def tables() -> str:
    """Both tables, as they stand in the documentation."""
    programs = ", ".join(f"`{form}`" for form in CARRIES if CARRIES[form] is CARRIES["c"])
    return "\n\n".join(
        [
            "### Per term",
            term_table(),
            "### Per effect",
            f"Programs are {programs}; `{NETWORK}` is for the networks `nn` and `r_nn` and holds all of them.",
            effect_table(),
        ]
    )


def write(page: Path) -> None:
    """Put the tables into ``page`` in the place of all behind the line :data:`FROM_HERE`; :class:`ConfigError` where it
    has no such line."""
    before, line, _ = page.read_text(encoding="utf-8").partition(FROM_HERE)
    if not line:
        raise ConfigError(f"{page}: no line {FROM_HERE!r}; put one in where the tables belong")
    with atomic_path(page) as temporary:
        temporary.write_text(f"{before}{FROM_HERE}\n\n{tables()}\n", encoding="utf-8")


if __name__ == "__main__":
    run_main(lambda: write(Path(*sys.argv[1:2] or ["docs/export.md"])))
