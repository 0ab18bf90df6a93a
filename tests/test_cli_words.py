"""A diagnosis in words: every effect with all its numbers, what is not settled in one line each."""

import inspect
import re

import pytest

from hybrid_dynamics.cli.words import (
    TOLD_ALREADY,
    details,
    headline,
    joint_rows,
    notes,
    parameter_lines,
    second_line,
    verdict_line,
)
from hybrid_dynamics.effects import Effect, catalogue, family
from hybrid_dynamics.loop import describe
from hybrid_dynamics.loop.model import effect_to_json
from hybrid_dynamics.loop_report.words import _tail, title_of, with_error


def diagnosis() -> dict:
    errors = {"rmse": [1.0, 2.0], "relative_rmse": [0.1, 0.2], "relative_error": 0.228}
    better = {"rmse": [0.1, 0.2], "relative_rmse": [0.01, 0.02], "relative_error": 0.0062}

    def effect(name: str, joints: list[str], *parameters: tuple[str, float, str], **more: object) -> dict:
        rows = [{"name": n, "joint": None, "value": v, "std_error": 0.01, "unit": u} for n, v, u in parameters]
        return {"effect": name, "joints": joints, "parameters": rows, "indistinguishable_from": [], **more}

    return {
        "robot": "arm",
        "joints": ["a", "b"],
        "verdict": "explained",
        "effects": [effect("payload", [], ("mass", 1.47, "kg"), ("com_x", 0.1, "m"))],
        "error": {"test": {"before": errors, "after": better}},
        "noise_floor": [0.1, 0.2],
        "unexplained": [],
    } | {"effect": effect}


def test_what_cannot_be_told_is_not_told_as_missing():
    """A joint whose torque never changes, or whose rest may be slow noise, is no proof that an effect is missing."""
    value = diagnosis()
    effect = value.pop("effect")
    named, value["effects"] = value["effects"], []
    silent = [{"joint": "b", "why": "its torque never changes in the training runs; its effects are not sought"}]
    value |= {"verdict": "unexplained", "unexplained": [], "not_identifiable": silent}
    rest = "nothing was added; nothing is known of b: the torque there never changes"
    assert verdict_line(value) == f"arm: unexplained: {rest}"
    assert second_line(value) == "held-out error 0.62 %"
    assert headline(value).startswith(f"{rest}; held-out error")
    value |= {"not_identifiable": [], "unexplained": [{"joint": "a", "share_of_residual_variance": 0.2}]}
    value |= {"cannot_tell": [True, False], "motion_dependent": [False, False]}
    assert verdict_line(value).endswith("nothing was added; these runs cannot tell whether anything is missing on a")
    value |= {"effects": [*named, effect("armature", ["b"], ("armature", 0.2, "kg m²"))], "verdict": "partly_explained"}
    assert headline(value).startswith("missing, as far as can be told: payload 1.47 kg; ")
    assert verdict_line(value).endswith("has been added; these runs cannot tell whether more is missing on a")
    # The control: what surely remains, on any joint, is told as that.
    value["motion_dependent"] = [True, False]
    assert headline(value).startswith("missing, and not all: ")
    assert verdict_line(value).endswith("something remains")
    value |= {"motion_dependent": [False, False], "worse_on_test": [True, False]}
    assert verdict_line(value).endswith("something remains")
    value |= {"worse_on_test": [False, False], "beyond_friction": [0.3, 0.0]}
    assert verdict_line(value).endswith("something remains")
    value |= {"beyond_friction": [0.0, 0.0], "better_with_everything": [True, False]}
    assert verdict_line(value).endswith("something remains")
    assert any("a fit of all links and friction at once leaves much less" in line for line in details(value))
    value |= {"better_with_everything": [False, False], "worse_than_start": [True, False]}
    assert verdict_line(value).endswith("something remains")
    assert "not down to noise: a: the starting model leaves less of the test runs" in details(value)
    value |= {"worse_than_start": [False, False], "provenance": {"command": {"model": "model.json"}}}
    assert verdict_line(value).endswith("these runs cannot tell whether more has changed on a")


