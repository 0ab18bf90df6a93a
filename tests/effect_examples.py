"""One effect of every family, and of some forms of it: the checks that hold for all families run them."""

from dataclasses import replace

from hybrid_dynamics.effects import Effect, family

BODY = {
    "mass": 1.4, "com_x": 0.03, "com_y": -0.02, "com_z": 0.1, "inertia_xx": 0.01, "inertia_xy": 0.001,
    "inertia_yy": 0.012, "inertia_xz": 0.0, "inertia_yz": -0.002, "inertia_zz": 0.008,
}  # fmt: skip
JOINT = ("panda_joint3",)
#: Of every family one at least, on a Panda.
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
    "gravity_tilt": Effect("gravity_tilt", (), {"roll": 2.5, "pitch": -0.9}),
    "link_mass": Effect("link_mass", JOINT, {"mass": 4.1}),
    "link_com": Effect("link_com", JOINT, {"com_x": 0.02753, "com_y": 0.0393, "com_z": -0.0665}),
    "asymmetric_coulomb_friction": Effect(
        "asymmetric_coulomb_friction",
        JOINT,
        {"coulomb_torque_positive": 2.0, "coulomb_torque_negative": 0.7},
        {"sign_width": 0.03},
    ),
    "stribeck_friction": Effect(
        "stribeck_friction", JOINT, {"coulomb_torque": 1.0, "static_torque": 1.8, "stribeck_velocity": 0.2}
    ),
    "hysteresis_friction": Effect("hysteresis_friction", JOINT, {"presliding_stiffness": 40.0, "coulomb_torque": 2.0}),
    "hysteresis_friction lugre": Effect(
        "hysteresis_friction",
        JOINT,
        {
            "presliding_stiffness": 40.0,
            "coulomb_torque": 2.0,
            "static_torque": 3.0,
            "micro_damping": 0.4,
            "stribeck_velocity": 0.1,
        },
        {"law": "lugre"},
    ),
    "hysteresis_friction damped": Effect(
        "hysteresis_friction",
        JOINT,
        {"presliding_stiffness": 40.0, "coulomb_torque": 2.0, "micro_damping": 0.4},
        {"law": "damped"},
    ),
    "stribeck_friction over a displacement": Effect(
        "stribeck_friction",
        JOINT,
        {"coulomb_torque": 1.0, "static_torque": 1.8, "stribeck_velocity": 0.2},
        {"sign_displacement": 1e-3},
    ),
    "torque_gain": Effect("torque_gain", JOINT, {"gain": 1.24}),
    "torque_gain of all": Effect("torque_gain", (), {"gain": 0.9}),
    "joint_spring": Effect("joint_spring", JOINT, {"stiffness": 12.0, "rest_position": 0.3}, {"shape": "linear"}),
    "joint_spring sine": Effect("joint_spring", JOINT, {"stiffness": 9.0, "rest_position": -0.4}, {"shape": "sine"}),
    "joint_spring piecewise": Effect(
        "joint_spring",
        JOINT,
        {"stiffness_1": 5.0, "stiffness_2": 0.5, "stiffness_3": 8.0, "rest_position": 0.1},
        {"shape": "piecewise", "knots": (-1.0, -0.3, 0.4, 1.0)},
    ),
    "torque_ripple": Effect("torque_ripple", JOINT, {"amplitude": 0.6, "harmonic": 12.0, "phase": 0.8}),
    "joint_coupling": Effect(
        "joint_coupling",
        JOINT,
        {"viscous_coefficient": 0.6, "coulomb_torque": 1.9, "armature": 0.05},
        {"from_joint": "panda_joint4", "rows": "own", "sign_of": "partner"},
    ),
    "joint_coupling both": Effect(
        "joint_coupling",
        JOINT,
        {"viscous_coefficient": 0.6, "coulomb_torque": 1.9, "armature": 0.05},
        {"from_joint": "panda_joint4", "rows": "both", "sign_of": "sum"},
    ),
    "position_offset": Effect("position_offset", ("panda_joint4",), {"offset": 1e-3}),
    "time_delay": Effect("time_delay", (), {"delay": 2e-4}),
    "external_contact": Effect("external_contact", JOINT, {"torque": 6.0}, {"intervals": ((0.5, 1.0), (2.0, 2.2))}),
    "drift": Effect("drift", JOINT, {"rate": 0.2, "time_constant": 5.0}, {"of": "coulomb"}),
    "symbolic_torque": Effect(
        "symbolic_torque", JOINT, {"scale": 0.8}, {"expression": "-0.5 * sin(q2) * abs(dq3) / (1 + exp(-ddq4))"}
    ),
    "inertial_parameters": Effect(
        "inertial_parameters",
        (),
        {f"{joint}/{name}": v for joint in ("panda_joint2", "panda_joint7") for name, v in BODY.items()},
        {"links": ("panda_joint2", "panda_joint7")},
    ),
}


def of_families_on(joint: str, without: set[str]) -> dict[str, Effect]:
    """By family, of those of a joint that are not among ``without``, the first example, put on ``joint`` of any robot:
    so that a new family is simulated, found and exported without an entry of its own.

    One whose settings name joints of the Panda, or that a small arm of 6 kg does not show, needs a case in the tests
    that call this.
    """
    out: dict[str, Effect] = {}
    for effect in EXAMPLES.values():
        if family(effect.effect).scope == "joint" and effect.joints and effect.effect not in without:
            out.setdefault(effect.effect, replace(effect, joints=(joint,)))
    return out
