"""C, Python and CasADi exports compute what Model.predict computes, for every effect of the catalogue."""

import subprocess

import casadi as cs
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.support_export import FINGER, compiled, drawn, imported, motion, saved

from hybrid_dynamics.effects import Effect, catalogue, family, readings
from hybrid_dynamics.export.carry import carried
from hybrid_dynamics.export.symbolic import SymbolicModel
from hybrid_dynamics.export.writing import export
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.robots import Robot

#: Between two ways of rounding the same formula.
ROUNDING = 1e-12


@pytest.fixture(scope="module")
def robot():
    return Robot.from_urdf(FINGER)


def along(step, rows, states, q, dt):
    """Torque (T, n) of an exported program over one run, its state advanced by the way between the rows."""
    state, out = np.zeros(states), []
    for k in range(rows):
        if k and states:
            state = step("advance", (q[k] - q[k - 1]) / dt, dt, state)
        out.append(step("torque", k, state))
    return np.array(out)


def programs(model, folder):
    """name -> function of one run giving torque (T, n), for the three formats that hold programs."""
    path = saved(model, folder)
    for form, name in (("c", "arm.c"), ("python", "arm.py"), ("casadi", "arm.casadi")):
        export(path, FINGER, form, folder / name)
    module = imported(folder / "arm.py")
    states = len(module.STATES)
    library = compiled(folder / "arm.c", model.robot.n_joints, states)
    loaded = cs.Function.load(str(folder / "arm.casadi"))

    def run_c(q, dq, ddq, dt):
        def step(what, *a):
            return library(what, *a) if what == "advance" else library(what, q[a[0]], dq[a[0]], ddq[a[0]], *held(a[1]))

        return along(step, len(q), states, q, dt)

    def run_python(q, dq, ddq, dt):
        def step(what, *a):
            return module.advance(*a) if what == "advance" else module.torque(q[a[0]], dq[a[0]], ddq[a[0]], *held(a[1]))

        return along(step, len(q), states, q, dt)

    def run_casadi(q, dq, ddq, dt):
        def step(what, *a):
            if what == "advance":
                return module.advance(*a)
            return np.asarray(loaded(q[a[0]], dq[a[0]], ddq[a[0]], *held(a[1]))[0]).ravel()

        return along(step, len(q), states, q, dt)

    def held(state):
        return [state] if states else []

    return {"c": run_c, "python": run_python, "casadi": run_casadi}


@pytest.mark.parametrize("name", catalogue(everything=True))
def test_every_effect_keeps_its_torque(robot, name, tmp_path):
    effect = drawn(robot, name)
    model = Model(robot, (effect,))
    time, q, dq, ddq = motion(robot.n_joints)
    if carried("c", (effect,), robot)[0].lost:
        # The wrong-cause control: what a program cannot carry must change the prediction, and be said.
        assert readings(robot, (effect,)).delay or effect.settings
        return
    ours = model.predict(q, dq, ddq, time)
    assert np.abs(ours - Model(robot).predict(q, dq, ddq, time)).max() > 1e-6, "the planted effect does nothing"
    for form, run in programs(model, tmp_path).items():
        theirs = run(q, dq, ddq, float(time[1]))
        assert np.abs(theirs - ours).max() <= ROUNDING * np.abs(ours).max(), form


def everything(robot, std_errors=False):
    """One of each family that a program carries, all in one model."""
    effects = [drawn(robot, name, seed, std_errors) for seed, name in enumerate(catalogue(everything=True))]
    return Model(robot, tuple(e for e in effects if not carried("c", (e,), robot)[0].lost))


def test_all_effects_together(robot, tmp_path):
    model = everything(robot)
    time, q, dq, ddq = motion(robot.n_joints)
    ours = model.predict(q, dq, ddq, time)
    for form, run in programs(model, tmp_path).items():
        theirs = run(q, dq, ddq, float(time[1]))
        assert np.abs(theirs - ours).max() <= ROUNDING * np.abs(ours).max(), form


def test_residual_is_what_the_users_own_rigid_body_lacks(robot, tmp_path):
    model = everything(robot)
    export(saved(model, tmp_path), FINGER, "python", tmp_path / "arm.py")
    module = imported(tmp_path / "arm.py")
    _, q, dq, ddq = motion(robot.n_joints)
    state = [np.full((len(q), len(module.STATES)), 0.3)] if module.STATES else []
    rigid = module.rigid_body(q, dq, ddq)
    assert rigid == pytest.approx(robot.inverse_dynamics(q, dq, ddq), rel=1e-12, abs=1e-12)
    together = rigid + module.residual(q, dq, ddq, rigid, *state)
    assert together == pytest.approx(module.torque(q, dq, ddq, *state), rel=1e-11, abs=1e-11)


