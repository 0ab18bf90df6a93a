"""A diagnosis in words for the terminal: what is missing first, then what is not settled, then the numbers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from hybrid_dynamics.effects.units import with_unit
from hybrid_dynamics.loop.alternatives import INSTEAD
from hybrid_dynamics.loop_report.meaning import meaning, only_untold
from hybrid_dynamics.loop_report.parameter_words import place, settings_words, several_words, single_words
from hybrid_dynamics.loop_report.rest import beyond_friction, final_errors, learned, state_of, unproven_shares
from hybrid_dynamics.loop_report.words import (
    SURPASSED,
    VARIABLES,
    asked,
    confirmed,
    described,
    effort_unit,
    left_open,
    other_notes,
    share,
    slides,
    standing,
    title_of,
    value_of,
    verdict_words,
)

Entry = Mapping[str, Any]
#: Kinds of effects whose values stand in the headline; of further ones the names.
_MOST = 4
#: Causes that could stand for one name, each with its reason; of further ones the names.
_ALIKE = 3
#: Lines on what cannot be told apart; of further ones how many.
_MOST_ALIKE = 6
#: Notes of a diagnosis that say again what :func:`details` says.
TOLD_ALREADY = (
    "contradicted by the test runs",
    "what is left changes slowly",
    "which may be chance",
    "differ between runs beyond",
)


def verdict_line(diagnosis: Mapping[str, Any]) -> str:
    """``panda: explained: what the model lacked has been found ...``."""
    return f"{diagnosis['robot']}: {verdict_words(diagnosis)}: {_clause(diagnosis)}"


def _clause(diagnosis: Mapping[str, Any]) -> str:
    """What the verdict means, within a sentence."""
    says = meaning(diagnosis)
    return f"{says[:1].lower()}{says[1:].rstrip('.')}"


def headline(diagnosis: Mapping[str, Any]) -> str:
    """One line: ``missing: payload 1.47 kg; held-out error 22.8 % → 0.62 %``."""
    verdict = diagnosis["verdict"]
    named = "; ".join(effect_phrases([e for e in diagnosis["effects"] if confirmed(e)]))
    error = _error_change(diagnosis)
    if verdict == "nothing_missing":
        lead = verdict_words(diagnosis) if asked(diagnosis) else "nothing is missing"
        return f"{lead}; {_error_kept(diagnosis)}"
    if not named:
        missing = "something is missing, but nothing looked for explains it"
        return f"{_clause(diagnosis) if only_untold(diagnosis) else missing}; {error}"
    # Asked of an earlier model, what is found is what has changed since: friction may have become less.
    lead = "changed" if asked(diagnosis) else "missing or wrong in the URDF" if described(diagnosis) else "missing"
    far = "" if verdict == "explained" else ", as far as can be told" if only_untold(diagnosis) else ", and not all"
    return f"{lead}{far}: {named}; {error}"


def second_line(diagnosis: Mapping[str, Any]) -> str:
    """The headline behind :func:`verdict_line`, without what that has said already."""
    verdict = diagnosis["verdict"]
    said = verdict == "nothing_missing" or (verdict == "unexplained" and only_untold(diagnosis))
    return _error_kept(diagnosis) if said else headline(diagnosis)


def effect_phrases(effects: Sequence[Entry]) -> list[str]:
    """``payload 1.47 kg``, ``viscous friction 2 N m s/rad on joint_1``; the same effect on several joints is one."""
    groups: dict[str, list[Entry]] = {}
    for entry in effects:
        groups.setdefault(entry["effect"], []).append(entry)
    out: list[str] = []
    for name, entries in groups.items():
        several = len(entries) > 1
        if len(out) >= _MOST:
            out.append(f"{'also ' if len(out) == _MOST else ''}{title_of(name)}{_where(entries)}")
        elif several:
            out.append(several_words(entries, _where(entries)))
        else:
            out.append(single_words(entries[0]))
    return out


def details(diagnosis: Mapping[str, Any]) -> list[str]:
    """What is not settled, a line each: left beyond noise, contradicted, alike, torn between runs, out of reach."""
    out = _left(diagnosis)
    for entry in diagnosis["effects"]:
        if not confirmed(entry):
            why = f": {entry['why_not']}" if entry.get("why_not") else ""
            out.append(f"contradicted by the test runs, not in the model: {place(entry)}{why}")
    if open_ := [place(e) for e in diagnosis["effects"] if "confirmed" in e and standing(e) == "undecided"]:
        out.append(f"in the model, and not decided by the test runs: {', '.join(open_)}")
    out += _alike(diagnosis["effects"])
    for entry in diagnosis["effects"]:
        if entry.get("undetermined_parameters"):
            out.append(f"left open by these motions: {_open(entry)}")
        for torn in entry.get("inconsistent_between_runs", []):
            runs = ", ".join(f"{r['run']} {r['value']:.3g}" for r in torn["runs"])
            out.append(
                f"differs between runs: {title_of(torn['parameter'])} of {place(entry)} [{torn['unit']}]: {runs}"
            )
    out += [f"out of reach: {entry['joint']}: {entry['why']}" for entry in diagnosis.get("not_identifiable", [])]
    return [*out, *_outside(diagnosis)]


def _open(entry: Entry) -> str:
    """The parameters of an effect that the motions leave open; of several links how many of each."""
    names = entry["undetermined_parameters"]
    links = Counter(name.split("/")[0] for name in names if "/" in name)
    if not links:
        return f"{', '.join(name.replace('_', ' ') for name in names)} of {place(entry)}"
    sizes = Counter(p["joint"] for p in entry["parameters"])
    told = ", ".join(f"{count} of {sizes[link]} of {link}" for link, count in links.items())
    return f"numbers of the links: {told}"


def _left(diagnosis: Mapping[str, Any]) -> list[str]:
    """What no effect explains, and what cannot be told from noise."""
    joints, final = list(diagnosis["joints"]), final_errors(diagnosis)["rmse"]
    alarms = dict(zip(joints, diagnosis.get("motion_dependent") or [False] * len(joints), strict=False))
    doubts = dict(zip(joints, diagnosis.get("cannot_tell") or [False] * len(joints), strict=False))
    parted = dict(zip(joints, diagnosis.get("worse_on_test") or [False] * len(joints), strict=False))
    held = beyond_friction(diagnosis)
    doubts = {joint: doubt and not parted.get(joint) for joint, doubt in doubts.items()}
    out, would_be = [], []
    told = {entry["joint"] for entry in diagnosis["unexplained"]}
    for entry in diagnosis["unexplained"]:
        joint, expression = entry["joint"], entry.get("expression") or "0"
        unit = effort_unit(diagnosis, joint)
        looks = "" if expression == "0" else f"; it looks like {expression} [{unit}]"
        if joint in held:
            rest = f"while it stands {held[joint]:.3g} {unit} (rms) are left, more than friction holds"
            out.append(f"not down to noise: {joint}: {rest}")
        if surpassed := SURPASSED.get(state_of(diagnosis, joints.index(joint))[1]):
            out.append(f"not down to noise: {joint}: {surpassed}")
        if (joint in held or surpassed) and not (alarms.get(joint) or parted.get(joint) or doubts.get(joint)):
            continue
        if doubts.get(joint):
            would_be += [] if expression == "0" else [f"{joint} {expression} [{unit}]"]
            continue
        if parted.get(joint) and not alarms.get(joint):
            out.append(f"not down to noise: {joint}: the test runs leave more than the training runs{looks}")
            continue
        out.append(
            f"not down to noise: {joint}: {100 * learned(diagnosis, entry):.2g} % of the mean square that is "
            f"left (rms {final[joints.index(joint)]:.3g} {unit}) depends on the motion{looks}"
        )
    out += [
        f"not down to noise: {joint}: what is left depends on the motion"
        for joint in joints
        if alarms.get(joint) and joint not in told
    ]
    looks = f"; an effect would look like {', '.join(would_be)}" if would_be else ""
    doubtful = [joint for joint in joints if doubts.get(joint)]
    unproven = {joint: size for joint, size in unproven_shares(diagnosis).items() if joint in doubtful}
    if slow := [joint for joint in doubtful if joint not in unproven]:
        out.append(
            f"cannot be told: {', '.join(slow)}: what is left changes slowly, slow noise or an effect that is missing"
            f"{looks}; what would tell: runs that pass the same states again"
        )
    if unproven:
        sizes = ", ".join(f"{100 * size:.2g} % on {joint}" for joint, size in unproven.items())
        out.append(
            f"cannot be told: of what is left {sizes} follow the motion on held-out parts, which may be chance"
            f"{'' if slow else looks}; what would tell: longer and more runs"
        )
    return out


def _alike(effects: Sequence[Entry]) -> list[str]:
    """Effects that these motions cannot tell apart, the same pair on several joints in one line, and one cause that
    could stand for several of them in one; of a name that much could stand for the rest by name. Of what is not in the
    model nothing: it is no answer."""
    groups: dict[tuple[str, ...], list[tuple[Entry, Mapping[str, Any]]]] = {}
    gone = {other["why"] for e in effects if not confirmed(e) for other in e.get("indistinguishable_from", [])}
    for entry in filter(confirmed, effects):
        for other in entry.get("indistinguishable_from", []):
            # One cause in the place of several of which one is gone stands for none of them.
            if other["why"].startswith(INSTEAD) and other["why"] in gone:
                continue
            own = all(e.get("joints") == entry.get("joints") for e in other["effects"])
            kinds = tuple(e["effect"] for e in other["effects"])
            key = (entry["effect"], *kinds) if own else (str(id(other)),)
            if other["why"].startswith(INSTEAD):
                key = (other["why"], *map(place, other["effects"]))
            groups.setdefault(key, []).append((entry, other))
    out = []
    alone: dict[int, tuple[str, list[str]]] = {}
    for pairs in groups.values():
        entry, other = pairs[0]
        tells = (other.get("motion_that_would_tell") or "").rstrip(".")
        lead = "" if tells.startswith("No ") else "what would tell: "
        tell = f"; {lead}{tells[:1].lower()}{tells[1:]}" if tells else ""
        names = " and ".join(place(e) for e in other["effects"])
        if other["why"].startswith(INSTEAD):
            out.append(f"cannot be told apart: {names}, {other['why']}{tell}")
            continue
        if len(pairs) == 1:
            _, listed = alone.setdefault(id(entry), (place(entry), []))
            listed.append(names)
            if len(listed) <= _ALIKE:
                out.append(f"cannot be told apart: {place(entry)} and {names}: {other['why']}{tell}")
            continue
        names = " and ".join(title_of(e["effect"]) for e in other["effects"])
        why = f": {other['why']}" if len({o["why"] for _, o in pairs}) == 1 else ""
        where = list(dict.fromkeys(joint for e, _ in pairs for joint in e["joints"]))
        on = f" on {', '.join(where)}" if where else ""
        out.append(f"cannot be told apart: {title_of(entry['effect'])} and {names}{on}{why}{tell}")
    for name, others in alone.values():
        if more := others[_ALIKE:]:
            out.append(f"cannot be told apart: {name} and {len(more)} more (report.html says why): {'; '.join(more)}")
    if (count := len(out) - _MOST_ALIKE) > 1:
        out[_MOST_ALIKE:] = [f"cannot be told apart: {count} more (report.html names them, and what would tell)"]
    return out


def _outside(diagnosis: Mapping[str, Any]) -> list[str]:
    far = [o for o in diagnosis.get("extrapolation") or [] if o.get("share_outside", 0.0) > 0.05]
    if not far:
        return []
    shown = ", ".join(
        f"{share(o['share_outside'])} of the {VARIABLES.get(o['variable'], o['variable'])} of {o['joint']}"
        for o in far[:3]
    )
    more = f" and {len(far) - 3} more" if len(far) > 3 else ""
    return [f"the test motion leaves the training range: {shown}{more}; there the model is not proven by like motions"]


def notes(diagnosis: Mapping[str, Any]) -> list[str]:
    """The diagnosis's notes, without those that :func:`details` has told already."""
    return [note for note in other_notes(diagnosis) if not any(words in note for words in TOLD_ALREADY)]


