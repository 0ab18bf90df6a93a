"""A huge offset and a link that no robot has, which nearly undo each other, are no result; plausible ones stay."""

from __future__ import annotations

import pytest
from tests.small_arm import heavier_links
from tests.test_loop_beside import SHOULDER, judged

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.loop.augment import refit
from hybrid_dynamics.loop.balanced import BEYOND, balanced

OFFSET = Term("torque_offset", 0)
FRICTION = Term("coulomb_friction", 0)
#: About one period over the range of the runs, which an offset and a weight can bow after.
BOW = Effect("torque_ripple", (SHOULDER,), {"amplitude": 6.0, "harmonic": 5.0, "phase": 2.0})


def test_an_offset_that_only_an_impossible_link_balances_is_told() -> None:
    judge, chosen, _ = judged([BOW])
    fitted = refit(judge.evidence, [*chosen, OFFSET, FRICTION])
    # The trap is there: an offset many times the law that it follows.
    assert abs(fitted.x[20]) > 3 * BOW.parameters["amplitude"]
    judge = judge.over(fitted.evidence)
    assert balanced(judge, [*chosen, OFFSET, FRICTION]) == [OFFSET]
    # Only where it is asked for.
    assert balanced(judge, [*chosen, OFFSET, FRICTION], [FRICTION]) == []
    assert balanced(judge, [OFFSET, FRICTION]) == []


@pytest.mark.parametrize("share", [0.15, 8.0])
def test_a_true_offset_stays_beside_links_that_are_off_by_themselves(share: float) -> None:
    """Also where the description holds placeholders: nothing named makes the links so."""
    judge, chosen, _ = judged([heavier_links(share), Effect("torque_offset", (SHOULDER,), {"offset": 1.5})])
    assert balanced(judge, [*chosen, OFFSET, FRICTION]) == []
    x, scale = refit(judge.evidence, [*chosen, OFFSET]).x[:20], chosen[0].prior_scale(judge.evidence.robot)
    assert (abs(x / scale).max() > BEYOND) == (share > 1)
