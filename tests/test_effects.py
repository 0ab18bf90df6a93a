"""Effects: columns, constraints and the way into dynamics are one and the same equation."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.effect_examples import BODY, EXAMPLES, JOINT
from tests.small_arm import arm

from hybrid_dynamics.effects import Effect, Motion, catalogue, family, predict, with_effects
from hybrid_dynamics.effects.inertia import BODY_PARAMETERS, is_physical, link_parameters, to_body, to_dynamic
from hybrid_dynamics.effects.state import State
from hybrid_dynamics.errors import ConfigError, InputError
from hybrid_dynamics.loop.model import effect_from_json, effect_to_json
from hybrid_dynamics.robots import Robot, find_description
from hybrid_dynamics.study.effect_pages import pages

TIME = np.arange(0.0, 4.0, 5e-3)
FINGERS = ("panda_finger_joint1", "panda_finger_joint2")


@pytest.fixture(scope="module")
def panda() -> Robot:
    return Robot.from_urdf(find_description("panda.urdf"), lock=FINGERS)


@pytest.fixture(scope="module")
def states() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A smooth run (q, dq, ddq) of 4 s at 200 Hz, several reversals of every joint."""
    time = TIME[:, None]
    rng = np.random.default_rng(3)
    q, dq, ddq = np.zeros((3, len(TIME), 7))
    for _ in range(3):
        size, speed, phase = rng.uniform(0.2, 0.6, 7), rng.uniform(1.0, 5.0, 7), rng.uniform(0, 6, 7)
        q += size * np.sin(speed * time + phase)
        dq += size * speed * np.cos(speed * time + phase)
        ddq -= size * speed**2 * np.sin(speed * time + phase)
    return q, dq, ddq


def torque_of_columns(effect: Effect, robot: Robot, states) -> np.ndarray:
    term, kind = effect.term(robot), family(effect.effect)
    x = kind.coordinates_of(effect.parameters, robot, term)
    columns = kind.columns(Motion(robot, TIME, *states), term)
    assert len(x) == term.size == columns.shape[-1]
    out = np.zeros_like(states[0])
    if columns.ndim == 3:
        out += columns @ x
    else:
        out[:, term.joint] += columns @ x
    return out


@pytest.mark.parametrize("name", sorted(EXAMPLES))
def test_columns_times_coordinates_is_the_torque_the_planted_robot_needs(name, panda, states):
    effect = EXAMPLES[name]
    added = predict(panda, [effect], *states, TIME) - panda.inverse_dynamics(*states)  # type: ignore[call-arg]
    assert np.abs(added).max() > 1e-5
    # Small shifts of a centre of mass, a zero or a clock are linear to first order only: about 1e-3 is left here.
    tolerance = 1e-2 if family(effect.effect).nonlinear else 1e-9
    # A delayed torque holds its first value for as long as the delay: nobody knows what was before.
    inside = slice(2, -2)
    expected = torque_of_columns(effect, panda, states)
    np.testing.assert_allclose(added[inside], expected[inside], atol=tolerance * np.abs(added).max())


@pytest.mark.parametrize("name", sorted(n for n in EXAMPLES if not family(EXAMPLES[n].effect).changes_reading))
def test_forward_dynamics_of_the_planted_robot_undoes_the_effect(name, panda, states):
    q, dq, ddq = states
    robot, torque = with_effects(panda, [EXAMPLES[name]], along=True)
    rigid = robot.inverse_dynamics(q, dq, ddq)
    tau = rigid + torque(q, dq, rigid, ddq, TIME)
    np.testing.assert_allclose(robot.forward_dynamics(q, dq, tau - torque(q, dq, rigid, ddq, TIME)), ddq, atol=1e-5)
    # Wrong-cause control: without the effect the motion is another one.
    assert np.abs(panda.forward_dynamics(q, dq, tau) - ddq).max() > 1e-4


REFINED = [
    (name, place)
    for name, effect in sorted(EXAMPLES.items())
    for place in range(len(family(effect.effect).nonlinear_of(effect.settings)))
]


