"""Friction that differs with the direction, in a part of the log that shows one direction alone."""

from __future__ import annotations

import numpy as np
import pytest
from tests.test_loop_beside import ROBOT, SHOULDER, offered

from hybrid_dynamics.effects import Effect
from hybrid_dynamics.loop.augment import refit
from hybrid_dynamics.loop.identifiability import undetermined
from hybrid_dynamics.loop.layout import Layout
from hybrid_dynamics.loop.problem import DIFFERENCE, Problem
from hybrid_dynamics.loop.tangents import published_covariance

VALUES = {"coulomb_torque_positive": 1.0, "coulomb_torque_negative": 0.7}
HIDDEN = Effect("asymmetric_coulomb_friction", (SHOULDER,), VALUES)


def nothing(_: Problem, layout: Layout) -> np.ndarray:
    return np.zeros((layout.total, layout.total))


def test_the_direction_that_a_part_does_not_show_is_like_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of folds some hold all that is seen of one direction: the rest would predict them by any number."""
    term = HIDDEN.term(ROBOT)
    judge, _ = offered([HIDDEN], [term])
    evidence = judge.evidence
    slow = judge.settings.process.slow_speed
    speeds = [
        evidence.runs[r].dq[low:high, 0]
        for r, (low, high) in zip(evidence.blocks.run, evidence.blocks.rows, strict=True)
    ]
    forward = np.array([[dq.min() > -slow and dq.max() > slow for dq in speeds]], float)
    assert 2 <= forward.sum() < len(speeds)
    grams = [gram.totals(forward)[0] for gram in evidence.gram]
    one_way, whole = evidence.fit([term], grams), evidence.fit([term])
    assert abs(one_way[1] - one_way[0]) < DIFFERENCE * evidence.problem.torque_size[0]
    # Where both are seen nothing is held to anything: to a ten-thousandth of what they differ by.
    monkeypatch.setattr(Problem, "alike", nothing)
    assert whole == pytest.approx(evidence.fit([term]), abs=1e-4 * 0.3)
    assert whole == pytest.approx(list(VALUES.values()), abs=0.02)
    # The control: what is not seen is nothing then.
    assert evidence.fit([term], grams)[1] == 0.0


def test_what_is_held_to_be_alike_is_not_known_by_that() -> None:
    """Neither its standard error nor what is said to be left open takes the hold for a measurement."""
    term = HIDDEN.term(ROBOT)
    judge, _ = offered([HIDDEN], [term])
    evidence = judge.evidence
    assert undetermined(evidence, [term], term) == []
    for r, run in enumerate(evidence.runs):
        back = np.flatnonzero(np.diff(np.r_[0, (run.dq[:, 0] < 0.05).astype(int), 0]))
        for low, high in zip(back[::2], back[1::2], strict=True):
            evidence = evidence.leave_out(r, slice(max(low - 8, 0), high + 8))
    fitted = refit(evidence, [term])
    forward, backward = np.sqrt(np.diag(published_covariance(fitted.evidence, [term], fitted.x)))
    assert undetermined(fitted.evidence, [term], term) == ["coulomb_torque_negative"]
    assert abs(fitted.x[0] - 1.0) < 4 * forward
    # Not seen at all: as uncertain as what it is held within, at least.
    assert backward >= DIFFERENCE * evidence.problem.torque_size[0]
    assert abs(fitted.x[1] - 0.7) < 4 * backward


def test_it_holds_the_difference_and_not_the_size() -> None:
    judge, _ = offered([HIDDEN], [HIDDEN.term(ROBOT)])
    problem = judge.evidence.problem
    held = problem.alike(judge.evidence.layout([HIDDEN.term(ROBOT)]))
    assert held @ np.ones(2) == pytest.approx(0.0, abs=1e-12)
    across = np.array([0.5, -0.5])
    assert across @ held @ across == pytest.approx(0.5 / (DIFFERENCE * problem.torque_size[0]) ** 2)
    plain = Effect("coulomb_friction", (SHOULDER,), {"coulomb_torque": 1.0}).term(ROBOT)
    assert not problem.alike(judge.evidence.layout([plain])).any()
