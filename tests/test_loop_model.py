"""A model.json that physics or the robot forbids is refused by file name; nothing but numbers is read."""

import json

import jsonschema
import numpy as np
import pytest
from tests.small_arm import arm

from hybrid_dynamics.effects import Effect
from hybrid_dynamics.errors import ConfigError, InputError
from hybrid_dynamics.loop import LoopSettings, Model, load_model, save_model
from hybrid_dynamics.loop.model import check_schema, load_schema
from hybrid_dynamics.robots import Robot, find_description


@pytest.fixture(scope="module")
def robot():
    return Robot.from_urdf(find_description("ur_description/urdf/ur10_joint_limited_robot.urdf"))


@pytest.fixture
def path(robot, tmp_path):
    friction = Effect("viscous_friction", (robot.joint_names[1],), {"viscous_coefficient": 2.0})
    save_model(tmp_path / "model.json", Model(robot, (friction,)))
    return tmp_path / "model.json"


def test_round_trip(robot, path):
    assert load_model(path, robot).effects[0].parameters == {"viscous_coefficient": 2.0}


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("2.0", "NaN", "NaN is no number"),
        ("2.0", "-Infinity", "-Infinity is no number"),
        ("2.0", "-2.0", "viscous_coefficient = -2; expected >= 0"),
        ("viscous_friction", "magic", "magic"),
        ("viscous_coefficient", "coefficient", "viscous_coefficient"),
    ],
)
def test_impossible_models_are_refused_by_file_name(robot, path, old, new, message):
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(InputError, match=message) as caught:
        load_model(path, robot)
    assert str(path) in str(caught.value)


def test_a_setting_under_its_former_name_is_read(robot, path):
    named = Effect("coulomb_friction", (robot.joint_names[0],), {"coulomb_torque": 1.0}, {"sign_displacement": 1e-3})
    Model(robot, (named,)).save(path)
    text = path.read_text()
    path.write_text(text.replace("sign_displacement", "sign_travel"))
    assert path.read_text() != text
    assert load_model(path, robot).effects == (named,)


def test_unknown_joint_of_an_effect_is_refused_by_file_name(robot, path):
    document = json.loads(path.read_text())
    document["effects"][0]["joints"] = ["elbow"]
    path.write_text(json.dumps(document))
    with pytest.raises(InputError, match=r"model\.json: effect viscous_friction: .*no joint 'elbow'"):
        load_model(path, robot)


def test_an_effect_named_twice_is_refused():
    with pytest.raises(ConfigError, match="name each only once"):
        LoopSettings(effects=("payload", "payload"))


@pytest.mark.parametrize("name", ["model", "diagnosis"])
def test_the_schemas_that_results_are_checked_against_are_schemas(name):
    schema = load_schema(name)
    jsonschema.validators.validator_for(schema).check_schema(schema)
    with pytest.raises(jsonschema.ValidationError):
        check_schema({}, name)


def test_how_friction_grows_with_the_load():
    small = arm()
    effect = Effect("load_dependent_friction", (small.joint_names[1],), {"load_coefficient": 0.12})
    rng = np.random.default_rng(0)
    q, dq, ddq = rng.normal(size=(3, 50, 2))
    expected = np.zeros((50, 2))
    expected[:, 1] = 0.12 * np.sign(dq[:, 1]) * np.sign(small.inverse_dynamics(q, dq, ddq)[:, 1])
    np.testing.assert_allclose(Model(small, (effect,)).load_derivative(q, dq, ddq), expected, atol=1e-6)
    assert not Model(small).load_derivative(q, dq, ddq).any()


LUGRE = {
    "presliding_stiffness": 40.0,
    "coulomb_torque": 2.0,
    "static_torque": 3.0,
    "micro_damping": 0.4,
    "stribeck_velocity": 0.2,
}


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"static_torque": 1.0}, "expected a static_torque of at least the coulomb_torque"),
        ({"coulomb_torque": 0.0}, "expected a static_torque of at least the coulomb_torque"),
        ({"micro_damping": -0.1}, "micro_damping = -0.1"),
        ({"coulomb_torque": -2.0, "static_torque": -3.0, "presliding_stiffness": -40.0}, "expected >= 0, all in all"),
    ],
)
def test_friction_that_rises_with_the_speed_or_drives_is_no_lugre_friction(robot, tmp_path, changed, message):
    whole = Effect("hysteresis_friction", robot.joint_names[:1], LUGRE, {"law": "lugre"})
    save_model(tmp_path / "model.json", Model(robot, (whole,)))
    assert load_model(tmp_path / "model.json", robot).effects[0].parameters == LUGRE
    wrong = Effect("hysteresis_friction", robot.joint_names[:1], {**LUGRE, **changed}, {"law": "lugre"})
    save_model(tmp_path / "wrong.json", Model(robot, (wrong,)))
    with pytest.raises(InputError, match=message):
        load_model(tmp_path / "wrong.json", robot)
