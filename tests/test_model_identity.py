"""A model.json is read for the robot it was made for and no other; nothing but finite numbers gets in."""

import json
import re
from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.two_links import EFFECTS, URDF, two_links

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.loop.model import Model, load_model, save_model
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.robots.identity import digest_of, dynamics_of
from hybrid_dynamics.strict_json import parse_json


def outcome(read: Callable[[], object], refusal: type[Exception]) -> str:
    """What became of ``read``; anything but ``refusal`` is a crash and goes on up."""
    try:
        read()
    except refusal as error:
        return "refused in one line" if str(error) and "\n" not in str(error) else f"refused: {error}"
    return "read"


@pytest.fixture
def path(tmp_path):
    save_model(tmp_path / "model.json", Model(two_links(), EFFECTS))
    return tmp_path / "model.json"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('<mass value="2"', '<mass value="8"', "joint elbow: mass of its body is 8 kg, not 2"),
        ('xyz="0.15 0 0.01"', 'xyz="0.16 0 0.01"', "joint elbow: centre of mass of its body is 0.16 0 0.01 m"),
        ('iyy="0.05"', 'iyy="0.051"', "joint shoulder: inertia of its body is"),
        ('xyz="0.4 0 0"', 'xyz="0.5 0 0"', "joint elbow: place is 0.5 0 0 m, not 0.4 0 0"),
        ('<axis xyz="0 1 0"', '<axis xyz="1 0 0"', "joint shoulder: type is RX, not RY"),
        ('type="revolute"', 'type="continuous"', "joint shoulder: type is"),
        ('robot name="two_links"', 'robot name="other"', "made for robot 'two_links'; the URDF describes 'other'"),
        ("shoulder", "hip", "made for joints shoulder, elbow; the robot has hip, elbow"),
    ],
)
def test_another_robot_is_refused_by_what_differs(path, old, new, message):
    robot = Robot.from_text(URDF.replace(old, new, 1), "other.urdf")
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        load_model(path, robot)
    assert str(path) in str(caught.value)


def test_what_is_no_dynamics_may_differ(path):
    """Limits, geometry and the last digits of an orientation are not what a torque depends on."""
    text = URDF.replace('effort="40"', 'effort="400"').replace(
        '<origin xyz="0.4 0 0"/>', '<origin xyz="0.4 0 0" rpy="0 1e-7 0"/>'
    )
    assert load_model(path, Robot.from_text(text, "same.urdf")).effects == EFFECTS
    changed = two_links()
    changed.model.gravity.linear[2] = -1.62
    with pytest.raises(InputError, match=r"in this URDF gravity is 0 0 -1.62 m/s\^2, not 0 0 -9.81"):
        load_model(path, changed)


def test_a_model_of_an_earlier_version_is_still_read(path):
    document = json.loads(path.read_text())
    del document["dynamics"], document["robot_digest"]
    path.write_text(json.dumps(document))
    assert load_model(path, two_links()).effects == EFFECTS


def test_the_digest_is_that_of_the_dynamics(path):
    document = json.loads(path.read_text())
    assert document["robot_digest"] == digest_of(document["dynamics"]) == digest_of(dynamics_of(two_links()))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("0.8", "1e999", "1e999 is beyond the range of numbers"),
        ("0.8", "-1" + "0" * 400, "is beyond the range of numbers"),
        ("0.8", "NaN", "NaN is no number"),
        ("0.8", "true", "True is not of type 'number'"),
        ("0.8", '"0.8"', "'0.8' is not of type 'number'"),
        ('"schema": 2', '"schema": 2, "schema": 2', "key 'schema' stands twice"),
        ('"schema": 2', '"schema": 2, "colour": 1', "Additional properties are not allowed"),
        ("{", "[" * 100_000, "nested too deeply"),
        ("two_links", "\x00", "not valid JSON"),
    ],
)
def test_what_is_no_number_or_no_model_is_refused(path, old, new, message):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=message):
        load_model(path, two_links())


