"""What the data cannot tell: sets of effects that would explain as much, the noise, motion that was not seen."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hybrid_dynamics.effects import Effect, Term, predict, with_effects
from hybrid_dynamics.effects.base import HELD
from hybrid_dynamics.loop import LoopSettings, Model, close_loop
from hybrid_dynamics.loop.alternatives import indistinguishable
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.held import Held
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory

LINK = """
<joint name="j{k}" type="revolute"><parent link="l{p}"/><child link="l{k}"/><origin xyz="{x} 0 0"/><axis xyz="0 1 0"/>
  <limit lower="-3" upper="3" effort="50" velocity="5"/></joint>
<link name="l{k}"><inertial><origin xyz="0.25 0 0"/><mass value="2"/>
  <inertia ixx="0.01" iyy="0.04" izz="0.04" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
TILT = Effect("gravity_tilt", (), {"roll": 0.0, "pitch": 0.035})


@pytest.fixture(scope="module")
def arm(tmp_path_factory) -> Robot:
    """Two links that swing in a vertical plane."""
    path = Path(tmp_path_factory.mktemp("arm")) / "arm.urdf"
    links = LINK.format(k=1, p=0, x=0) + LINK.format(k=2, p=1, x=0.5)
    path.write_text(f'<robot name="arm"><link name="l0"/>{links}</robot>')
    return Robot.from_urdf(path)


def swing(arm: Robot, reach: float, seed: int, effects=(TILT,), about=(0.5, 0.4)) -> Trajectory:
    """8 s of ``arm`` with ``effects``, its joints swinging by ``reach`` [rad] ``about`` a posture; noise 0.15 N m."""
    rng = np.random.default_rng(seed)
    time = np.arange(4000) / 500
    w = 2 * np.pi * np.array([0.4, 0.9, 1.3])[:, None]
    phase, size = rng.uniform(0, 2 * np.pi, (3, 2)), reach / 3 * rng.uniform(0.5, 1, (3, 2))
    angle = w * time[:, None, None] + phase
    q = np.array(about) + (size * np.sin(angle)).sum(axis=1)
    dq, ddq = (size * w * np.cos(angle)).sum(axis=1), -(size * w**2 * np.sin(angle)).sum(axis=1)
    changed, _ = with_effects(arm, effects)
    tau = changed.inverse_dynamics(q, dq, ddq) + rng.normal(size=q.shape) * 0.15
    return Trajectory(f"run_{seed}", "train", time, {"q": q, "tau": tau})


def alternatives(arm: Robot, reach: float) -> list[tuple[set, str]]:
    runs = [swing(arm, reach, seed) for seed in range(4)]
    diagnosis = close_loop(arm, runs[:3], runs[3:]).diagnosis.to_json()
    assert [e["effect"] for e in diagnosis["effects"]] == ["gravity_tilt"]
    return [
        ({(e["effect"], *e["joints"]) for e in other["effects"]}, other["motion_that_would_tell"])
        for other in diagnosis["effects"][0]["indistinguishable_from"]
    ]


def test_two_offsets_together_are_as_good_as_a_tilt_where_gravity_hardly_turns(arm):
    # Within 0.03 rad of one posture the torque of a tilt is constant on both joints.
    offsets = {("torque_offset", "j1"), ("torque_offset", "j2")}
    told = {frozenset(names): motion for names, motion in alternatives(arm, 0.03)}
    assert frozenset(offsets) in told
    assert "all the way round" in told[frozenset(offsets)]
    # One of them alone is none: the other joint would be left unexplained.
    assert not any(frozenset([offset]) in told for offset in offsets)


def test_a_wide_motion_tells_the_tilt_from_offsets(arm):
    assert alternatives(arm, 1.5) == []


def test_the_noise_floor_holds_where_one_run_moves_farther_than_the_others(arm):
    reach = (0.03, 0.03, 0.9, 0.03)
    runs = [swing(arm, r, seed, (), (0.0, 0.0)) for seed, r in enumerate(reach)]
    diagnosis = close_loop(arm, runs[:3], runs[3:]).diagnosis.to_json()
    assert diagnosis["verdict"] == "nothing_missing"
    # Nothing is missing, so what is left of the torque is the noise, in all four runs.
    left = [np.square(diagnosis["error_moving"][part]["after"]["rmse"]) for part in ("train", "test")]
    noise = np.sqrt(0.75 * left[0] + 0.25 * left[1])
    np.testing.assert_allclose(diagnosis["noise_floor"], noise, rtol=0.2)


