"""What a diagnosis says is left on a joint: its errors, what can be learned of them, and the state in a few words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

Diagnosis = Mapping[str, Any]

#: What is left on a joint whose alarm is on, and on one that leaves it open.
ALARM, SLOW = "still depends on the motion", "cannot be told from noise"
PARTED = "more on the test runs than on the training runs"
WORSE = "more than the starting model leaves"
#: Where all links and friction at once predict the test runs much better than what was named.
RIVALLED = "much more than a fit of everything leaves"
ABOVE = "above the noise; no cause found"
#: Where a hand, a stop, a brake or a load holds a joint that stands, or friction of which the model knows nothing.
HELD = "while it stands, more than friction holds"
#: A joint that says nothing on the test runs.
UNTESTED = "stands still in the test runs"
#: Where all samples together are above the noise and those in which the joint moves are not.
STANDING = "noise in motion, more at standstill"
#: Times the upper bound of the floor beyond which a held-out error is more than noise.
ABOVE_NOISE = 1.25


def final_errors(d: Diagnosis, split: str = "test", of: str = "error") -> Mapping[str, Any]:
    """Errors of the model that stands in model.json: without contradicted effects."""
    errors = d[of][split]
    return dict(errors.get("after_confirmed") or errors["after"])


def learned(d: Diagnosis, entry: Mapping[str, Any]) -> float:
    """Share of what all runs leave on the joint of ``entry`` (of ``unexplained``) that a black box learns.

    The share that ``entry`` gives is at least as large: also what the test runs leave beyond the training runs counts.
    """
    known = d.get("learnable_share")
    return float(known[list(d["joints"]).index(entry["joint"])] if known else entry["share_of_residual_variance"])


def unproven_shares(d: Diagnosis) -> dict[str, float]:
    """Of the joints on which held-out rows follow the motion, perhaps by chance, the share of what is left."""
    return _sizes(d, "unproven_share")


def beyond_friction(d: Diagnosis) -> dict[str, float]:
    """Of the joints that leave more while they stand than friction holds, the rms of it."""
    return _sizes(d, "beyond_friction")


def _sizes(d: Diagnosis, key: str) -> dict[str, float]:
    sizes = d.get(key) or [0.0] * len(d["joints"])
    return {joint: float(size) for joint, size in zip(d["joints"], sizes, strict=True) if size}


def state_of(d: Diagnosis, joint: int) -> tuple[str, str]:
    """(kind, words) of what is left on a joint; kinds are ``good``, ``open`` and ``unseen``."""
    name = d["joints"][joint]
    if why := [entry["why"] for entry in d.get("not_identifiable", []) if entry["joint"] == name]:
        # The joint never moves, or its torque never changes.
        return "unseen", why[0].partition(" in the training runs")[0].removeprefix("the joint ")
    if flags(d, "worse_than_start")[joint]:
        return "open", WORSE
    if flags(d, "motion_dependent")[joint]:
        return "open", ALARM
    if flags(d, "worse_on_test")[joint]:
        return "open", PARTED
    if beyond_friction(d).get(name):
        return "open", HELD
    if flags(d, "better_with_everything")[joint]:
        return "open", RIVALLED
    if flags(d, "cannot_tell")[joint]:
        return "open", SLOW
    if "motion_dependent" not in d and name in {entry["joint"] for entry in d["unexplained"]}:
        return "open", "something is left"
    if flags(d, "untested")[joint]:
        return "unseen", UNTESTED
    if _above_noise(d, joint, "error_moving" if "error_moving" in d else "error"):
        return "open", ABOVE
    return ("open", STANDING) if _above_noise(d, joint, "error") else ("good", "down to the noise")


def _above_noise(d: Diagnosis, joint: int, of: str) -> bool:
    """True where the held-out error is surely more than the noise, though nothing tells of what."""
    high = d.get("noise_floor_high")
    if high is None:
        return False
    after = final_errors(d, of=of)["rmse"][joint]
    return bool(after is not None and high[joint] and after > ABOVE_NOISE * high[joint])


def flags(d: Diagnosis, key: str) -> list[bool]:
    """Per joint, what ``d`` says by ``key``; an older one that does not, nothing."""
    return [bool(v) for v in d.get(key) or [False] * len(d["joints"])]
