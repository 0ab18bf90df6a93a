"""``hybrid-dynamics export``: what it says, and what it refuses in one line with the old file untouched."""

import json
import os
import stat
import sys

import numpy as np
import pytest
from tests.support_export import FINGER, imported, saved

from hybrid_dynamics.cli import main
from hybrid_dynamics.effects import Effect
from hybrid_dynamics.export import FORMATS
from hybrid_dynamics.loop.model import Model, save_model
from hybrid_dynamics.robots import Robot, find_description

OTHER = find_description("double_pendulum_description/urdf/double_pendulum_simple.urdf")
ENDINGS = {"urdf": "urdf", "mjcf": "xml", "c": "c", "python": "py", "casadi": "casadi"}


@pytest.fixture
def robot():
    return Robot.from_urdf(FINGER)


@pytest.fixture
def model(robot):
    first, second = robot.joint_names[:2]
    stribeck = {"coulomb_torque": 0.5, "static_torque": 0.9, "stribeck_velocity": 0.1}
    return Model(
        robot,
        (
            Effect("viscous_friction", (first,), {"viscous_coefficient": 0.4}, {}, {"viscous_coefficient": 0.01}),
            Effect("stribeck_friction", (second,), stribeck),
        ),
    )


@pytest.fixture
def path(model, tmp_path):
    return saved(model, tmp_path)


def run(capsys, *arguments):
    """Exit code, stdout, stderr."""
    with pytest.raises(SystemExit) as ended:
        main([str(a) for a in arguments])
    out, err = capsys.readouterr()
    return ended.value.code, out, err


def arguments(path, form, out, *more, robot=FINGER):
    return ["export", "--model", path, "--robot", robot, "--format", form, "--out", out, *more]


@pytest.mark.parametrize("form", ENDINGS)
def test_console_and_file_head_say_what_is_in_it_and_what_is_not(form, path, robot, tmp_path, capsys):
    out = tmp_path / f"arm.{ENDINGS[form]}"
    code, said, noted = run(capsys, *arguments(path, form, out))
    assert code == 0
    assert f"{out}: written" in said
    head = out if form != "casadi" else tmp_path / "arm.casadi.txt"
    text = head.read_text()
    assert "viscous_coefficient 0.4 +- 0.01 N m s/rad" in text
    lost = f"stribeck_friction ({robot.joint_names[1]}) in full: without the rise of friction towards standstill"
    assert (lost in noted) == (form in ("urdf", "mjcf")) == (lost in text)
    assert ("carries all of them" in text) == (form not in ("urdf", "mjcf"))


@pytest.mark.parametrize("form", ["urdf", "mjcf"])
def test_strict_makes_the_loss_an_error(form, path, tmp_path, capsys):
    out = tmp_path / f"arm.{ENDINGS[form]}"
    code, _, err = run(capsys, *arguments(path, form, out, "--strict"))
    assert code == 2
    assert err.startswith(f"error: {form} cannot carry stribeck_friction")
    assert not out.exists()


def test_the_same_loss_of_several_joints_is_one_line_with_all_of_them(robot, tmp_path, capsys):
    joints = robot.joint_names
    stribeck = {"coulomb_torque": 0.5, "static_torque": 0.9, "stribeck_velocity": 0.1}
    effects = [Effect("stribeck_friction", (joint,), stribeck) for joint in joints[:2]]
    effects.append(Effect("coulomb_friction", joints[2:3], {"coulomb_torque": 0.5}, {"sign_displacement": 0.01}))
    path = saved(Model(robot, tuple(effects)), tmp_path)
    code, _, err = run(capsys, *arguments(path, "urdf", tmp_path / "arm.urdf", "--strict"))
    assert code == 2
    assert err.count("\n") == 1
    rise = f"stribeck_friction of 2 joints ({joints[0]}, {joints[1]}) in full: without the rise of friction"
    turn = f"coulomb_friction ({joints[2]}) in full: without the gradual turn-over of friction at a reversal"
    assert f"{rise} towards standstill | {turn}" in err