def test_words_for_every_verdict():
    value = diagnosis()
    effect = value.pop("effect")
    assert headline(value) == second_line(value) == "missing: payload 1.47 kg; held-out error 22.8 % → 0.62 %"
    value["effects"] += [
        effect("coulomb_friction", ["a"], ("coulomb_torque", 3.0, "N m")),
        effect("coulomb_friction", ["b"], ("coulomb_torque", 5.0, "N m")),
        effect("armature", ["b"], ("armature", 0.2, "kg m²"), confirmed=False, why_not="the error grows by 3 %"),
    ]
    value["verdict"] = "partly_explained"
    line = headline(value)
    assert line.startswith("missing, and not all: payload 1.47 kg; Coulomb friction 3 and 5 N m on a, b;")
    assert "armature" not in line
    contradicted = "contradicted by the test runs, not in the model: armature on b: the error grows by 3 %"
    assert contradicted in details(value)
    assert any("contradicted, not in the model" in x for x in parameter_lines(value))
    value |= {"effects": [], "verdict": "unexplained", "motion_dependent": [True, True]}
    value["unexplained"] = [{"joint": "b", "share_of_residual_variance": 0.7, "expression": "sin(q1)"}]
    assert headline(value).startswith("something is missing, but nothing looked for explains it; held-out error 22.8 %")
    told = details(value)
    left = "not down to noise: b: 70 % of the mean square that is left (rms 0.2 N m) depends on the motion"
    assert f"{left}; it looks like sin(q1) [N m]" in told
    assert "not down to noise: a: what is left depends on the motion" in told
    value["verdict"] = "nothing_missing"
    assert headline(value) == "nothing is missing; held-out error 0.62 %"
    rest = "what the model leaves does not depend on the motion"
    assert [verdict_line(value), second_line(value)] == [f"arm: nothing missing: {rest}", "held-out error 0.62 %"]
    # Asked of an earlier model, that is no statement about the robot's URDF.
    value["provenance"] = {"command": {"model": "model.json"}}
    assert headline(value) == "nothing has changed; held-out error 0.62 %"
    assert [verdict_line(value), second_line(value)] == [f"arm: nothing has changed: {rest}", "held-out error 0.62 %"]


def test_words_for_what_cannot_be_told_apart():
    value = diagnosis()
    value.pop("effect")
    value["effects"][0]["indistinguishable_from"] = [
        {
            "effects": [{"effect": "link_inertia", "joints": ["b"]}],
            "why": "same torque",
            "motion_that_would_tell": "turn",
        }
    ]
    value["error"]["test"]["after_confirmed"] = value["error"]["test"]["before"]
    value |= {"noise_floor_low": [0.05, 0.1], "noise_floor_high": [0.2, 0.3]}
    assert "cannot be told apart: payload and link inertia on b: same torque; what would tell: turn" in details(value)
    assert headline(value).endswith("22.8 % → 22.8 %")
    header, rows = joint_rows(value)
    assert len(header) == len(rows[0]) == 6
    assert rows[0] == ["a", "1", "1", "10 %", "0.1 (0.05 to 0.2)", "above the noise; no cause found"]
    value["noise_floor_high"] = [0.9, 0.9]
    assert joint_rows(value)[1][0][-1] == "down to the noise"


SETTINGS = {
    "joint_coupling": {"from_joint": "elbow", "rows": "both", "sign_of": "sum"},
    "joint_spring": {"shape": "sine"},
    "drift": {"of": "coulomb"},
    "external_contact": {"intervals": ((1.0, 2.5),)},
    "symbolic_torque": {"expression": "sin(2*q1)"},
    "inertial_parameters": {"links": ("shoulder", "elbow")},
}


