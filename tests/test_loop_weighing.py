"""A joint of which much has no name does not bend what the joints share."""

from __future__ import annotations

import numpy as np
import pytest
from tests.small_arm import heavier_links
from tests.test_loop_beside import ROBOT

from hybrid_dynamics.effects import Term
from hybrid_dynamics.loop import LoopSettings, Model
from hybrid_dynamics.loop.augment import model_of
from hybrid_dynamics.loop.diagnosis import predict_run
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.loop.trace import Judge
from hybrid_dynamics.loop.weighing import as_left, weighed_by
from hybrid_dynamics.simulation.excitation import excitations

HEAVIER = heavier_links(0.3)


def judged(unnamed: float) -> tuple[Judge, Term, list[Run]]:
    """All links heavier, and on the shoulder a torque of ``unnamed`` [N m] that no family makes; runs without that to
    test with."""
    settings = LoopSettings()
    train, test = excitations(ROBOT, [HEAVIER], train=2, test=2, duration=8.0, rate=250.0)
    for run in train:
        q = run.signals["q"]
        run.signals["tau"][:, 0] += unnamed * np.cos(q.sum(axis=1)) * np.cos(q[:, 1])
    logs = read_motion(ROBOT, train, test, settings)
    judge, _, _ = gather(Model(ROBOT), logs, settings)
    term = HEAVIER.term(ROBOT)
    return judge.adding([term]).at([term]), term, logs.test


def elbow(judge: Judge, term: Term, test: list[Run]) -> float:
    """Error [N m] of the elbow, rms on runs without what has no name."""
    model = model_of(judge.evidence, [term], False)
    return float(np.sqrt(np.mean(np.concatenate([(r.tau - predict_run(model, r))[:, 1] for r in test]) ** 2)))


def test_a_joint_with_a_law_without_a_name_does_not_spoil_its_neighbour() -> None:
    judge, term, test = judged(unnamed=3.0)
    # White noise of both alike, known beforehand: the law is no noise.
    judge = weighed_by(judge, np.full(2, 0.05))
    quiet = as_left(judge, [term])
    before, after = elbow(judge, term, test), elbow(quiet, term, test)
    assert after < 0.5 * before
    assert after == pytest.approx(elbow(*judged(unnamed=0.0)), rel=0.1)
    # It is weights that change, and nothing that is asked by the floor.
    assert quiet.floor is judge.floor
    weights = judge.evidence.weights / quiet.evidence.weights
    assert weights[0] > 4.0 * weights[1] >= 4.0 * (1 - 1e-12)


def test_where_everything_has_a_name_nothing_is_weighed_anew() -> None:
    judge, term, _ = judged(unnamed=0.0)
    assert as_left(judge, [term]).evidence.weights == pytest.approx(judge.evidence.weights, rel=0.3)


def test_a_joint_without_a_floor_counts_nothing() -> None:
    judge, term, _ = judged(unnamed=3.0)
    still = weighed_by(judge, judge.floor * [1.0, 0.0])
    assert as_left(still, [term]).evidence.weights[1] == 0.0
