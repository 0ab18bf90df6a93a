"""What runs leave open is said, however sure the fit's own scatter is of it."""

import numpy as np
import pinocchio as pin
import pytest
from tests.two_links import two_links

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.effects.inertia import to_body
from hybrid_dynamics.loop import LoopSettings, Model
from hybrid_dynamics.loop.augment import model_of
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.identifiability import undetermined
from hybrid_dynamics.loop.process import ProcessSettings, process
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

ROBOT = two_links()
COULOMB = Effect("coulomb_friction", ("elbow",), {"coulomb_torque": 2.0})
OFFSET = Effect("torque_offset", ("elbow",), {"offset": 0.5})
VISCOUS = Effect("viscous_friction", ("elbow",), {"viscous_coefficient": 1.0})


TIME = np.arange(0.0, 8.0, 0.005)


def moved(q: Array, *effects: Effect, noise: float = 0.0) -> tuple[Evidence, list[Term]]:
    """A run along ``q`` (T, 2) [rad] of the arm with ``effects``, white ``noise`` [N m] on its torque; their terms."""
    dq = np.gradient(q, TIME, axis=0)
    tau = Model(ROBOT, effects).predict(q, dq, np.gradient(dq, TIME, axis=0), TIME)
    tau += np.random.default_rng(0).normal(0.0, noise, tau.shape)
    run = process(Trajectory("run", "train", TIME, {"q": q, "tau": tau}), ROBOT, ProcessSettings())
    terms = [e.term(ROBOT) for e in effects]
    return Evidence.of(Model(ROBOT), [run], terms, LoopSettings()), terms


def turning(back: float, *effects: Effect) -> tuple[Evidence, list[Term]]:
    """A run of the elbow with ``effects`` that turns on at .2 rad/s, give or take ``back`` rad/s."""
    elbow = 0.2 * TIME - back / 3.0 * np.cos(3.0 * TIME)
    return moved(np.column_stack([np.sin(TIME), elbow - elbow.mean()]), *effects)


def open_of(back: float, *effects: Effect) -> list[list[str]]:
    """What that run leaves open of each effect."""
    evidence, terms = turning(back, *effects)
    return [undetermined(evidence, terms, term) for term in terms]


def test_on_a_joint_that_turns_one_way_friction_and_offset_are_one_constant() -> None:
    assert open_of(0.1, COULOMB, OFFSET, VISCOUS) == [["coulomb_torque"], ["offset"], []]


@pytest.mark.parametrize("effects", [(COULOMB, VISCOUS), (OFFSET, VISCOUS)])
def test_one_of_them_alone_is_known(effects: tuple[Effect, ...]) -> None:
    assert open_of(0.1, *effects) == [[], []]


def test_a_joint_that_turns_back_tells_them_apart() -> None:
    # Control: a tenth of the time backwards.
    assert open_of(0.25, COULOMB, OFFSET, VISCOUS) == [[], [], []]


def upper_link(mass: float) -> Effect:
    """What is found of the upper link, whose weight times lever every run shows, and whose mass alone none does."""
    body = pin.Inertia(mass, np.array([3.3 / 5 / mass, 0.0, 0.0]), np.diag([0.02, 0.09, 0.09]))
    planted = Effect("link_inertia", ("shoulder",), to_body(body.toDynamicParameters()))
    q = np.column_stack([np.sin(TIME) + 0.5 * np.sin(2.7 * TIME), np.cos(1.7 * TIME)])
    evidence, (term,) = moved(q, planted, noise=0.02)
    (found,) = model_of(evidence, [term]).effects
    assert "mass" in undetermined(evidence, [term], term)
    return found


def test_a_mass_that_no_motion_shows_is_off_by_no_more_than_its_standard_error_allows() -> None:
    # The URDF says 3 kg; the prior's spread is 5 kg.
    masses = np.array([1.5, 3.0, 5.0, 8.0])
    found = [upper_link(mass) for mass in masses]
    off = np.array([(f.parameters["mass"] - m) / f.std_errors["mass"] for f, m in zip(found, masses, strict=True)])
    assert (np.abs(off) < 2.0).all()
    # It is not told to be known: all four came out alike.
    assert np.ptp([f.parameters["mass"] for f in found]) < 1.0
    # Control: what the motion shows is known closely, the same first moment in all four.
    lever = np.array([f.parameters["mass"] * f.parameters["com_x"] for f in found])
    assert lever == pytest.approx(3.3 / 5, rel=0.02)
    assert max(f.std_errors["com_z"] * f.parameters["mass"] for f in found) < 0.05


def test_a_constant_that_two_effects_share_is_known_of_neither() -> None:
    coulomb, offset, viscous = model_of(*turning(0.1, COULOMB, OFFSET, VISCOUS)).effects
    assert abs(coulomb.parameters["coulomb_torque"] - 2.0) < 2 * coulomb.std_errors["coulomb_torque"]
    assert abs(offset.parameters["offset"] - 0.5) < 2 * offset.std_errors["offset"]
    # Control: what the run shows, and a run that tells the two apart.
    assert viscous.std_errors["viscous_coefficient"] < 0.1
    coulomb, offset, _ = model_of(*turning(0.25, COULOMB, OFFSET, VISCOUS)).effects
    assert max(coulomb.std_errors["coulomb_torque"], offset.std_errors["offset"]) < 0.1