def test_effects_that_runs_contradict_are_left_out_and_that_is_said(model, robot, tmp_path, capsys):
    """An inactive effect of model.json is on record only: no torque of it in the file, and its name on the console."""
    third = robot.joint_names[2]
    refused = Effect("torque_offset", (third,), {"offset": 5.0})
    path = saved(model.with_inactive([refused]), tmp_path)
    out = tmp_path / "arm.py"
    code, _, noted = run(capsys, *arguments(path, "python", out))
    assert code == 0
    assert f"left out, held-out runs contradict it: torque_offset ({third})" in noted
    assert "Left out, because held-out runs contradict them:" in out.read_text()
    still = np.zeros(robot.n_joints)
    assert imported(out).residual(still, still, still, still) == pytest.approx(still, abs=1e-12)


def test_what_was_there_and_what_changed_since_is_told_as_one(model, robot, tmp_path, capsys):
    third = robot.joint_names[2]
    offset = Effect("torque_offset", (third,), {"offset": 2.0}, std_errors={"offset": 0.5})
    less = Effect("torque_offset", (third,), {"offset": -1.5}, std_errors={"offset": 0.25})
    path = saved(Model(robot, (*model.effects, offset, less)), tmp_path)
    out = tmp_path / "arm.urdf"
    code, _, noted = run(capsys, *arguments(path, "urdf", out))
    assert code == 0
    assert noted.count(f"urdf cannot carry torque_offset ({third})") == 1
    assert f"torque_offset ({third}): offset 0.5 +- 0.25 N m" in out.read_text()
    assert "-1.5" not in out.read_text().split("<robot")[0]


@pytest.mark.parametrize(
    ("block", "words"),
    [
        (None, "standard errors of the parameters (taken as independent of one another)."),
        ({"residual": [0.1, 0.1, 0.1]}, "(taken as independent of one another) and the error on held-out runs."),
        (
            {"residual": [0.1, 0.1, 0.1], "correlation": [[1.0, 0.9], [0.9, 1.0]]},
            "standard errors of the parameters with their correlations and the error on held-out runs.",
        ),
    ],
)
def test_what_the_standard_deviation_is_made_of_is_said_as_it_is(block, words, robot, tmp_path, capsys):
    viscous = [
        Effect("viscous_friction", (joint,), {"viscous_coefficient": 0.4}, {}, {"viscous_coefficient": 0.01})
        for joint in robot.joint_names[:2]
    ]
    path = saved(Model(robot, tuple(viscous)), tmp_path)
    if block is not None:
        changed(path, lambda v: v.update(uncertainty=block))
    heads = {"c": "arm.h", "python": "arm.py", "casadi": "arm.casadi.txt"}
    for form, head in heads.items():
        assert run(capsys, *arguments(path, form, tmp_path / f"arm.{ENDINGS[form]}"))[0] == 0
        assert words in " ".join((tmp_path / head).read_text().split()), form


def test_strict_is_content_where_all_is_carried(path, tmp_path, capsys):
    assert run(capsys, *arguments(path, "c", tmp_path / "arm.c", "--strict"))[0] == 0


def test_json_holds_the_files_and_the_losses(path, tmp_path, capsys):
    code, out, _ = run(capsys, *arguments(path, "mjcf", tmp_path / "arm.xml", "--json"))
    value = json.loads(out)
    assert code == 0
    assert value["files"] == [str(tmp_path / "arm.xml")]
    assert len(value["lost"]) == 1


def changed(path, change):
    value = json.loads(path.read_text())
    change(value)
    path.write_text(json.dumps(value))


def _rename(value):
    value["joints"][0] = "elbow"
    for effect in value["effects"]:
        effect["joints"] = ["elbow"]


BAD_MODELS = {
    "of a newer schema": (lambda p: changed(p, lambda v: v.update(schema=99)), "schema"),
    "truncated": (lambda p: p.write_text(p.read_text()[:200]), "model.json"),
    "with a parameter out of range": (
        lambda p: changed(p, lambda v: v["effects"][0]["parameters"][0].update(value=-3.0)),
        "viscous_coefficient = -3; expected >= 0",
    ),
    "with other joints": (lambda p: changed(p, _rename), "made for joints elbow"),
    "that is none": (lambda p: p.write_text("[1, 2]"), "model.json"),
    "missing": (lambda p: p.unlink(), "no such"),
}


