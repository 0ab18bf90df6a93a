"""Blind cases of another engine: what is hidden, how large it is drawn, and what a right diagnosis would be.

A recipe draws a hidden cause of unit size; its size then follows from the torque that it adds, measured by the engine
itself. ``truth`` says which effects of the catalogue it is, or nothing where the catalogue does not have its form.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hybrid_dynamics.effects import Effect
from hybrid_dynamics.effects.inertia import link_parameters, to_body, to_dynamic
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.study.engine import Hidden
from hybrid_dynamics.types import Array

#: ``make(robot, joint, size) -> Hidden`` with a torque that grows with ``size``; a draw makes one.
Make = Callable[[Robot, int, float], Hidden]
Draw = Callable[[np.random.Generator], Make]
#: The effects of the catalogue that a hidden cause is.
Truth = Callable[[Robot, Hidden], list[Effect]]


@dataclass(frozen=True)
class Recipe:
    """``name`` of the form, its ``draw``, and ``truth(robot, hidden)``: its effects, none for forms unknown.

    ``of``: the effect of the catalogue that an unknown form is another law of; empty where there is none.
    """

    name: str
    draw: Draw
    truth: Truth
    of: str = ""

    @property
    def known(self) -> bool:
        """True where the catalogue has this form."""
        return self.truth is not _nothing


def _nothing(robot: Robot, hidden: Hidden) -> list[Effect]:
    return []


def _one(effect: str, settings: dict[str, object] | None = None, **names: str) -> Truth:
    """Truth of one effect on the hidden joint; ``names``: parameter = number of the hidden cause."""

    def truth(robot: Robot, hidden: Hidden) -> list[Effect]:
        joints = () if hidden.joint is None else (robot.joint_names[hidden.joint],)
        values = {name: float(hidden.values[key]) for name, key in names.items()}
        return [Effect(effect, joints, values, settings or {})]

    return truth


def _plain(kind: str, whole: bool = False, **numbers: float) -> Draw:
    """A cause whose ``numbers`` all grow with the size."""

    def draw(rng: np.random.Generator) -> Make:
        return lambda robot, joint, size: Hidden(
            kind, None if whole else joint, {k: v * size for k, v in numbers.items()}
        )

    return draw


def _stiffness(cubic: float) -> Draw:
    def draw(rng: np.random.Generator) -> Make:
        rest = float(rng.uniform(-0.5, 0.5))
        return lambda robot, joint, size: Hidden(
            "stiffness", joint, {"stiffness": size, "rest": rest, "cubic": cubic * size}
        )

    return draw


def _block(last: bool) -> Draw:
    def draw(rng: np.random.Generator) -> Make:
        shape = dict(zip(("edge_x", "edge_y", "edge_z"), rng.uniform(0.05, 0.2, 3).tolist(), strict=True))
        place = dict(zip(("x", "y", "z"), rng.uniform(-0.12, 0.12, 3).tolist(), strict=True))
        return lambda robot, joint, size: Hidden(
            "block",
            robot.n_joints - 1 if last else max(min(joint, robot.n_joints - 2), 1),
            {"mass": size, **place, **shape},
        )

    return draw


def _block_body(hidden: Hidden) -> Array:
    v = hidden.values
    edges = np.array([v["edge_x"], v["edge_y"], v["edge_z"]]) ** 2
    inertia = v["mass"] * (edges.sum() - edges) / 12
    body = {"mass": v["mass"], "com_x": v["x"], "com_y": v["y"], "com_z": v["z"]}
    body |= {f"inertia_{e}": 0.0 for e in ("xy", "xz", "yz")}
    return to_dynamic(body | {f"inertia_{a * 2}": float(inertia[k]) for k, a in enumerate("xyz")})


def _payload(robot: Robot, hidden: Hidden) -> list[Effect]:
    return [Effect("payload", (), to_body(_block_body(hidden)))]


def _link(robot: Robot, hidden: Hidden) -> list[Effect]:
    total = link_parameters(robot, hidden.at) + _block_body(hidden)
    return [Effect("link_inertia", (robot.joint_names[hidden.at],), to_body(total))]


def _tilt(rng: np.random.Generator) -> Make:
    angle = float(rng.uniform(0, 2 * np.pi))
    return lambda robot, joint, size: Hidden(
        "tilt", None, {"roll": 0.05 * size * np.cos(angle), "pitch": 0.05 * size * np.sin(angle)}
    )


def _stribeck(exponent: float) -> Draw:
    def draw(rng: np.random.Generator) -> Make:
        ratio, speed = float(rng.uniform(1.4, 2.5)), float(np.exp(rng.uniform(np.log(0.05), np.log(0.4))))
        return lambda robot, joint, size: Hidden(
            "stribeck", joint, {"coulomb": size, "static": ratio * size, "velocity": speed, "exponent": exponent}
        )

    return draw


def _dahl(rng: np.random.Generator) -> Make:
    way = float(np.exp(rng.uniform(np.log(0.005), np.log(0.1))))
    return lambda robot, joint, size: Hidden("dahl", joint, {"coulomb": size, "stiffness": size / way})


def _lugre(rng: np.random.Generator) -> Make:
    way = float(np.exp(rng.uniform(np.log(0.005), np.log(0.1))))

    def hidden(robot: Robot, joint: int, size: float) -> Hidden:
        forces = {"coulomb": size, "static": 1.6 * size, "stiffness": size / way, "micro_damping": 0.5 * size}
        return Hidden("lugre", joint, {**forces, "velocity": 0.1})

    return hidden


def _gonthier(rng: np.random.Generator) -> Make:
    return lambda robot, joint, size: Hidden("gonthier", joint, {"torque": size, "width": 0.05, "dwell": 0.1})


def _tanh(rng: np.random.Generator) -> Make:
    return lambda robot, joint, size: Hidden("tanh_coulomb", joint, {"torque": size, "width": 0.3})


def _slow_sign(robot: Robot, hidden: Hidden) -> list[Effect]:
    values, settings = {"coulomb_torque": hidden.values["torque"]}, {"sign_width": hidden.values["width"]}
    return [Effect("coulomb_friction", (robot.joint_names[hidden.at],), values, settings)]


def _ripple(second: float) -> Draw:
    def draw(rng: np.random.Generator) -> Make:
        harmonic, phase = float(rng.integers(6, 30)), float(rng.uniform(-3, 3))
        return lambda robot, joint, size: Hidden(
            "ripple", joint, {"amplitude": size, "harmonic": harmonic, "phase": phase, "second": second}
        )

    return draw


def _coupled(kind: str) -> Draw:
    def draw(rng: np.random.Generator) -> Make:
        def hidden(robot: Robot, joint: int, size: float) -> Hidden:
            j = min(joint, robot.n_joints - 2)
            if kind == "tendon":
                return Hidden("tendon", j, {"partner": j + 1, "damping": 0.5 * size, "friction": size})
            if kind == "own_coupling":
                return Hidden(kind, j, {"partner": j + 1, "viscous": 0.7 * size, "coulomb": size})
            return Hidden(kind, j, {"partner": j + 1, "torque": size})

        return hidden

    return draw


def _gear(robot: Robot, hidden: Hidden) -> list[Effect]:
    names, other, v = robot.joint_names, int(hidden.values["partner"]), hidden.values
    gear = {"viscous_coefficient": v["damping"], "coulomb_torque": v["friction"], "armature": 0.0}
    settings = {"from_joint": names[other], "rows": "both", "sign_of": "sum"}
    own = [Effect("viscous_friction", (names[k],), {"viscous_coefficient": v["damping"]}) for k in (hidden.at, other)]
    return [Effect("joint_coupling", (names[hidden.at],), gear, settings), *own]


def _own_coupling(robot: Robot, hidden: Hidden) -> list[Effect]:
    names, v = robot.joint_names, hidden.values
    values = {"viscous_coefficient": v["viscous"], "coulomb_torque": v["coulomb"], "armature": 0.0}
    settings = {"from_joint": names[int(v["partner"])], "rows": "own", "sign_of": "partner"}
    return [Effect("joint_coupling", (names[hidden.at],), values, settings)]


def _load(rng: np.random.Generator) -> Make:
    # On a joint that carries something: a wrist's load friction would need a coefficient of many.
    return lambda robot, joint, size: Hidden("load_friction", 1 + joint % 2, {"coefficient": 0.05 * size})


def _zero(rng: np.random.Generator) -> Make:
    # Where gravity hardly changes with the joint, no zero is wrong enough to be seen.
    return lambda robot, joint, size: Hidden("position_offset", 1 + joint % 2, {"offset": 0.01 * size})


def _gain(rng: np.random.Generator) -> Make:
    return lambda robot, joint, size: Hidden("gain", 1 + joint % 2, {"gain": 1.0 + 0.05 * size})


def _mass(rng: np.random.Generator) -> Make:
    return lambda robot, joint, size: Hidden("mass", max(joint, 1), {"ratio": 1.0 + 0.1 * size})


def _mass_truth(robot: Robot, hidden: Hidden) -> list[Effect]:
    mass = float(link_parameters(robot, hidden.at)[0]) * hidden.values["ratio"]
    return [Effect("link_mass", (robot.joint_names[hidden.at],), {"mass": mass})]


def _com(rng: np.random.Generator) -> Make:
    way = rng.normal(size=3)
    way /= np.linalg.norm(way)
    return lambda robot, joint, size: Hidden(
        "com", max(joint, 1), dict(zip(("x", "y", "z"), (0.02 * size * way).tolist(), strict=True))
    )


def _com_truth(robot: Robot, hidden: Hidden) -> list[Effect]:
    own = link_parameters(robot, hidden.at)
    com = own[1:4] / own[0] + np.array([hidden.values.get(k, 0.0) for k in "xyz"])
    return [
        Effect("link_com", (robot.joint_names[hidden.at],), dict(zip(("com_x", "com_y", "com_z"), com, strict=True)))
    ]


def _hysteresis(robot: Robot, hidden: Hidden) -> list[Effect]:
    names = {"presliding_stiffness": hidden.values["stiffness"], "coulomb_torque": hidden.values["coulomb"]}
    return [Effect("hysteresis_friction", (robot.joint_names[hidden.at],), names)]


def _falling(robot: Robot, hidden: Hidden) -> list[Effect]:
    v = hidden.values
    names = {
        "presliding_stiffness": v["stiffness"],
        "coulomb_torque": v["coulomb"],
        "static_torque": v["static"],
        "micro_damping": v["micro_damping"],
        "stribeck_velocity": v["velocity"],
    }
    return [Effect("hysteresis_friction", (robot.joint_names[hidden.at],), names, {"law": "lugre"})]


def _harmonics(robot: Robot, hidden: Hidden) -> list[Effect]:
    """One ripple, and a second at twice its harmonic (:func:`.outside.ripple`): the catalogue's law twice."""
    joint, v = (robot.joint_names[hidden.at],), hidden.values
    first = {"amplitude": v["amplitude"], "harmonic": v["harmonic"], "phase": v["phase"]}
    if not v["second"]:
        return [Effect("torque_ripple", joint, first)]
    second = {
        "amplitude": v["second"] * v["amplitude"],
        "harmonic": 2 * v["harmonic"],
        "phase": float(np.angle(np.exp(1j * (2 * v["phase"] + 1.0)))),
    }
    return [Effect("torque_ripple", joint, first), Effect("torque_ripple", joint, second)]