@pytest.mark.parametrize(("name", "place"), REFINED)
def test_nonlinear_parameters_have_columns_and_standard_errors_of_their_own(name, place, panda, states):
    effect = EXAMPLES[name]
    kind, term = family(effect.effect), effect.term(panda)
    x = kind.coordinates_of(effect.parameters, panda, term)
    refined = kind.nonlinear_of(effect.settings)[place]
    assert refined.name not in effect.settings
    value = term.options[refined.name]
    assert refined.low < value < refined.high
    motion = Motion(panda, TIME, *states)
    slope = kind.setting_columns(motion, term, x)[:, place]
    step = 1e-3 * value
    up, down = (kind.columns(motion, term.refined(**{refined.name: value + s * step})) @ x for s in (1, -1))
    np.testing.assert_allclose((up - down) / (2 * step), slope, atol=1e-3 * np.abs(slope).max())
    assert np.abs(slope).max() > 0
    jacobian = kind.setting_jacobian(x, panda, term)
    moved = kind.parameters_of(x, panda, term.refined(**{refined.name: value * 1.001}))
    change = np.array([moved[key] - effect.parameters[key] for key in kind.published(effect.settings)])
    np.testing.assert_allclose(jacobian[:, place] * 0.001 * value, change, rtol=2e-3, atol=1e-9)


@pytest.mark.parametrize("name", sorted(EXAMPLES))
def test_parameters_survive_the_way_to_coordinates_and_back(name, panda):
    effect = EXAMPLES[name]
    term, kind = effect.term(panda), family(effect.effect)
    x = kind.coordinates_of(effect.parameters, panda, term)
    back = kind.parameters_of(x, panda, term)
    assert back == pytest.approx(dict(effect.parameters), abs=1e-12)
    jacobian = kind.jacobian(x, panda, term)
    step = 1e-5 * np.random.default_rng(1).normal(size=len(x))
    moved = kind.parameters_of(x + step, panda, term)
    change = np.array([moved[key] - back[key] for key in kind.published(effect.settings)])
    np.testing.assert_allclose(jacobian @ step, change, atol=1e-8)


def test_effects_change_a_copy_and_add_up(panda, states):
    q, dq, ddq = states
    before = panda.inverse_dynamics(q, dq, ddq)
    robot, torque = with_effects(panda, [EXAMPLES["viscous_friction"], EXAMPLES["armature"], EXAMPLES["torque_offset"]])
    np.testing.assert_array_equal(panda.inverse_dynamics(q, dq, ddq), before)
    added = robot.inverse_dynamics(q, dq, ddq) + torque(q, dq) - before
    np.testing.assert_allclose(added[:, 2], 2.0 * dq[:, 2] + 0.4 * ddq[:, 2] - 0.7, atol=1e-9)
    np.testing.assert_allclose(np.delete(added, 2, axis=1), 0, atol=1e-12)


def test_tilt_turns_gravity_into_the_base_frame(panda):
    tilted, _ = with_effects(panda, [Effect("gravity_tilt", (), {"roll": 0.1, "pitch": 0.0})])
    # R_base = Rx(roll): seen from the base, gravity leans towards -y by sin(roll).
    np.testing.assert_allclose(tilted.model.gravity.linear, 9.81 * np.array([0, -np.sin(0.1), -np.cos(0.1)]), atol=1e-9)


@settings(max_examples=60, deadline=None)
@given(
    st.floats(0.05, 20),
    st.lists(st.floats(-0.5, 0.5), min_size=3, max_size=3),
    st.lists(st.floats(0.01, 0.5), min_size=3, max_size=3),
)
def test_solid_blocks_are_physical_and_negative_masses_are_not(mass, com, edges):
    a = np.array(edges) ** 2
    body = dict.fromkeys([p.name for p in BODY_PARAMETERS], 0.0)
    body |= {"mass": mass, "com_x": com[0], "com_y": com[1], "com_z": com[2]}
    body |= {f"inertia_{axis * 2}": mass * (a.sum() - a[k]) / 12 for k, axis in enumerate("xyz")}
    dynamic = to_dynamic(body)
    assert is_physical(dynamic)
    assert not is_physical(-dynamic)
    assert to_body(dynamic) == pytest.approx(body, abs=1e-9, rel=1e-6)


