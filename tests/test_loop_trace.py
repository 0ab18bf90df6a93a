"""Selection by itself: what counts as good as, and what may replace what, on held-out residuals written by hand."""

from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np
import pytest
from scipy.signal import lfilter

from hybrid_dynamics.effects import Effect, Term, family
from hybrid_dynamics.effects.inertia import BODY_PARAMETERS, to_body, to_dynamic
from hybrid_dynamics.loop import LoopSettings, Model
from hybrid_dynamics.loop.blocks import Blocks, Folds
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.gram import BlockGrams
from hybrid_dynamics.loop.held import Held, change_by_block
from hybrid_dynamics.loop.layout import Layout
from hybrid_dynamics.loop.noise import noise_floor
from hybrid_dynamics.loop.process import process
from hybrid_dynamics.loop.prune import choose
from hybrid_dynamics.loop.search import _replace, search
from hybrid_dynamics.loop.sums import FoldSums
from hybrid_dynamics.loop.trace import FEWEST_CLUSTERS, Judge, block_error, rank
from hybrid_dynamics.robots import Robot, find_description
from hybrid_dynamics.simulation.excitation import excitations

VISCOUS, CURVED = Term("viscous_friction", 0), Term("nonlinear_viscous_friction", 0)
OTHER = Term("coulomb_friction", 1)
BLOCKS, SAMPLES = 20, 8


@dataclass
class Told:
    """Stands for the evidence: the held-out residual (blocks, samples) [N m] of one joint for every set of terms."""

    residuals: dict[frozenset[Term], np.ndarray]
    weights: np.ndarray = field(default_factory=lambda: np.ones(1))
    samples: np.ndarray = field(default_factory=lambda: np.array([float(SAMPLES * BLOCKS)]))
    n: int = 1

    def __post_init__(self) -> None:
        # The target, the last column, is nothing: residuals are what the columns make.
        columns = np.stack([*self.residuals.values(), np.zeros((BLOCKS, SAMPLES))], axis=2)
        self.gram = [BlockGrams.of(np.einsum("bti,btj->bij", columns, columns))]
        self.blocks = Blocks(np.zeros(BLOCKS, int), ((0, 0),) * BLOCKS)
        self.folds = Folds(self.blocks, 1, np.zeros(BLOCKS, int))
        self.sums = FoldSums.of(self.gram, self.folds)

    def held(self, terms: Any, physical: bool = False) -> Held:
        place = list(self.residuals).index(frozenset(terms))
        return Held.of(self.sums, [(np.array([0]), np.array([place]))], np.array([[-1.0]]), self.weights)

    def change(self, left: Held, old: Held, new: Held) -> np.ndarray:
        return change_by_block(left, old, new, self.gram, self.folds)

    def adding(self, terms: Any) -> "Told":
        return self

    def acts(self, term: Term) -> np.ndarray:
        return np.ones(1, bool)

    def layout(self, terms: Any) -> Layout:
        return Layout((), (), 0)

    def fit(self, terms: Any) -> np.ndarray:
        return np.zeros(0)

    def constrained(self, terms: Any) -> bool:
        return False


def judge(residuals: dict[frozenset[Term], np.ndarray]) -> Judge:
    """Noise floor 1 N m."""
    return Judge(cast(Evidence, Told(residuals)), LoopSettings(), np.ones(1), np.ones(1), np.zeros(1), np.zeros(1))


#: Noise of one floor, and two changes of a prediction, of mean square one, that no sample of it resembles.
NOISE = np.tile([1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0], (BLOCKS, 1))
LARGE = np.tile([1.0, 1.0, -1.0, -1.0, 1.0, 1.0, -1.0, -1.0], (BLOCKS, 1))
SMALL = np.tile([1.0, 1.0, 1.0, 1.0, -1.0, -1.0, -1.0, -1.0], (BLOCKS, 1))


@pytest.mark.parametrize(("worse_by", "first"), [(0.05, VISCOUS), (0.4, CURVED)])
def test_of_two_that_may_be_named_the_simpler_wins_unless_the_loss_matters(worse_by, first):
    # Worse in every block by the same: certain. 0.05 is below keep_share (0.1) of a squared floor, 0.4 is above.
    told = {
        frozenset(): NOISE + 3 * LARGE,
        frozenset([CURVED]): NOISE,
        frozenset([VISCOUS]): NOISE + np.sqrt(worse_by) * SMALL,
    }
    judged = judge(told)
    table = rank(judged, [], [VISCOUS, CURVED], judged.evidence.held([]))
    assert table[0].term == first
    assert all(c.accepted for c in table)


@pytest.mark.parametrize(("by_chance", "enters"), [(True, False), (False, True)])
def test_being_simpler_lets_nothing_in_that_explains_nothing_surely(by_chance, enters, monkeypatch):
    # What could imitate what needs columns; here every candidate could.
    monkeypatch.setattr("hybrid_dynamics.loop.search._rivals", lambda likeness, group, rest, candidates: [OTHER])
    # The same gain, 0.5 a sample: once from what the noise did block by block, once from the motion.
    turn = np.where(np.arange(BLOCKS) % 2, 1.0, -1.0)[:, None]
    change = np.sqrt(0.5) * (turn * NOISE if by_chance else LARGE)
    told = {frozenset(): NOISE + change, frozenset([CURVED]): SMALL, frozenset([OTHER]): NOISE}
    judged = judge(told)
    held = judged.evidence.held([CURVED])
    replaced = _replace(judged, [CURVED], [CURVED, OTHER], held, {frozenset([CURVED])})
    assert (replaced == [OTHER]) is enters


