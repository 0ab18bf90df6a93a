"""Many runs of which some carry another tool: told as runs that disagree, in groups that ask for the same."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.small_arm import arm

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.effects.base import ONLY_RUN, acts_in, whole_of
from hybrid_dynamics.loop import LoopSettings, close_loop
from hybrid_dynamics.loop.columns import Columns
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.layout import Layout
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.problem import Problem
from hybrid_dynamics.loop.process import process
from hybrid_dynamics.loop.runs import MOST_GROUPS, groups_of, split_by_run
from hybrid_dynamics.loop.weighing import weighed_by
from hybrid_dynamics.simulation.excitation import excitation

BODY: dict[str, Any] = {f"inertia_{a}": 0.0 for a in ("xx", "xy", "xz", "yy", "yz", "zz")}
AT = {"com_x": 0.05, "com_y": 0.0, "com_z": 0.0}
LIGHT, HEAVY = (Effect("payload", (), BODY | AT | {"mass": mass}) for mass in (0.4, 1.2))
TOOL = Term("payload")
SETTINGS = LoopSettings(effects=("viscous_friction", "payload"))


GREASE = Effect("viscous_friction", ("shoulder",), {"viscous_coefficient": 2.0})
TILT = Effect("gravity_tilt", (), {"roll": 0.05, "pitch": 0.03})


def logs(count: int, tools: tuple[Effect, ...], name: str = "r", also: tuple[Effect, ...] = ()) -> list[Any]:
    """Runs that carry ``tools`` in turn, and show what is ``also`` there."""
    carried = [[tools[k % len(tools)], *also] for k in range(count)]
    return [excitation(arm(), own, name=f"{name}{k}", duration=8.0, rate=100.0) for k, own in enumerate(carried)]


def evidence_of(count: int, tools: tuple[Effect, ...]) -> Evidence:
    runs = [process(run, arm(), SETTINGS.process) for run in logs(count, tools)]
    return Evidence.of(Model(arm()), runs, [TOOL], SETTINGS)


def test_runs_that_ask_for_alike_parameters_are_in_one_group():
    groups = groups_of(evidence_of(12, (LIGHT, HEAVY)), [], TOOL)
    assert len(groups) == MOST_GROUPS
    assert sorted(name for group in groups for name in group) == sorted(f"r{k}" for k in range(12))
    for group in groups:
        assert len({int(name[1:]) % 2 for name in group}) == 1
    # Few runs are each by itself.
    assert groups_of(evidence_of(MOST_GROUPS, (LIGHT, HEAVY)), [], TOOL) == [[f"r{k}"] for k in range(MOST_GROUPS)]


def test_a_tool_that_is_another_in_every_second_of_many_runs_is_told():
    diagnosis = close_loop(arm(), logs(8, (LIGHT, HEAVY)), logs(2, (LIGHT, HEAVY), "t"), SETTINGS).diagnosis.to_json()
    assert [e["effect"] for e in diagnosis["effects"]] == ["payload"]
    (mass,) = [d for d in diagnosis["effects"][0]["inconsistent_between_runs"] if d["parameter"] == "mass"]
    assert len(mass["runs"]) == 8
    for own in mass["runs"]:
        true = (0.4, 1.2)[int(own["run"][1:]) % 2]
        assert abs(own["value"] - true) < 5 * own["std_error"] + 0.02
    assert diagnosis["verdict"] == "partly_explained"
    # The control: the same tool in all of them.
    same = close_loop(arm(), logs(8, (LIGHT,)), logs(2, (LIGHT,), "t"), SETTINGS).diagnosis.to_json()
    assert [e["effect"] for e in same["effects"]] == ["payload"]
    assert "inconsistent_between_runs" not in same["effects"][0]


def test_what_is_the_same_in_all_runs_is_found_beside_tools_that_differ():
    """Names that come in beside the parts of an effect are fitted together with these."""
    both = logs(8, (LIGHT, HEAVY), also=(GREASE, TILT)), logs(2, (LIGHT, HEAVY), "t", (GREASE, TILT))
    named = {e.effect.effect: e for e in close_loop(arm(), *both).diagnosis.effects}
    # In eight seconds of two joints a tilt and an offset look alike.
    assert (
        {"payload", "viscous_friction"} < set(named) <= {"payload", "viscous_friction", "gravity_tilt", "torque_offset"}
    )
    for own in {d["parameter"]: d["runs"] for d in named["payload"].inconsistent_between_runs}["mass"]:
        true = (0.4, 1.2)[int(own["run"][1:]) % 2]
        assert abs(own["value"] - true) < 5 * own["std_error"] + 0.02


@pytest.mark.parametrize("with_whole", [True, False])
def test_columns_of_some_runs_are_those_of_all_runs_there_and_none_elsewhere(with_whole: bool):
    runs = [process(run, arm(), SETTINGS.process) for run in logs(3, (LIGHT,))]
    problem = Problem(Model(arm()), runs, SETTINGS)
    part = Term("payload", None, ((ONLY_RUN, ("r0", "r2")),))
    assert whole_of(part) == TOOL
    assert [acts_in(part.options, run.name) for run in runs] == [True, False, True]
    friction = Term("viscous_friction", 0)
    whole = Columns.of(problem, [friction, TOOL])
    columns = (whole if with_whole else Columns.of(problem, [friction])).adding([part])
    moving, weights = columns.nothing_moving(), np.random.default_rng(0).normal(size=part.size)
    for r, run in enumerate(runs):
        for j in range(2):
            own, all_runs = columns.where(part)[j], whole.where(TOOL)[j]
            if own is None:
                assert all_runs is None
                continue
            got = columns.pick(r, j, own, moving)
            expected = whole.pick(r, j, all_runs, whole.nothing_moving()) * acts_in(part.options, run.name)
            np.testing.assert_array_equal(got, expected)
            left = np.ones((1, len(run.time)))
            products = columns.times(left, r, j, moving, slice(None))
            np.testing.assert_allclose(products[:, own], left @ expected, atol=1e-9)
    torque = columns.linear(Layout.of([part]), weights, moving)
    expected_torque = whole.linear(Layout.of([TOOL]), weights, whole.nothing_moving())
    for r in range(3):
        np.testing.assert_allclose(torque[r], expected_torque[r] * (r != 1), atol=1e-12)


def test_what_tools_of_each_run_leave_is_the_floor_where_their_disagreement_hid_in_it() -> None:
    """Dry friction that no candidate is for leaves its own size; a floor that saw through the disagreement stays."""
    dry = Effect("coulomb_friction", ("shoulder",), {"coulomb_torque": 0.7})
    train, test = logs(2, (LIGHT, HEAVY), also=(dry,)), logs(1, (LIGHT,), "t", (dry,))
    sees = gather(Model(arm()), read_motion(arm(), train, test, SETTINGS), SETTINGS)[0]
    average = np.sqrt(sees.mean_square(sees.evidence.held([TOOL])))
    hidden = replace(weighed_by(sees, average), low=average / 20)
    assert average[0] > 2 * 0.7
    for judge, floor in ((hidden, 0.7), (sees, sees.floor[0])):
        after, steps = split_by_run(judge, [TOOL], [TOOL], lambda step: None)
        assert [whole_of(t) for t in steps[-1].terms] == [TOOL, TOOL]
        assert after.floor[0] == pytest.approx(floor, rel=0.1)
