"""The page of one loop: says what was found and nothing else, draws it from data, and works in a browser."""

from __future__ import annotations

import copy
import re
import subprocess
import sys
from dataclasses import replace
from html.parser import HTMLParser
from importlib.resources import files

import numpy as np
import pytest
from tests.browser import look

from hybrid_dynamics.effects import Effect
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.loop import LoopResult, close_loop
from hybrid_dynamics.loop_report import words
from hybrid_dynamics.loop_report.content import Content, Curve, read_content, write_content
from hybrid_dynamics.loop_report.gather import _described, _laws, gather
from hybrid_dynamics.loop_report.plots import drawn, law_of
from hybrid_dynamics.loop_report.report import content_html
from hybrid_dynamics.loop_report.sections import explanation_of
from hybrid_dynamics.loop_report.templates import KEPT, library, template
from hybrid_dynamics.robots import Robot, find_description
from hybrid_dynamics.simulation.excitation import excitations

COULOMB, ARMATURE = 1.5, 0.3


@pytest.fixture(scope="module")
def result() -> LoopResult:
    fixed = (*(f"panda_joint{j}" for j in (4, 5, 6, 7)), "panda_finger_joint1", "panda_finger_joint2")
    robot = Robot.from_urdf(find_description("panda.urdf"), lock=fixed)
    planted = [
        Effect("coulomb_friction", ("panda_joint2",), {"coulomb_torque": COULOMB}),
        Effect("viscous_friction", ("panda_joint2",), {"viscous_coefficient": 2.0}),
        Effect("armature", ("panda_joint3",), {"armature": ARMATURE}),
    ]
    train, test = excitations(robot, planted, train=2, test=2, duration=6.0)
    return close_loop(robot, train, test)


@pytest.fixture(scope="module")
def content(result: LoopResult) -> Content:
    return gather(result, "simulated")


@pytest.fixture(scope="module")
def page(content: Content) -> str:
    return content_html(content)