def _curved(robot: Robot, hidden: Hidden) -> list[Effect]:
    joint = (robot.joint_names[hidden.at],)
    v = hidden.values
    return [
        Effect("viscous_friction", joint, {"viscous_coefficient": v["d0"]}),
        Effect(
            "nonlinear_viscous_friction",
            joint,
            {"quadratic_coefficient": v["d1"], "cubic_coefficient": v.get("d2", 0.0)},
        ),
    ]


#: Forms that the catalogue has.
KNOWN = (
    Recipe("viscous", _plain("damping", d0=1.0), _one("viscous_friction", viscous_coefficient="d0")),
    Recipe("curved viscous", _plain("damping", d0=1.0, d1=0.8, d2=0.3), _curved),
    Recipe("coulomb", _plain("frictionloss", torque=1.0), _one("coulomb_friction", coulomb_torque="torque")),
    Recipe(
        "asymmetric",
        _plain("asymmetric", positive=1.0, negative=0.4),
        _one("asymmetric_coulomb_friction", coulomb_torque_positive="positive", coulomb_torque_negative="negative"),
    ),
    Recipe(
        "stribeck",
        _stribeck(2.0),
        _one("stribeck_friction", coulomb_torque="coulomb", static_torque="static", stribeck_velocity="velocity"),
    ),
    Recipe("dahl", _dahl, _hysteresis),
    Recipe(
        "load",
        _load,
        _one("load_dependent_friction", load_coefficient="coefficient"),
    ),
    Recipe("offset", _plain("offset", torque=1.0), _one("torque_offset", offset="torque")),
    Recipe("gain", _gain, _one("torque_gain", gain="gain")),
    Recipe("armature", _plain("armature", armature=0.1), _one("armature", armature="armature")),
    Recipe(
        "spring",
        _stiffness(0.0),
        _one("joint_spring", {"shape": "linear"}, stiffness="stiffness", rest_position="rest"),
    ),
    Recipe("ripple", _ripple(0.0), _harmonics),
    Recipe("two harmonics", _ripple(0.6), _harmonics),
    Recipe("gear", _coupled("tendon"), _gear),
    Recipe("coupling", _coupled("own_coupling"), _own_coupling),
    Recipe("zero", _zero, _one("position_offset", offset="offset")),
    Recipe("delay", _plain("delay", True, delay=0.001), _one("time_delay", delay="delay")),
    Recipe("lag", _plain("lag", True, constant=0.001), _one("time_delay", {"response": "lag"}, delay="constant")),
    Recipe("payload", _block(True), _payload),
    Recipe("link", _block(False), _link),
    Recipe("mass", _mass, _mass_truth),
    Recipe("com", _com, _com_truth),
    Recipe("tilt", _tilt, _one("gravity_tilt", roll="roll", pitch="pitch")),
)
#: Forms that it does not have, or not in the usual form.
UNKNOWN = (
    # The catalogue has it as a setting of presliding friction, and the next but one as one of dry friction: both are
    # drawn among those that it lacks, since one level and a sharp sign are not it.
    Recipe("lugre", _lugre, _falling),
    Recipe("gonthier", _gonthier, _nothing),
    Recipe("tanh", _tanh, _slow_sign),
    Recipe("stribeck 1/2", _stribeck(0.5), _nothing, of="stribeck_friction"),
    Recipe("cubic spring", _stiffness(1.5), _nothing, of="joint_spring"),
    Recipe("two joints", _coupled("two_joints"), _nothing),
)
RECIPES = {r.name: r for r in (*KNOWN, *UNKNOWN)}


def scaled(
    make: Callable[[float], Hidden], added: Callable[[Hidden], Array], wanted: float, rounds: int = 4
) -> tuple[Hidden, Array]:
    """The hidden cause whose ``added`` torque (T, n), in floors, has the root mean square ``wanted`` on one joint.

    A secant in the logarithm: exact at once where the torque grows in proportion.
    """
    size = 1.0
    hidden = make(size)
    torque = added(hidden)
    for _ in range(rounds):
        now = float(np.sqrt(np.mean(torque**2, axis=0)).max())
        if abs(now / wanted - 1) < 1e-3 or now <= 0:
            break
        size *= float(np.clip(wanted / now, 1e-3, 1e3))
        hidden = make(size)
        torque = added(hidden)
    return hidden, torque
