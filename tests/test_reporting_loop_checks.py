"""The closed loop's claims: met by results that show them, not met by results that do not."""

import json
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from hybrid_dynamics.study.claims.loop_checks import blind_checks, loop_checks
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


def cases(
    wrong: int = 0, after: float = 1.0, floor: float = 1.0, error: float = 0.005, count: int = 160
) -> pd.DataFrame:
    rows = []
    for k in range(count):
        hidden = ("viscous_friction", "payload armature", None, "payload")[k % 4]
        rows.append(
            {
                "robot": "arm", "hidden": hidden, "named_right": True, "nothing_wrong_named": k >= wrong,
                "parameter_error": error if hidden else None, "rmse_after": after, "rmse_true_model": 1.0,
                "rmse_after_all_rows": after, "rmse_true_model_all_rows": 1.0, "floor_over_true_model": floor,
                "unknown_forms": "", "verdict": "explained" if hidden else "nothing_missing",
            }
        )  # fmt: skip
    return pd.DataFrame(rows)


def test_claims_on_hidden_effects_follow_their_cases():
    assert [c.met for c in blind_checks(cases())] == [True] * 6
    measured = [c.measured.split(" (")[0] for c in blind_checks(cases(wrong=15))]
    assert measured[:3] == ["73 of 80", "36 of 40", "36 of 40"]
    assert [c.met for c in blind_checks(cases(wrong=15))][:3] == [False, False, False]
    # Ten of ten are no evidence of 97 %.
    few = list(blind_checks(cases(count=20)))[:3]
    assert [(c.met, c.n) for c in few] == [(None, 10), (None, 5), (None, 5)]
    assert "too few cases" in few[0].measured
    assert [c.met for c in blind_checks(cases(error=0.02))][3] is False
    assert [c.met for c in blind_checks(cases(after=1.2))][4] is False
    assert [c.met for c in blind_checks(cases(floor=0.7))][5] is False
    assert not list(blind_checks(cases().iloc[:0]))


def test_a_law_outside_the_catalogue_is_judged_by_its_verdict_alone():
    both = cases()
    strange = both.iloc[:40].assign(unknown_forms="lugre", nothing_wrong_named=False, rmse_after=20.0)
    for verdict, met in (("partly_explained", True), ("explained", False)):
        found = list(blind_checks(pd.concat([both, strange.assign(verdict=verdict)])))
        assert (found[0].met, found[0].n) == (met, 40)
        # Neither its names nor its errors are counted among those that could be right.
        assert [c.met for c in found[1:]] == [True] * 6