def test_deviation_is_that_of_the_parameters(robot):
    """Against differences of the prediction, by parameter; correlation matters, and what was left is added."""
    first, second = robot.joint_names[:2]
    effects = (
        Effect("viscous_friction", (first,), {"viscous_coefficient": 0.4}, {}, {"viscous_coefficient": 0.05}),
        Effect("armature", (second,), {"armature": 0.02}, {}, {"armature": 0.003}),
        drawn(robot, "payload", 3, std_errors=True),
        Effect("coulomb_friction", (first,), {"coulomb_torque": 0.3}, {}, {"coulomb_torque": 0.02}),
    )
    _, q, dq, ddq = motion(robot.n_joints)
    changes = []
    for k, effect in enumerate(effects):
        for key, spread in effect.std_errors.items():
            sides = []
            for sign in (1, -1):
                values = {**effect.parameters, key: effect.parameters[key] + 1e-4 * sign * spread}
                moved = Effect(effect.effect, effect.joints, values, effect.settings)
                sides.append(Model(robot, (*effects[:k], moved, *effects[k + 1 :])).predict(q, dq, ddq))
            changes.append((sides[0] - sides[1]) / 2e-4)
    changes = np.array(changes)  # type: ignore[assignment]
    left = np.array([0.1, 0.2, 0.0])
    rng = np.random.default_rng(0)
    root = rng.normal(size=(len(changes), len(changes)))
    covariance = root @ root.T
    scale = np.sqrt(np.diag(covariance))
    for correlation in (None, covariance / np.outer(scale, scale)):
        function = SymbolicModel(Model(robot, effects), left, correlation).deviation
        theirs = np.array([np.asarray(function(*row)).ravel() for row in zip(q, dq, ddq, strict=True)])
        weights = np.eye(len(changes)) if correlation is None else correlation
        ours = np.sqrt(np.einsum("ktj,kl,ltj->tj", changes, weights, changes) + left**2)
        assert theirs == pytest.approx(ours, rel=1e-5)


def test_the_deviation_of_friction_with_a_falling_level_is_that_of_sliding_at_the_speed():
    """Static torque and Stribeck velocity are in the state as well, which has come to the level of the numbers as they
    are; against differences of what the law makes when it has slid at a speed for long."""
    robot = Robot.from_urdf(FINGER)
    numbers = {"presliding_stiffness": 40.0, "coulomb_torque": 2.0, "static_torque": 3.0, "micro_damping": 0.4}
    values = {**numbers, "stribeck_velocity": 0.2}
    errors = {"static_torque": 0.2, "stribeck_velocity": 0.03, "coulomb_torque": 0.1}
    lugre = Effect("hysteresis_friction", robot.joint_names[:1], values, {"law": "lugre"}, errors)
    symbolic = SymbolicModel(Model(robot, (lugre,)))
    still = np.zeros(3)
    for speed in (0.02, 0.1, 0.5):

        def slid(speed: float = speed, **moved: float) -> float:
            now = {**values, **moved}
            bump = np.exp(-((speed / now["stribeck_velocity"]) ** 2))
            return now["coulomb_torque"] + (now["static_torque"] - now["coulomb_torque"]) * bump

        changes = [
            (slid(**{key: values[key] + 1e-5}) - slid(**{key: values[key] - 1e-5})) / 2e-5 * spread
            for key, spread in errors.items()
        ]
        dq = np.array([speed, 0.0, 0.0])
        state = np.zeros(1)
        for _ in range(2000):
            state = np.asarray(symbolic.advance(dq, 0.1, state)).ravel()
        assert float(state[0]) == pytest.approx(slid() / 2.0)
        theirs = float(np.asarray(symbolic.deviation(still, dq, still, state)).ravel()[0])
        assert theirs == pytest.approx(np.linalg.norm(changes), rel=1e-4)


@pytest.mark.parametrize("form", ["c", "python", "casadi"])
def test_lugre_friction_with_its_errors_is_exported(form, tmp_path):
    robot = Robot.from_urdf(FINGER)
    numbers = {"presliding_stiffness": 40.0, "coulomb_torque": 2.0, "static_torque": 3.0, "micro_damping": 0.4}
    values = {**numbers, "stribeck_velocity": 0.2}
    errors = {key: 0.1 * value for key, value in values.items()}
    model = Model(robot, (Effect("hysteresis_friction", robot.joint_names[:1], values, {"law": "lugre"}, errors),))
    time, q, dq, ddq = motion(robot.n_joints, rows=400)
    ours = model.predict(q, dq, ddq, time)
    friction = ours - Model(robot).predict(q, dq, ddq, time)
    theirs = programs(model, tmp_path)[form](q, dq, ddq, float(time[1]))
    # The level is that of a row's speed here, and of the middle of two there: seen where rows .02 s apart turn round.
    off = theirs - ours
    assert np.sqrt(np.mean(off[:, 0] ** 2)) < 0.02 * np.sqrt(np.mean(friction[:, 0] ** 2))
    assert np.abs(theirs - ours)[:, 1:].max() < 1e-9