@pytest.mark.parametrize(
    ("effect", "settings", "message"),
    [
        (
            "coulomb_friction",
            {"magic": 1},
            "setting 'magic' is unknown; known are held_within, only_run, sign_displacement, sign_width",
        ),
        ("coulomb_friction", {"sign_width": "wide"}, "setting sign_width is 'wide'; expected a speed"),
        ("coulomb_friction", {"sign_width": -0.1}, "setting sign_width is -0.1"),
        ("coulomb_friction", {"sign_width": None}, "setting sign_width is None"),
        ("coulomb_friction", {"sign_width": True}, "setting sign_width is True"),
        ("coulomb_friction", {"sign_displacement": {"a": 1}}, "setting sign_displacement is {'a': 1}"),
        ("viscous_friction", {"sign_width": 0.1}, "setting 'sign_width' is unknown; known are held_within, only_run"),
        ("joint_spring", {"shape": "round"}, "setting shape is 'round'; expected one of linear, sine, piecewise"),
        ("joint_spring", {"shape": "piecewise", "knots": [1, 0]}, "setting knots is (1, 0)"),
        ("symbolic_torque", {"expression": 3}, "setting expression is 3"),
    ],
)
def test_settings_an_effect_does_not_have_are_refused(path, effect, settings, message):
    document = json.loads(path.read_text())
    entry = document["effects"][0]
    entry["effect"], entry["settings"] = effect, settings
    path.write_text(json.dumps(document))
    with pytest.raises(InputError, match=re.escape(message)):
        load_model(path, two_links())


def test_a_parameter_a_law_divides_by_is_not_zero(path):
    document = json.loads(path.read_text())
    entry = document["effects"][0]
    values = {"coulomb_torque": 1.0, "static_torque": 2.0, "stribeck_velocity": 0.0}
    template = entry["parameters"][0]
    entry |= {
        "effect": "stribeck_friction",
        "parameters": [template | {"name": k, "value": v} for k, v in values.items()],
    }
    path.write_text(json.dumps(document))
    with pytest.raises(InputError, match="expected a stribeck velocity > 0"):
        load_model(path, two_links())


def test_bytes_that_are_no_text_and_a_folder(path):
    path.write_bytes(b'{"schema": \xff}')
    with pytest.raises(InputError, match="not text in UTF-8"):
        load_model(path, two_links())
    with pytest.raises(InputError, match=r"is a folder; give the model\.json that close-loop wrote"):
        load_model(path.parent, two_links())


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_a_damaged_model_is_refused_or_read_but_never_a_crash(tmp_path_factory, data):
    """Truncations, changed bytes and changed types: the model of before, another valid one, or one line."""
    path = tmp_path_factory.mktemp("model") / "model.json"
    save_model(path, Model(two_links(), EFFECTS))
    raw = path.read_bytes()
    if data.draw(st.booleans()):
        start = data.draw(st.integers(0, len(raw) - 1))
        stop = data.draw(st.integers(start, len(raw)))
        path.write_bytes(raw[:start] + data.draw(st.binary(max_size=8)) + raw[stop:])
    else:
        document = json.loads(raw)
        place = document
        while True:
            key = data.draw(st.sampled_from(sorted(place) if isinstance(place, dict) else list(range(len(place)))))
            if not isinstance(place[key], dict | list) or not place[key] or data.draw(st.booleans()):
                break
            place = place[key]
        place[key] = data.draw(st.sampled_from([None, True, -1, 1e300, "", "x", [], {}, [[]], {"a": 1}]))
        path.write_text(json.dumps(document))
    assert outcome(lambda: load_model(path, two_links()), InputError) in ("read", "refused in one line")


@given(st.text())
def test_any_text_is_a_value_or_a_value_error(text):
    assert outcome(lambda: parse_json(text), ValueError) in ("read", "refused in one line")
