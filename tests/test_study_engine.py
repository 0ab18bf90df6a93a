"""MuJoCo and the catalogue agree on what they share: two engines, two sets of equations, one torque."""

import numpy as np
import pytest

from hybrid_dynamics.effects import Effect, predict
from hybrid_dynamics.effects.inertia import link_parameters, to_body, to_dynamic
from hybrid_dynamics.errors import ConfigError, InputError
from hybrid_dynamics.robots import find_description
from hybrid_dynamics.study.blind_logs import NOISES, LogSettings, coloured
from hybrid_dynamics.study.engine import Engine, Hidden, read_text, robot_of
from hybrid_dynamics.study.mujoco_log import make_mujoco_log
from hybrid_dynamics.study.outside import LAWS, Course

TEXT = read_text(find_description("ur_description/urdf/ur5_joint_limited_robot.urdf"))
ROBOT = robot_of(TEXT)
NAMES = ROBOT.joint_names
BLOCK = {"mass": 1.2, "x": 0.03, "y": -0.02, "z": 0.1, "edge_x": 0.1, "edge_y": 0.05, "edge_z": 0.2}
_SQUARES = np.array([0.1, 0.05, 0.2]) ** 2
BODY = {
    "mass": 1.2, "com_x": 0.03, "com_y": -0.02, "com_z": 0.1, "inertia_xy": 0.0, "inertia_xz": 0.0, "inertia_yz": 0.0,
    **{f"inertia_{a * 2}": float(1.2 * (_SQUARES.sum() - _SQUARES[k]) / 12) for k, a in enumerate("xyz")},
}  # fmt: skip


def _joint(name: str, joint: int, settings=None, **parameters: float) -> Effect:
    return Effect(name, (NAMES[joint],), parameters, settings or {})


def _cases() -> dict[str, tuple[Hidden, list[Effect]]]:
    own = link_parameters(ROBOT, 2)
    com = own[1:4] / own[0] + [0.01, 0.02, 0.0]
    gear = {"viscous_coefficient": 0.6, "coulomb_torque": 1.9, "armature": 0.05}
    pair = {"from_joint": NAMES[5], "rows": "both", "sign_of": "sum"}
    return {
        "damping": (
            Hidden("damping", 1, {"d0": 1.0, "d1": 0.5, "d2": 0.2}),
            [
                _joint("viscous_friction", 1, viscous_coefficient=1.0),
                _joint("nonlinear_viscous_friction", 1, quadratic_coefficient=0.5, cubic_coefficient=0.2),
            ],
        ),
        "frictionloss": (Hidden("frictionloss", 2, {"torque": 2.0}), [_joint("coulomb_friction", 2, coulomb_torque=2)]),
        "armature": (Hidden("armature", 2, {"armature": 0.3}), [_joint("armature", 2, armature=0.3)]),
        "stiffness": (
            Hidden("stiffness", 2, {"stiffness": 12.0, "rest": 0.2}),
            [_joint("joint_spring", 2, {"shape": "linear"}, stiffness=12.0, rest_position=0.2)],
        ),
        "mass": (Hidden("mass", 2, {"ratio": 1.3}), [_joint("link_mass", 2, mass=1.3 * own[0])]),
        "com": (
            Hidden("com", 2, {"x": 0.01, "y": 0.02}),
            [_joint("link_com", 2, com_x=com[0], com_y=com[1], com_z=com[2])],
        ),
        "payload": (Hidden("block", 5, BLOCK), [Effect("payload", (), BODY)]),
        "link": (Hidden("block", 2, BLOCK), [_joint("link_inertia", 2, **to_body(own + to_dynamic(BODY)))]),
        "tilt": (
            Hidden("tilt", None, {"roll": 2.0, "pitch": -0.7}),
            [Effect("gravity_tilt", (), {"roll": 2.0, "pitch": -0.7})],
        ),
        "tendon": (
            Hidden("tendon", 4, {"partner": 5, "damping": 0.6, "friction": 1.9, "armature": 0.05}),
            [
                Effect("joint_coupling", (NAMES[4],), gear, pair),
                *(_joint("viscous_friction", k, viscous_coefficient=0.6) for k in (4, 5)),
                *(_joint("armature", k, armature=0.05) for k in (4, 5)),
            ],
        ),
    }


@pytest.mark.parametrize("name", sorted(_cases()))
def test_both_engines_give_the_same_torque(name):
    hidden, effects = _cases()[name]
    states = np.random.default_rng(0).normal(size=(3, 50, 6))
    theirs, plain = Engine(TEXT, [hidden]).torque(*states), Engine(TEXT).torque(*states)
    np.testing.assert_allclose(plain, ROBOT.inverse_dynamics(*states), atol=1e-9)
    assert np.abs(theirs - plain).max() > 0.1
    np.testing.assert_allclose(theirs, predict(ROBOT, effects, *states), atol=1e-9)


LAW_CASES = [
    ("offset", {"torque": 2.0}, "torque_offset", {"offset": 2.0}, {}),
    (
        "asymmetric",
        {"positive": 2.0, "negative": 1.0},
        "asymmetric_coulomb_friction",
        {"coulomb_torque_positive": 2.0, "coulomb_torque_negative": 1.0},
        {},
    ),
    (
        "stribeck",
        {"coulomb": 1.0, "static": 2.0, "velocity": 0.2},
        "stribeck_friction",
        {"coulomb_torque": 1.0, "static_torque": 2.0, "stribeck_velocity": 0.2},
        {},
    ),
    ("load_friction", {"coefficient": 0.1}, "load_dependent_friction", {"load_coefficient": 0.1}, {}),
    (
        "dahl",
        {"stiffness": 60.0, "coulomb": 3.0},
        "hysteresis_friction",
        {"presliding_stiffness": 60.0, "coulomb_torque": 3.0},
        {},
    ),
    ("tanh_coulomb", {"torque": 3.0, "width": 0.1}, "coulomb_friction", {"coulomb_torque": 3.0}, {"sign_width": 0.1}),
    (
        "ripple",
        {"amplitude": 1.0, "harmonic": 9.0, "phase": 0.4},
        "torque_ripple",
        {"amplitude": 1.0, "harmonic": 9.0, "phase": 0.4},
        {},
    ),
]