def test_clean_under_the_sanitizers(robot, tmp_path):
    """Address and undefined behaviour, over ordinary and over strange numbers.

    A program of its own: a library with sanitizers cannot be loaded into a Python that was built without them.
    """
    model = everything(robot, std_errors=True)
    export(saved(model, tmp_path), FINGER, "c", tmp_path / "arm.c")
    states = len(SymbolicModel(model).memories)
    state = "s, " if states else ""
    (tmp_path / "main.c").write_text(
        f"""#include "arm.h"
        int main(void) {{
          static const double strange[] = {{0.0, -0.0, 1e-300, -3.0, 7.5, 1e6}};
          double q[ARM_JOINTS], v[ARM_JOINTS], a[ARM_JOINTS], m[ARM_JOINTS], o[ARM_JOINTS], s[ARM_STATES + 1] = {{0}};
          for (int k = 0; k < 6; k++) for (int l = 0; l < 6; l++) {{
            for (int j = 0; j < ARM_JOINTS; j++) {{
              q[j] = strange[k]; v[j] = strange[l]; a[j] = strange[(k + l) % 6];
            }}
            {"advance(v, 1e-3, s, s);" if states else ""}
            rigid_body(q, v, a, m); residual(q, v, a, m, {state}o); torque(q, v, a, {state}o);
            torque_std(q, v, a, {state}o);
          }}
          return (o[0] != o[0]) + s[ARM_STATES] > 1.0;
        }}
        """
    )
    flags = ["-std=c99", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    subprocess.run(["gcc", *flags, "main.c", "arm.c", "-lm", "-o", "main"], cwd=tmp_path, check=True)
    done = subprocess.run(["./main"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_two_models_in_one_program(robot, tmp_path):
    """The functions take a prefix, so that two arms can be linked into one controller."""
    for name in ("left", "right"):
        export(saved(Model(robot), tmp_path), FINGER, "c", tmp_path / f"{name}.c")
        flags = ["-std=c99", f"-DHYBRID_DYNAMICS_PREFIX={name}_", "-c", f"{name}.c"]
        subprocess.run(["gcc", *flags], cwd=tmp_path, check=True)
    (tmp_path / "main.c").write_text(
        "void left_torque(const double*, const double*, const double*, double*);"
        "void right_torque(const double*, const double*, const double*, double*);"
        "int main(void) { double x[3] = {0}, o[3]; left_torque(x, x, x, o); right_torque(x, x, x, o); return 0; }"
    )
    subprocess.run(["gcc", "-std=c99", "main.c", "left.o", "right.o", "-lm", "-o", "main"], cwd=tmp_path, check=True)
    subprocess.run([str(tmp_path / "main")], check=True)


@given(
    speed=st.lists(st.floats(-20, 20), min_size=3, max_size=3),
    dt=st.floats(1e-6, 1.0),
    z=st.floats(-1, 1),
)
@settings(max_examples=60, deadline=None)
def test_memory_stays_within_its_bounds_and_follows_the_motion(speed, dt, z):
    """|z| <= 1 whatever the motion; moving on, it tends to the sign of the speed; at rest it stays."""
    robot = Robot.from_urdf(FINGER)
    friction = Effect("coulomb_friction", (robot.joint_names[0],), {"coulomb_torque": 1.0}, {"sign_displacement": 0.05})
    advance = SymbolicModel(Model(robot, (friction,))).advance
    after = float(advance(speed, dt, [z]))
    assert abs(after) <= 1 + 1e-12
    way = np.sign(speed[0])
    assert abs(after - way) <= abs(z - way) + 1e-12 or way == 0
    if speed[0] == 0:
        assert after == z


def test_two_memories_of_one_displacement_are_two_where_their_levels_differ():
    """Dahl's friction and LuGre's of one joint, and of the same presliding displacement: each with its own state, which
    follows the motion as the prediction does; another Dahl's shares the first one's."""
    robot = Robot.from_urdf(FINGER)
    joint = (robot.joint_names[1],)
    dahl = Effect("hysteresis_friction", joint, {"presliding_stiffness": 20.0, "coulomb_torque": 1.0})
    over = Effect("coulomb_friction", joint, {"coulomb_torque": 0.5}, {"sign_displacement": 0.05})
    numbers = {"presliding_stiffness": 40.0, "coulomb_torque": 2.0, "static_torque": 3.4, "micro_damping": 0.3}
    lugre = Effect("hysteresis_friction", joint, {**numbers, "stribeck_velocity": 0.4}, {"law": "lugre"})
    model = Model(robot, (dahl, over, lugre))
    symbolic = SymbolicModel(model)
    assert [m.law for m in symbolic.memories] == [None, 2]
    time = np.arange(4000) / 2000.0
    dq = 0.8 * np.outer(np.sin(7.0 * time), np.ones(3))
    q = 0.8 / 7.0 * np.outer(1.0 - np.cos(7.0 * time), np.ones(3))
    still = np.zeros(3)
    ours = model.predict(q, dq, np.zeros_like(q), time)[:, 1]
    state, theirs = np.zeros(2), []
    for k in range(len(time)):
        if k:
            state = np.asarray(symbolic.advance(0.5 * (dq[k] + dq[k - 1]), time[1], state)).ravel()
        theirs.append(float(np.asarray(symbolic.torque(q[k], dq[k], still, state)).ravel()[1]))
    friction = ours - Model(robot).predict(q, dq, np.zeros_like(q), time)[:, 1]
    np.testing.assert_allclose(theirs, ours, atol=1e-3 * np.abs(friction).max())


def test_a_law_that_follows_accelerations_enters_the_masses(robot):
    """What a law has of ddq is part of what forward dynamics divides by: said by the function's own derivative."""
    own = [name for name in catalogue(everything=True) if family(name).changes_body]
    assert "armature" in own
    model = Model(robot, (Effect("armature", (robot.joint_names[0],), {"armature": 0.5}),))
    symbolic = SymbolicModel(model)
    mass = cs.jacobian(symbolic.torque(symbolic.q, symbolic.dq, symbolic.ddq), symbolic.ddq)
    at = cs.Function("mass", [symbolic.q, symbolic.dq, symbolic.ddq], [mass])
    plain = SymbolicModel(Model(robot))
    before = cs.Function(
        "mass", [plain.q, plain.dq, plain.ddq], [cs.jacobian(plain.torque(plain.q, plain.dq, plain.ddq), plain.ddq)]
    )
    zero = np.zeros(3)
    assert np.asarray(at(zero, zero, zero) - before(zero, zero, zero)) == pytest.approx(np.diag([0.5, 0, 0]), abs=1e-12)


MIMIC = """<robot name="gripper"><link name="base"/>
<link name="a"><inertial><origin xyz="0 0 0.1"/><mass value="2"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="b"><inertial><origin xyz="0.1 0 0"/><mass value="1"/>
<inertia ixx="0.05" iyy="0.05" izz="0.05" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="lead" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="50" velocity="3"/></joint>
<joint name="follow" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0 0 0.3"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="50" velocity="3"/><mimic joint="lead" multiplier="-0.5" offset="0.2"/></joint>
</robot>
"""


def test_a_joint_that_follows_another_is_part_of_its_torque(tmp_path):
    """Not simply left out: with the follower held still the torque is another one."""
    urdf = tmp_path / "gripper.urdf"
    urdf.write_text(MIMIC)
    robot = Robot.from_urdf(urdf)
    assert robot.joint_names == ("lead",)
    model = Model(robot, (Effect("viscous_friction", ("lead",), {"viscous_coefficient": 0.4}),))
    _, q, dq, ddq = motion(1)
    ours = model.predict(q, dq, ddq)
    path = saved(model, tmp_path)
    export(path, urdf, "python", tmp_path / "arm.py")
    assert imported(tmp_path / "arm.py").torque(q, dq, ddq) == pytest.approx(ours, rel=1e-12, abs=1e-12)
    export(path, urdf, "urdf", tmp_path / "out.urdf")
    assert Robot.from_urdf(tmp_path / "out.urdf").inverse_dynamics(q, dq, ddq) == pytest.approx(
        robot.inverse_dynamics(q, dq, ddq), abs=1e-12
    )
    export(path, urdf, "mjcf", tmp_path / "out.xml")
    assert 'joint1="follow" joint2="lead" polycoef="0.2 -0.5 0.0 0.0 0.0"' in (tmp_path / "out.xml").read_text()
    still = Robot.from_urdf(urdf, ("follow",))
    assert np.abs(still.inverse_dynamics(q, dq, ddq) - robot.inverse_dynamics(q, dq, ddq)).max() > 0.1
