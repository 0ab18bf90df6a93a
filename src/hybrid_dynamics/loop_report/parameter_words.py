"""The parameters and settings of an effect in words: those that matter, with their units."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from hybrid_dynamics.loop_report.words import (
    SURE,
    arrow,
    capital,
    confirmed,
    ends_of,
    left_open,
    listed,
    standing,
    title_of,
    unit_of,
    value_of,
    where,
)

Entry = Mapping[str, Any]
#: An effect with more parameters than this has a table's worth of them; the headline counts its links.
_MOST = 5
#: Pitch [rad] from which on a base stands on its side.
_ON_ITS_SIDE = 1.53
#: Error of pitch over that of roll, the cosine of pitch: below it roll turns hardly anything.
_TURNS = 0.05
#: Joints that are named one by one have each its value.
FEW = 3
#: Settings that :func:`settings_words` and :func:`place` tell in words of their own, or that the effect's name tells.
_IN_WORDS = (
    "sign_of", "of", "law", "response", "shape", "expression", "links", "intervals", "only_run", "sign_width",
    "sign_displacement", "at_rest", "from_joint", "rows",
)  # fmt: skip
#: Stands behind a name that the model has and the held-out runs neither confirm nor contradict.
UNDECIDED = " (not decided by the held-out runs)"


def missing(
    diagnosis: Mapping[str, Any],
    sizes: Mapping[str, float] | None = None,
    before: Mapping[str, float] | None = None,
) -> list[str]:
    """A phrase a kind of effect that stands in the model: what, where, how much, how sure.

    ``sizes`` is the torque [N m] that a kind adds: the largest comes first. Without it, the order of naming. Names that
    the held-out runs do not decide come last and say so. ``before``: what the starting model says of the links, by
    ``"joint/mass"``.
    """
    groups: dict[tuple[bool, str], list[Entry]] = {}
    for entry in diagnosis["effects"]:
        if confirmed(entry):
            groups.setdefault((standing(entry) == "undecided", entry["effect"]), []).append(entry)
    order = sorted(groups, key=lambda group: (group[0], -(sizes or {}).get(group[1], 0.0)))
    return [
        capital(_missing(groups[group], diagnosis["joints"], before or {})) + (UNDECIDED if group[0] else "")
        for group in order
    ]


def _missing(entries: Sequence[Entry], joints: Sequence[str], before: Mapping[str, float]) -> str:
    if len(entries) == 1:
        (entry,) = entries
        if len({p.get("joint") for p in entry["parameters"]}) > 1:
            return _links(entry, before)
        values = [
            f"{_named(entry, p['name'])}{value_of(entry, p)}"
            + (" (left open by these runs)" if left_open(entry, p) else "")
            for p in matter(entry)
        ]
        values += settings_words(entry)
        return f"{place(entry)}: {', '.join(values)}" if values else place(entry)
    places = list(dict.fromkeys(entry["joints"][0] for entry in entries if entry["joints"]))
    values = [f"{_named(entries[0], key)}{own}" for key, own in _values(entries).items()] + _open_mass(entries)
    phrase = title_of(entries[0]["effect"]) + (f" on {where(places, joints)}" if places else "")
    return f"{phrase}: {', '.join(values)}" if values else phrase


def _links(entry: Entry, before: Mapping[str, float]) -> str:
    """The numbers of several links: how many the runs decide, and which of these has surely changed most."""
    parameters = entry["parameters"]
    decided = [p for p in parameters if not left_open(entry, p)]
    links = len({p["joint"] for p in parameters})
    out = f"{title_of(entry['effect'])} of {links} links: these runs decide {len(decided)} of {len(parameters)} numbers"
    known = {key: p for p in decided if (key := f"{p['joint']}/{p['name']}") in before and p["std_error"]}
    sureness = {key: abs(p["value"] - before[key]) / p["std_error"] for key, p in known.items()}
    if max(sureness.values(), default=0.0) <= SURE:
        return out
    key = max(sureness, key=sureness.__getitem__)
    value = f"{before[key]:.3g} → {value_of(entry, known[key])}"
    return f"{out}; most surely changed is {title_of(known[key]['name'])} of {known[key]['joint']}, {value}"


def _named(entry: Entry, parameter: str) -> str:
    """The parameter's name, where it says more than the effect's."""
    return "" if parameter == entry["effect"] else f"{title_of(parameter)} "


def place(entry: Entry) -> str:
    """``Coulomb friction on joint_3``, ``joint coupling of joint_5 and joint_6``."""
    joints = list(entry.get("joints") or [])
    settings = entry.get("settings") or {}
    name = title_of(entry["effect"])
    if joints and "from_joint" in settings:
        partner = settings["from_joint"]
        if settings.get("rows") == "both":
            return f"{name} of {joints[0]} and {partner}"
        return f"{name} on {joints[0]} from {partner}"
    return f"{name} on {joints[0]}" if joints else name


def single_words(entry: Entry) -> str:
    """One effect with the parameters that matter: ``viscous friction 2 N m s/rad on shoulder``."""
    extra = _open_mass([entry]) + settings_words(entry)
    shown = [p for p in matter(entry) if not _is_open_mass(entry, p)]
    if len(shown) == 1 and not extra:
        name = title_of(entry["effect"])
        return f"{name} {_value(entry, shown[0])}{place(entry).removeprefix(name)}"
    values = [f"{title_of(p['name'])} {_value(entry, p)}" for p in shown] + extra
    return f"{place(entry)} ({', '.join(values)})" if values else place(entry)


def several_words(entries: Sequence[Entry], places: str) -> str:
    """The same effect on several joints: ``Coulomb friction 2.7 and 8.5 N m on a, b``; on many, ranges."""
    own = _values(entries)
    name = title_of(entries[0]["effect"])
    extra = _open_mass(entries)
    if len(own) == 1 and not extra:
        return f"{name} {next(iter(own.values()))}{places}"
    values = ", ".join([f"{title_of(key)} {words}" for key, words in own.items()] + extra)
    return f"{name}{places} ({values})" if values else f"{name}{places}"


def matter(entry: Entry) -> list[Mapping[str, Any]]:
    """Parameters that a person asks for first: of a body its mass, else those that are known and not zero."""
    parameters = list(entry["parameters"])
    if len({p.get("joint") for p in parameters}) > 1:
        return []
    if parameters and parameters[0]["name"] == "mass":
        return parameters[:1]
    if len(parameters) > _MOST or "expression" in (entry.get("settings") or {}):
        return []
    own = {p["name"]: p for p in parameters}
    if "pitch" in own and abs(own["pitch"]["value"]) > _ON_ITS_SIDE:
        # Of a base on a wall along x roll turns next to nothing, and is known the less for it.
        surer = (own["pitch"].get("std_error") or 0.0) / (own["roll"].get("std_error") or 1.0)
        parameters = [p for p in parameters if p["name"] != "roll" or surer > _TURNS]
    known = [p for p in parameters if not left_open(entry, p) and abs(p["value"]) > (p.get("std_error") or 0.0)]
    return known or parameters[:1]


def _is_open_mass(entry: Entry, p: Mapping[str, Any]) -> bool:
    """Whether ``p`` is a mass that these motions do not show: its number is the starting model's."""
    return p["name"] == "mass" and left_open(entry, p)