@pytest.mark.parametrize("name", catalogue(everything=True))
def test_every_effect_of_the_catalogue_is_named_with_all_its_numbers(name):
    """Parameters with names, values, errors and units, settings in words; in the headline those that matter."""
    kind, settings = family(name), SETTINGS.get(name, {})
    keys = kind.published(settings)
    values = {key: 1.5 + 0.25 * k for k, key in enumerate(keys)}
    joints = () if kind.scope == "robot" else ("shoulder",)
    entry = effect_to_json(Effect(name, joints, values, settings, dict.fromkeys(keys, 0.125)))
    entry["indistinguishable_from"] = []
    value = diagnosis() | {"effects": [entry]}
    lines = parameter_lines(value)
    words = " ".join(lines)
    assert len(lines) == (3 if name == "inertial_parameters" else 1)
    for p in entry["parameters"]:
        said = f"{title_of(p['name'])} {with_error(p['value'], 0.125, p['unit'])}"
        assert re.search(rf"{re.escape(said)}(,|$| +link)", words), p
    line = headline(value).split(";")[0]
    assert line.startswith(f"missing: {title_of(name)}")
    body = keys and keys[0].endswith("mass")
    for p in [] if len(keys) > 4 or name == "symbolic_torque" else entry["parameters"][: 1 if body else None]:
        assert f"{p['value']:.3g}{_tail(p['unit'])}" in line, (p, line)
    for said in {
        "joint_coupling": ["of shoulder and elbow", "of the sum of both speeds"],
        "joint_spring": ["sine in q"],
        "drift": ["of the coulomb torque"],
        "external_contact": ["1 to 2.5 s"],
        "symbolic_torque": ["sin(2*q1) [N m]"],
        "inertial_parameters": ["2 links"],
    }.get(name, [" on shoulder"] if joints else []):
        assert said in line


def test_of_several_links_it_is_counted_what_is_left_open():
    kind, settings = family("inertial_parameters"), SETTINGS["inertial_parameters"]
    entry = effect_to_json(Effect("inertial_parameters", (), dict.fromkeys(kind.published(settings), 1.0), settings))
    entry |= {
        "indistinguishable_from": [],
        "undetermined_parameters": ["shoulder/mass", "shoulder/com_x", "elbow/mass"],
    }
    said = [line for line in details(diagnosis() | {"effects": [entry]}) if line.startswith("left open")]
    assert said == ["left open by these motions: numbers of the links: 2 of 10 of shoulder, 1 of 10 of elbow"]
    # With their values stand those of which the motions say something.
    shoulder, elbow = parameter_lines(diagnosis() | {"effects": [entry]})[1:]
    assert shoulder.startswith("  link of shoulder: centre of mass y 1 m,")
    assert shoulder.endswith(", 2 left open")
    assert "mass 1 kg" not in shoulder
    assert elbow.endswith(", 1 left open")
    assert elbow.startswith("  link of elbow: centre of mass x 1 m,")


def test_what_is_zero_or_left_open_is_not_in_the_headline():
    value = diagnosis()
    effect = value.pop("effect")
    friction = effect(
        "stribeck_friction",
        ["a"],
        ("coulomb_torque", 2.0, "N m"),
        ("static_torque", 3.0, "N m"),
        ("stribeck_velocity", 0.02, "rad/s"),
        undetermined_parameters=["stribeck_velocity"],
    )
    value["effects"] = [friction]
    assert headline(value).startswith(
        "missing: Stribeck friction on a (Coulomb torque 2 N m, static torque 3 N m); held"
    )
    assert "Stribeck velocity 0.02 rad/s (left open)" in parameter_lines(value)[0]
    assert "left open by these motions: stribeck velocity of Stribeck friction on a" in details(value)
    other = effect("stribeck_friction", ["b"], ("coulomb_torque", 5.0, "N m"), ("static_torque", 0.0, "N m"))
    value["effects"].append(other)
    assert "Stribeck friction on a, b (Coulomb torque 2 and 5 N m, static torque 3 N m)" in headline(value)
    kinds = ("viscous_friction", "torque_offset", "armature", "torque_gain", "torque_ripple")
    value["effects"] += [effect(kind, ["a"], ("x", 1.0, "1")) for kind in kinds]
    value["effects"] += [effect("drift", ["a"], ("rate", 1.0, "N m/s"))]
    assert "; also torque gain on a; torque ripple on a; drift on a; held-out error" in headline(value)


def test_a_mass_that_the_motion_does_not_show_is_not_told_as_one():
    value = diagnosis()
    effect = value.pop("effect")
    mass = ("mass", 3.2, "kg"), ("com_x", 0.1, "m")
    value["effects"] = [effect("link_inertia", ["a"], *mass, undetermined_parameters=["mass"])]
    assert headline(value).startswith("missing: link inertia on a (mass left open by these motions); held-out")
    value["effects"].append(effect("link_inertia", ["b"], *mass))
    assert "link inertia on a, b (mass 3.2 kg, mass left open by these motions)" in headline(value)


