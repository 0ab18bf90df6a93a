"""Samples that two runs share are counted pair by pair, however many runs there are."""

import numpy as np

from hybrid_dynamics.check.duplicates import check_duplicates
from hybrid_dynamics.trajectory import Trajectory


def run(name: str, q: np.ndarray, split: str = "train") -> Trajectory:
    return Trajectory(name, split, np.arange(len(q)) / 100.0, {"q": q, "tau": np.cos(q)})


def test_of_many_runs_the_pairs_that_share_samples_are_told_with_their_shares() -> None:
    rng = np.random.default_rng(0)
    apart = [rng.normal(size=(200, 2)).cumsum(axis=0) for _ in range(12)]
    runs = [run(f"r{k}", q) for k, q in enumerate(apart)]
    assert check_duplicates(runs[:10], runs[10:]) == [], "the control"
    half = run("half", np.concatenate([apart[3][:100], rng.normal(size=(100, 2)).cumsum(axis=0) + 50.0]))
    whole = run("whole", apart[7], "test")
    still = run("still", np.zeros((200, 2)))
    found = check_duplicates([*runs, half, still], [whole])
    assert [(f.severity, f.run) for f in found] == [("warning", "half"), ("hard", "whole")]
    assert "run r3 (50%" in found[0].text
    assert "run r7 (100%" in found[1].text


def test_runs_that_all_stand_share_nothing() -> None:
    still = [run(name, np.zeros((50, 2))) for name in "abc"]
    assert check_duplicates(still, []) == []