class Structure(HTMLParser):
    """Ids, links into the page, and the text of the section ``answer``."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.ids: list[str] = []
        self.links: list[str] = []
        self.outside: list[str] = []
        self.answer = ""
        self._depth = 0
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        known = dict(attrs)
        if known.get("id"):
            self.ids.append(str(known["id"]))
        for name in ("href", "src"):
            target = known.get(name) or ""
            if target.startswith("#"):
                self.links.append(target[1:])
            elif target and not target.startswith("data:"):
                self.outside.append(target)
        if tag == "section":
            self._depth = 1 if known.get("id") == "answer" else 0

    def handle_data(self, data: str) -> None:
        if self._depth:
            self.answer += data


def test_the_first_screen_names_what_was_planted_with_value_and_unit_and_nothing_else(content, page):
    answer = " ".join(Structure(page).answer.split())
    for what, true, unit in (
        ("Coulomb friction on panda_joint2: Coulomb torque", COULOMB, "N m"),
        ("Armature on panda_joint3:", ARMATURE, "kg m²"),
    ):
        found = re.search(rf"{what} ([\d.]+) ± ([\d.]+) {unit}", answer)
        assert found
        assert float(found[1]) == pytest.approx(true, rel=0.03)
    for absent in ("payload", "Payload", "offset", "gravity tilt", "panda_joint1:"):
        assert absent not in answer.split("What it buys")[0]
    before, after = (content.diagnosis["error"]["test"][k]["rmse"] for k in ("before", "after"))
    assert f"{before[1]:#.3g} → {after[1]:#.3g}" in answer


def test_the_page_is_whole_and_the_same_every_time(content, page):
    seen = Structure(page)
    assert len(seen.ids) == len(set(seen.ids))
    assert set(seen.links) <= set(seen.ids)
    assert not seen.outside
    assert content_html(content) == page
    assert page.count("JSON.parse(document.getElementById") == 1
    library = max(re.findall(r"(?s)<script>(.*?)</script>", page), key=len)
    assert len(library) < 1_500_000
    assert '<meta name="viewport"' in page


def test_every_effect_is_linked_to_its_evidence_and_its_explanation(content, page):
    links = Structure(page).links
    for effect in ("coulomb_friction", "viscous_friction", "armature"):
        assert f"what-{effect}" in links
        assert explanation_of(effect) in page.replace("&gt;", ">").replace("&#39;", "'")
    assert "evidence-panda-joint2-friction" in links
    assert "effect-coulomb-friction-panda-joint2" in links


def test_what_is_drawn_is_the_planted_law_and_what_is_left_is_noise(content):
    friction, rotor = content.groups
    assert (friction.kind, rotor.kind) == ("friction", "rotor")
    (curve,) = friction.curves
    added, left = np.array(curve.added), np.array(curve.missing) - np.array(curve.added)
    # Near a reversal the filter's window of 40 ms holds both signs, up to 10 rad/s² times the window.
    fast = np.abs(curve.x) > 0.4
    law = COULOMB * np.sign(curve.x) + 2.0 * np.array(curve.x)
    assert np.abs(added - law)[fast].max() < 0.03 * np.abs(law).max()
    assert np.sqrt(np.mean(left[fast] ** 2)) == pytest.approx(curve.noise, rel=0.25)
    # The rms of Ia ddq over the drawn samples is that of the whole run.
    (drawn,) = rotor.curves
    assert rotor.contribution[0] == pytest.approx(ARMATURE * np.sqrt(np.mean(np.square(drawn.x))), rel=0.1)


def test_a_law_that_turns_its_sign_is_not_averaged_across_zero():
    x = np.linspace(-1.0, 2.0, 900)
    curve = Curve("j", "dq", 0.1, tuple(x), tuple(x), tuple(np.sign(x)), (0,) * len(x))
    centre, mean, low, high = law_of(curve)
    assert np.array_equal(mean, np.sign(centre))
    assert np.array_equal(low, high)


def contradicted(content: Content) -> Content:
    """The same result had the test runs spoken against the rotor inertia (schema 2)."""
    d = copy.deepcopy(dict(content.diagnosis))
    d["schema"] = 2
    for entry in d["effects"]:
        good = entry["effect"] != "armature"
        entry |= {"confirmed": good, "test_change": {"value": -0.2 if good else 0.07, "std_error": 0.01}}
        if entry["effect"] == "coulomb_friction":
            slow = {"effect": "stribeck_friction", "joints": entry["joints"], "settings": {}}
            told = {"why": "the same torque", "motion_that_would_tell": "Move slowly."}
            entry["indistinguishable_from"] = [{"effects": [slow], **told}]
        if not good:
            entry["why_not"] = "a correlated partner explains as much"
    for of in ("error", "error_moving"):
        for split in ("train", "test"):
            d[of][split]["after_confirmed"] = d[of][split]["before"]
    d |= {
        "noise_floor_low": [0.8 * v for v in d["noise_floor"]],
        "noise_floor_high": [1.2 * v for v in d["noise_floor"]],
        "learnable_share": [0.0, 0.6, 0.0],
        "motion_dependent": [False, True, False],
        "cannot_tell": [False, False, True],
        "autocorrelation": [0.0, 0.5, 0.4],
        "unexplained": [{"joint": "panda_joint2", "share_of_residual_variance": 0.6, "expression": "0.3*cos(q1)"}],
        "provenance": {
            "version": "9.9",
            "command": "hybrid-dynamics close-loop --robot <r>.urdf",
            "logs": [{"file": "a.csv", "sha256": "abc"}],
        },
        "extrapolation": [
            {
                "joint": "panda_joint1", "variable": "dq", "unit": "rad/s", "train": [-1.0, 1.0], "test": [-2.0, 2.0],
                "share_outside": 0.3, "beyond": 0.5,
            }
        ],
    }  # fmt: skip
    return replace(content, diagnosis=d)


def test_contradicted_names_alarms_and_origin_are_shown_as_such(content):
    page = content_html(contradicted(content))
    answer = " ".join(Structure(page).answer.split())
    assert "Armature" not in answer.split("What it buys")[0]
    assert "confirm 2 of 3 names" in answer
    assert "Not decided by them: none. Contradicted and not in the model: 1, armature (panda_joint3)." in answer
    assert "panda_joint2: what is left depends on the motion; 60 % of it" in answer
    assert "still depends on the motion" in answer
    assert "cannot be told from noise" in answer
    assert "30 % of the speed of panda_joint1" in answer
    # What cannot be told apart stays open, on the first screen and in the section that it links.
    assert "Coulomb friction on panda_joint2 cannot be told from Stribeck friction." in answer
    assert re.search(r'<section id="left".*What these runs cannot tell apart.*Move slowly.*</section>', page, re.S)
    assert "✗ contradicted" in page
    assert "+7 ± 1 %" in page
    # What is said of the gain is said of the model that is kept.
    d = content.diagnosis
    assert f"to {words.share(d['error']['test']['before']['relative_error'], 3)} of the torque" in answer
    assert "close-loop --robot &lt;r&gt;.urdf" in page
    assert "sha256 abc" in page
    found = Structure(page)
    assert len(found.ids) == len(set(found.ids))
    assert set(found.links) <= set(found.ids)


def test_the_numbers_of_links_are_told_beside_those_of_the_urdf(result, content):
    robot = result.model.robot
    body = robot.model.inertias[robot.joint_ids[1]]
    new = {"name": "mass", "joint": "panda_joint2", "value": body.mass + 0.5, "std_error": 0.02, "unit": "kg"}
    other = {"name": "mass", "joint": "panda_joint3", "value": 9.0, "std_error": 0.01, "unit": "kg"}
    links = {
        "effect": "inertial_parameters", "joints": [], "settings": {"links": ["panda_joint2", "panda_joint3"]},
        "parameters": [new, other], "undetermined_parameters": ["panda_joint3/mass"], "indistinguishable_from": [],
    }  # fmt: skip
    d = dict(content.diagnosis) | {"effects": [links]}
    before = _described(result, d)
    assert len(before) == 20
    assert before["panda_joint2/mass"] == pytest.approx(body.mass, rel=1e-4)
    assert before["panda_joint2/com_y"] == pytest.approx(body.lever[1], rel=1e-4)
    answer = Structure(content_html(replace(content, diagnosis=d, groups=(), described=before))).answer
    told = f"decide 1 of 2 numbers; most surely changed is mass of panda_joint2, {body.mass:.3g} → "
    assert told in answer.replace("\u00a0", " ")
    assert _described(result, content.diagnosis) == {}


def test_a_formula_for_what_is_left_is_told_with_what_it_is_worth(result, content):
    law = "0.8*cos(3*q1)"
    torque = [0.8 * np.cos(3 * run.q[:, 0]) for run in result.test]
    off = [replace(run, tau=run.tau + np.outer(t, [0, 1, 0])) for run, t in zip(result.test, torque, strict=True)]
    d = dict(content.diagnosis) | {
        "unexplained": [{"joint": "panda_joint2", "share_of_residual_variance": 0.6, "expression": law}]
    }
    (found,) = _laws(replace(result, test=tuple(off)), d)
    moving = np.concatenate([run.mask[:, 1] for run in result.test])
    planted = float(np.mean(np.concatenate(torque)[moving] ** 2))
    assert found.after == pytest.approx(content.diagnosis["error_moving"]["test"]["after"]["rmse"][1], rel=1e-3)
    assert found.before**2 - found.after**2 == pytest.approx(planted, rel=0.05)
    page = content_html(replace(content, diagnosis=d, laws=(found,)))
    told = f"takes {words.share(1 - (found.after / found.before) ** 2)} of the test runs&#39; error (variance; rms"
    assert f"{told} {found.before:#.3g} → " in page
    assert _laws(result, d | {"unexplained": [{"joint": "panda_joint2", "expression": "0"}]}) == []
    # Pages of earlier results have none.
    assert "error (variance; rms" not in content_html(replace(content, diagnosis=d))


def test_nothing_missing_is_said_plainly(content):
    d = copy.deepcopy(dict(content.diagnosis)) | {"effects": [], "verdict": "nothing_missing"}
    answer = Structure(content_html(replace(content, diagnosis=d, groups=(), steps=()))).answer
    assert "Nothing was named." in answer
    assert "Nothing missing." in answer


def test_content_survives_the_file_and_a_broken_file_is_refused_by_name(content, tmp_path):
    path = tmp_path / "page.json"
    write_content(path, content)
    assert content_html(read_content(path)) == content_html(content)
    path.write_text(path.read_text()[:-40])
    with pytest.raises(InputError, match=r"page\.json.*run the stage"):
        read_content(path)


@pytest.mark.parametrize(
    ("value", "error", "shown"),
    [
        (2.79586, 0.0176, "2.796 ± 0.018 kg"),
        (43.66, 1.71, "43.7 ± 1.7 kg"),
        (1234.0, 56.0, "1234 ± 56 kg"),
        (0.5, None, "0.5 kg"),
        (0.25, 0.0, "0.25 kg"),
    ],
)
def test_a_value_has_as_many_decimals_as_its_error_warrants(value, error, shown):
    assert words.with_error(value, error, "kg") == shown


def luminance(colour: str) -> float:
    part = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    linear = np.where(part <= 0.03928, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


@pytest.mark.parametrize("block", [0, 1], ids=["light", "dark"])
def test_text_has_the_contrast_that_wcag_asks_for(block):
    css = files("hybrid_dynamics.loop_report").joinpath("report.css").read_text("utf-8")
    colours = dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6});", re.findall(r"(?s):root \{(.*?)\}", css)[block]))
    for paper in ("paper", "soft"):
        for ink in ("ink", "muted", "accent", "good", "bad", "warn"):
            low, high = sorted((luminance(colours[paper]), luminance(colours[ink])))
            assert (high + 0.05) / (low + 0.05) >= 4.5, (paper, ink)


@pytest.mark.slow
@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_the_page_in_a_browser(page, content, dark):
    html = content_html(contradicted(content)) if dark else page
    for width, seen in look(html, (1100, 400), dark).items():
        assert seen.errors == []
        assert seen.wide == []
        assert seen.scroll <= seen.width == width
        assert seen.twice == seen.dead == []
        assert seen.bars > 1
        assert seen.uneven == []
        assert seen.drawn == seen.plots > 4
        assert seen.paper == ("rgb(21, 24, 28)" if dark else "rgb(255, 255, 255)")


@pytest.mark.parametrize("kind", KEPT)
def test_a_figure_that_is_kept_is_the_one_that_the_library_draws(kind):
    # After a change of a figure: templates.py says how to write the file anew.
    assert template(kind) == drawn(kind)


def test_the_script_of_the_page_is_the_librarys():
    from bokeh.resources import INLINE

    assert library() in str(INLINE.js_raw[0])


def test_a_usual_page_is_written_without_loading_the_library():
    code = "import sys; from hybrid_dynamics.loop_report.templates import *; [template(k) for k in KEPT]; library()"
    done = subprocess.run(
        [sys.executable, "-c", f"{code}; print('bokeh' in sys.modules)"], capture_output=True, text=True
    )
    assert done.stdout == "False\n", done.stderr
