"""Hidden effects are counted by what became of them: in the claims and in the tables of the page."""

import re
from pathlib import Path
from typing import Any

import pandas as pd

from hybrid_dynamics.study.blind_score import COLUMNS
from hybrid_dynamics.study.blind_table import effects_of, missing, pairs, read_cases
from hybrid_dynamics.study.claims.blind_checks import blind_checks
from hybrid_dynamics.study.report.blind import blind_section


def case(name: str, hidden: str = "", **other: Any) -> dict[str, Any]:
    """A row of blind.csv in which every hidden effect is named right, but for ``other``."""
    count = len(hidden.split())
    row = {
        "case": name, "robot": "arm", "engine": "own", "hidden": hidden, "hidden_joints": " ".join(["j1"] * count),
        "size_over_floor": 5.0, "named": hidden, "named_joints": " ".join(["j1"] * count), "named_right": True,
        "nothing_wrong_named": True, "verdict": "explained" if hidden else "nothing_missing", "rmse_before": 4.0,
        "rmse_after": 1.0, "rmse_true_model": 1.0, "rmse_after_all_rows": 1.0, "rmse_true_model_all_rows": 1.0,
        "floor_over_true_model": 1.0, "noise": "white", "seconds": 60.0, "unknown_forms": "",
        "sizes": " ".join(["5"] * count), "outcomes": " ".join(["named"] * count),
        "parameter_errors": " ".join(["0.005"] * count), "checked": " ".join(["100"] * count),
        "within": " ".join(["95"] * count), "wrong": "", "stand_ins": "", "other_laws": "",
        "alternatives": 1, "loop_seconds": 9.0,
        "noise_floor": 1.0, "runs": 4, "parameter_error": 0.005, "rate": 500.0, "velocity": True, "listed": "",
        "joint": 1, "silent": "",
    }  # fmt: skip
    return row | other


MISSED = {
    "outcomes": "missed", "named": "", "named_joints": "", "named_right": False, "parameter_errors": "-",
    "checked": "0", "within": "0",
}  # fmt: skip
WRONG = {"named": "armature", "nothing_wrong_named": False, "wrong": "armature@j1"}
STRANGE = {"unknown_forms": "stribeck_1/2", "verdict": "partly_explained", **WRONG}


def table(*more: dict[str, Any]) -> pd.DataFrame:
    many = [case(f"c{k}", ("viscous_friction", "payload armature")[k % 2]) for k in range(100)]
    bare = [case(f"n{k}") for k in range(60)]
    return pd.DataFrame([*many, *bare, *more])


def claims(cases: pd.DataFrame) -> dict[str, bool | None]:
    return {check.claim: check.met for check in blind_checks(cases)}


def unmet(*more: dict[str, Any]) -> list[str]:
    return [what for what, met in claims(table(*more)).items() if met is False]


def test_a_study_in_which_each_case_hides_one_effect_at_most_is_read_as_it_was_written(tmp_path):
    """Lists of one number each, and empty ones: a column that looks like numbers and is none."""
    written = pd.DataFrame([case("a"), case("b", "viscous_friction")])
    file = tmp_path / "blind.csv"
    written.to_csv(file, index=False)
    for _ in range(2):  # read, written and read again, as the report does
        effects = effects_of(read_cases(file))
        pd.testing.assert_frame_equal(effects, effects_of(written))
        read_cases(file).to_csv(file, index=False)
    assert blind_section(file) is not None
    assert list(effects["checked"]) == [100]


def test_claims_are_met_by_what_shows_them_and_by_nothing_else():
    small = [case(f"s{k}", "viscous_friction", sizes="1.7") for k in range(20)]
    assert set(claims(table(*small)).values()) == {True}
    assert not list(blind_checks(table().iloc[:0]))
    (only,) = unmet(*(case(f"m{k}", "viscous_friction", **MISSED) for k in range(6)))
    assert "of every family" in only  # 50 of 56
    assert len(unmet(*(case(f"m{k}", "viscous_friction", **MISSED) for k in range(20)))) == 2
    # Listed with the reason counts; a short log and a small effect do not.
    assert not unmet(*(case(f"l{k}", "viscous_friction", **{**MISSED, "outcomes": "listed"}) for k in range(20)))
    assert not unmet(*(case(f"m{k}", "viscous_friction", **{**MISSED, "seconds": 10.0}) for k in range(20)))
    assert not unmet(*(case(f"m{k}", "viscous_friction", **{**MISSED, "sizes": "2.5"}) for k in range(20)))
    (only,) = unmet(*(case(f"m{k}", "viscous_friction", **{**MISSED, "sizes": "1.7"}) for k in range(20)))
    assert only.startswith("Half of the effects")
    assert unmet(*(case(f"a{k}", **WRONG) for k in range(3))) == ["Nothing hidden: at most 1 false alarm in 100"]
    (only,) = unmet(*(case(f"v{k}", "payload", verdict="unexplained") for k in range(30)))
    assert "explained in at least 85 %" in only