def test_what_is_asked_of_an_earlier_model_is_a_change():
    value = diagnosis() | {"provenance": {"command": {"model": "model.json"}}}
    assert headline(value).startswith("changed: payload 1.47 kg; held-out")
    value["provenance"]["command"]["model"] = None
    assert headline(value).startswith("missing: payload 1.47 kg; held-out")


def offsets_or_a_tilt():
    """A diagnosis of two offsets that a tilt could stand for, and the tilt as it is listed with each."""
    value = diagnosis()
    effect = value.pop("effect")
    why = "in the place of torque_offset of a and torque_offset of b: held-out error grows by at most 0.1 %"
    tilt = {"effects": [{"effect": "gravity_tilt", "joints": []}], "why": why, "motion_that_would_tell": "Turn."}
    value["effects"] = [
        effect("torque_offset", [j], ("offset", 1.0, "N m")) | {"indistinguishable_from": [tilt]} for j in ("a", "b")
    ]
    return value, tilt


def test_one_cause_that_could_stand_for_several_names_is_told_once():
    value, tilt = offsets_or_a_tilt()
    told = [line for line in details(value) if "told apart" in line]
    assert told == [f"cannot be told apart: gravity tilt, {tilt['why']}; what would tell: turn"]
    # Control: two causes are two lines.
    value["effects"][1]["indistinguishable_from"] = [tilt | {"effects": [{"effect": "payload", "joints": []}]}]
    assert sum("told apart" in line for line in details(value)) == 2


def test_of_a_name_that_much_could_stand_for_the_rest_is_told_by_name():
    value = diagnosis()
    effect = value.pop("effect")
    kinds = ["torque_offset", "torque_gain", "joint_spring", "armature", "drift"]
    others = [
        {"effects": [{"effect": kind, "joints": ["a"]}], "why": f"as good {k}", "motion_that_would_tell": "Turn."}
        for k, kind in enumerate(kinds)
    ]
    named = effect("viscous_friction", ["a"], ("viscous_coefficient", 1.0, "N m s/rad"))
    value["effects"] = [named | {"indistinguishable_from": others}]
    told = [line for line in details(value) if "told apart" in line]
    assert [f"as good {k}" in line for k, line in enumerate(told[:3])] == [True] * 3
    rest = "viscous friction on a and 2 more (report.html says why): armature on a; drift on a"
    assert told[3:] == [f"cannot be told apart: {rest}"]
    # Control: three are told each with its reason.
    value["effects"] = [named | {"indistinguishable_from": others[:3]}]
    assert [line for line in details(value) if "told apart" in line] == told[:3]


@pytest.mark.parametrize(("count", "lines", "rest"), [(7, 7, 0), (9, 7, 3)])
def test_of_much_that_cannot_be_told_apart_the_first_lines_stand(count: int, lines: int, rest: int):
    value = diagnosis()
    effect = value.pop("effect")
    other = {"effects": [{"effect": "drift", "joints": ["a"]}], "why": "as good", "motion_that_would_tell": "Turn."}
    kinds = ["viscous_friction", "coulomb_friction", "armature", "torque_offset", "torque_gain", "joint_spring"]
    kinds += ["stribeck_friction", "hysteresis_friction", "torque_ripple"]
    value["effects"] = [
        effect(kind, ["a"], ("x", 1.0, "N m")) | {"indistinguishable_from": [other]} for kind in kinds[:count]
    ]
    told = [line for line in details(value) if "told apart" in line]
    assert len(told) == lines
    more = f"cannot be told apart: {rest} more (report.html names them, and what would tell)"
    assert (told[-1] == more) is (rest > 0)


def test_a_cause_in_the_place_of_several_is_not_told_where_one_of_them_is_gone():
    value, _ = offsets_or_a_tilt()
    value["effects"][1]["confirmed"] = False
    assert not any("told apart" in line for line in details(value))
    # Control: both in the model.
    value["effects"][1]["confirmed"] = True
    assert sum("told apart" in line for line in details(value)) == 1


