"""The rows of ``blind.csv`` taken apart: one row a hidden effect, and which cases count for what."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from hybrid_dynamics.study.blind_score import COLUMNS, LISTED, MISSED, NAMED, NONE
from hybrid_dynamics.study.results import read_csv

#: Floors from which on a hidden effect must be found; below :data:`NOTHING` it counts as nothing missing.
SIZE, NOTHING = 3.0, 1.0
#: Total length [s] of the training runs from which on a log counts as long.
LONG = 30.0
#: Verdicts that say that nothing is left to find.
ALL_CLEAR = ("explained", "nothing_missing")
#: What a row of the table of effects holds.
EFFECT_COLUMNS = (
    "case",
    "robot",
    "engine",
    "effect",
    "joint",
    "size",
    "outcome",
    "parameter_error",
    "checked",
    "within",
    "seconds",
    "strange",
)


#: Columns whose cells hold one entry a hidden effect, or a name each.
PER_EFFECT = ("hidden", "hidden_joints", "sizes", "outcomes", "parameter_errors", "checked", "within")
LISTS = (*PER_EFFECT, "named", "named_joints", "unknown_forms", "wrong", "stand_ins", "other_laws", "silent")


def read_cases(path: Path) -> pd.DataFrame:
    """The scored cases of ``scores.csv`` or ``blind.csv``."""
    return read_csv(path, COLUMNS, LISTS)


def truth(column: pd.Series) -> pd.Series:
    """A column of true and false as booleans."""
    return column.astype(str).str.lower() == "true"


def words(value: object) -> list[str]:
    """The entries of a list in a cell."""
    return [] if value is None or value != value else str(value).split()


def clean(cases: pd.DataFrame) -> pd.Series:
    """Cases in which nothing wrong is named; a name that lists what was hidden as doing as well is not wrong, and that
    of an effect of which another law was hidden is not."""
    return cases["wrong"].map(lambda names: not words(names))


def strange(cases: pd.DataFrame) -> pd.Series:
    """Cases that hold a form the catalogue does not have."""
    return cases["unknown_forms"].map(lambda forms: len(words(forms)) > 0)


def silent(cases: pd.DataFrame) -> pd.Series:
    """Cases in which the torque of a joint never changes: nothing can be said of it, so nothing is all clear."""
    return cases["silent"].map(lambda joints: len(words(joints)) > 0)


def effects_of(cases: pd.DataFrame) -> pd.DataFrame:
    """One row a hidden effect of the catalogue (:data:`EFFECT_COLUMNS`): its size and what became of it."""
    rows = [row for case in cases.to_dict("records") for row in _effects(case)]
    return pd.DataFrame(rows, columns=list(EFFECT_COLUMNS))


def _effects(case: Mapping[Any, Any]) -> Iterator[dict[str, Any]]:
    lists = (words(case[name]) for name in PER_EFFECT)
    for effect, joint, size, outcome, error, checked, within in zip(*lists, strict=True):
        yield {
            "case": case["case"],
            "robot": case["robot"],
            "engine": case["engine"],
            "effect": effect,
            "joint": joint,
            "size": float(size),
            "outcome": outcome,
            "parameter_error": None if error == NONE else float(error),
            "checked": int(checked),
            "within": int(within),
            "seconds": float(case["seconds"]),
            "strange": bool(words(case["unknown_forms"])),
        }


def found(effects: pd.DataFrame) -> pd.Series:
    """Effects that were named, or listed as indistinguishable from a name."""
    return effects["outcome"].isin((NAMED, LISTED))


def missing(cases: pd.DataFrame) -> pd.Series:
    """Cases in which something is missing: an effect of the catalogue of :data:`NOTHING` floors or a form beyond it."""
    large = cases["sizes"].map(lambda sizes: any(float(size) >= NOTHING for size in words(sizes)))
    return large | strange(cases)


def pairs(cases: pd.DataFrame) -> pd.DataFrame:
    """``hidden`` and ``named``, one row a pair: a hidden cause with its own name, or with what was named in its
    place (on its joint, or for the whole robot), or with ``nothing``. Names without any cause are hidden
    ``nothing``."""
    rows: list[tuple[str, str]] = []
    for case in cases.to_dict("records"):
        wrong = [tuple(e.rsplit("@", 1)) for name in ("wrong", "stand_ins", "other_laws") for e in words(case[name])]
        told: set[int] = set()

        def instead(joint: str, wrong: list[Any] = wrong, told: set[int] = told) -> list[str]:
            here = [k for k, w in enumerate(wrong) if NONE in (joint, w[1]) or w[1] == joint]
            told.update(here)
            return list(dict.fromkeys(wrong[k][0] for k in here)) or ["nothing"]

        for effect, joint, outcome in zip(
            *(words(case[n]) for n in ("hidden", "hidden_joints", "outcomes")), strict=True
        ):
            rows += [(effect, effect)] if outcome == NAMED else [(effect, other) for other in instead(joint)]
        for form in words(case["unknown_forms"]):
            rows += [(form, other) for other in instead(NONE)]
        rows += [("nothing", w[0]) for k, w in enumerate(wrong) if k not in told]
        if not (words(case["hidden"]) or words(case["unknown_forms"]) or wrong):
            rows.append(("nothing", "nothing"))
    return pd.DataFrame(rows, columns=["hidden", "named"])


__all__ = [
    "ALL_CLEAR",
    "EFFECT_COLUMNS",
    "LONG",
    "MISSED",
    "NOTHING",
    "SIZE",
    "clean",
    "effects_of",
    "found",
    "missing",
    "pairs",
    "silent",
    "strange",
    "truth",
    "words",
]