def parameter_lines(diagnosis: Mapping[str, Any]) -> list[str]:
    """Every effect with its parameters, standard errors and settings; joint by joint, then the whole robot. Of several
    links those numbers that the motions do not leave open: of some ten they say little, and hardly of all."""
    out = []
    order = {name: j for j, name in enumerate(diagnosis["joints"])}
    last = len(order)
    entries = sorted(diagnosis["effects"], key=lambda e: order.get(e["joints"][0], last) if e["joints"] else last)
    for entry in entries:
        bodies: dict[str | None, list[str]] = {}
        silent = Counter[str | None]()
        links = len({p.get("joint") for p in entry["parameters"]}) > 1
        for p in entry["parameters"]:
            open_ = left_open(entry, p)
            values = bodies.setdefault(p.get("joint"), [])
            if links and open_:
                silent[p.get("joint")] += 1
                continue
            values.append(f"{title_of(p['name'])} {value_of(entry, p)}{' (left open)' if open_ else ''}")
        mark = "" if confirmed(entry) else " (contradicted, not in the model)"
        own = next(iter(bodies.values())) if len(bodies) == 1 else []
        own = [*own, *settings_words(entry, placed=True, slides=slides(diagnosis))]
        out.append(f"{place(entry)}: {', '.join(own)}{mark}" if own else f"{place(entry)}{mark}")
        if len(bodies) > 1:
            # Ten numbers a link: a line a link, with those of which the motions say something.
            for joint, values in bodies.items():
                rest = [f"{silent[joint]} left open"] if silent[joint] else []
                out.append(f"  link of {joint}: {', '.join([*values, *rest])}")
    return out