def _open_mass(entries: Sequence[Entry]) -> list[str]:
    open_mass = any(_is_open_mass(entry, p) for entry in entries for p in matter(entry))
    return ["mass left open by these motions"] if open_mass else []


def settings_words(entry: Entry, placed: bool = False, slides: Collection[str] = ()) -> list[str]:
    """What is not a number that was identified; with ``placed`` all of it: also how dry friction turns over. ``slides``
    are the prismatic joints."""
    settings = dict(entry.get("settings") or {})
    out = []
    if settings.get("sign_of") in ("sum", "difference"):
        out.append(f"of the {settings['sign_of']} of both speeds")
    if "of" in settings:
        out.append(f"of the {settings['of']} torque" if settings["of"] != "offset" else "of the offset")
    if settings.get("response") == "lag":
        out.append("behind a first-order low-pass")
    if settings.get("law") == "damped":
        out.append("with micro-damping")
    if settings.get("law") == "lugre":
        out.append("with a level that falls with the speed (LuGre)")
    if "shape" in settings:
        out.append(f"{settings['shape']} in q")
    if "expression" in settings:
        out.append(f"{settings['expression']} [N m]")
    if "links" in settings:
        out.append(
            f"{len(settings['links'])} links: {', '.join(settings['links'])}"
            if placed
            else f"{len(settings['links'])} links"
        )
    for start, end in settings.get("intervals", ()):
        out.append(f"{start:.4g} to {end:.4g} s")
    if "only_run" in settings:
        out.append(f"in run {settings['only_run']} alone")
    length = "m" if any(joint in slides for joint in entry.get("joints") or ()) else "rad"
    if placed and settings.get("sign_width"):
        out.append(f"sign turns over {settings['sign_width']:g} {length}/s")
    if placed and settings.get("sign_displacement"):
        out.append(f"sign turns over {settings['sign_displacement']:g} {length}")
    if placed and settings.get("at_rest") == "middle":
        out.append("at rest it holds the middle of its two torques")
    if placed:
        # What has no words of its own is told as it stands in model.json.
        out += [f"{title_of(key)}: {_shown(value)}" for key, value in settings.items() if key not in _IN_WORDS]
    return out


