"""Sections of a page, as data: each a small class that prepares values for a template of its own. Here the answers.

The study's page shows some of the same sections under a prefix of their own, so that no anchor stands twice.
"""

from __future__ import annotations

import inspect
import re
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from hybrid_dynamics.effects import family
from hybrid_dynamics.effects.units import with_unit
from hybrid_dynamics.errors import ConfigError
from hybrid_dynamics.loop_report import rest, words
from hybrid_dynamics.loop_report.book import FigureBook
from hybrid_dynamics.loop_report.content import KINDS, Content, Group
from hybrid_dynamics.loop_report.html import slug
from hybrid_dynamics.loop_report.meaning import meaning
from hybrid_dynamics.loop_report.parameter_words import missing, row_words

#: Anchor of the section on what stays open, which the first screen links.
LEFT = "left"


@dataclass(frozen=True)
class Section(ABC):
    """A piece of a page: ``template`` (a file of ``templates/``) filled with :meth:`values`."""

    title: ClassVar[str]
    name: ClassVar[str]
    template: ClassVar[str]

    @property
    def anchor(self) -> str:
        """Where links to the section lead."""
        return self.name

    @property
    def heading(self) -> str:
        """What stands above it."""
        return self.title

    @property
    def wanted(self) -> bool:
        """False where there is nothing to show."""
        return True

    @abstractmethod
    def values(self, book: FigureBook) -> dict[str, Any]:
        """What the template is filled with; figures go into ``book``."""


@dataclass(frozen=True)
class LoopSection(Section):
    """A section about one loop. ``prefix`` precedes its anchors; ``light`` leaves out what only its own page shows."""

    content: Content
    prefix: str = ""
    light: bool = False

    @property
    def anchor(self) -> str:
        """Where links to the section lead."""
        return self.prefix + self.name

    @property
    def diagnosis(self) -> Mapping[str, Any]:
        """The diagnosis that is told."""
        return self.content.diagnosis

    def effect_anchor(self, entry: Mapping[str, Any]) -> str:
        """Where links to an effect lead."""
        return slug(f"{self.prefix}effect {entry['effect']} {' '.join(entry['joints'])}")

    def group_anchor(self, group: Group) -> str:
        """Where links to the evidence for a group of effects lead."""
        return slug(f"{self.prefix}evidence {group.where or 'robot'} {group.kind}")


class Answer(LoopSection):
    """The first screen: what is missing, where, how much, how sure, what it buys, what stays open; one picture."""

    title = "The answer"
    name = "answer"
    template = "answer.html"

    def values(self, book: FigureBook) -> dict[str, Any]:
        d = self.diagnosis
        return {
            "verdict": d["verdict"],
            "says": words.verdict_words(d),
            "headline": meaning(d),
            "what": what(d),
            "missing": [_unbroken(line) for line in missing(d, _sizes(self.content), self.content.described)],
            "link": "#" + self.prefix + Effects.name if d["effects"] else "",
            "gains": words.gains(d),
            "certainty": words.certainty(d),
            "still_open": [_unbroken(line) for line in words.still_open(d)],
            "link_left": "#" + self.prefix + LEFT if words.opens(d) else "",
            "bars": bars(d),
            "first": [_unbroken(words.capital(note)) for note in words.told_first(d)],
            "notes": words.other_notes(d),
            "schema_two": "noise_floor_low" in d,
            "mass_caveat": _mass_caveat(d),
        }


def what(d: Mapping[str, Any]) -> str:
    """What the effects are the answer to."""
    if words.asked(d):
        return "What has changed"
    return "What is missing, or wrong in the URDF" if words.described(d) else "What is missing"


def _unbroken(text: str) -> str:
    """``text`` whose lines break neither within a unit nor before one, nor beside the sign of an error."""
    return re.sub(r"(?<=[\d±]) (?=[\d±%]|N m|kg|rad|m\b)|(?<=N) (?=m)|(?<=kg) (?=m)", "\u00a0", text)


def _sizes(content: Content) -> dict[str, float]:
    """Largest rms torque [N m] that an effect of each kind adds on a joint of the held-out runs."""
    out: dict[str, float] = {}
    for group in content.groups:
        for k, size in zip(group.effects, group.contribution, strict=True):
            name = content.diagnosis["effects"][k]["effect"]
            out[name] = max(out.get(name, 0.0), size)
    return out


def bars(d: Mapping[str, Any]) -> list[dict[str, Any]]:
    """A row per joint: widths in per cent of its larger error, numbers in N m, what is left in a word."""
    before, after = d["error"]["test"]["before"]["rmse"], rest.final_errors(d)["rmse"]
    low, high = d.get("noise_floor_low") or d["noise_floor"], d.get("noise_floor_high") or d["noise_floor"]
    rows = []
    for j, name in enumerate(d["joints"]):
        full = max(before[j], after[j], high[j], 1e-12)
        kind, state = rest.state_of(d, j)
        rows.append(
            {
                "joint": with_unit(name, words.slides(d)),
                "before": 100 * before[j] / full,
                "after": 100 * after[j] / full,
                "low": 100 * low[j] / full,
                "span": max(100 * (high[j] - low[j]) / full, 0.0),
                "before_text": words.padded(before[j]),
                "after_text": words.padded(after[j]),
                "floor_text": range_of(low[j], high[j]),
                "state": state,
                "kind": kind,
            }
        )
    return rows


