"""A diagnosis in words: what is missing, where, how much, how sure, what it buys, what stays open."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from hybrid_dynamics.effects.units import unit_at
from hybrid_dynamics.loop.describe import NO_BETTER
from hybrid_dynamics.loop.described import WORSE
from hybrid_dynamics.loop.spoiled import SPOILED
from hybrid_dynamics.loop_report import rest
from hybrid_dynamics.loop_report.rest import (
    ABOVE,
    STANDING,
    UNTESTED,
    Diagnosis,
    beyond_friction,
    final_errors,
    flags,
    learned,
    state_of,
    unproven_shares,
)

#: What stays open where nothing that is left depends on the motion, by the state of the joint.
_BESIDE = {
    ABOVE: "the held-out error is above the noise, and these runs show no cause",
    STANDING: "noise in motion, more at standstill, where the motion does not determine friction",
    UNTESTED: "stands still in the test runs, which say nothing of what was found on it",
}
#: What may hold a joint that stands, where friction does not.
_HOLDS = "more than friction holds: a hand, a stop, a brake, a load or friction that the model does not know"
#: What other models leave less of the test runs, by the state of the joint.
SURPASSED = {
    rest.WORSE: "the starting model leaves less of the test runs",
    rest.RIVALLED: "a fit of all links and friction at once leaves much less of the test runs",
}
#: How notes begin that come before the numbers.
FIRST = (NO_BETTER, SPOILED, WORSE)
#: Words of notes on what the starting model had of an effect; its value tells that too.
_WITH_VALUES = ("since the starting model", "in all, of which the URDF gives")
#: Joints that are named one by one, however few the others are.
_NAMED = 3
#: Standard errors beyond which a change is more than chance.
SURE = 2.0
#: What the motion consists of.
VARIABLES = {"q": "position", "dq": "speed", "ddq": "acceleration"}
#: Names that are people's, and short ones that are nobody's.
PROPER = {"coulomb": "Coulomb", "stribeck": "Stribeck", "com": "centre of mass"}
#: Parameters in proportion to which the drive gains enter: a mass is known no better than the torque is calibrated.
SCALED_BY_GAIN = ("mass",)
GAIN_CAVEAT = (
    "The standard error is statistical. If your torque is computed from motor current, a drive gain that is off by 1 % "
    "makes the mass wrong by 1 %"
)


def slides(diagnosis: Diagnosis) -> Sequence[str]:
    """Joints that slide."""
    return tuple(diagnosis.get("prismatic", ()))


def effort_unit(diagnosis: Diagnosis, joint: str) -> str:
    """N m, or N where ``joint`` slides."""
    return unit_at("N m", joint, slides(diagnosis))


#: No quantity of a robot, in SI units, is as small.
_ROUNDING = 1e-15


def number(value: float | None, digits: int = 4) -> str:
    """``value`` with ``digits`` significant digits, – where there is none; what is nothing but for rounding is 0."""
    return "–" if value is None else f"{0.0 if abs(value) <= _ROUNDING else value:.{digits}g}"


def known(value: float) -> float | None:
    """``value`` as a float, None where it is not a number."""
    return None if math.isnan(value) else float(value)


def padded(value: float, digits: int = 3) -> str:
    """``value`` with ``digits`` significant digits, zeros at the end too, so that numbers below one another compare."""
    return f"{value:#.{digits}g}".rstrip(".")


def share(value: float | None, digits: int = 2) -> str:
    """A share as per cent."""
    return "–" if value is None else f"{plain(100 * value, digits)} %"


def plain(value: float, digits: int = 2) -> str:
    """``value`` with ``digits`` significant digits; a large one is written out, as people do: 2,600."""
    text = f"{value:.{digits}g}"
    return f"{float(text):,.0f}" if "e+" in text else text


def unit_of(unit: str) -> str:
    """``kg m^2`` as people write it."""
    return unit.replace("^2", "²").replace("^3", "³")


def _tail(unit: str) -> str:
    return "" if unit in ("", "-", "–", "1") else f" {unit_of(unit)}"


def with_error(value: float, error: float | None, unit: str) -> str:
    """Value and standard error with as many decimals as the error warrants."""
    tail = _tail(unit)
    if not error:
        return f"{number(value)}{tail}"
    decimals = max(0, 1 - int(f"{error:e}".split("e")[1]))
    return f"{value:.{decimals}f} ± {error:.{decimals}f}{tail}" if decimals < 8 else f"{value:.3g} ± {error:.1g}{tail}"


def title_of(effect: str) -> str:
    """``coulomb_friction`` as people write it."""
    return " ".join(PROPER.get(word, word) for word in effect.split("_"))


def capital(text: str) -> str:
    """First letter in upper case, the rest as it is."""
    return text[:1].upper() + text[1:]


def place_of(entry: Mapping[str, Any]) -> str:
    """The joint of an effect, or the whole robot."""
    return ", ".join(entry["joints"]) or "whole robot"


def placed(effect: str, joint: str) -> str:
    """An effect and its joint, where it has one."""
    return title_of(effect) + (f" ({joint})" if joint else "")


def confirmed(entry: Mapping[str, Any]) -> bool:
    """False only where test runs contradict the name (schema 1 did not ask them)."""
    return bool(entry.get("confirmed", True))


def standing(entry: Mapping[str, Any]) -> str:
    """What the held-out runs say of a name: ``confirmed``, ``undecided`` (no more than chance) or ``contradicted``."""
    if not confirmed(entry):
        return "contradicted"
    change = entry.get("test_change")
    if change is None:
        return "confirmed"
    return "confirmed" if change["value"] < -SURE * change["std_error"] else "undecided"


def left_open(entry: Mapping[str, Any], p: Mapping[str, Any]) -> bool:
    """Whether parameter ``p`` of ``entry`` is not determined by the runs: its number is the starting model's."""
    return bool({p["name"], f"{p['joint']}/{p['name']}"} & set(entry.get("undetermined_parameters") or ()))


