"""The table that ``make bench`` writes: what was measured, against what, and whether the goal is met."""

import csv
import json

import numpy as np
import pytest
from benchmarks import bench
from benchmarks.cases import CASES, dynamics, sindy
from benchmarks.data import arm, log

FASTER = bench.Row("x, {} rows", "sindy", 10, 5, 8.0, "peer")
BOUNDED = bench.Row("y", "help", 0, 0, 0.7)


@pytest.mark.parametrize(
    ("row", "ours", "peer", "ratio", "met"),
    [
        (FASTER, 1.0, 8.0, "8", "yes"),
        (FASTER, 1.0, 7.9, "7.9", "no"),
        (FASTER, 1.0, None, "", "not measured"),
        (BOUNDED, 0.7, None, "", "yes"),
        (BOUNDED, 0.71, None, "", "no"),
        (BOUNDED, None, None, "", "no"),
    ],
)
def test_a_goal_is_met_or_not(row, ours, peer, ratio, met):
    found = bench.line(row, 10, ours, peer)
    assert (found["ratio"], found["met"]) == (ratio, met)


def test_growth_is_the_exponent_of_the_largest_sizes():
    """A fixed cost of 5 s must not make quadratic growth look linear."""
    sizes, seconds = [1, 100, 1000], [5 + 1e-3 * n**2 for n in (1, 100, 1000)]
    assert bench.exponent(sizes, seconds) == pytest.approx(1.83, abs=0.01)
    growth = bench.Growth("g", "loop_runs", (1, 100, 1000), None, 1.05)
    assert bench.growth_line(growth, growth.sizes, seconds)["met"] == "no"
    assert bench.growth_line(growth, growth.sizes, [5.0, None, None])["met"] == "not measured"


def test_rows_name_cases_and_the_file_has_the_agreed_columns(tmp_path):
    assert {row.case for row in bench.ROWS} | {growth.case for growth in bench.GROWTHS} == set(CASES)
    bench.write(tmp_path, [bench.line(BOUNDED, 0, 0.5, None)], {"machine": bench.machine()})
    with open(tmp_path / "benchmarks.csv", newline="", encoding="utf-8") as file:
        assert next(csv.reader(file)) == ["name", "ours", "peer", "ratio", "goal", "met"]
    assert json.loads((tmp_path / "benchmarks.json").read_text())["machine"]["cores"] >= 1


def test_both_sides_solve_the_same_problem():
    ours, peer = (sindy.fit(side, 1500)() for side in ("ours", "peer"))
    assert ours["terms"] == peer["terms"]
    assert ours["sum"] == pytest.approx(peer["sum"], rel=1e-9)
    ours, peer = (dynamics.rigid_body(side, 50)() for side in ("ours", "peer"))
    assert ours["sum"] == pytest.approx(peer["sum"], rel=1e-12)


def test_the_logs_hold_the_friction_they_say():
    robot = arm(3)
    run = log(robot, 4.0, 100.0, seed=1, friction=5.0, viscous=0.0)
    dq = np.gradient(run["q"], run.time, axis=0)
    ddq = np.gradient(dq, run.time, axis=0)
    left = run["tau"] - robot.inverse_dynamics(run["q"], dq, ddq)
    moving = np.abs(dq) > 0.2
    assert np.median((left * np.sign(dq))[moving[:, 0], 0]) == pytest.approx(5.0, abs=0.1)
    assert np.median((left * np.sign(dq))[moving[:, 1], 1]) == pytest.approx(0.0, abs=0.1)