def listed(diagnosis: dict[str, Any], name: str) -> set[frozenset[str]]:
    """What is said to do as well as ``name`` on the first joint."""
    entry = next(e for e in diagnosis["effects"] if (e["effect"], e["joints"]) == (name, ["j1"]))
    return {frozenset(e["effect"] for e in a["effects"]) for a in entry["indistinguishable_from"]}


@pytest.mark.parametrize("offset", [1.2, 0.0], ids=["with an offset", "alone"])
def test_friction_and_an_offset_may_be_friction_that_is_rougher_one_way(arm, offset):
    runs = []
    for seed in range(4):
        run = swing(arm, 1.0, seed, effects=())
        speed = np.gradient(run["q"][:, 0], run.time)
        tau = run["tau"] + np.outer(2.7 * np.sign(speed) + offset, [1, 0])
        runs.append(run.with_signals(tau=tau))
    diagnosis = close_loop(arm, runs[:3], runs[3:]).diagnosis.to_json()
    names = {(e["effect"], *e["joints"]) for e in diagnosis["effects"]}
    if offset:
        # One cause rather than two; nothing rests here, where the offset would show.
        assert names == {("asymmetric_coulomb_friction", "j1")}
        assert {"coulomb_friction", "torque_offset"} in listed(diagnosis, "asymmetric_coulomb_friction")
    else:
        # Without an offset there is nothing that a second number would stand for.
        assert names == {("coulomb_friction", "j1")}
        assert {"asymmetric_coulomb_friction"} not in listed(diagnosis, "coulomb_friction")


@pytest.mark.parametrize(("harmonic", "is_ripple"), [(21.0, True), (5.0, False)])
def test_a_ripple_is_found_at_its_harmonic_in_a_short_range_and_none_in_less_than_two_periods(arm, harmonic, is_ripple):
    """Over 0.8 rad harmonics are known to two units at first; what is slower than two periods is no ripple."""
    runs = []
    for seed in range(4):
        run = swing(arm, 0.5, seed, effects=())
        tau = run["tau"] + np.outer(1.5 * np.sin(harmonic * run["q"][:, 0] + 0.3), [1, 0])
        runs.append(run.with_signals(tau=tau))
    span = np.ptp(np.concatenate([run["q"][:, 0] for run in runs[:3]]))
    assert 2 * np.pi / span > 5.0  # one period over the range, in the unit of a harmonic
    diagnosis = close_loop(arm, runs[:3], runs[3:]).diagnosis.to_json()
    ripples = [e for e in diagnosis["effects"] if e["effect"] == "torque_ripple"]
    if is_ripple:
        values = {p["name"]: p["value"] for p in ripples[0]["parameters"]}
        assert values["harmonic"] == pytest.approx(harmonic, rel=0.02)
        assert values["amplitude"] == pytest.approx(1.5, rel=0.05)
        assert ripples[0]["confirmed"]
    else:
        assert ripples == []


@pytest.mark.parametrize("gain", [True, False], ids=["gain", "friction"])
def test_a_gain_of_a_joint_that_is_mostly_friction_is_named_or_said_to_be_as_good(arm, gain):
    """Asked what changed: a torque read 3 % too large is, on a joint that mostly rubs, as good as rougher friction."""
    friction = Effect("coulomb_friction", ("j2",), {"coulomb_torque": 20.0}, {"sign_width": 0.01})
    calibrated = Model(arm, (friction,))
    runs = []
    for seed in range(4):
        run = swing(arm, 0.4, seed, effects=())
        speed = np.gradient(run["q"], run.time, axis=0)
        size, factor = (20.0, 1.03) if gain else (22.0, 1.0)
        tau = run["tau"] + size * np.tanh(speed / 0.01) * [0, 1]
        runs.append(run.with_signals(tau=tau * [1, factor]))
    diagnosis = close_loop(arm, runs[:3], runs[3:], start=calibrated).diagnosis.to_json()
    names = {(e["effect"], *e["joints"]) for e in diagnosis["effects"]}
    alike = {
        (a["effects"][0]["effect"], *a["effects"][0]["joints"])
        for e in diagnosis["effects"]
        for a in e["indistinguishable_from"]
        if len(a["effects"]) == 1
    }
    if gain:
        assert ("torque_gain", "j2") in names | alike
    else:
        # A gain would make the weight of the link larger, too, and that is not recorded.
        assert names == {("coulomb_friction", "j2")}
        assert ("torque_gain", "j2") not in alike