@pytest.mark.parametrize("what", BAD_MODELS)
def test_a_model_that_is_no_good_is_refused_in_one_line(what, path, tmp_path, capsys):
    spoil, message = BAD_MODELS[what]
    spoil(path)
    out = tmp_path / "arm.xml"
    out.write_text("old")
    code, said, err = run(capsys, *arguments(path, "mjcf", out, "--force"))
    assert (code, said) == (2, "")
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    assert message in err
    assert out.read_text() == "old"


def test_a_model_of_another_robot_is_refused(path, tmp_path, capsys):
    code, _, err = run(capsys, *arguments(path, "c", tmp_path / "arm.c", robot=OTHER))
    assert code == 2
    assert "made for joints" in err
    assert list(tmp_path.glob("arm*")) == []


def test_an_output_that_exists_asks_for_force(path, tmp_path, capsys):
    out = tmp_path / "arm.c"
    header = tmp_path / "arm.h"
    header.write_text("old")
    code, _, err = run(capsys, *arguments(path, "c", out))
    assert code == 2
    assert "arm.h: exists; give another name, or --force to replace it" in err
    assert (out.exists(), header.read_text()) == (False, "old")
    assert run(capsys, *arguments(path, "c", out, "--force"))[0] == 0
    assert header.read_text() != "old"


def test_an_output_that_is_an_input_is_never_written(model, tmp_path, capsys):
    urdf = tmp_path / "robot.urdf"
    urdf.write_bytes(FINGER.read_bytes())
    path = saved(model, tmp_path)
    code, _, err = run(capsys, *arguments(path, "urdf", urdf, "--force", robot=urdf))
    assert code == 2
    assert "is an input" in err
    assert urdf.read_bytes() == FINGER.read_bytes()


@pytest.mark.skipif(os.geteuid() == 0, reason="the superuser may write anywhere")
def test_a_folder_that_cannot_be_written_to(path, tmp_path, capsys):
    folder = tmp_path / "closed"
    folder.mkdir()
    folder.chmod(stat.S_IRUSR | stat.S_IXUSR)
    code, _, err = run(capsys, *arguments(path, "c", folder / "arm.c"))
    assert (code, err.count("\n")) == (2, 1)


def test_an_output_below_a_file_cannot_be_written(path, tmp_path, capsys):
    code, _, err = run(capsys, *arguments(path, "c", path / "arm.c"))
    assert (code, err.count("\n")) == (2, 1)
    assert "is a file" in err


@pytest.mark.parametrize("form", FORMATS)
def test_the_file_name_must_fit_the_format(form, path, tmp_path, capsys):
    code, _, err = run(capsys, *arguments(path, form, tmp_path / "arm.txt"))
    assert code == 2
    assert "expected a file name that ends in" in err


def test_the_same_model_gives_the_same_bytes(model, tmp_path, capsys):
    for form, ending in ENDINGS.items():
        written = []
        for turn in ("first", "second"):
            folder = tmp_path / form / turn
            folder.mkdir(parents=True)
            save_model(folder / "model.json", model)
            assert run(capsys, *arguments(folder / "model.json", form, folder / f"arm.{ending}"))[0] == 0
            written.append((folder / f"arm.{ending}").read_bytes())
        assert written[0] == written[1], form


@pytest.mark.parametrize(("form", "extra"), [("c", "export"), ("mjcf", "export"), ("onnx", "onnx")])
def test_without_the_extra_the_remedy_is_told(form, extra, path, tmp_path, capsys, monkeypatch):
    for module in [name for name in sys.modules if name.startswith("hybrid_dynamics.export.")]:
        monkeypatch.delitem(sys.modules, module)
    for library in ("casadi", "mujoco", "onnx"):
        monkeypatch.setitem(sys.modules, library, None)
    ending = {**ENDINGS, "onnx": "onnx"}[form]
    code, _, err = run(capsys, *arguments(path, form, tmp_path / f"arm.{ending}"))
    assert code == 2
    assert f"run in a clone of the project: pip install '.[{extra}]'" in err
    # A URDF needs none of them.
    assert run(capsys, *arguments(path, "urdf", tmp_path / "arm.urdf"))[0] == 0
