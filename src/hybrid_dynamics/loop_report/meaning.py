"""What a verdict means in words: what surely remains, and what these runs only cannot tell."""

from __future__ import annotations

from hybrid_dynamics.loop_report.rest import Diagnosis, beyond_friction, flags

VERDICTS = {
    "explained": "What the model lacked has been found and added; what is left does not depend on the motion.",
    "partly_explained": "Part of what the model lacks has been found and added; something remains.",
    "unexplained": "Something is missing that no effect looked for explains; nothing was added.",
    "nothing_missing": "What the model leaves does not depend on the motion.",
}
#: How a sentence begins that goes on with what cannot be told.
_ADDED = {"partly_explained": "What was found has been added", "unexplained": "Nothing was added"}


def meaning(d: Diagnosis) -> str:
    """The verdict as a sentence: of joints on which nothing surely remains, why it is no better one."""
    untold = _untold(d)
    return f"{_ADDED[d['verdict']]}; {'; '.join(untold)}." if untold else VERDICTS[d["verdict"]]


def only_untold(d: Diagnosis) -> bool:
    """True where nothing surely remains, and yet not all is clear: noise or an effect, a torque that never changes."""
    return bool(_untold(d))


def _untold(d: Diagnosis) -> list[str]:
    """Why these runs cannot tell whether all is clear; nothing where it is, or where something surely remains."""
    joints = list(d["joints"])
    surely = [flags(d, key) for key in ("motion_dependent", "worse_on_test")]
    held = beyond_friction(d)
    doubted = {
        joint
        for j, joint in enumerate(joints)
        if flags(d, "cannot_tell")[j] and joint not in held and not any(flag[j] for flag in surely)
    }
    if d["verdict"] not in _ADDED or {entry["joint"] for entry in d["unexplained"]} - doubted:
        return []
    more = "more" if d["verdict"] == "partly_explained" else "an effect"
    silent = [e["joint"] for e in d.get("not_identifiable", ()) if "torque never changes" in e["why"]]
    out = []
    if doubted:
        out.append(
            f"whether {more} is missing on {', '.join(j for j in joints if j in doubted)} these runs cannot tell"
        )
    if silent:
        out.append(f"nothing is known of {', '.join(silent)}: the torque there never changes")
    return out
