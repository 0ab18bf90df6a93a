"""Columns of the evidence against what a model predicts: of a load beside friction that follows it, as of one model."""

from __future__ import annotations

import numpy as np
import pytest
from tests.small_arm import arm

from hybrid_dynamics.effects import Effect, Term, family
from hybrid_dynamics.loop import LoopSettings, Model
from hybrid_dynamics.loop.likeness import Likeness
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.trace import Judge
from hybrid_dynamics.simulation.excitation import excitations

ROBOT = arm()
SHOULDER, _ = ROBOT.joint_names
SETTINGS = LoopSettings(sign_widths=(0.0,))
BRAKES = Effect("load_dependent_friction", (SHOULDER,), {"load_coefficient": 0.4})
#: Mass 1.5 kg at 0.1 m along the fore link's axes, with inertia of its own: ten dynamic parameters.
CARRIED = np.array([1.5, 0.0, 0.0, 0.45, 0.15, 0.0, 0.15, 0.0, 0.0, 0.01])


def judged(base: Model) -> tuple[Judge, list[Term]]:
    train, test = excitations(ROBOT, base.effects, train=1, test=1, duration=4.0, rate=200.0)
    judge, terms, _ = gather(base, read_motion(ROBOT, train, test, SETTINGS), SETTINGS)
    return judge, terms


@pytest.fixture(scope="module")
def plain() -> tuple[Judge, list[Term]]:
    return judged(Model(ROBOT))


def added(judge: Judge, model: Model, effect: Effect) -> list[np.ndarray]:
    """(K, n) [N m] by how much more ``model`` predicts with ``effect``, in every run, smoothed as the runs are."""
    out = []
    for run in judge.evidence.runs:
        m = run.motion
        more, less = (each.predict(m.q, m.dq, m.ddq, m.time) for each in (model.adding([effect]), model))
        out.append(run.smooth(more - less))
    return out


@pytest.mark.parametrize("name", ["payload", "link_inertia", "inertial_parameters"])
@pytest.mark.parametrize("brakes", [True, False])
def test_a_body_is_borne_with_the_friction_that_follows_its_load(name: str, brakes: bool) -> None:
    base = Model(ROBOT, (BRAKES,) if brakes else ())
    judge, terms = judged(base)
    (term,) = (t for t in terms if t.effect == name)
    small = 1e-3
    # A body that is like the fore link: mass, moments and inertia about where it is held.
    x = small * np.tile(ROBOT.model.inertias[2].toDynamicParameters(), term.size // 10)
    effect = Effect(
        name,
        () if term.joint is None else (ROBOT.joint_names[term.joint],),
        term.family().parameters_of(x, ROBOT, term),
        dict(term.settings),
    )
    for linear, expected in zip(judge.evidence.linear([term], x), added(judge, base, effect), strict=True):
        np.testing.assert_allclose(linear, expected, atol=0.01 * np.abs(expected).max())
        # The control: without that friction the shoulder feels another torque.
        bare = added(judge, Model(ROBOT), effect)[0]
        assert (np.abs(linear - bare).max() > 0.1 * np.abs(bare[:, 0]).max()) == brakes


def test_columns_that_follow_the_load_are_those_of_the_model_asked(plain: tuple[Judge, list[Term]]) -> None:
    judge, _ = plain
    heavier = Effect("payload", (), family("payload").parameters_of(CARRIED, ROBOT, Term("payload", None)))
    term = BRAKES.term(ROBOT)
    for model, evidence in (
        (Model(ROBOT), judge.evidence),
        (Model(ROBOT, (heavier,)), judge.evidence.at([heavier])),
        (Model(ROBOT), judge.evidence.at([heavier]).at([])),
    ):
        for linear, expected in zip(evidence.linear([term], np.array([0.4])), added(judge, model, BRAKES), strict=True):
            np.testing.assert_allclose(linear, expected, atol=1e-6)
        # The mean square of what one unit makes, over the rows that count.
        rows = np.concatenate([run.mask[:, 0] for run in evidence.runs])
        unit = np.concatenate(added(judge, model, BRAKES))[rows, 0] / 0.4
        assert evidence.unit_square(term) == pytest.approx(np.mean(unit**2), rel=1e-4)


def test_a_likeness_is_the_share_of_a_torque_that_least_squares_gives_others(plain: tuple[Judge, list[Term]]) -> None:
    evidence = plain[0].evidence
    term = Term("nonlinear_viscous_friction", 1)
    x = np.array([0.7, 0.2])
    likeness = Likeness(evidence, term, x)

    def torque(of: Term, at: np.ndarray) -> np.ndarray:
        made = evidence.linear([of], at)
        return np.concatenate([np.where(m, t, 0.0) for m, t in zip(evidence.mask, made, strict=True)])

    own = (torque(term, x) * np.sqrt(evidence.weights)).ravel()
    grease, dry, held = (Term(name, 1) for name in ("viscous_friction", "coulomb_friction", "torque_offset"))
    for others in ((grease,), (dry,), (grease, dry), (grease, dry, held), (Term("viscous_friction", 0),)):
        columns = [(torque(t, np.ones(1)) * np.sqrt(evidence.weights)).ravel() for t in others]
        stacked = np.column_stack(columns)
        hat = stacked @ np.linalg.lstsq(stacked, own, rcond=None)[0]
        assert likeness.share(*others) == pytest.approx(float(hat @ hat) / float(own @ own), abs=1e-6)
    assert likeness.share() == 0.0
    assert likeness.share(term) == pytest.approx(1.0)


def test_scores_of_blocks_are_what_their_rows_still_ask_of_the_coordinates(plain: tuple[Judge, list[Term]]) -> None:
    evidence = plain[0].evidence
    terms = [Term("coulomb_friction", 0), Term("nonlinear_viscous_friction", 0)]
    layout, x = evidence.layout(terms), np.array([0.3, -0.1, 0.2])
    parts, scores = evidence.by_block(layout, x, evidence.weights)
    left = evidence.residuals(terms, x)
    unit = [evidence.linear(terms, column) for column in np.eye(3)]
    for b, (r, (low, high)) in enumerate(zip(evidence.blocks.run, evidence.blocks.rows, strict=True)):
        rows = np.flatnonzero(evidence.mask[r][low:high, 0]) + low
        columns = np.column_stack([made[r][rows, 0] for made in unit])
        np.testing.assert_allclose(scores[b], evidence.weights[0] * columns.T @ left[r][rows, 0], rtol=1e-4, atol=1e-3)
        np.testing.assert_allclose(parts[b], evidence.weights[0] * columns.T @ columns, rtol=1e-4, atol=1e-3)
