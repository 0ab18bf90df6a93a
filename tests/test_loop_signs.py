"""How dry friction turns over is chosen by reversals, too; what holds a resting joint proves no law."""

from __future__ import annotations

import numpy as np
import pytest
from tests.test_loop_slow_sign import ELBOW, judged

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.effects.sign import WIDTH
from hybrid_dynamics.loop.signs import _rows, choose_signs
from hybrid_dynamics.loop.trace import Gain, Judge

SHARP = Effect("coulomb_friction", (ELBOW,), {"coulomb_torque": 2.0})


def wide_of(terms: list[Term]) -> list[Term]:
    return [t for t in terms if t.joint == 1 and t.effect == "coulomb_friction" and t.options.get(WIDTH) == 0.08]


def width(terms: list[Term]) -> float:
    (term,) = terms
    return float(term.options.get(WIDTH, 0.0))


def test_a_sign_that_is_wrong_at_every_reversal_is_let_go() -> None:
    judge, terms = judged([SHARP])
    assert width(choose_signs(judge, wide_of(terms))[1]) < 0.03


@pytest.mark.parametrize(("share", "sharp"), [(0.5, True), (2.0, False)])
def test_moving_rows_are_weighed_against_reversals(monkeypatch: pytest.MonkeyPatch, share: float, sharp: bool) -> None:
    """The few blocks of a short log may surely prefer a wide sign; they lose by it only what they gain."""
    judge, terms = judged([SHARP])
    chosen = wide_of(terms)
    every, reversals = _rows(judge.evidence, 1)
    assert 0 < sum(r.sum() for r in reversals) < 0.2 * sum(r.sum() for r in every)
    plain = next(t for t in terms if t.joint == 1 and t.effect == "coulomb_friction" and not t.settings)
    wrong, right = (judge.evidence.held_out_on(t, 1, (reversals,))[0] for t in (chosen, [plain]))
    assert right < 0.2 * wrong
    lost = share * float(wrong - right) * judge.evidence.weights[1]
    per_joint = np.array([0.0, lost / judge.evidence.weights[1] / judge.evidence.samples[1]])
    assert per_joint[1] > judge.settings.floor_share * judge.floor[1] ** 2
    monkeypatch.setattr(Judge, "gain", lambda *_: Gain(lost, 0.1 * lost, per_joint, 20))
    assert (width(choose_signs(judge, chosen)[1]) < 0.03) == sharp


def test_rows_of_a_rest_are_no_reversals() -> None:
    judge, _ = judged([SHARP])
    for run, mask in zip(judge.evidence.runs, judge.evidence.mask, strict=True):
        low, high = np.searchsorted(run.time, (run.time[0] + 2.0, run.time[0] + 4.0))
        mask[low:high, 1] = False
        _, reversals = _rows(judge.evidence, 1)
        own = next(r for r, other in zip(reversals, judge.evidence.runs, strict=True) if other is run)
        # All of it but what is braking and starting.
        assert own[low:high].sum() < 0.15 * (high - low)
        assert own.sum() > 0
