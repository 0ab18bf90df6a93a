"""The pages of ``docs/effects/``: written from the families, so that they say what the code does.

``make pages`` writes them into ``docs/effects``; a test compares.
"""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

from hybrid_dynamics.effects import Family, catalogue, family

_SCOPE = {
    "joint": "one joint",
    "link": "one link, and so the joint that moves it and those before it",
    "robot": "the whole robot",
}
_VARIABLE = {
    "q": "the joint's position",
    "dq": "the joint's speed",
    "ddq": "the joint's acceleration",
    "time": "time",
    "load": "the joint's rigid-body torque",
}


def page(name: str) -> str:
    """Markdown of one family."""
    kind = family(name)
    text = (importlib.import_module(type(kind).__module__).__doc__ or "").strip()
    lines = [f"# {name}", "", "The torque the drive must add:", "", "```math", kind.equation, "```", "", text, ""]
    lines += [f"Acts on {_SCOPE[kind.scope]}{', or on all joints as one cause' if kind.shared else ''}.", ""]
    lines += ["| parameter | unit | found |", "|---|---|---|"]
    refined = {r.name: r for r in kind.nonlinear_settings}
    for p in kind.parameters:
        how = "refined within the bounds below" if p.name in refined else "by (constrained) least squares"
        lines.append(f"| `{p.name}` | {p.unit} | {how} |")
    lines += [f"\nRefined: {_bounds(kind)}."] if refined else []
    lines += ["", f"Shown by a motion in which {kind.shown_by}.", ""]
    lines += [f"In the report its residual is drawn against {_VARIABLE[kind.drawn_against]}.", ""]
    if kind.contains:
        special = ", ".join(f"[{e}]({e}.md)" for e in kind.contains)
        lines += [f"Holds as a special case, which is named where it explains as much: {special}.", ""]
    if kind.equivalent_to:
        lines += [
            "## What makes the same torque, and what would tell",
            "",
            "| effects | why | remedy |",
            "|---|---|---|",
        ]
        lines += [f"| {_names(e.effects)} | {e.why} | {e.remedy} |" for e in kind.equivalent_to]
        lines.append("")
    return "\n".join(lines)


def index() -> str:
    """Markdown of the table of all families."""
    lines = [
        "# The effect catalogue",
        "",
        "One page a family, written from its module in `src/hybrid_dynamics/effects/` by "
        "`make pages`. What a family offers the loop, the simulation "
        "and the exports is said in `effects/law.py` and `effects/base.py`.",
        "",
        "| effect | the torque the drive must add | parameters |",
        "|---|---|---|",
    ]
    for name in catalogue(everything=True):
        parameters = ", ".join(f"`{p.name}`" for p in family(name).parameters)
        lines.append(f"| [{name}]({name}.md) | ${family(name).equation.replace('|', '∣')}$ | {parameters} |")
    return "\n".join([*lines, ""])


def pages() -> dict[str, str]:
    """Contents by file name."""
    return {"README.md": index(), **{f"{name}.md": page(name) for name in catalogue(everything=True)}}


def _bounds(kind: Family) -> str:
    return ", ".join(f"`{r.name}` from {r.low:g} to {r.high:g}" for r in kind.nonlinear_settings)


def _names(effects: tuple[str, ...]) -> str:
    return " + ".join(f"[{e}]({e}.md)" for e in effects)


def write(folder: Path) -> None:
    """Write all pages into ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in pages().items():
        (folder / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    write(Path(sys.argv[1]))