def range_of(low: float, high: float) -> str:
    """Both numbers, or one where they read the same."""
    one, two = words.number(low, 2), words.number(high, 2)
    return one if one == two else f"{one} to {two}"


def _mass_caveat(d: Mapping[str, Any]) -> str:
    masses = [
        p
        for e in d["effects"]
        if words.confirmed(e) and family(e["effect"]).detachable
        for p in e["parameters"]
        if p["name"] in words.SCALED_BY_GAIN
    ]
    if not masses:
        return ""
    return (
        f"{words.GAIN_CAVEAT} (1 % of {words.number(masses[0]['value'], 3)} kg is {masses[0]['value'] / 100:.2g} kg)."
    )


class Effects(LoopSection):
    """Named effects per joint and kind: parameters, what each contributes, what held-out runs say."""

    title = "Named effects"
    name = "effects"
    template = "effects.html"

    @property
    def wanted(self) -> bool:
        return bool(self.diagnosis["effects"])

    def values(self, book: FigureBook) -> dict[str, Any]:
        return {
            "groups": [self._group(group) for group in self.content.groups],
            "explanations": [
                {"effect": name, "title": words.capital(words.title_of(name)), "text": explanation_of(name)}
                for name in dict.fromkeys(e["effect"] for e in self.diagnosis["effects"])
            ],
            "mass_caveat": _mass_caveat(self.diagnosis),
            "prefix": self.prefix,
            "light": self.light,
        }

    def _group(self, group: Group) -> dict[str, Any]:
        largest = max((c for g in self.content.groups for c in g.contribution), default=0.0) or 1.0
        rows = []
        for place, k in enumerate(group.effects):
            entry = self.diagnosis["effects"][k]
            shown = _parameters(entry)
            rows.append(
                {
                    "anchor": self.effect_anchor(entry),
                    "effect": entry["effect"],
                    "title": words.capital(words.title_of(entry["effect"])),
                    "first": [] if len({p["joint"] for p in entry["parameters"]}) > 1 else shown[:1],
                    "body": len(shown) > 4,
                    "open": sum(bool(p["left_open"]) for p in shown),
                    "parameters": shown,
                    "settings": ", ".join(row_words(entry, words.slides(self.diagnosis))),
                    "width": 100 * group.contribution[place] / largest,
                    "adds": words.number(group.contribution[place], 3),
                    "adds_unit": words.effort_unit(self.diagnosis, group.contribution_joint[place]),
                    "adds_on": group.contribution_joint[place]
                    if group.contribution_joint[place] != group.where
                    else "",
                    "standing": words.standing(entry) if "confirmed" in entry else "",
                    "change": _change(entry),
                    "why_not": entry.get("why_not", ""),
                    "alike": [_alike(other) for other in entry["indistinguishable_from"]],
                    "inconsistent": [_inconsistent(item) for item in entry.get("inconsistent_between_runs", [])],
                }
            )
        return {
            "where": group.where or "Whole robot",
            "kind": KINDS[group.kind],
            "evidence": "" if not group.curves else "#" + self.group_anchor(group),
            "rows": rows,
        }


def explanation_of(effect: str) -> str:
    """What the effect is: the first paragraph of its family's documentation."""
    try:
        known = type(family(effect))
    except ConfigError:
        return ""
    module = inspect.getmodule(known)
    text = inspect.getdoc(module) if module is not None else None
    return " ".join((text or "").split("\n\n")[0].split()).replace("``", "")


def _parameters(entry: Mapping[str, Any]) -> list[dict[str, str]]:
    joints = {p["joint"] for p in entry["parameters"]}
    return [
        {
            "key": p["name"],
            "name": words.title_of(p["name"]) + (f" of {p['joint']}" if len(joints) > 1 else ""),
            "value": words.value_of(entry, p),
            "left_open": "left open by the runs" if words.left_open(entry, p) else "",
        }
        for p in entry["parameters"]
    ]


def _change(entry: Mapping[str, Any]) -> str:
    """What leaving the effect in does to the held-out mean square error."""
    change = entry.get("test_change")
    if change is None:
        return ""
    value, error = (change["value"], change["std_error"]) if isinstance(change, Mapping) else (change, None)
    if not error:
        return f"{100 * value:+.3g} %"
    decimals = min(max(0, -int(f"{100 * error:e}".split("e")[1])), 6)
    return f"{100 * value:+.{decimals}f} ± {100 * error:.{decimals}f} %"


def _alike(other: Mapping[str, Any]) -> dict[str, str]:
    names = " with ".join(f"{words.title_of(e['effect'])} ({words.place_of(e)})" for e in other["effects"])
    return {"names": names, "why": words.capital(other["why"]), "tell": words.capital(other["motion_that_would_tell"])}


def _inconsistent(item: Mapping[str, Any]) -> str:
    runs = "; ".join(f"{r['run']}: {words.with_error(r['value'], r['std_error'], item['unit'])}" for r in item["runs"])
    return f"{words.capital(words.title_of(item['parameter']))} differs between runs: {runs}"
