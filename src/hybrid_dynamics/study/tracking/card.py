"""The model card of a closed loop's model: what it is, how good, how sure, made from what, and where it ends."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from hybrid_dynamics.loop.diagnosis import Diagnosis
from hybrid_dynamics.loop_report.meaning import meaning
from hybrid_dynamics.loop_report.parameter_words import missing
from hybrid_dynamics.loop_report.rest import final_errors, state_of
from hybrid_dynamics.loop_report.words import (
    capital,
    certainty,
    gains,
    left_open,
    number,
    place_of,
    share,
    still_open,
    title_of,
    value_of,
)
from hybrid_dynamics.study.tracking.inputs import InputRecord

#: MLflow's registry takes 5000 characters of description.
LONGEST = 5000
CARD_FILE = "model_card.md"


def model_card(
    name: str, diagnosis: Diagnosis, provenance: str, inputs: Sequence[InputRecord], measures: Mapping[str, float]
) -> str:
    """Markdown. ``name`` is the registered model's; ``measures`` are the run's metrics (held-out error)."""
    d = diagnosis.to_json()
    lines = [
        f"# {name}",
        "",
        f"Inverse dynamics of **{diagnosis.robot}** ({len(diagnosis.joints)} joints): rigid body plus "
        f"{len(diagnosis.confirmed)} named effects. Data: {provenance}.",
        "",
        f"**{capital(diagnosis.verdict.replace('_', ' '))}.** {meaning(d)}",
        "",
        *(f"- {phrase}" for phrase in missing(d)),
        "",
        gains(d),
        "",
        "## Error on held-out runs",
        "",
        *_errors(d),
        "",
        "## How sure, and what stays open",
        "",
        *(f"- {line}" for line in (*certainty(d), *still_open(d))),
        "",
        "## Use",
        "",
        "Torque [N m] that the drives deliver along a motion, at the loop's bandwidth; offline, over a whole log. "
        "Input: `time` [s], `q1 ..` [rad], `dq1 ..` [rad/s] where it is measured, one log at a time. Not for motions "
        "far outside those of the training runs, for another arm of the same kind, or after a repair or a change of "
        "tool: close the loop anew.",
        "",
        "## Data",
        "",
        *(_data(record) for record in inputs),
        "",
        "## Parameters",
        "",
        *_parameters(d),
        "",
    ]
    if "test/relative_error" in measures:
        at = next(i for i, line in enumerate(lines) if line.startswith("## How sure"))
        pooled = share(measures["test/relative_error"], 3)
        lines[at:at] = [f"In the comparison of all methods (features' bandwidth) the pooled error is {pooled}.", ""]
    return "\n".join(lines)


def description(card: str) -> str:
    """``card`` as the registry takes it: whole, or cut at a line and said to be."""
    if len(card) <= LONGEST:
        return card
    more = f"\n\n(Cut here; the whole card is the run's artifact `{CARD_FILE}`.)\n"
    head = card[: LONGEST - len(more)]
    return head[: head.rfind("\n")] + more


def _errors(d: Mapping[str, Any]) -> list[str]:
    test, final = d["error"]["test"]["before"], final_errors(d)
    rows = ["| joint | before [N m] | after [N m] | noise floor [N m] | what is left |", "|---|---|---|---|---|"]
    for j, name in enumerate(d["joints"]):
        cells = (
            name,
            number(test["rmse"][j]),
            number(final["rmse"][j]),
            number(d["noise_floor"][j]),
            state_of(d, j)[1],
        )
        rows.append("| " + " | ".join(cells) + " |")
    return rows


def _data(record: InputRecord) -> str:
    profile = json.loads(record.profile)
    origin = f", {profile['repository']} at {profile['commit'][:12]}" if "repository" in profile else ""
    return (
        f"- {record.name}: {profile['runs']} runs, {profile['rows']} rows, {profile['provenance']}{origin} "
        f"(sha256 {record.digest}...)"
    )


def _parameters(d: Mapping[str, Any]) -> list[str]:
    rows = ["| effect | where | parameter | value ± standard error |", "|---|---|---|---|"]
    for entry in d["effects"]:
        against = "" if entry.get("confirmed", True) else " (contradicted by the test runs, inactive)"
        for p in entry["parameters"]:
            where = p["joint"] if p["joint"] is not None else place_of(entry)
            value = value_of(entry, p) + (" (left open by the runs)" if left_open(entry, p) else "")
            rows.append(f"| {title_of(entry['effect'])}{against} | {where} | {title_of(p['name'])} | {value} |")
    return rows if len(rows) > 2 else ["None: nothing was added."]
