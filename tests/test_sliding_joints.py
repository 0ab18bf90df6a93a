"""A joint that slides has forces [N] and positions [m], in every place where it is told."""

import json

import pyarrow.parquet as pq
import pytest
from tests.small_arm import write_folder

from hybrid_dynamics.check.excitation import check_excitation
from hybrid_dynamics.cli import main
from hybrid_dynamics.cli.words import joint_rows
from hybrid_dynamics.effects import Effect, family
from hybrid_dynamics.effects.units import on_a_slide, unit_of
from hybrid_dynamics.export.source import values
from hybrid_dynamics.loop import Model, close_loop
from hybrid_dynamics.loop_report.content import Curve, Trace
from hybrid_dynamics.loop_report.plots import curve_figure, torque_figure
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.simulation.excitation import excitations

LINK = (
    '<inertial><origin xyz="{com}"/><mass value="{mass}"/>'
    '<inertia ixx=".02" iyy=".03" izz=".03" ixy="0" ixz="0" iyz="0"/></inertial>'
)
LIFT = f"""<robot name="lift">
<link name="base"/>
<link name="carriage">{LINK.format(com="0 0 0.05", mass=4)}</link>
<link name="arm">{LINK.format(com="0.2 0 0.03", mass=2)}</link>
<joint name="slide" type="prismatic"><parent link="base"/><child link="carriage"/><axis xyz="0 0 1"/>
<limit lower="-0.6" upper="0.6" effort="200" velocity="1.5"/></joint>
<joint name="turn" type="revolute"><parent link="carriage"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="60" velocity="4"/></joint>
</robot>"""
FRICTION = (
    Effect("viscous_friction", ("slide",), {"viscous_coefficient": 30.0}),
    Effect("viscous_friction", ("turn",), {"viscous_coefficient": 2.0}),
)


@pytest.fixture(scope="module")
def lift() -> Robot:
    return Robot.from_text(LIFT, "lift.urdf")


@pytest.fixture(scope="module")
def result(lift):
    return close_loop(lift, *excitations(lift, FRICTION, train=2, test=1, duration=6.0))


def test_a_prismatic_joint_is_known(lift):
    assert lift.prismatic == ("slide",)


@pytest.mark.parametrize(
    ("name", "turns", "slides"),
    [
        ("viscous_friction", ["N m s/rad"], ["N s/m"]),
        ("stribeck_friction", ["N m", "N m", "rad/s"], ["N", "N", "m/s"]),
        ("joint_spring", ["N m/rad", "rad"], ["N/m", "m"]),
        ("torque_ripple", ["N m", "1/rad", "rad"], ["N", "1/m", "rad"]),
        ("armature", ["kg m^2"], ["kg"]),
        ("link_mass", ["kg"], ["kg"]),
    ],
)
def test_units_follow_the_joint_and_those_of_bodies_do_not(name, turns, slides, lift):
    kind = family(name)
    for joint, expected in (("turn", turns), ("slide", slides)):
        settings = {"shape": "linear"} if name == "joint_spring" else {}
        effect = Effect(name, (joint,), dict.fromkeys(kind.published(settings), 1.0), settings)
        found = [unit_of(effect, key, lift.prismatic) for key in effect.parameters]
        assert found == expected
    inertia = Effect("link_inertia", ("slide",), dict.fromkeys(family("link_inertia").published({}), 1.0))
    assert {unit_of(inertia, key, lift.prismatic) for key in inertia.parameters} == {"kg", "m", "kg m^2"}
    assert on_a_slide("s") == "s"


def test_diagnosis_and_model_tell_forces_of_the_sliding_joint(result, lift, tmp_path):
    result.model.save(tmp_path / "model.json")
    for document in (result.diagnosis.to_json(), json.loads((tmp_path / "model.json").read_text("utf-8"))):
        units = {e["joints"][0]: e["parameters"][0]["unit"] for e in document["effects"] if len(e["joints"]) == 1}
        assert units == {"slide": "N s/m", "turn": "N m s/rad"}
    again = type(result.diagnosis).from_json(result.diagnosis.to_json())
    assert again.prismatic == ("slide",)
    assert [row[0] for row in joint_rows(again.to_json())[1]] == ["slide [N]", "turn"]
    assert {e.effect.joints[0]: round(next(iter(e.effect.parameters.values())), 1) for e in again.effects} == {
        "slide": 30.0,
        "turn": 2.0,
    }
    assert Model.load(tmp_path / "model.json", lift).effects == result.model.effects


def test_a_robot_that_only_turns_says_nothing_of_slides(result):
    turning = result.diagnosis.to_json() | {"prismatic": []}
    assert [row[0] for row in joint_rows(turning)[1]] == ["slide", "turn"]
    plain = type(result.diagnosis).from_json(turning).to_json()
    assert "prismatic" not in plain
    assert {p["unit"] for e in plain["effects"] for p in e["parameters"]} == {"N m s/rad"}


def test_exports_and_checks_have_the_same_units(result, lift):
    told = {e.joints[0]: values(e, lift.prismatic) for e in result.model.effects}
    assert told["slide"].endswith("N s/m")
    assert told["turn"].endswith("N m s/rad")
    train, _ = excitations(lift, FRICTION, train=1, test=1, duration=6.0)
    ranges = {f.joint: f.text for f in check_excitation(lift, train) if f.code == "range"}
    assert " m (" in ranges["slide"]
    assert " m/s" in ranges["slide"]
    assert " rad/s" in ranges["turn"]


def test_predict_tells_newtons_on_the_console_and_in_its_file(result, lift, tmp_path, capsys):
    train, test = excitations(lift, FRICTION, train=1, test=1, duration=6.0)
    write_folder(tmp_path, LIFT, train, test)
    result.model.save(tmp_path / "model.json")
    out = tmp_path / "predicted.parquet"
    files = {"--robot": "robot.urdf", "--model": "model.json", "--data": f"{test[0].name}.parquet"}
    with pytest.raises(SystemExit) as ended:
        main(["predict", *(a for flag, name in files.items() for a in (flag, str(tmp_path / name))), "--out", str(out)])
    assert not ended.value.code
    assert "slide [N]" in capsys.readouterr().out
    units = {field.name: field.metadata[b"unit"] for field in pq.read_schema(out)}
    assert (units["tau1"], units["tau2"]) == (b"N", b"N m")


def test_plots_of_a_sliding_joint_are_labelled_in_newtons():
    trace = Trace("run", "slide", (0.0, 0.1), (1.0, 2.0), (0.0, 0.0), (1.0, 2.0))
    assert torque_figure(trace, 0.1, slides=True).values["effort"] == "force [N]"
    assert torque_figure(trace, 0.1).values["effort"] == "torque [N m]"
    curve = Curve("slide", "load", 0.1, (0.0, 1.0), (0.0, 1.0), (0.0, 1.0), (0, 0))
    values = curve_figure(curve, ("run",), "", slides=True).values
    assert (values["axis"], values["effort"]) == ("rigid-body force [N]", "force [N]")