def test_a_joint_of_which_nothing_can_be_said_asks_for_no_all_clear_and_forbids_one():
    mute = [case(f"s{k}", "payload", verdict="partly_explained", silent="j2 j3") for k in range(30)]
    assert not unmet(*mute)
    (only,) = unmet(*mute, case("s", "payload", silent="j2"))
    assert only == "The torque of a joint never changes: no all-clear"
    assert only not in claims(table())
    (only,) = unmet(*(case(f"p{k}", "payload", parameter_errors="0.2") for k in range(60)))
    assert "Parameter error" in only
    assert not unmet(*(case(f"p{k}", "hysteresis_friction", parameter_errors="0.15") for k in range(60)))
    (only,) = unmet(*(case(f"p{k}", "payload", within="50") for k in range(60)))
    assert "two standard errors" in only
    assert len(unmet(*(case(f"r{k}", "payload", rmse_after=1.3) for k in range(30)))) == 1
    assert unmet(case("f", "payload", floor_over_true_model=0.7))
    assert "alternatives" in unmet(*(case(f"p{k}", "payload", alternatives=9) for k in range(60)))[0]


def test_a_law_outside_the_catalogue_is_judged_by_its_verdict_and_no_wrong_name_is_right_beside_an_all_clear():
    honest = [case(f"u{k}", rmse_after=20.0, **STRANGE) for k in range(40)]
    assert not unmet(*honest)
    (only,) = unmet(*honest, case("u", **{**STRANGE, "verdict": "explained"}))
    assert "beside an all-clear" in only
    assert not unmet(
        *honest, case("u", **{**STRANGE, "verdict": "explained", "wrong": "", "nothing_wrong_named": True})
    )
    # Stribeck's law where one of another exponent was hidden is not the name of another effect.
    law = {**STRANGE, "verdict": "explained", "wrong": "", "other_laws": "stribeck_friction@j1"}
    assert not unmet(*honest, case("u", **law))


def test_effects_are_taken_apart_and_names_stand_where_their_cause_sits():
    rows = [
        case("a", "payload armature", hidden_joints="- j1", sizes="9 0.4", outcomes="named listed"),
        case("b", "viscous_friction", **MISSED, wrong="coulomb_friction@j1 torque_gain@j2"),
        case("c", **STRANGE),
        case("d"),
        case("e", "armature", **MISSED, sizes="0.5"),
        case("f", "payload", hidden_joints="-", **{**MISSED, "outcomes": "listed"}, stand_ins="link_inertia@j6"),
        case("g", **{**STRANGE, "wrong": ""}, other_laws="stribeck_friction@j1"),
    ]
    cases = pd.DataFrame(rows)
    effects = effects_of(cases)
    assert list(effects["effect"]) == ["payload", "armature", "viscous_friction", "armature", "payload"]
    assert list(effects["size"]) == [9.0, 0.4, 5.0, 0.5, 5.0]
    assert list(missing(cases)) == [True, True, True, False, False, True, True]
    assert sorted(pairs(cases).itertuples(index=False, name=None)) == [
        ("armature", "nothing"), ("armature", "nothing"), ("nothing", "nothing"),
        ("nothing", "torque_gain"), ("payload", "link_inertia"), ("payload", "payload"),
        ("stribeck_1/2", "armature"), ("stribeck_1/2", "stribeck_friction"),
        ("viscous_friction", "coulomb_friction"),
    ]  # fmt: skip


def test_the_page_counts_every_hidden_effect_against_its_size(tmp_path: Path) -> None:
    rows = [
        case("c1", "viscous_friction"),
        case("c2", "payload", hidden_joints="-", **MISSED | WRONG),
        case("c3", "payload", hidden_joints="-", **{**MISSED, "sizes": "1.2", "seconds": 10.0}),
        case("c4"),
        case("c5", "payload armature", hidden_joints="- j1", sizes="9 7"),
        case("c6", rmse_after=3.0, **STRANGE),
    ]
    table = pd.DataFrame(rows)
    assert set(COLUMNS) <= set(table.columns)
    table.to_csv(tmp_path / "blind.csv", index=False)
    section = blind_section(tmp_path / "blind.csv")
    assert section is not None
    html = section.html
    assert re.search(r"3 to 6</td>.*?1 of 2 \(95 % interval 1 to 99 %\)", html, re.S)
    assert re.search(r"6 to 12</td>.*?2 of 2 \(95 % interval 16 to 100 %\)", html, re.S)
    assert html.count('class="drawn"') == 2  # long and short logs
    confusion = html[html.index('class="confusion"') :]
    assert "stribeck_1/2" in confusion
    assert "A form it lacks" in html
    assert "Listed alternatives: 1.00 a case" in html
    assert "9.0 s (median)" in html
    assert "The 2 cases that were not right" in html
    assert blind_section(tmp_path / "none.csv") is None
