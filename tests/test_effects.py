"""Effects: columns, constraints and the way into dynamics are one and the same equation."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hybrid_dynamics.effects import Effect, Motion, catalogue, family, plant
from hybrid_dynamics.effects.inertia import BODY_PARAMETERS, is_physical, to_body, to_dynamic
from hybrid_dynamics.errors import ConfigError, InputError
from hybrid_dynamics.robots import Robot, find_description

FINGERS = ("panda_finger_joint1", "panda_finger_joint2")
BODY = {
    "mass": 1.4, "com_x": 0.03, "com_y": -0.02, "com_z": 0.1, "inertia_xx": 0.01, "inertia_xy": 0.001,
    "inertia_yy": 0.012, "inertia_xz": 0.0, "inertia_yz": -0.002, "inertia_zz": 0.008,
}  # fmt: skip
JOINT = ("panda_joint3",)
EXAMPLES = {
    "viscous_friction": Effect("viscous_friction", JOINT, {"viscous_coefficient": 2.0}),
    "coulomb_friction": Effect("coulomb_friction", JOINT, {"coulomb_torque": 1.5}, {"sign_width": 0.03}),
    "torque_offset": Effect("torque_offset", JOINT, {"offset": -0.7}),
    "armature": Effect("armature", JOINT, {"armature": 0.4}),
    "payload": Effect("payload", (), BODY),
    "link_inertia": Effect("link_inertia", JOINT, BODY),
    "load_dependent_friction": Effect("load_dependent_friction", JOINT, {"load_coefficient": 0.05}),
    "nonlinear_viscous_friction": Effect(
        "nonlinear_viscous_friction", JOINT, {"quadratic_coefficient": -0.3, "cubic_coefficient": 0.2}
    ),
    "gravity_tilt": Effect("gravity_tilt", (), {"roll": 1e-5, "pitch": -2e-5}),
}


@pytest.fixture(scope="module")
def panda() -> Robot:
    return Robot.from_urdf(find_description("panda.urdf"), lock=FINGERS)


@pytest.fixture(scope="module")
def states() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return tuple(np.random.default_rng(3).normal(size=(3, 40, 7)))  # type: ignore[return-value]


@pytest.mark.parametrize("name", sorted(EXAMPLES))
def test_columns_times_coordinates_is_the_torque_the_planted_robot_needs(name, panda, states):
    q, dq, ddq = states
    effect = EXAMPLES[name]
    slot, kind = effect.slot(panda), family(name)
    x = kind.coordinates_of(effect.parameters, panda, slot)
    columns = kind.columns(Motion(panda, np.arange(40.0), q, dq, ddq), slot)
    expected = np.zeros_like(q)
    if columns.ndim == 3:
        expected += columns @ x
    else:
        expected[:, slot.joint] += columns @ x
    robot, torque = plant(panda, [effect])
    rigid = robot.inverse_dynamics(q, dq, ddq)
    added = rigid + torque(q, dq, rigid) - panda.inverse_dynamics(q, dq, ddq)
    assert np.abs(added).max() > 1e-5
    # A tilt is linear only for small angles: its second-order part is 1e-5 of the first here.
    tolerance = 1e-4 if kind.nonlinear else 1e-9
    np.testing.assert_allclose(added, expected, atol=tolerance * np.abs(added).max())


@pytest.mark.parametrize("name", sorted(EXAMPLES))
def test_forward_dynamics_of_the_planted_robot_undoes_the_effect(name, panda, states):
    q, dq, ddq = states
    robot, torque = plant(panda, [EXAMPLES[name]])
    rigid = robot.inverse_dynamics(q, dq, ddq)
    tau = rigid + torque(q, dq, rigid)
    np.testing.assert_allclose(robot.forward_dynamics(q, dq, tau - torque(q, dq, rigid)), ddq, atol=1e-6)
    # Wrong-cause control: without the effect the motion is another one.
    assert np.abs(panda.forward_dynamics(q, dq, tau) - ddq).max() > 1e-5


@pytest.mark.parametrize("name", sorted(EXAMPLES))
def test_parameters_survive_the_way_to_coordinates_and_back(name, panda):
    effect = EXAMPLES[name]
    slot, kind = effect.slot(panda), family(name)
    x = kind.coordinates_of(effect.parameters, panda, slot)
    back = kind.parameters_of(x, panda, slot)
    assert back == pytest.approx(dict(effect.parameters), abs=1e-12)
    jacobian = kind.jacobian(x, panda, slot)
    step = 1e-5 * np.random.default_rng(1).normal(size=len(x))
    moved = kind.parameters_of(x + step, panda, slot)
    change = np.array([moved[p.name] - back[p.name] for p in kind.parameters])
    np.testing.assert_allclose(jacobian @ step, change, atol=1e-8)


def test_effects_change_a_copy_and_add_up(panda, states):
    q, dq, ddq = states
    before = panda.inverse_dynamics(q, dq, ddq)
    robot, torque = plant(panda, [EXAMPLES["viscous_friction"], EXAMPLES["armature"], EXAMPLES["torque_offset"]])
    np.testing.assert_array_equal(panda.inverse_dynamics(q, dq, ddq), before)
    added = robot.inverse_dynamics(q, dq, ddq) + torque(q, dq) - before
    np.testing.assert_allclose(added[:, 2], 2.0 * dq[:, 2] + 0.4 * ddq[:, 2] - 0.7, atol=1e-9)
    np.testing.assert_allclose(np.delete(added, 2, axis=1), 0, atol=1e-12)


def test_tilt_turns_gravity_into_the_base_frame(panda):
    tilted, _ = plant(panda, [Effect("gravity_tilt", (), {"roll": 0.1, "pitch": 0.0})])
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


def test_catalogue_names_what_is_unknown_or_incomplete(panda):
    assert set(EXAMPLES) <= set(catalogue())
    with pytest.raises(ConfigError, match=r"effect 'stiction' is unknown; known are .*viscous_friction"):
        family("stiction")
    with pytest.raises(InputError, match=r"viscous_friction: parameters are damping; expected viscous_coefficient"):
        Effect("viscous_friction", JOINT, {"damping": 1.0})
    with pytest.raises(InputError, match="1 joints are named; expected 0"):
        Effect("payload", JOINT, BODY)
    with pytest.raises(InputError, match=r"has no joint 'elbow'; its joints are panda_joint1"):
        plant(panda, [Effect("torque_offset", ("elbow",), {"offset": 1.0})])
