"""The loop beside least squares: worse, as good or better, told from made-up residuals whose truth is known."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from tests.small_arm import arm, runs

from hybrid_dynamics.files import write_json
from hybrid_dynamics.identification import LeastSquaresSettings
from hybrid_dynamics.loop import LoopSettings, close_loop
from hybrid_dynamics.study.claims.park_checks import park_checks
from hybrid_dynamics.study.park import judge_arm
from hybrid_dynamics.study.park.compare import AS_GOOD, BETTER, WORSE, Comparison, compare
from hybrid_dynamics.study.park.tables import COLUMNS
from hybrid_dynamics.study.report.park import MODELS, _percent, added_section, park_section
from hybrid_dynamics.types import Array

RATE, SECONDS, BLOCK, CHANCE = 100.0, 40.0, 0.5, 0.025
TIME = np.arange(int(RATE * SECONDS)) / RATE


def noise(seed: int, colour: float = 0.0) -> Array:
    """(K, 2) of unit spread; ``colour`` is the correlation of neighbours."""
    rng = np.random.default_rng(seed)
    white = rng.normal(size=(len(TIME), 2))
    out = np.empty_like(white)
    out[0] = white[0]
    for k in range(1, len(white)):
        out[k] = colour * out[k - 1] + np.sqrt(1 - colour**2) * white[k]
    return out


def lacking(size: float) -> Array:
    """What a model leaves out on the first joint: mean square ``size``; nothing on the second."""
    return np.sqrt(2 * size) * np.stack([np.sin(2 * np.pi * 0.7 * TIME), np.zeros_like(TIME)], axis=1)


def judged(one: Array, other: Array, runs: int = 2) -> tuple[list[Comparison], Comparison]:
    cut = [np.array_split(part, runs) for part in (one, other, TIME)]
    return compare(cut[0], cut[1], cut[2], BLOCK, CHANCE)


@pytest.mark.parametrize("colour", [0.0, 0.9])
def test_a_difference_is_told_with_its_size_and_where_it_is(colour: float) -> None:
    e = noise(1, colour)
    joints, arm = judged(e, e + lacking(0.5))
    assert [j.verdict for j in joints] == [BETTER, AS_GOOD]
    # Of 1.5 the one lacks a half; e is the same in both, so that only its correlation with the difference is random.
    assert joints[0].relative == pytest.approx(-0.5 / 1.5, abs=3 * joints[0].error)
    assert (joints[1].relative, joints[1].error) == (0.0, 0.0)
    assert arm.relative == pytest.approx(-0.5 / 2.5, abs=3 * arm.error)
    # Seen from the other side it is worse, by as many standard errors.
    back, _ = judged(e + lacking(0.5), e)
    assert [j.verdict for j in back] == [WORSE, AS_GOOD]
    assert back[0].relative / back[0].error == pytest.approx(-joints[0].relative / joints[0].error)


@pytest.mark.slow
def test_nothing_between_them_is_as_good_as_often_as_promised() -> None:
    """Two models off by as much, each in its own way: which is better on one log is chance."""
    verdicts = []
    for seed in range(100):
        e = noise(seed, 0.8)
        one, other = (0.3 * noise(1000 * k + seed, 0.95) for k in (1, 2))
        joints, arm = judged(e + one, e + other)
        verdicts += [*(j.verdict for j in joints), arm.verdict]
    wrong = sum(v != AS_GOOD for v in verdicts)
    # Twice CHANCE of 300; three standard deviations of a binomial count that is dependent in threes beyond that.
    assert wrong <= 2 * CHANCE * 300 + 3 * np.sqrt(3 * 2 * CHANCE * 300)


@pytest.mark.slow
def test_a_standard_error_is_the_scatter_over_logs() -> None:
    found = [judged(e, e + lacking(0.2))[0][0] for e in (noise(seed, 0.9) for seed in range(200))]
    scatter = float(np.std([f.relative for f in found]))
    # The share's denominator is random too, by less; 200 logs tell a scatter to a twentieth.
    assert np.median([f.error for f in found]) == pytest.approx(scatter, rel=0.25)


def test_a_sure_difference_of_no_size_is_none() -> None:
    e = noise(3)
    joints, _ = judged(e, e + lacking(0.004))
    assert joints[0].verdict == AS_GOOD


def test_one_short_run_is_compared_too() -> None:
    e = noise(5)[:60]
    joints, arm = compare([e], [e + lacking(9.0)[:60]], [TIME[:60]], BLOCK, CHANCE)
    assert np.isfinite([joints[0].relative, joints[0].error, arm.relative]).all()


def test_an_arm_is_judged_with_the_comparison() -> None:
    """Friction that changes its sign at standstill: what least squares smooths over, and the loop does not."""
    train, test = runs(train=2, test=1, duration=6.0)
    settings = LoopSettings()
    found = close_loop(arm(), train, test, settings)
    joints = judge_arm("a", arm(), [*train, *test], found, settings, LeastSquaresSettings()).joints
    assert tuple(joints.columns) == COLUMNS
    mean_squares = joints[["loop", "least_squares"]] ** 2
    expected = mean_squares["loop"] / mean_squares["least_squares"] - 1
    np.testing.assert_allclose(joints["against_least_squares"], expected, rtol=1e-9)
    whole = mean_squares.sum()
    assert joints["arm_against_least_squares"].tolist() == pytest.approx(
        [whole["loop"] / whole["least_squares"] - 1] * 2
    )
    assert "worse" not in set(joints["against_least_squares_verdict"])
    assert (joints["against_least_squares_error"] > 0).all()


def park_rows(verdicts: list[str], arm: str) -> pd.DataFrame:
    own = {
        "dataset": "arm",
        "joint": range(1, len(verdicts) + 1),
        **dict.fromkeys(("floor", "rigid_body", "least_squares", "loop", "black_box", "explained_share"), 0.5),
        "named": "coulomb_friction",
        "against_least_squares": -0.25,
        "against_least_squares_error": 0.1,
        "against_least_squares_verdict": verdicts,
        "arm_against_least_squares": 0.125,
        "arm_against_least_squares_error": 0.05,
        "arm_against_least_squares_verdict": arm,
    }
    return pd.DataFrame(own)


@pytest.mark.parametrize(
    ("verdicts", "arm", "met"),
    [
        ([BETTER, AS_GOOD], AS_GOOD, True),
        ([BETTER, WORSE], BETTER, False),
        ([AS_GOOD, AS_GOOD], WORSE, False),
    ],
)
def test_the_claim_follows_the_comparison(verdicts: list[str], arm: str, met: bool) -> None:
    [check] = park_checks(park_rows(verdicts, arm))
    assert check.met is met
    assert ("joint 2" in check.measured) == (WORSE in verdicts)
    without = park_rows(verdicts, arm)[["dataset", "joint", "loop", "least_squares"]]
    assert not list(park_checks(without))


def test_the_parks_table_says_what_the_comparison_says(tmp_path: Path) -> None:
    park_rows([BETTER, WORSE], AS_GOOD).to_csv(tmp_path / "park.csv", index=False)
    regimes = pd.DataFrame({"dataset": "arm", "joint": [1, 2], "regime": "standing", **dict.fromkeys(MODELS, 3.0)})
    regimes.to_csv(tmp_path / "park_regimes.csv", index=False)
    parameters = pd.DataFrame({"dataset": "arm", "scatter": [0.5, 1.0, 4.0, np.nan]})
    parameters.to_csv(tmp_path / "park_parameters.csv", index=False)
    write_json(
        tmp_path / "data" / "arm" / "park" / "summary.json", {"title": "The Arm", "repository": "a/b", "licence": "MIT"}
    )
    section = park_section(tmp_path, tmp_path / "data")
    assert section is not None
    text = section.html
    arms, joints = text.split("joint by joint", 1)
    assert "as good within its uncertainty" in arms
    assert "+12 ± 5 %" in arms
    assert text.count("worse beyond its uncertainty") == 1
    assert "-25 ± 10 %" in joints
    assert "The Arm (arm)" in arms
    assert "recorded" in arms
    assert "a/b" in joints
    assert "MIT" in joints
    # 3 N m on each of two joints; two of three scatters within two standard errors.
    assert "4.24" in joints
    # The loop and the black box are as good: the best of the three that are compared is marked, in their columns.
    assert joints[: joints.index("standing")].count('class="best"') == 3 * 2
    assert "50 %" in joints
    assert "2 of 3" in joints
    # A table of before the comparison is still shown.
    park_rows([BETTER, WORSE], AS_GOOD).iloc[:, :9].to_csv(tmp_path / "park.csv", index=False)
    old = park_section(tmp_path, tmp_path / "data")
    assert old is not None
    assert "uncertainty" not in old.html


def test_a_share_near_one_is_not_rounded_to_it() -> None:
    shown = [_percent(share) for share in (0.5, 0.984, 0.9984, 0.99962, 1.0)]
    assert shown == ["50 %", "98 %", "99.8 %", "99.96 %", "100 %"]


def test_added_effects_are_counted_by_arm(tmp_path: Path) -> None:
    columns = ["dataset", "hidden", "hidden_joints", "size_over_floor", "named", "named_joints"]
    columns += ["detected", "named_right", "others", "parameter", "true", "found", "std_error"]
    rows = [
        ("arm", None, None, 0.0, None, None, False, False, 0, None, None, None, None),
        ("arm", "armature", "j1", 3.0, "armature", "j1", True, True, 0, "armature", 0.5, 0.6, 0.06),
        ("arm", "payload", "-", 3.0, "armature", "j2", True, False, 1, None, None, None, None),
        ("arm", "torque_offset", "j1", 3.0, "torque_offset", "j1", True, True, 0, "offset", 1.0, 2.0, 0.1),
    ]
    pd.DataFrame(rows, columns=columns).to_csv(tmp_path / "added.csv", index=False)
    section = added_section(tmp_path / "added.csv")
    assert section is not None
    line = section.html[section.html.index("<tbody>") : section.html.index("</tr>", section.html.index("<tbody>"))]
    assert re.findall(r"(\d of \d)", line) == ["3 of 3", "2 of 3", "2 of 3", "1 of 2", "1 of 1"]
    assert "0.6 ± 0.06" in section.html
    assert added_section(tmp_path / "none.csv") is None
