"""What a verdict means in words: what surely remains, and what these runs only cannot tell."""

from __future__ import annotations

from hybrid_dynamics.loop.describe import SILENT
from hybrid_dynamics.loop_report.rest import SLOW, Diagnosis, state_of
from hybrid_dynamics.loop_report.words import asked

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
    doubted = [joint for j, joint in enumerate(d["joints"]) if state_of(d, j)[1] == SLOW]
    if d["verdict"] not in _ADDED or {entry["joint"] for entry in d["unexplained"]} - {*doubted}:
        return []
    more = "more" if d["verdict"] == "partly_explained" else "anything"
    what = f"{more} has changed" if asked(d) else f"{more} is missing"
    silent = [entry["joint"] for entry in d.get("not_identifiable", ()) if entry["why"].startswith(SILENT)]
    out = [f"these runs cannot tell whether {what} on {', '.join(doubted)}"] if doubted else []
    return out + ([f"nothing is known of {', '.join(silent)}: the torque there never changes"] if silent else [])