def row_words(entry: Entry, slides: Collection[str] = ()) -> list[str]:
    """:func:`settings_words` where a row stands under its joint: the partner of a coupling too."""
    partner = [place(entry).removeprefix(f"{title_of(entry['effect'])} ")] if _coupled(entry) else []
    return partner + settings_words(entry, placed=True, slides=slides)


def _coupled(entry: Entry) -> bool:
    return bool(entry["joints"]) and "from_joint" in (entry.get("settings") or {})


def _shown(value: Any) -> str:
    if isinstance(value, Sequence) and not isinstance(value, str):
        return ", ".join(map(_shown, value))
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _values(entries: Sequence[Entry]) -> dict[str, str]:
    """Parameters that matter over several entries of one effect, in words by name: where each of few joints has one, in
    the order of the joints, else between which they lie."""
    out: dict[str, list[Mapping[str, Any]]] = {}
    for entry in entries:
        for p in matter(entry):
            if _is_open_mass(entry, p):
                continue
            out.setdefault(p["name"], []).append({**p, "ends": ends_of(entry, p)})
    places = {entry["joints"][0] for entry in entries if entry["joints"]}
    few = len(places) == len(entries) <= FEW
    return {name: _each(own) if few and len(own) == len(entries) else _range(own) for name, own in out.items()}


def _value(entry: Entry, p: Mapping[str, Any]) -> str:
    ends, tail = ends_of(entry, p), _tail(p["unit"])
    if "start" in ends:
        return f"{arrow(ends, 3)}{tail}"
    return f"{p['value']:.3g}{tail}" + (f" (URDF: {ends['urdf']:.3g})" if ends else "")


def _each(parameters: Sequence[Mapping[str, Any]]) -> str:
    values = [arrow(p["ends"], 3) if "start" in p["ends"] else f"{p['value']:.3g}" for p in parameters]
    before = [f"{p['ends']['urdf']:.3g}" for p in parameters if "urdf" in p["ends"]]
    told = f"{listed(values)}{_tail(parameters[0]['unit'])}"
    return f"{told} (URDF: {listed(before)})" if len(before) == len(values) else told


def _range(parameters: Sequence[Mapping[str, Any]]) -> str:
    own = f"{_span([p['value'] for p in parameters])}{_tail(parameters[0]['unit'])}"
    if any("start" in p["ends"] for p in parameters):
        return f"changed by {own}"
    urdf = [p["ends"]["urdf"] for p in parameters if "urdf" in p["ends"]]
    return f"{own} (URDF: {_span(urdf)})" if urdf else own


def _span(values: Sequence[float]) -> str:
    low, high = f"{min(values):.3g}", f"{max(values):.3g}"
    return low if low == high else f"{low} to {high}"


def _tail(unit: str) -> str:
    return "" if unit in ("", "-", "–", "1") else f" {unit_of(unit)}"