def joint_rows(diagnosis: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    """Header and rows of the table of held-out errors [N m], or [N] where a joint slides."""
    before, final = diagnosis["error"]["test"]["before"], final_errors(diagnosis)
    low, high = (diagnosis.get(f"noise_floor_{side}") for side in ("low", "high"))
    rows = []
    for j, name in enumerate(diagnosis["joints"]):
        floor = f"{diagnosis['noise_floor'][j]:.3g}"
        if low and high:
            floor += f" ({low[j]:.3g} to {high[j]:.3g})"
        errors = [f"{before['rmse'][j]:.3g}", f"{final['rmse'][j]:.3g}"]
        name, relative = with_unit(name, slides(diagnosis)), _percent(final["relative_rmse"][j])
        rows.append([name, *errors, relative, floor, state_of(diagnosis, j)[1]])
    return ["held-out rmse, all samples [N m]", "before", "after", "of the spread", "noise floor", "what is left"], rows


def _where(entries: Sequence[Entry]) -> str:
    places = list(dict.fromkeys(entry["joints"][0] for entry in entries if entry["joints"]))
    if not places:
        return ""
    return f" on {', '.join(places)}" if len(places) <= 3 else f" on {len(places)} joints"


def _percent(value: float | None) -> str:
    return "unknown" if value is None else f"{100 * value:.3g} %"


def _error_change(diagnosis: Mapping[str, Any]) -> str:
    before = diagnosis["error"]["test"]["before"]["relative_error"]
    return f"held-out error {_percent(before)} → {_percent(final_errors(diagnosis)['relative_error'])}"


def _error_kept(diagnosis: Mapping[str, Any]) -> str:
    """The held-out error where nothing was added."""
    return f"held-out error {_percent(final_errors(diagnosis)['relative_error'])}"