def value_of(entry: Mapping[str, Any], p: Mapping[str, Any]) -> str:
    """The value with its standard error, without one where the runs leave it open; what the starting model had."""
    own = with_error(p["value"], None if left_open(entry, p) else p["std_error"], p["unit"])
    ends = ends_of(entry, p)
    if not ends:
        return own
    return f"{own} (URDF: {number(ends['urdf'])})" if "urdf" in ends else f"{own} ({arrow(ends)})"


def ends_of(entry: Mapping[str, Any], p: Mapping[str, Any]) -> Mapping[str, float]:
    """The parameter in the starting model (``urdf`` or ``start``) and ``now``; empty where that has none."""
    return dict((entry.get("in_all") or {}).get(p["name"], {}))


def arrow(ends: Mapping[str, float], digits: int = 4) -> str:
    """From the starting model to now."""
    return f"{number(ends['start'], digits)} → {number(ends['now'], digits)}"


def asked(d: Diagnosis) -> bool:
    """Whether an earlier model was asked what has changed since."""
    command = (d.get("provenance") or {}).get("command")
    return isinstance(command, Mapping) and bool(command.get("model"))


def described(d: Diagnosis) -> bool:
    """Whether what was found corrects what the URDF gives."""
    return any("urdf" in ends for e in d["effects"] for ends in (e.get("in_all") or {}).values())


def run_words(run: str) -> str:
    """``run 3``; a name that says so itself, as it is."""
    return run if run.lower().startswith("run") else f"run {run}"


def told_first(d: Diagnosis) -> list[str]:
    """Notes that a reader needs before the numbers: a model that is of no use, a description that does harm."""
    return [note for note in d.get("notes", []) if note.startswith(FIRST)]


def other_notes(d: Diagnosis) -> list[str]:
    """Notes that neither :func:`told_first` nor the effects' values (:func:`value_of`) tell."""
    return [n for n in d.get("notes", []) if not n.startswith(FIRST) and not any(w in n for w in _WITH_VALUES)]


def where(names: Sequence[str], joints: Sequence[str]) -> str:
    """Which of ``joints``: "all 6 joints", by name, or, where that is shorter, by the names of the others."""
    shown, others = [n for n in joints if n in names], [n for n in joints if n not in names]
    if not others and len(joints) > 1:
        return f"all {len(joints)} joints"
    if len(shown) > _NAMED and len(others) < len(shown):
        return f"all joints but {listed(others)}"
    return listed(shown)


def listed(names: Sequence[str]) -> str:
    """``a``, ``a and b``, ``a, b and c``."""
    return ", ".join(names[:-1]) + (" and " if len(names) > 1 else "") + names[-1]