@pytest.mark.parametrize(("reach", "alike"), [(0.03, True), (1.5, False)], ids=["tilt, one posture", "offsets, wide"])
def test_one_cause_that_does_as_well_as_several_names_together_is_listed_with_each(arm, reach, alike):
    runs = [swing(arm, reach, seed, effects=(TILT,) if alike else ()) for seed in range(4)]
    if not alike:
        runs = [run.with_signals(tau=run["tau"] + [0.6, 0.2]) for run in runs]
    settings = LoopSettings()
    judge, candidates, _ = gather(Model(arm), read_motion(arm, runs[:3], runs[3:], settings), settings)
    offsets = [t for t in candidates if t.effect == "torque_offset"]
    # The same cause in another setting does as well, and is the same cause.
    twice = [replace(t, settings=((HELD, 9.0),)) for t in candidates if t.effect == "gravity_tilt"]
    assert twice
    judge = judge.adding(twice).at(offsets)
    for others in indistinguishable(judge, offsets, [*candidates, *twice]).values():
        tilt = [o["why"] for o in others if {e["effect"] for e in o["effects"]} == {"gravity_tilt"}]
        assert len(tilt) == alike
        assert all("torque_offset of j1 and torque_offset of j2" in why for why in tilt)


@pytest.mark.parametrize("gain", [1.1, 1.0], ids=["gain", "friction"])
def test_one_gain_of_all_joints_is_not_told_as_rougher_friction_and_heavier_links_on_each(arm, gain):
    """Asked what changed of an arm whose calibration is off by a law that the catalogue lacks."""
    friction = {"coulomb_torque": 6.0}
    calibrated = Model(
        arm, tuple(Effect("coulomb_friction", (j,), friction, {"sign_width": 0.01}) for j in ("j1", "j2"))
    )
    runs = []
    for seed in range(4):
        run = swing(arm, 1.0, seed, effects=())
        speed = np.gradient(run["q"], run.time, axis=0)
        size = 6.0 if gain > 1 else np.array([6.0, 7.0])
        lacking = 0.3 * np.sin(7 * run["q"][:, [0]] * run["q"][:, [1]]) * [1, 1]
        tau = gain * (run["tau"] + size * np.tanh(speed / 0.01) + lacking)
        runs.append(run.with_signals(tau=tau))
    diagnosis = close_loop(arm, runs[:3], runs[3:], start=calibrated.with_misfit([0.25, 0.25])).diagnosis
    names = [(e.effect.effect, *e.effect.joints) for e in diagnosis.effects]
    if gain > 1:
        assert names == [("torque_gain",)]
        assert diagnosis.effects[0].effect.parameters["gain"] == pytest.approx(gain, rel=0.02)
    else:
        assert names == [("coulomb_friction", "j2")]


@pytest.mark.parametrize("gain", [1.05, 1.0], ids=["gain", "offset"])
def test_one_gain_of_all_joints_is_listed_where_all_links_and_one_joint_are_named(arm, gain):
    """What is recorded too large on all joints is asked of all joints, however few of them have a name."""
    runs = [swing(arm, 1.0, seed, effects=()) for seed in range(4)]
    runs = [run.with_signals(tau=gain * run["tau"] + ([0, 0] if gain > 1 else [0, 0.6])) for run in runs]
    settings = LoopSettings()
    judge, candidates, _ = gather(Model(arm), read_motion(arm, runs[:3], runs[3:], settings), settings)
    terms = [next(t for t in candidates if t.effect == "inertial_parameters"), Term("torque_offset", 1)]
    judge = judge.at(terms)
    for others in indistinguishable(judge, terms, candidates).values():
        told = [o["why"] for o in others if o["effects"] == [{"effect": "torque_gain", "joints": []}]]
        # Control: an offset is no multiple of the torque, whatever stands for the links.
        together = any("inertial_parameters and torque_offset of j2" in why for why in told)
        assert together is (gain > 1)


def test_what_is_structurally_the_same_is_told_once_and_not_again_as_one_that_predicts_as_well(arm):
    runs = [swing(arm, 1.0, seed, effects=()) for seed in range(4)]
    runs = [run.with_signals(tau=1.05 * run["tau"]) for run in runs]
    settings = LoopSettings()
    judge, candidates, _ = gather(Model(arm), read_motion(arm, runs[:3], runs[3:], settings), settings)
    gain = Term("torque_gain", None)
    judge = judge.adding([gain]).at([gain])
    listed = indistinguishable(judge, [gain], candidates)[gain]
    links = [o["why"] for o in listed if o["effects"] == [{"effect": "inertial_parameters", "joints": []}]]
    assert len(links) == 1
    assert links[0].startswith("structurally the same")
    # Control: without them among the candidates it is the same one, not found but declared.
    fewer = [c for c in candidates if c.effect != "inertial_parameters"]
    assert links == [o["why"] for o in indistinguishable(judge, [gain], fewer)[gain] if "structurally" in o["why"]]