def test_the_uncertainty_of_a_gain_is_that_of_its_noise_not_of_its_size():
    # A gain that differs from block to block only because the motion does is certain; its size does not enter.
    swing = np.linspace(0.0, 3.0, BLOCKS)[:, None] * LARGE
    told = {frozenset(): NOISE + swing, frozenset([OTHER]): NOISE}
    judged = judge(told)
    gain = judged.gain(judged.evidence.held([OTHER]), judged.evidence.held([]))
    assert gain.total == pytest.approx(np.sum(swing**2))
    # All that is left of it is rounding.
    assert 0.0 < gain.error < 1e-8 * gain.total
    # White noise: the error is 2 sqrt(sum d^2) noise floors (d given).
    rng = np.random.default_rng(0)
    errors, gains = [], []
    for _ in range(200):
        noise = rng.normal(size=NOISE.shape)
        one = judge({frozenset(): noise + swing, frozenset([OTHER]): noise})
        told_gain = one.gain(one.evidence.held([OTHER]), one.evidence.held([]))
        errors.append(told_gain.error)
        gains.append(told_gain.total)
    assert np.std(gains) == pytest.approx(2 * np.sqrt(np.sum(swing**2)), rel=0.15)
    # Twenty clusters know a standard deviation to a sixth.
    assert np.median(errors) / np.std(gains) == pytest.approx(1.0, abs=1 / 6)


FAMILIES = ("armature", "link_inertia", "torque_offset")


def start_from_body(robot: Robot, effects: list[Effect]) -> list[Term]:
    """What a search ends with that begins where the inertia of the second link has been named."""
    runs = [
        process(t, robot, LoopSettings().process) for t in excitations(robot, effects, train=3, test=1, duration=8.0)[0]
    ]
    moving = np.ones(robot.n_joints, bool)
    terms = [s for name in FAMILIES for s in family(name).terms(robot, moving, LoopSettings().options)]
    evidence = Evidence.of(Model(robot), runs, terms, LoopSettings())
    floor = noise_floor(evidence)
    evidence = evidence.weigh(floor)
    torque = np.concatenate([run.tau for run in runs]).var(axis=0)
    judged = Judge(evidence, LoopSettings(), floor, torque, np.zeros(robot.n_joints), floor)
    _, steps = search(judged, terms, lambda step: None, [Term("link_inertia", 1)])
    return sorted(steps[-1].terms)


def test_a_body_gives_way_to_two_simple_effects_that_explain_as_much_and_a_true_one_stays():
    robot = Robot.from_urdf(find_description("panda.urdf"), lock=("panda_finger_joint1", "panda_finger_joint2"))
    joint = robot.joint_names[1]
    simple = [Effect("armature", (name,), {"armature": 0.3}) for name in robot.joint_names[:2]]
    assert start_from_body(robot, simple) == [Term("armature", 0), Term("armature", 1)]
    own = np.asarray(robot.model.inertias[robot.joint_ids[1]].toDynamicParameters())
    heavier = own + to_dynamic({p.name: 0.0 for p in BODY_PARAMETERS} | {"mass": 2.0, "com_z": -0.1, "com_x": 0.1,
                               "inertia_xx": 0.01, "inertia_yy": 0.01, "inertia_zz": 0.01})  # fmt: skip
    assert start_from_body(robot, [Effect("link_inertia", (joint,), to_body(heavier))]) == [Term("link_inertia", 1)]


def test_of_ends_that_met_in_the_same_terms_the_first_counts_whatever_rounding_says(monkeypatch):
    told = {frozenset([VISCOUS, OTHER]): NOISE, frozenset([CURVED]): NOISE + LARGE}
    judged = judge(told)
    monkeypatch.setattr(Judge, "at", lambda judge, terms: judge)
    for ends in ([[VISCOUS, OTHER], [OTHER, VISCOUS]], [[OTHER, VISCOUS], [VISCOUS, OTHER]]):
        scores = [1.0 - 1e-12, 1.0]
        asked = [replace(judged, evidence=Rounded(told, score=score)) for score in scores]
        assert choose(list(zip(asked, ends, strict=True)))[1] == ends[0]


@dataclass
class Rounded(Told):
    """What is told, with every held-out prediction scored ``score``."""

    score: float = 0.0

    def held(self, terms: Any, physical: bool = False) -> Held:
        return replace(super().held(terms, physical), score=self.score)


def test_blocks_are_merged_where_they_remember_each_other_and_only_there() -> None:
    """Of autoregressive sums of unit variance the variance of the total is n (1 + r) / (1 - r), of white ones n."""
    rng = np.random.default_rng(2)
    count, draws = 256, 100
    one_run = np.zeros(count, int)
    white = [block_error(rng.normal(size=count), one_run) for _ in range(draws)]
    # An autocorrelation of two standard errors and more is there by chance once in forty.
    assert np.mean([clusters == count for _, clusters in white]) > 0.9
    assert np.median([error for error, _ in white]) == pytest.approx(np.sqrt(count), rel=0.1)
    r = 0.8
    steps = np.sqrt(1 - r**2) * rng.normal(size=(draws, count + 50))
    remembering = [block_error(lfilter([1.0], [1.0, -r], own)[50:], one_run) for own in steps]
    assert all(FEWEST_CLUSTERS <= clusters < count / 2 for _, clusters in remembering)
    truth = np.sqrt(count * (1 + r) / (1 - r))
    assert 0.7 * truth < np.median([error for error, _ in remembering]) < 1.3 * truth
