"""Selection by itself: what counts as good as, and what may replace what, on held-out errors written by hand."""

from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
import pytest

from hybrid_dynamics.effects import Slot
from hybrid_dynamics.loop import LoopSettings
from hybrid_dynamics.loop.augment import _replace
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.trace import Judge, rank

VISCOUS, CURVED = Slot("viscous_friction", 0), Slot("nonlinear_viscous_friction", 0)
OTHER = Slot("coulomb_friction", 1)
BLOCKS = 20


@dataclass
class Told:
    """Stands for the evidence: squared errors (blocks, 1 joint) of every set of slots, ten samples a block."""

    errors: dict[frozenset[Slot], np.ndarray]
    weights: np.ndarray = field(default_factory=lambda: np.ones(1))
    samples: np.ndarray = field(default_factory=lambda: np.array([10.0 * BLOCKS]))
    n: int = 1

    def held_out(self, slots: Any, physical: bool = False) -> np.ndarray:
        return self.errors[frozenset(slots)][:, None]

    def acts(self, slot: Slot) -> np.ndarray:
        return np.ones(1, bool)

    def constrained(self, slots: Any) -> bool:
        return False


def judge(errors: dict[frozenset[Slot], np.ndarray]) -> Judge:
    """Noise floor 1 N m: ten samples a block make 10 (N m)^2 of noise."""
    return Judge(cast(Evidence, Told(errors)), LoopSettings(), np.ones(1), np.ones(1))


def wavering(mean: float, by: float) -> np.ndarray:
    return mean + by * np.where(np.arange(BLOCKS) % 2, 1.0, -1.0)


@pytest.mark.parametrize(("worse_by", "first"), [(0.5, VISCOUS), (4.0, CURVED)])
def test_of_two_that_may_be_named_the_simpler_wins_unless_the_loss_matters(worse_by, first):
    nothing, curved = wavering(60, 1), wavering(11, 1)
    # Worse in every block by the same: certain. 0.5 of 10 is below keep_share (0.1) of a squared floor, 4 is above.
    told = {frozenset(): nothing, frozenset([CURVED]): curved, frozenset([VISCOUS]): curved + worse_by}
    table = rank(judge(told), [], [VISCOUS, CURVED], nothing[:, None])
    assert table[0].slot == first
    assert all(c.accepted for c in table)


@pytest.mark.parametrize(("wavers", "enters"), [(30.0, False), (0.1, True)])
def test_being_simpler_lets_nothing_in_that_explains_nothing_surely(wavers, enters):
    nothing, curved = wavering(20, 0), wavering(15, 0)
    told = {frozenset(): nothing, frozenset([CURVED]): curved, frozenset([OTHER]): wavering(15, wavers)}
    replaced = _replace(judge(told), [CURVED], [CURVED, OTHER], curved[:, None], {frozenset([CURVED])})
    assert (replaced == [OTHER]) is enters
