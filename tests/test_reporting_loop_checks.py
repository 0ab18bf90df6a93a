"""The closed loop's claims: met by results that show them, not met by results that do not."""

import json
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from hybrid_dynamics.study.claims.loop_checks import loop_checks
from hybrid_dynamics.study.results import DatasetResults

JOINTS = tuple(f"j{k}" for k in range(1, 7))


def answer(
    mass: float, first: str = "payload", after: float = 0.02, inconsistent: tuple[str, ...] = ()
) -> dict[str, Any]:
    payload = {
        "effect": "payload",
        "joints": [],
        "parameters": [{"name": "mass", "value": mass, "std_error": 0.01}],
        "inconsistent_between_runs": [{"parameter": name} for name in inconsistent],
    }
    others = [] if first == "payload" else [{"effect": first, "joints": ["j1"], "parameters": []}]
    errors = {"before": {"relative_rmse": [0.5] * 6}, "after": {"relative_rmse": [after] * 6}}
    return {"effects": [*others, payload], "error": {"test": errors}}


def results(folder: Path, answers: dict[str, dict[str, Any]], loop_error: float = 0.05) -> DatasetResults:
    calibrated = {"effects": [{"effect": "coulomb_friction", "joints": [j], "parameters": []} for j in JOINTS]}
    for place, value in {"models/loop": calibrated, **{f"questions/{k}": v for k, v in answers.items()}}.items():
        (folder / place).mkdir(parents=True)
        (folder / place / "diagnosis.json").write_text(json.dumps(value))
    rows = [
        {"split": "test", "trajectory": "14harm50sec", "method": m, "joint": j + 1, "relative_rmse": e}
        for m, e in (("loop", loop_error), ("least_squares", 0.06))
        for j in range(6)
    ]
    empty = pd.DataFrame()
    return DatasetResults(
        "ur10e",
        folder,
        "recorded",
        "ur10e",
        JOINTS,
        pd.DataFrame(rows),
        empty,
        empty,
        empty,
        empty,
        {},
        {},
        "UR10e",
        (),
        None,
    )


GOOD = {
    "load_14harm": answer(2.9),
    "load_15harm": answer(2.95),
    "load_both": answer(2.9, inconsistent=("com_x", "com_z")),
}


def test_results_that_show_the_claims_meet_them(tmp_path):
    found = list(loop_checks(results(tmp_path, GOOD)))
    assert len(found) == 8
    assert all(check.met for check in found)


@pytest.mark.parametrize(
    ("wrong", "claim"),
    [
        ({"load_14harm": answer(3.4), "load_15harm": answer(3.4)}, "load_14harm: the undeclared payload"),
        ({"load_14harm": answer(2.9, first="torque_offset")}, "load_14harm: the undeclared payload"),
        ({"load_15harm": answer(2.95, after=0.1)}, "load_15harm: held-out relative RMSE"),
        ({"load_15harm": answer(3.1)}, "The payload's mass in both recordings"),
        ({"load_both": answer(2.9)}, "Both recordings together"),
        ({"load_both": answer(2.9, inconsistent=("mass",))}, "Both recordings together"),
    ],
)
def test_what_the_loop_did_not_show_is_not_met(wrong, claim, tmp_path):
    missed = [check.claim for check in loop_checks(results(tmp_path, {**GOOD, **wrong})) if not check.met]
    assert any(text.startswith(claim) for text in missed)
    assert len(missed) <= 2


def test_a_loop_worse_than_the_baseline_is_told_and_a_twin_claims_nothing(tmp_path):
    worse = results(tmp_path, GOOD, loop_error=0.061)
    assert [c.claim[:11] for c in loop_checks(worse) if not c.met] == ["Closed loop"]
    object.__setattr__(worse, "provenance", "simulated twin")
    assert not list(loop_checks(worse))