def gains(d: Diagnosis) -> str:
    """What the completed model buys on held-out runs."""
    before, after = d["error"]["test"]["before"], final_errors(d)
    if not any(confirmed(e) for e in d["effects"]):
        return (
            f"Nothing was added. On held-out runs the model is off by {share(before['relative_error'], 3)} of the "
            "torque (pooled over all joints)."
        )
    factors = [b / a for b, a in zip(before["rmse"], after["rmse"], strict=True) if a > 0]
    least, most = plain(min(factors)), plain(max(factors))
    spread = least if least == most else f"{least} to {most}"
    by_joint = "it stays as it was" if spread == "1" else f"it becomes {spread} times smaller"
    return (
        f"On held-out runs the torque error falls from {share(before['relative_error'], 3)} to "
        f"{share(after['relative_error'], 3)} of the torque (pooled over all joints); joint by joint {by_joint}."
    )


def certainty(d: Diagnosis) -> list[str]:
    """How sure the names are."""
    out = []
    effects = d["effects"]
    out += _asked([e for e in effects if "confirmed" in e])
    if torn := sum(confirmed(e) and bool(e["indistinguishable_from"]) for e in effects):
        which = f"{torn} of the names" if len(effects) > 1 else "The name"
        out.append(f"{which} cannot be told from another cause: see what stays open.")
    inconsistent = [e for e in effects if e.get("inconsistent_between_runs")]
    if inconsistent:
        about = ", ".join(f"{title_of(e['effect'])} ({place_of(e)})" for e in inconsistent)
        out.append(f"Runs disagree about {about}.")
    outside = d.get("extrapolation") or []
    far = [o for o in outside if isinstance(o, Mapping) and o.get("share_outside", 0) > 0.05]
    if far:
        worst = far[0]
        variable = VARIABLES.get(worst["variable"], worst["variable"])
        more = f", and {len(far) - 1} more" if len(far) > 1 else ""
        where_to = f"{share(worst['share_outside'])} of the {variable} of {worst['joint']}"
        out.append(f"The test motion leaves the training range: {where_to}{more}.")
    if not out:
        out.append("No name was needed." if not effects else "Every name was chosen on runs held out of its own fit.")
    return out


def _asked(asked: Sequence[Mapping[str, Any]]) -> list[str]:
    """What the held-out runs say of the names: better with them, no more than chance, better without."""
    if not asked:
        return []
    said = {kind: [e for e in asked if standing(e) == kind] for kind in ("confirmed", "undecided", "contradicted")}
    sure, all_of_them = len(said["confirmed"]), "the name" if len(asked) == 1 else f"all {len(asked)} names"
    better = "with them they are predicted better" if len(asked) > 1 else "with it they are predicted better"
    if sure == len(asked):
        return [f"The held-out runs confirm {all_of_them}: {better}."]
    if len(asked) == 1:
        out = ["The held-out runs do not confirm the name."]
    else:
        out = [f"The held-out runs confirm {sure or 'none'} of {len(asked)} names{f': {better}' if sure else ''}."]
    for kind, what_of_it in (
        ("undecided", "Not decided by them"),
        ("contradicted", "Contradicted and not in the model"),
    ):
        out.append(f"{what_of_it}: {f'{len(said[kind])}, {_names(said[kind])}' if said[kind] else 'none'}.")
    return [" ".join(out)]


def _names(entries: Sequence[Mapping[str, Any]]) -> str:
    return "; ".join(f"{title_of(e['effect'])} ({place_of(e)})" for e in entries)


def alike(d: Diagnosis, by_motion: bool = False) -> list[tuple[str, str, str]]:
    """What these runs cannot tell apart: a name with its joints, other causes, and the motion that would tell them.

    Names that have the same other causes stand together; the motion is left out unless asked for ``by_motion``.
    """
    groups: dict[tuple[str, str, str], list[str]] = {}
    for entry in filter(confirmed, d.get("effects", ())):
        parts: dict[str, list[Mapping[str, Any]]] = {}
        for other in entry["indistinguishable_from"]:
            parts.setdefault(capital(other["motion_that_would_tell"]) if by_motion else "", []).append(other)
        for motion, others in parts.items():
            found = (entry["effect"], _others(others, entry["joints"], d["joints"]), motion)
            groups.setdefault(found, []).extend(entry["joints"])
    return [
        (title_of(effect) + (f" on {where(at, d['joints'])}" if at else ""), others, motion)
        for (effect, others, motion), at in groups.items()
    ]