@pytest.mark.parametrize(("roll", "pitch"), [(3.1, 0.0), (0.0, np.pi / 2 - 1e-3), (-2.0, -1.2), (0.02, 0.01)])
def test_a_tilt_by_any_angle_is_found_exactly_and_two_tilts_are_one(panda, states, roll, pitch):
    q, dq, ddq = states
    first = Effect("gravity_tilt", (), {"roll": 0.3, "pitch": -0.2})
    started, _ = with_effects(panda, [first])
    truth = Effect("gravity_tilt", (), {"roll": roll, "pitch": pitch})
    true, _ = with_effects(panda, [truth])
    both, _ = with_effects(started, [truth])
    np.testing.assert_allclose(both.model.gravity.linear, true.model.gravity.linear, atol=1e-12)
    motion = Motion(started, TIME, q, dq, ddq)
    kind, term = family("gravity_tilt"), truth.term(started)
    columns = kind.columns(motion, term).reshape(-1, 3)
    missing = (true.inverse_dynamics(q, dq, ddq) - started.inverse_dynamics(q, dq, ddq)).ravel()
    x = np.linalg.lstsq(columns, missing, rcond=None)[0]
    assert kind.parameters_of(x, started, term) == pytest.approx({"roll": roll, "pitch": pitch}, abs=1e-6)
    # The truth lies on the surface that keeps gravity's size; more of the same direction does not.
    normal, value = kind.surface(x, started, term)
    assert normal @ x == pytest.approx(value, abs=1e-6)
    assert normal @ (x + 0.1 * normal) - value == pytest.approx(0.1, abs=1e-6)


def test_cheaper_causes_inside_a_link_keep_what_they_do_not_change(panda):
    before = to_body(link_parameters(panda, 2))
    heavier, _ = with_effects(panda, [EXAMPLES["link_mass"]])
    after = to_body(link_parameters(heavier, 2))
    assert after["mass"] == pytest.approx(4.1)
    for name in ("com_x", "com_y", "com_z"):
        assert after[name] == pytest.approx(before[name])
    ratio = after["inertia_xx"] / before["inertia_xx"]  # radii of gyration stay: inertia grows as the mass
    assert ratio == pytest.approx(after["mass"] / before["mass"])
    shifted, _ = with_effects(panda, [EXAMPLES["link_com"]])
    moved = to_body(link_parameters(shifted, 2))
    for name in ("mass", "inertia_xx", "inertia_yy", "inertia_zz", "inertia_xy"):
        assert moved[name] == pytest.approx(before[name], abs=1e-12)
    assert moved["com_y"] == pytest.approx(0.0393)
    assert is_physical(link_parameters(shifted, 2))


def test_all_links_together_have_a_body_each_and_a_prior_of_their_own_size(panda):
    kind = family("inertial_parameters")
    moving = np.ones(7, bool)
    (term,) = kind.terms(panda, moving, {})
    assert term.size == 70
    bodies = kind.inertial_bodies(panda, term)
    assert [start for start, _ in bodies] == list(range(0, 70, 10))
    np.testing.assert_allclose(bodies[4][1], link_parameters(panda, 4))
    scale = kind.prior_scale(panda, term).reshape(7, 10)
    assert np.all(scale > 0)
    masses = np.array([link_parameters(panda, k)[0] for k in range(7)])
    np.testing.assert_allclose(scale[:, 0], np.maximum(masses, 0.5) / 2)


@pytest.mark.parametrize("name", sorted(EXAMPLES))
def test_json_gives_the_same_effect_back(name):
    effect = EXAMPLES[name]
    errors = {key: 0.01 * (k + 1) for k, key in enumerate(effect.parameters)}
    effect = Effect(effect.effect, effect.joints, effect.parameters, effect.settings, errors)
    entry = effect_to_json(effect)
    assert effect_from_json(json.loads(json.dumps(entry))) == effect
    own = list(effect.joints) or [None]  # type: ignore[list-item]
    names = [p["name"] for p in entry["parameters"]]
    if name == "inertial_parameters":
        assert {p["joint"] for p in entry["parameters"]} == {"panda_joint2", "panda_joint7"}
        assert names[:2] == ["mass", "com_x"]
    else:
        assert {p["joint"] for p in entry["parameters"]} == set(own)