@pytest.mark.parametrize(("pace", "alike"), [(0.1, True), (1.0, False)])
def test_of_a_links_numbers_those_that_look_like_a_spring_are_listed_too(arm, pace, alike):
    """In slow motion a first moment is a spring on a crank; ten numbers of the link say less than its three."""
    spring = Effect("joint_spring", ("j1",), {"stiffness": 2.0, "rest_position": 0.3}, {"shape": "sine"})
    rng = np.random.default_rng(3)
    runs = []
    for seed in (1, 2):
        plain = swing(arm, 1.5, seed, ())
        time, q = plain.time / pace, plain["q"]
        dq = np.gradient(q, time, axis=0)
        tau = predict(arm, [spring], q, dq, np.gradient(dq, time, axis=0), time)
        runs.append(Trajectory(plain.name, "train", time, {"q": q, "tau": tau + 0.3 * rng.normal(size=q.shape)}))
    settings = LoopSettings()
    judge, candidates, _ = gather(Model(arm), read_motion(arm, runs, [], settings), settings)
    term = Term("joint_spring", 0, (("shape", "sine"),))
    listed = indistinguishable(judge.adding([term]).at([term]), [term], candidates)[term]
    names = [[(e["effect"], *e["joints"]) for e in other["effects"]] for other in listed]
    assert [("link_inertia", "j1")] in names
    # Control: of quick motion, which the link's inertia resists, its three alone make no spring.
    assert ([("link_com", "j1")] in names) == alike


@pytest.mark.parametrize("beside", [None, 0, 1], ids=["alone", "curve of j1", "curve of j2"])
def test_what_is_as_good_is_listed_beside_a_law_that_only_its_bounds_keep_possible_too(
    arm: Robot, beside: int | None
) -> None:
    """Noise alone asks for friction that drives: fits are held to what can be, and the offsets stay as good."""
    runs = [swing(arm, 0.03, seed) for seed in range(4)]
    settings = LoopSettings(effects=("gravity_tilt", "torque_offset", "nonlinear_viscous_friction"))
    judge, candidates, _ = gather(Model(arm), read_motion(arm, runs[:3], runs[3:], settings), settings)
    tilt = Term("gravity_tilt")
    curve = [] if beside is None else [Term("nonlinear_viscous_friction", beside)]
    assert judge.evidence.constrained(curve) is bool(curve)
    listed = indistinguishable(judge.at([tilt, *curve]), [tilt, *curve], candidates)[tilt]
    names = [{(e["effect"], *e["joints"]) for e in other["effects"]} for other in listed]
    assert {("torque_offset", "j1"), ("torque_offset", "j2")} in names


def test_a_link_in_the_place_of_a_spring_is_one_that_can_exist(arm: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fitted freely ten numbers of a link may be no body and predict held-out parts badly: of a blind arm with another
    centre of mass a spring was named then, and no link listed beside it."""
    centre = Effect("link_com", ("j1",), {"com_x": 0.25, "com_y": 0.0, "com_z": -0.08})
    runs = [swing(arm, 0.4, seed, (centre,)) for seed in (1, 2)]
    settings = LoopSettings()
    judge, candidates, _ = gather(Model(arm), read_motion(arm, runs, [], settings), settings)
    term = Term("joint_spring", 0, (("shape", "linear"),))
    (link,) = (c for c in candidates if c.effect == "link_inertia" and c.joint == 0)
    judge = judge.adding([term]).at([term])
    assert judge.evidence.constrained([link])
    assert not judge.evidence.constrained([])
    asked, held = [], Evidence.held

    def spy(evidence: Evidence, terms: Any, physical: bool = False) -> Held:
        """The link that is fitted freely predicts as badly as nothing would, as it did there."""
        asked.append((frozenset(terms), physical))
        return held(evidence, [] if terms == [link] and not physical else terms, physical)

    monkeypatch.setattr(Evidence, "held", spy)
    listed = indistinguishable(judge, [term], candidates)[term]
    assert [("link_inertia", "j1")] in [[(e["effect"], *e["joints"]) for e in other["effects"]] for other in listed]
    assert {physical for terms, physical in asked if terms == {link}} == {False, True}