@pytest.mark.parametrize(("kind", "values", "effect", "parameters", "setting"), LAW_CASES)
def test_laws_written_twice_agree_where_they_are_the_same_law(kind, values, effect, parameters, setting):
    time = np.arange(0, 8, 1e-3)
    q = 0.8 * np.sin(1.1 * time)[:, None] * np.linspace(1, 2, 6) + 0.3 * np.sin(3.7 * time)[:, None]
    dq = np.gradient(q, 1e-3, axis=0)
    ddq = np.gradient(dq, 1e-3, axis=0)
    load = ROBOT.inverse_dynamics(q, dq, ddq)
    theirs = LAWS[kind](Course(time, q, dq, ddq, load), 2, values)
    ours = predict(ROBOT, [_joint(effect, 2, setting, **parameters)], q, dq, ddq, time)[:, 2] - load[:, 2]
    # Dahl's memory: one integrates over time, the other over the way; half a sample of displacement is between them.
    tolerance = 0.02 if kind == "dahl" else 1e-9
    np.testing.assert_allclose(theirs, ours, atol=tolerance * np.abs(ours).max())


def test_logs_are_reproducible_hold_the_readings_faults_and_name_what_is_unknown():
    short = LogSettings(train=1, test=1, duration=4.0, rate=250.0, noise="none", encoder_bits=0)
    plain = make_mujoco_log(TEXT, settings=short)
    again = make_mujoco_log(TEXT, settings=short)
    assert [r.split for r in plain] == ["train", "test"]
    np.testing.assert_array_equal(plain[0]["tau"], again[0]["tau"])
    faults = [
        Hidden("gain", 1, {"gain": 1.2}),
        Hidden("position_offset", 2, {"offset": 0.05}),
        Hidden("delay", None, {"delay": 0.008}),
    ]
    faulty = make_mujoco_log(TEXT, faults, settings=short)[0]
    np.testing.assert_allclose(faulty["q"][:, 2] + 0.05, plain[0]["q"][:, 2], atol=1e-12)
    shift = 2  # samples of 4 ms
    np.testing.assert_allclose(faulty["tau"][shift:, 1], 1.2 * plain[0]["tau"][:-shift, 1], atol=1e-6)
    np.testing.assert_allclose(faulty["tau"][shift:, 0], plain[0]["tau"][:-shift, 0], atol=1e-6)
    lagging = make_mujoco_log(TEXT, [Hidden("lag", None, {"constant": 0.02})], settings=short)[0]
    # A first-order lag and a delay of the same length T differ in the second order only: by about w T = 0.2 here.
    late = make_mujoco_log(TEXT, [Hidden("delay", None, {"delay": 0.02})], settings=short)[0]
    assert np.std(lagging["tau"] - late["tau"]) < 0.2 * np.std(lagging["tau"] - plain[0]["tau"])
    with pytest.raises(InputError, match=r"hidden cause 'magic' is unknown; known are damping"):
        make_mujoco_log(TEXT, [Hidden("magic", 0)], settings=short)
    with pytest.raises(ConfigError, match="noise is 'brown'"):
        LogSettings(noise="brown")


@pytest.mark.parametrize("kind", [k for k in NOISES if k not in ("none", "quantised")])
def test_noise_has_unit_size_and_its_own_colour(kind):
    dt, colour = 2e-3, 0.02
    noise = coloured(kind, (20000, 3), dt, colour, np.random.default_rng(0))
    np.testing.assert_allclose(noise.std(axis=0), 1.0, atol=0.1)
    lag = round(colour / dt)
    correlation = np.mean(noise[lag:] * noise[:-lag])
    expected = {"white": (-0.03, 0.03), "ar1": (0.3, 0.44), "pink": (0.2, 1.0), "lowpass": (0.15, 0.7)}[kind]
    assert expected[0] < correlation < expected[1]


@pytest.mark.parametrize("kind", ["mass", "com"])
def test_what_is_fixed_to_a_link_is_part_of_it(kind):
    """The Panda's hand is turned against its last link and fixed to it: for the loop they are one body."""
    text = read_text(
        find_description("panda_description/urdf/panda.urdf"), ("panda_finger_joint1", "panda_finger_joint2")
    )
    robot = robot_of(text)
    values = {"ratio": 1.3} if kind == "mass" else {"x": 0.02, "y": -0.01, "z": 0.03}
    hidden = Hidden(kind, 6, values)
    own = link_parameters(robot, 6)
    if kind == "mass":
        effect = Effect("link_mass", (robot.joint_names[6],), {"mass": float(own[0] * 1.3)})
    else:
        com = own[1:4] / own[0] + np.array([0.02, -0.01, 0.03])
        effect = Effect("link_com", (robot.joint_names[6],), dict(zip(("com_x", "com_y", "com_z"), com, strict=True)))
    rng = np.random.default_rng(4)
    q, dq, ddq = rng.uniform(-1.5, 1.5, (3, 40, 7))
    np.testing.assert_allclose(
        Engine(text, [hidden]).torque(q, dq, ddq), predict(robot, [effect], q, dq, ddq), atol=1e-8
    )