def test_what_is_not_in_the_model_is_not_compared_with_anything():
    value = diagnosis()
    effect = value.pop("effect")
    other = {"effects": [{"effect": "drift", "joints": ["a"]}], "why": "as good", "motion_that_would_tell": "Turn."}
    named = effect("viscous_friction", ["a"], ("viscous_coefficient", 1.0, "N m s/rad"))
    value["effects"] = [named | {"indistinguishable_from": [other], "confirmed": False}]
    told = details(value)
    assert any(line.startswith("contradicted by the test runs") for line in told)
    assert not any("told apart" in line for line in told)
    # Control: confirmed, it is.
    value["effects"] = [named | {"indistinguishable_from": [other], "confirmed": True}]
    assert any("told apart" in line for line in details(value))


def test_two_doubts_of_one_kind_about_the_whole_robot_are_told_without_a_joint():
    value = diagnosis()
    effect = value.pop("effect")
    links = [{"effect": "inertial_parameters", "joints": []}]
    why = [{"effects": links, "why": w, "motion_that_would_tell": "Weigh."} for w in ("the same", "as good")]
    value["effects"] = [effect("torque_gain", [], ("gain", 1.1, "-")) | {"indistinguishable_from": why}]
    told = [line for line in details(value) if "told apart" in line]
    assert told == ["cannot be told apart: torque gain and inertial parameters; what would tell: weigh"]


def test_the_same_doubt_on_several_joints_is_one_line():
    value = diagnosis()
    effect = value.pop("effect")
    alike = {"why": "the same torque", "motion_that_would_tell": "Move fast."}
    value["effects"] = [
        effect("viscous_friction", [j], ("viscous_coefficient", 1.0, "N m s/rad"))
        | {"indistinguishable_from": [{"effects": [{"effect": "torque_offset", "joints": [j]}], **alike}]}
        for j in ("a", "b")
    ]
    told = "viscous friction and torque offset on a, b: the same torque; what would tell: move fast"
    assert f"cannot be told apart: {told}" in details(value)
    value |= {"cannot_tell": [True, True], "verdict": "partly_explained"}
    value["unexplained"] = [{"joint": j, "share_of_residual_variance": 0.7, "expression": "0"} for j in ("a", "b")]
    value["extrapolation"] = [{"joint": "a", "variable": "dq", "share_outside": 0.25}]
    told = [line for line in details(value) if not line.startswith("cannot be told apart")]  # type: ignore[assignment]
    assert told[0].startswith("cannot be told: a, b: what is left changes slowly")
    assert told[1].startswith("the test motion leaves the training range: 25 % of the speed of a;")
    parted = [
        line for line in details(value | {"worse_on_test": [True, False]}) if not line.startswith("cannot be told ap")
    ]
    assert parted[0] == "not down to noise: a: the test runs leave more than the training runs"
    assert parted[1].startswith("cannot be told: b: what is left changes slowly")
    chance = [line for line in details(value | {"unproven_share": [0.0, 0.31]}) if line.startswith("cannot be told: ")]
    assert chance[0].startswith("cannot be told: a: what is left changes slowly")
    assert chance[1].startswith("cannot be told: of what is left 31 % on b follow the motion on held-out parts, which")
    # The diagnosis says it again in its notes; the console once. Its words are those that are looked for.
    value["notes"] = ["a: what is left changes slowly (...)", "another note"]
    assert notes(value) == ["another note"]
    source = inspect.getsource(describe)
    assert all(words in source for words in TOLD_ALREADY)


def test_names_that_the_test_runs_do_not_decide_are_told_on_the_terminal():
    value = diagnosis()
    effect = value.pop("effect")

    def found(joint: str, change: float, **more: object) -> dict:
        own = {"confirmed": True, "test_change": {"value": change, "std_error": 0.2}}
        return effect("torque_gain", [joint], ("gain", 1.31, "1"), **own | more)

    value["effects"] = [found("a", 0.53), found("b", -0.9)]
    line = "in the model, and not decided by the test runs: torque gain on a"
    assert line in details(value)
    # Controls: decided, contradicted, and no test run asked.
    for other in (found("a", -0.9), found("a", 0.9, confirmed=False), effect("payload", [], ("mass", 1.0, "kg"))):
        value["effects"] = [other]
        assert not any("not decided" in told for told in details(value))
