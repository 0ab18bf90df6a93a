"""What the page of one loop is made from, as data: numbers and names, no drawing. Written and read as JSON.

The loop's own page and the study's page draw from the same content; neither reads the other's HTML.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, cast

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.files import write_text

Numbers = tuple[float, ...]

#: Where the study's stages leave the content beside the loop's other files.
CONTENT_FILE = "page.json"
#: Kinds of effects in the order of the page, and the variable that a kind is drawn against.
KINDS = {
    "friction": "Friction",
    "rotor": "Rotor inertia",
    "position": "Torque that depends on the position",
    "offset": "Offset",
    "moment": "For a moment",
    "body": "Masses and inertias",
    "reading": "What is read",
    "other": "Other",
}
AXES = {
    "q": "position [rad]",
    "dq": "speed [rad/s]",
    "ddq": "acceleration [rad/s²]",
    "load": "rigid-body torque [N m]",
    "time": "time [s]",
    "added": "torque that the named effects add [N m]",
}


@dataclass(frozen=True)
class Curve:
    """The final model's law at one joint and the samples it answers to.

    ``x`` is the variable of :data:`AXES` named ``axis``; ``missing`` [N m] what the final model lacks there once the
    group's effects are taken out; ``added`` [N m] what they add. ``run`` counts into :attr:`Group.runs`, or into
    :attr:`Content.test_runs`.
    ``noise`` [N m] is the joint's noise floor.
    """

    joint: str
    axis: str
    noise: float
    x: Numbers
    missing: Numbers
    added: Numbers
    run: tuple[int, ...]

    def thinned(self, points: int) -> Curve:
        """Every so many samples of it, at most ``points``."""
        step = slice(None, None, max(-(-len(self.x) // points), 1))
        return replace(self, x=self.x[step], missing=self.missing[step], added=self.added[step], run=self.run[step])


@dataclass(frozen=True)
class Group:
    """Named effects of one kind at one place. ``effects`` count into the diagnosis' list; ``contribution`` [N m] is the
    rms torque that each of them adds on held-out runs (of one run alone: there), on the joint
    (``contribution_joint``) where it adds most. ``runs``: those of the curves, where they are not the held-out ones."""

    where: str
    kind: str
    effects: tuple[int, ...]
    contribution: Numbers
    contribution_joint: tuple[str, ...]
    curves: tuple[Curve, ...] = ()
    runs: tuple[str, ...] = ()


@dataclass(frozen=True)
class Trace:
    """Torque of one joint along one held-out run: ``time`` [s]; ``measured before after`` [N m]."""

    run: str
    joint: str
    time: Numbers
    measured: Numbers
    before: Numbers
    after: Numbers


@dataclass(frozen=True)
class Law:
    """Formula that the diagnosis gives for what is left on ``joint``, tried on the held-out runs: rms error [N m] over
    samples in which the joint moves, ``before`` and ``after`` the formula is taken from it."""

    joint: str
    before: float
    after: float


@dataclass(frozen=True)
class Candidate:
    """A cause that was tried in a step: ``score`` and ``gain`` in squared noise floors a sample; ``added`` if taken."""

    effect: str
    joint: str
    settings: str
    score: float
    gain: float
    gain_error: float
    added: bool
    why: str


@dataclass(frozen=True)
class SearchStep:
    """One step of the search: ``action`` (start, add, drop, replace, stop), on what, the candidates ranked for it, and
    what a replacement took out, in words."""

    action: str
    effect: str
    joint: str
    candidates: tuple[Candidate, ...] = ()
    replaced: tuple[str, ...] = ()


@dataclass(frozen=True)
class Content:
    """Everything the page shows. ``diagnosis`` is diagnosis.json; ``provenance`` says where the logs come from;
    ``described`` are the numbers of the starting model's links, by ``"joint/mass"`` and so on."""

    diagnosis: Mapping[str, Any]
    train_runs: tuple[str, ...]
    test_runs: tuple[str, ...]
    groups: tuple[Group, ...] = ()
    traces: tuple[Trace, ...] = ()
    steps: tuple[SearchStep, ...] = ()
    provenance: str = ""
    laws: tuple[Law, ...] = ()
    described: Mapping[str, float] = field(default_factory=dict)


#: Fields of a class that hold others.
_PARTS: Mapping[tuple[type, str], type] = {
    (Content, "groups"): Group,
    (Content, "traces"): Trace,
    (Content, "steps"): SearchStep,
    (Content, "laws"): Law,
    (Group, "curves"): Curve,
    (SearchStep, "candidates"): Candidate,
}


def write_content(path: str | os.PathLike[str], content: Content) -> None:
    """Write ``content`` as JSON, atomically."""
    write_text(Path(path), json.dumps(asdict(content), separators=(",", ":")) + "\n")


def read_content(path: str | os.PathLike[str]) -> Content:
    """Inverse of :func:`write_content`; :class:`InputError` names the file that is not one."""
    try:
        value = json.loads(Path(path).read_text("utf-8"))
        return cast(Content, _built(Content, value))
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; run the stage that writes it again (dvc repro)") from None
    except (ValueError, TypeError) as error:
        raise InputError(f"{path}: {error}; run the stage that writes it again (dvc repro)") from None


def _built(kind: type, value: Any) -> Any:
    """``kind`` from its JSON: lists become tuples; a name that is unknown or missing raises ``TypeError``."""
    if not isinstance(value, dict):
        raise TypeError(f"expected the values of {kind.__name__}, found {type(value).__name__}")
    known: dict[str, Any] = {}
    for name, own in value.items():
        part = _PARTS.get((kind, name))
        if part is not None:
            own = [_built(part, item) for item in own]
        known[name] = tuple(own) if isinstance(own, list) else own
    return kind(**known)
