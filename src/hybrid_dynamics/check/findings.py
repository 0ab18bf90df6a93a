"""What a check says: one finding a line, with the value and what to do about it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from hybrid_dynamics.errors import InputError

Severity = Literal["hard", "warning", "note"]
#: Worst first.
SEVERITIES: tuple[Severity, ...] = ("hard", "warning", "note")


@dataclass(frozen=True)
class Finding:
    """One thing that was found.

    ``code`` is a fixed name (``dq_scale``) that scripts may rely on; ``severity``: ``hard`` (no verdict can be given:
    ``close-loop``, or ``predict``, refuses with exit code 2), ``warning`` (probably wrong) or ``note`` (worth knowing).
    ``run`` and ``joint`` are names, empty where the finding is about all of them. ``text`` gives the value and the
    remedy on one line. ``suggestion`` holds the keys of a ``log.yaml`` that mend it, empty where there is not one clear
    cure.
    """

    code: str
    severity: Severity
    text: str
    run: str = ""
    joint: str = ""
    suggestion: Mapping[str, Any] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """All fields, JSON-ready."""
        return {
            "code": self.code,
            "severity": self.severity,
            "run": self.run,
            "joint": self.joint,
            "text": self.text,
            "suggestion": dict(self.suggestion),
        }

    @property
    def line(self) -> str:
        """``run x: joint y: text``, as it stands in an error or a note."""
        where = [f"run {self.run}"] if self.run else []
        where += [f"joint {self.joint}"] if self.joint else []
        return ": ".join([*where, self.text])


def ordered(findings: Iterable[Finding]) -> list[Finding]:
    """Worst first; within a severity as they were found."""
    return sorted(findings, key=lambda f: SEVERITIES.index(f.severity))


def refuse_hard(findings: Sequence[Finding], options: str = "") -> None:
    """Raise :class:`InputError` with the first hard finding; how many further ones there are, and that ``check`` with
    ``options`` lists them, is told."""
    hard = [f for f in findings if f.severity == "hard"]
    if hard:
        more = "" if len(hard) == 1 else f" ({len(hard) - 1} more: hybrid-dynamics check{options} lists all)"
        raise InputError(hard[0].line + more)


def merged(parts: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Nested mappings of several suggestions as one; a key given twice keeps its first value."""
    out: dict[str, Any] = {}
    for part in parts:
        for key, value in part.items():
            if isinstance(value, Mapping):
                below = out.setdefault(key, {})
                if isinstance(below, dict):
                    out[key] = merged([below, value])
            else:
                out.setdefault(key, value)
    return out
