"""Dry friction of a URDF that the torque does not have is no knowledge to start from; that which it has is."""

import pytest
from tests.small_arm import arm, noisy_log

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.loop import LoopSettings, ProcessSettings, close_loop, process
from hybrid_dynamics.loop.described import with_described
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.placeholders import harmed, times_in_torque, with_unmatched, without_placeholders
from hybrid_dynamics.simulation.excitation import excitations

SETTINGS = LoopSettings(effects=("viscous_friction", "coulomb_friction", "torque_offset"))
NOISE = 0.02


def dry(joint: str, torque: float, **settings: float) -> Effect:
    return Effect("coulomb_friction", (joint,), {"coulomb_torque": torque}, settings)


def damping(joint: str, coefficient: float) -> Effect:
    return Effect("viscous_friction", (joint,), {"viscous_coefficient": coefficient})


def looked_at(hidden: list[Effect], described: list[Effect]):
    train = [noisy_log(hidden, seed, "train", NOISE) for seed in (1, 2)]
    test = [noisy_log(hidden, 3, "test", NOISE)]
    return with_described(close_loop(arm(), train, test, SETTINGS, described=described), described)


@pytest.fixture(scope="module")
def runs():
    train, _ = excitations(arm(), [dry("shoulder", 1.5)], train=2, test=0, duration=6.0, rate=200.0)
    return [process(log, arm(), ProcessSettings()) for log in train]


@pytest.mark.parametrize(
    ("torque", "kept"), [(0.1, False), (0.7, False), (0.8, True), (1.5, True), (2.9, True), (3.1, False), (20.0, False)]
)
def test_dry_friction_is_kept_from_half_to_twice_what_the_torque_has(runs, torque, kept):
    given = [dry("shoulder", torque)]
    start = Model(arm(), tuple(given))
    assert times_in_torque(arm(), given, runs) == pytest.approx([1.5 / torque], rel=0.02)
    assert (without_placeholders(start, given, runs) == start) is kept
    # Of a sign that is the torque's own, c for t leaves (c - t)^2: more than t^2 from 2 t on.
    assert (harmed(arm(), given, runs) == {}) is (torque < 3.0)


@pytest.mark.parametrize("coefficient", [0.0, 0.5, 30.0])
def test_a_damping_stays_and_says_nothing_of_dry_friction(runs, coefficient):
    given = [damping("shoulder", coefficient), dry("shoulder", 1.5), dry("elbow", 4.0)]
    out = without_placeholders(Model(arm(), tuple(given)), given, runs)
    # A damping harms the joint; a change of it is a damping, whatever it is.
    assert out.effects == (given[0], given[1])
    assert without_placeholders(out, [], runs) == out


def test_of_dry_friction_of_a_joint_that_stands_nothing_is_said():
    train, _ = excitations(arm(), [], train=1, test=0, duration=6.0, rate=200.0)
    still = [log.with_signals(q=log["q"] * [1.0, 0.0]) for log in train]
    runs = [process(log, arm(), ProcessSettings()) for log in still]
    assert times_in_torque(arm(), [dry("elbow", 4.0)], runs) == [1.0]


def test_what_was_left_out_comes_back_where_nothing_is_found_in_its_place():
    given = Model(arm(), (damping("shoulder", 30.0), dry("shoulder", 5.0), dry("elbow", 5.0)))
    base = Model(arm(), given.effects[:1])
    assert with_unmatched(given, base, []).effects == given.effects
    asymmetric = Term("asymmetric_coulomb_friction", 1)
    assert with_unmatched(given, base, [asymmetric]).effects == given.effects[:2]
    # A damping and friction of another joint stand in the place of nothing.
    assert with_unmatched(given, base, [Term("viscous_friction", 1), asymmetric]).effects == given.effects[:2]
    assert with_unmatched(given, base, [Term("coulomb_friction", 0), asymmetric]) == base


def test_friction_that_turns_over_slowly_is_found_in_full_beside_a_placeholder():
    hidden = [dry("elbow", 1.5, sign_width=0.08)]
    bare = looked_at(hidden, [])
    found = looked_at(hidden, [dry("elbow", 6.0)])
    assert found.model.effects == bare.model.effects
    (entry,) = found.diagnosis.effects
    assert entry.effect.parameters["coulomb_torque"] == pytest.approx(1.5, rel=0.02)
    assert entry.in_all["coulomb_torque"]["urdf"] == 6.0
    first = found.diagnosis.notes[0]
    assert first.startswith("the URDF's <dynamics> makes the training error larger: elbow ")
    assert any("friction elbow 6 N m is left out of the starting model" in n for n in found.diagnosis.notes)
    # Before is the model that the URDF describes; 6 N m for 1.5 leave about three times what no friction leaves.
    before, without = (r.diagnosis.error_moving["test"].before.rmse[1] for r in (found, bare))
    assert 2.5 < before / without < 3.5
    after = found.diagnosis.error_moving["test"].after.rmse[1]
    assert after < 2 * NOISE


def test_a_urdfs_friction_where_there_is_none_is_told():
    found = looked_at([damping("shoulder", 3.0)], [dry("elbow", 6.0)])
    totals = {(e.effect.effect, *e.effect.joints): e.effect.parameters for e in found.diagnosis.effects}
    assert totals[("coulomb_friction", "elbow")]["coulomb_torque"] == pytest.approx(0.0, abs=0.02)
    assert totals[("viscous_friction", "shoulder")]["viscous_coefficient"] == pytest.approx(3.0, rel=0.02)
    assert found.diagnosis.verdict == "explained"


def test_friction_that_the_urdf_has_right_is_neither_left_out_nor_found():
    found = looked_at([dry("elbow", 1.5)], [dry("elbow", 1.5)])
    assert found.diagnosis.verdict == "nothing_missing"
    assert found.diagnosis.notes[0].startswith(
        "the URDF's <dynamics> belongs to the starting model (friction elbow 1.5"
    )