def test_catalogue_names_what_is_unknown_or_incomplete(panda):
    assert {e.effect for e in EXAMPLES.values()} == set(catalogue(everything=True))
    with pytest.raises(ConfigError, match=r"effect 'stiction' is unknown; known are .*viscous_friction"):
        family("stiction")
    with pytest.raises(InputError, match=r"viscous_friction: parameters are damping; expected viscous_coefficient"):
        Effect("viscous_friction", JOINT, {"damping": 1.0})
    with pytest.raises(InputError, match="1 joints are named; expected 0"):
        Effect("payload", JOINT, BODY)
    with pytest.raises(InputError, match=r"has no joint 'elbow'; its joints are panda_joint1"):
        with_effects(panda, [Effect("torque_offset", ("elbow",), {"offset": 1.0})])


def test_pages_of_the_catalogue_say_what_the_code_does():
    folder = Path(__file__).parents[1] / "docs" / "effects"
    written = {path.name: path.read_text("utf-8") for path in folder.glob("*.md")}
    assert written == pages(), "run: make pages"
    for name in catalogue(everything=True):
        kind = family(name)
        assert kind.equation
        assert kind.shown_by
        assert all(other in catalogue(everything=True) for e in kind.equivalent_to for other in e.effects)


def test_the_error_of_a_parameter_is_told_in_shares_of_the_largest_of_its_unit() -> None:
    kind = family("stribeck_friction")
    true = Effect(kind.name, ("j",), {"coulomb_torque": 2.0, "static_torque": 4.0, "stribeck_velocity": 0.1})
    found = Effect(kind.name, ("j",), {"coulomb_torque": 2.2, "static_torque": 3.0, "stribeck_velocity": 0.12})
    error = kind.parameter_error(true, found, arm())
    assert error == pytest.approx({"coulomb_torque": 0.05, "static_torque": 0.25, "stribeck_velocity": 0.2})
    nothing = Effect("torque_offset", ("j",), {"offset": 0.0})
    assert family("torque_offset").parameter_error(nothing, nothing, arm()) == {}


@pytest.mark.parametrize("at", [-2.0, 0.0, 2.0])
@pytest.mark.parametrize(("travel", "springs"), [(0.1, 0), (1.5, 1)])
def test_a_piecewise_spring_is_proposed_by_how_far_a_joint_travels_not_by_where(
    at: float, travel: float, springs: int
) -> None:
    """Over a short travel it is a constant torque, wherever the joint is."""
    q = np.column_stack([np.zeros(200), at + travel * np.linspace(-0.5, 0.5, 200)])
    motion = Motion(arm(), 0.01 * np.arange(200), q, 0 * q, 0 * q)
    proposed = family("joint_spring").propose(arm().joint_names, [motion], [0 * q], np.array([False, True]))
    assert len(proposed) == springs
    for term in proposed:
        assert np.ptp(term.options["knots"]) == pytest.approx(travel, abs=1e-3)


@pytest.mark.parametrize(("began", "since"), [(None, 0.0), (97.0, 3.0)])
def test_a_law_sees_the_time_since_its_run_began(began: float | None, since: float) -> None:
    time = 100.0 + 0.01 * np.arange(50)
    q = np.zeros((50, 2))
    state = Motion(arm(), time, q, q, q, began=began).state(0)
    np.testing.assert_allclose(state.time, since + 0.01 * np.arange(50), atol=1e-9)


@pytest.mark.parametrize("asked", ["own_ddq", "partner_ddq", "own_load"])
def test_what_a_law_asks_for_is_its_joints_or_refused_where_it_is_not_given(asked: str) -> None:
    values = np.array([[1.0], [2.0]])
    given = State(0 * values, 0 * values, values, 10 * values, joint=1, partner=0)
    assert getattr(given, asked) == {"own_ddq": 2.0, "partner_ddq": 1.0, "own_load": 20.0}[asked]
    with pytest.raises(InputError, match="give"):
        getattr(State(values, values, joint=1, partner=0), asked)
