"""What the page of a loop says in words and how it draws: nothing that the data leave open looks measured."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hybrid_dynamics.effects import Term
from hybrid_dynamics.loop.search import Step
from hybrid_dynamics.loop_report import rest, words
from hybrid_dynamics.loop_report.bokeh_json import Drawing
from hybrid_dynamics.loop_report.content import Candidate, Curve, SearchStep, Trace
from hybrid_dynamics.loop_report.details import _how_much, _title, _together
from hybrid_dynamics.loop_report.gather import _key, _swapped, kind_of, run_title
from hybrid_dynamics.loop_report.parameter_words import missing, row_words
from hybrid_dynamics.loop_report.plots import curve_figure, torque_figure
from hybrid_dynamics.loop_report.sections import _mass_caveat


def parameter(name: str, value: float, error: float, unit: str, joint: str | None = None) -> dict[str, Any]:
    return {"name": name, "joint": joint, "value": value, "std_error": error, "unit": unit}


def entry(effect: str, joints: list[str], parameters: list[dict[str, Any]], **more: Any) -> dict[str, Any]:
    return {"effect": effect, "joints": joints, "settings": {}, "parameters": parameters, **more}


def test_a_parameter_that_the_runs_leave_open_has_no_error_that_looks_measured() -> None:
    mass = parameter("mass", 4.971, 6.9e-14, "kg", "a")
    links = entry("inertial_parameters", [], [mass, mass | {"joint": "b"}], undetermined_parameters=["a/mass"])
    assert words.value_of(links, links["parameters"][0]) == "4.971 kg"
    assert "±" in words.value_of(links, links["parameters"][1])  # another link's mass is not the same parameter
    links["settings"] = {"links": ["a", "b"]}
    (phrase,) = missing({"effects": [links], "joints": ["a", "b"]})
    assert phrase == "Inertial parameters of 2 links: these runs decide 1 of 2 numbers"
    # What is left open has not changed, however far its number is from the starting model's.
    links["parameters"].append(parameter("com_x", 0.1, 0.02, "m", "b"))
    (phrase,) = missing(
        {"effects": [links], "joints": ["a", "b"]}, before={"a/mass": 1.0, "b/mass": 4.971, "b/com_x": 0.02}
    )
    assert phrase == (
        "Inertial parameters of 2 links: these runs decide 2 of 3 numbers; "
        "most surely changed is centre of mass x of b, 0.02 → 0.100 ± 0.020 m"
    )
    payload = entry("payload", [], [mass | {"joint": None}], undetermined_parameters=["mass"])
    assert missing({"effects": [payload], "joints": ["a"]}) == ["Payload: mass 4.971 kg (left open by these runs)"]


def test_of_a_base_on_its_side_the_angle_that_turns_it_is_told() -> None:
    def phrase(roll: float, pitch: float) -> str:
        angles = [parameter("roll", roll, 0.3, "rad"), parameter("pitch", pitch, 0.009, "rad")]
        (words,) = missing({"effects": [entry("gravity_tilt", [], angles)], "joints": ["a"]})
        return words

    assert phrase(1.51, 1.558) == "Gravity tilt: pitch 1.5580 ± 0.0090 rad"
    # Control: elsewhere both say how it stands.
    assert phrase(1.51, 0.4) == "Gravity tilt: roll 1.51 ± 0.30 rad, pitch 0.4000 ± 0.0090 rad"


def test_what_a_drive_gain_does_to_a_mass_is_said_with_an_if() -> None:
    # No log says whether its torque was computed from motor current.
    payload = entry("payload", [], [parameter("mass", 1.5, 0.01, "kg")])
    told = _mass_caveat({"effects": [payload]})
    assert told.startswith("The standard error is statistical. If your torque is computed from motor current,")
    assert told.endswith("(1 % of 1.5 kg is 0.015 kg).")
    assert _mass_caveat({"effects": [entry("armature", ["a"], [])]}) == ""


def test_joints_are_named_and_not_counted() -> None:
    joints = [f"joint_{k}" for k in range(1, 7)]
    assert words.where(joints, joints) == "all 6 joints"
    assert words.where(joints[3:], joints) == "joint_4, joint_5 and joint_6"
    assert words.where(joints[:5], joints) == "all joints but joint_6"
    assert words.where([*joints[:2], *joints[4:]], joints) == "all joints but joint_3 and joint_4"
    many = [f"j{k}" for k in range(8)]
    assert words.where(many[4:], many) == "j4, j5, j6 and j7"
    friction = [entry("armature", [name], [parameter("armature", 0.2, 0.01, "kg m^2")]) for name in joints[:4]]
    assert missing({"effects": friction, "joints": joints}) == [
        "Armature on all joints but joint_5 and joint_6: 0.2 kg m²"
    ]


def test_numbers_are_written_out_as_people_do() -> None:
    assert (words.share(0.9961), words.share(1.0), words.share(0.0123)) == ("100 %", "100 %", "1.2 %")
    assert (words.plain(2612.0), words.plain(15_400.0), words.plain(5.43)) == ("2,600", "15,000", "5.4")
    assert words.title_of("com_x") == "centre of mass x"


def test_an_error_that_is_noise_in_motion_alone_is_not_called_noise() -> None:
    def state(moving: float, every: float) -> tuple[str, str]:
        d = {"joints": ["a"], "noise_floor_high": [1.0], "motion_dependent": [False], "cannot_tell": [False]}
        d["error"], d["error_moving"] = ({"test": {"after": {"rmse": [value]}}} for value in (every, moving))
        return rest.state_of(d, 0)

    assert state(1.0, 1.0) == ("good", "down to the noise")
    assert state(1.0, 4.5) == ("open", rest.STANDING)
    assert state(2.0, 4.5) == ("open", rest.ABOVE)


def test_a_joint_whose_test_runs_leave_more_says_so_before_all_doubt() -> None:
    left = {"joint": "a", "share_of_residual_variance": 0.7, "expression": "0"}
    d: dict[str, Any] = {"joints": ["a"], "unexplained": [left], "motion_dependent": [False], "cannot_tell": [True]}
    assert rest.state_of(d, 0) == ("open", rest.SLOW)
    assert words.still_open(d) == ["a: what is left may be noise or an effect: it changes slowly."]
    (chance,) = words.still_open(d | {"unproven_share": [0.31]})
    assert chance.endswith("31 % of it follows the motion on held-out parts, perhaps by chance.")
    d["worse_on_test"] = [True]
    assert rest.state_of(d, 0) == ("open", rest.PARTED)
    assert words.still_open(d) == ["a: the test runs leave more than the training runs; no cause found."]
    d["motion_dependent"] = [True]
    assert rest.state_of(d, 0) == ("open", rest.ALARM)


@pytest.mark.parametrize(
    ("flag", "state", "told"),
    [
        ("worse_than_start", rest.WORSE, "the starting model leaves less of the test runs"),
        ("better_with_everything", rest.RIVALLED, "a fit of all links and friction at once leaves much less"),
    ],
)
def test_another_model_that_predicts_a_joint_better_is_told_as_that(flag: str, state: str, told: str) -> None:
    left = {"joint": "a", "share_of_residual_variance": 0.6, "expression": "0"}
    d: dict[str, Any] = {"joints": ["a"], "unexplained": [left], "motion_dependent": [False], flag: [True]}
    assert rest.state_of(d, 0) == ("open", state)
    (line,) = words.still_open(d)
    assert line.startswith(f"a: {told}")
    assert _how_much(d, left).startswith(told)
    # What else is known of the joint is told as well.
    _, more = words.still_open(d | {"cannot_tell": [True]})
    assert more == "a: what is left may be noise or an effect: it changes slowly."


def test_what_can_be_learned_is_one_number_on_the_whole_page() -> None:
    # The entry's own share is what the test runs leave beyond the training runs: no black box learns it.
    left = {"joint": "a", "share_of_residual_variance": 0.6, "expression": "0"}
    d: dict[str, Any] = {"joints": ["a"], "unexplained": [left], "motion_dependent": [True], "learnable_share": [0.54]}
    (line,) = words.still_open(d)
    assert line == "a: what is left depends on the motion; 54 % of it (variance) can be learned."
    assert _how_much(d, left) == "54 % can be learned from the motion"
    (more,) = words.still_open(d | {"worse_on_test": [True]})
    assert more.endswith("can be learned; the test runs leave more of it than the training runs.")
    parted = d | {"motion_dependent": [False], "worse_on_test": [True]}
    assert _how_much(parted, left) == "60 % is more than noise, or than the training runs leave"


def test_what_is_above_the_noise_stays_open() -> None:
    def told(moving: list[float]) -> list[str]:
        d: dict[str, Any] = {"joints": ["a", "b"], "noise_floor_high": [1.0, 1.0], "unexplained": []}
        for of, values in (("error", [4.5, 1.0]), ("error_moving", moving)):
            d[of] = {"test": {"after": {"rmse": values}}}
        return words.still_open(d | {"motion_dependent": [False, False], "cannot_tell": [False, False]})

    (standing,) = told([1.0, 1.0])
    assert standing.startswith("a: noise in motion, more at standstill")
    (above,) = told([3.0, 1.0])
    assert above.startswith("a: the held-out error is above the noise")


def test_what_the_runs_cannot_tell_stays_open() -> None:
    def alike(effect: str, joint: str, *others: tuple[str, str]) -> dict[str, Any]:
        apart = [
            {"effects": [{"effect": name, "joints": [at]}], "why": "the same", "motion_that_would_tell": f"try {at}"}
            for name, at in others
        ]
        return entry(effect, [joint], [], indistinguishable_from=apart)

    d: dict[str, Any] = {
        "joints": ["a", "b", "c"],
        "unexplained": [],
        "effects": [
            alike("coulomb_friction", "a", ("stribeck_friction", "a")),
            alike("coulomb_friction", "c", ("stribeck_friction", "c")),
            alike("armature", "b", ("link_inertia", "b"), ("link_inertia", "c")),
            alike("armature", "a") | {"confirmed": False, "indistinguishable_from": [None]},
        ],
    }
    assert words.still_open(d) == [
        "Coulomb friction on a and c cannot be told from Stribeck friction.",
        "Armature on b cannot be told from link inertia on b and c.",
    ]
    # What would tell is not the same for both links.
    assert words.alike(d, by_motion=True)[-2:] == [
        ("armature on b", "link inertia", "Try b"),
        ("armature on b", "link inertia on c", "Try c"),
    ]
    assert "3 of the names cannot be told from another cause: see what stays open." in words.certainty(d)
    two = [{"effect": name, "joints": ["b"]} for name in ("coulomb_friction", "torque_offset")]
    both = alike("asymmetric_coulomb_friction", "b")
    both["indistinguishable_from"] = [{"effects": two, "motion_that_would_tell": "rest"}]
    (line,) = words.still_open(d | {"effects": [both]})
    assert line == "Asymmetric Coulomb friction on b cannot be told from Coulomb friction with torque offset."
    assert words.opens(d)
    assert not words.opens(d | {"effects": []})


def test_numbers_that_the_runs_leave_open_stay_open() -> None:
    mass, com = parameter("mass", 4.0, 0.1, "kg"), parameter("com_x", 0.1, 0.01, "m")
    payload = entry("payload", [], [mass, com], undetermined_parameters=["mass"], indistinguishable_from=[])
    d: dict[str, Any] = {"joints": ["a"], "unexplained": [], "effects": [payload]}
    assert words.still_open(d) == ["Payload: mass left to the starting model."]
    links = [p | {"joint": joint} for joint in ("a", "b") for p in (mass, com)]
    names = [f"{p['joint']}/{p['name']}" for p in links]
    payload |= {"parameters": links, "undetermined_parameters": names}
    assert words.still_open(d) == ["Payload: 4 of 4 numbers left to the starting model."]


def test_an_effects_row_tells_every_setting() -> None:
    def told(effect: str, **settings: Any) -> str:
        torque = parameter("coulomb_torque", 2.0, 0.1, "N m", "a")
        return "; ".join(row_words(entry(effect, ["a"], [torque]) | {"settings": settings}))

    assert told("asymmetric_coulomb_friction", at_rest="middle", sign_width=0.01) == (
        "sign turns over 0.01 rad/s; at rest it holds the middle of its two torques"
    )
    assert told("joint_coupling", from_joint="b", rows="both", sign_of="sum") == "of a and b; of the sum of both speeds"
    assert told("joint_coupling", from_joint="b", rows="own", sign_of="partner") == "on a from b"
    assert told("joint_spring", shape="piecewise", knots=[-1.0, 0.12345, 2.0]) == (
        "piecewise in q; knots: -1, 0.1235, 2"
    )
    assert told("torque_offset", held_within=1.22) == "held within: 1.22"
    # Friction in proportion to a load has a coefficient without a unit; its joint turns all the same, or slides.
    load = entry("load_dependent_friction", ["a"], [parameter("load_coefficient", 0.1, 0.01, "1", "a")])
    for slides, length in (((), "rad"), (("a",), "m"), (("b",), "rad")):
        assert row_words(load | {"settings": {"sign_displacement": 1e-4}}, slides) == [
            f"sign turns over 0.0001 {length}"
        ]
    # One that comes later is told too.
    assert told("viscous_friction", form="cubic") == "form: cubic"


def test_the_largest_cause_is_named_first() -> None:
    delay = entry("time_delay", [], [parameter("delay", 1e-6, 1e-7, "s")])
    friction = entry("viscous_friction", ["a"], [parameter("viscous_coefficient", 2.0, 0.1, "N m s/rad", "a")])
    d = {"effects": [delay, friction], "joints": ["a"]}
    assert [line.split()[0] for line in missing(d, {"viscous_friction": 3.0, "time_delay": 1e-5})] == [
        "Viscous",
        "Time",
    ]
    assert [line.split()[0] for line in missing(d)] == ["Time", "Viscous"]


def test_many_runs_are_drawn_alike_and_few_by_name() -> None:
    def drawn(runs: int) -> dict[str, Any]:
        points = tuple(float(k) for k in range(20))
        curve = Curve("j", "dq", 0.1, points, points, points, tuple(k % runs for k in range(20)))
        return dict(curve_figure(curve, tuple(f"r{k}" for k in range(runs)), "").values)

    few, many = drawn(3), drawn(10)
    assert [few[f"label{k}"] for k in range(3)] == ["run r0", "run r1", "run r2"]
    assert many["label0"] == "10 held-out runs"
    assert len(many["x0"]) == 20
    assert "label1" not in many


def test_a_name_is_confirmed_only_where_the_held_out_runs_surely_gain() -> None:
    def said(value: float, confirmed: bool = True) -> str:
        change = {"value": value, "std_error": 0.1}
        return words.standing(entry("armature", ["a"], [], confirmed=confirmed, test_change=change))

    assert (said(-0.3), said(-0.1), said(0.3, False)) == ("confirmed", "undecided", "contradicted")
    chance = entry("armature", ["a"], [], confirmed=True, test_change={"value": -0.1, "std_error": 0.1})
    sure = chance | {"joints": ["b"], "test_change": {"value": -0.5, "std_error": 0.1}}
    against = chance | {"joints": ["c"], "confirmed": False}
    for one in (chance, sure, against):
        one["indistinguishable_from"] = []

    def told(*effects: dict[str, Any]) -> str:
        (line,) = words.certainty({"effects": effects, "joints": ["a", "b", "c"]})
        return line

    assert told(chance, sure) == (
        "The held-out runs confirm 1 of 2 names: with them they are predicted better. "
        "Not decided by them: 1, armature (a). Contradicted and not in the model: none."
    )
    assert told(chance, against) == (
        "The held-out runs confirm none of 2 names. "
        "Not decided by them: 1, armature (a). Contradicted and not in the model: 1, armature (c)."
    )
    assert told(sure, sure) == "The held-out runs confirm all 2 names: with them they are predicted better."
    assert told(sure) == "The held-out runs confirm the name: with it they are predicted better."
    assert told(chance) == (
        "The held-out runs do not confirm the name. "
        "Not decided by them: 1, armature (a). Contradicted and not in the model: none."
    )


@pytest.mark.parametrize(
    ("after", "expected"),
    [([1.0, 2.0], "it stays as it was."), ([0.5, 1.0], "it becomes 2 times smaller."), ([0.5, 2.0], "1 to 2 times")],
)
def test_an_error_that_stays_is_not_told_to_become_smaller(after: list[float], expected: str) -> None:
    error = {"rmse": [1.0, 2.0], "relative_error": 0.2}
    test = {"before": error, "after": error | {"rmse": after}, "after_confirmed": error | {"rmse": after}}
    told = words.gains({"effects": [{"confirmed": True}], "error": {"test": test}})
    assert expected in told


def test_names_that_the_held_out_runs_do_not_decide_come_last_and_say_so() -> None:
    def found(effect: str, joint: str, change: float) -> dict[str, Any]:
        value = parameter("offset" if effect == "torque_offset" else "armature", 2.0, 0.1, "N m")
        return entry(effect, [joint], [value], confirmed=True, test_change={"value": change, "std_error": 0.175})

    d = {
        "effects": [found("torque_offset", "a", -0.14), found("armature", "a", -0.6), found("armature", "b", 0.1)],
        "joints": ["a", "b"],
    }
    assert missing(d, {"torque_offset": 89.0, "armature": 0.5}) == [
        "Armature on a: 2.00 ± 0.10 N m",
        "Torque offset on a: offset 2.00 ± 0.10 N m (not decided by the held-out runs)",
        "Armature on b: 2.00 ± 0.10 N m (not decided by the held-out runs)",
    ]


def test_an_effect_is_found_again_in_the_diagnosis_whatever_json_made_of_its_settings() -> None:
    assert _key("x", ("a",), {"links": ("a", "b"), "w": 0.1 + 0.2}) == _key("x", ["a"], {"links": ["a", "b"], "w": 0.3})
    assert _key("x", ("a",), {"links": ("a", "b")}) != _key("x", ("a",), {"links": ("a",)})


@pytest.mark.parametrize(
    ("effect", "kind"),
    [("hysteresis_friction", "friction"), ("load_dependent_friction", "friction"), ("joint_spring", "position"),
     ("armature", "rotor"), ("payload", "body"), ("torque_offset", "offset"), ("time_delay", "reading")],
)  # fmt: skip
def test_effects_stand_under_their_own_heading(effect: str, kind: str) -> None:
    assert kind_of(effect) == kind


def span(figure: Drawing) -> tuple[float, float]:
    """The range of the axis."""
    value = figure.values["range"]
    assert isinstance(value, tuple)
    return value


def test_a_knock_does_not_flatten_the_picture_and_is_counted() -> None:
    x = np.linspace(-1, 1, 400)
    law = np.sign(x)
    left = np.zeros(400)
    left[[7, 300]] = 40.0, -40.0
    curve = Curve("j", "dq", 0.05, tuple(x), tuple(law + left), tuple(law), (0,) * 400)
    figure = curve_figure(curve, ("run_1",), "j")
    low, high = span(figure)
    assert -1.5 < low < -1.0 < 1.0 < high < 1.5
    assert figure.values["title"] == "j: 2 of 400 points lie beyond the picture"
    calm = curve_figure(Curve("j", "dq", 0.05, tuple(x), tuple(law), tuple(law), (0,) * 400), ("run_1",), "").values
    assert calm["title"] == ""
    trace = Trace("run_1", "j", tuple(x), tuple(law + left), tuple(law), tuple(law))
    assert max(span(torque_figure(trace, 0.05))) < 1.0


def test_steps_read_as_a_story() -> None:
    def dropped(joint: str) -> SearchStep:
        return SearchStep("drop", "torque_offset", joint)

    tried = Candidate("armature", "a", "", 1.0, 0.5, 0.1, True, "accepted")
    steps = [
        SearchStep("start", "", ""),
        dropped("a"),
        dropped("b"),
        SearchStep("add", "armature", "a", (tried,)),
        dropped("c"),
        SearchStep("replace", "payload", "", (), ("link inertia (c)",)),
    ]
    lines = [f"{first}: {_title(own)}" for first, own in _together(steps)]
    assert lines[1:] == [
        "2: drop torque offset (a), torque offset (b)",
        "4: add armature (a)",
        "5: drop torque offset (c)",
        "6: replace link inertia (c) by payload",
    ]


def test_a_replacement_says_what_went_and_what_came() -> None:
    old, kept, new = Term("payload"), Term("armature", 0), Term("link_inertia", 1)
    step = Step("replace", None, (kept, new), (), (0.0,))
    assert _swapped((old, kept), step) == (new, (old,))
    assert _swapped((old, kept), Step("drop", old, (kept,), (), (0.0,))) == (None, ())


def test_runs_bear_their_files_names() -> None:
    assert [run_title(n) for n in ("test:run_3", "train:a", "plain")] == ["run_3", "a", "plain"]


def test_a_number_that_is_rounding_is_nothing_and_small_ones_are_what_they_are():
    assert [words.number(value) for value in (4.494e-20, -2e-17, 0.0, 2.03e-8, -1.5)] == [
        "0",
        "0",
        "0",
        "2.03e-08",
        "-1.5",
    ]
    assert words.with_error(-1.763e-19, None, "kg m^2").startswith("0 ")
    assert words.number(float("nan")) == "nan"
    assert words.number(None) == "–"