def _others(others: Sequence[Mapping[str, Any]], own: Sequence[str], joints: Sequence[str]) -> str:
    """Other causes, with their joints where these are not the name's ``own``."""
    places: dict[str, list[str]] = {}
    for other in others:
        effects = other["effects"]
        if len(effects) == 1:
            places.setdefault(title_of(effects[0]["effect"]), []).extend(effects[0]["joints"])
        else:
            here = all(list(e["joints"]) == list(own) for e in effects)
            names = (title_of(e["effect"]) + ("" if here else f" ({place_of(e)})") for e in effects)
            places.setdefault(" with ".join(names), [])
    return " or ".join(
        name + (f" on {where(at, joints)}" if at and at != list(own) else "") for name, at in places.items()
    )


def open_numbers(d: Diagnosis) -> list[str]:
    """What of the names' parameters the runs leave to the starting model, a phrase an effect."""
    out = []
    for entry in filter(confirmed, d.get("effects", ())):
        names = [title_of(p["name"]) for p in entry["parameters"] if left_open(entry, p)]
        few = listed(names) if 0 < len(names) <= _NAMED else f"{len(names)} of {len(entry['parameters'])} numbers"
        if names:
            place = f" on {place_of(entry)}" if entry["joints"] else ""
            out.append(f"{title_of(entry['effect'])}{place}: {few} left to the starting model")
    return out


def still_open(d: Diagnosis) -> list[str]:
    """What stays open in words: what is left, joint by joint, and what of the names these runs cannot tell."""
    out = []
    dependent = flags(d, "motion_dependent")
    for entry in d["unexplained"]:
        j = list(d["joints"]).index(entry["joint"])
        part = share(entry["share_of_residual_variance"])
        if size := beyond_friction(d).get(entry["joint"]):
            unit = effort_unit(d, entry["joint"])
            out.append(f"{entry['joint']}: while it stands {number(size, 3)} {unit} (rms) are left, {_HOLDS}.")
        if surpassed := SURPASSED.get(state_of(d, j)[1]):
            out.append(f"{entry['joint']}: {surpassed}.")
        if (size or surpassed) and not (dependent[j] or flags(d, "worse_on_test")[j] or flags(d, "cannot_tell")[j]):
            continue
        if "motion_dependent" not in d:
            out.append(f"{entry['joint']}: {part} of what is left (variance) is not noise.")
        elif dependent[j]:
            more = "; the test runs leave more of it than the training runs" if flags(d, "worse_on_test")[j] else ""
            part = share(learned(d, entry))
            out.append(
                f"{entry['joint']}: what is left depends on the motion; {part} of it (variance) can be learned{more}."
            )
        elif flags(d, "worse_on_test")[j]:
            out.append(f"{entry['joint']}: the test runs leave more than the training runs; no cause found.")
        else:
            size = unproven_shares(d).get(entry["joint"])
            why = (
                f"{share(size)} of it follows the motion on held-out parts, perhaps by chance"
                if size
                else "it changes slowly"
            )
            out.append(f"{entry['joint']}: what is left may be noise or an effect: {why}.")
    out += [f"{entry['joint']}: {entry['why']}." for entry in d.get("not_identifiable", [])]
    told = {entry["joint"] for entry in (*d["unexplained"], *d.get("not_identifiable", []))}
    for state, words in _BESIDE.items():
        names = [name for j, name in enumerate(d["joints"]) if name not in told and state_of(d, j)[1] == state]
        if names:
            out.append(f"{where(names, d['joints'])}: {words}.")
    out += [f"{capital(name)} cannot be told from {others}." for name, others, _ in alike(d)]
    out += [f"{capital(phrase)}." for phrase in open_numbers(d)]
    if not out:
        out.append("Nothing that these runs show: what is left on every joint does not depend on the motion.")
    return out


def verdict_words(d: Diagnosis) -> str:
    """The verdict in words: of a model that is asked again, nothing missing is nothing changed."""
    unchanged = d["verdict"] == "nothing_missing" and asked(d)
    return "nothing has changed" if unchanged else str(d["verdict"]).replace("_", " ")


def opens(d: Diagnosis) -> bool:
    """Whether a section of its own tells what stays open."""
    return bool(d["unexplained"] or d.get("extrapolation") or alike(d) or open_numbers(d))
