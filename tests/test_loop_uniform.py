"""One size of rotor or friction on all joints is told: a controller's gain looks like that, drives seldom do."""

from __future__ import annotations

import pytest
from tests.panda_arm import load_panda

from hybrid_dynamics.effects import Effect
from hybrid_dynamics.loop.uniform import same_everywhere

ROBOT = load_panda()
ALIKE = (9.1, 8.9, 9.2, 9.0, 9.1, 8.8, 9.3)


def _told(name: str, key: str, values: tuple[float, ...], error: float = 0.3) -> list[str]:
    named = zip(ROBOT.joint_names, values, strict=False)
    return same_everywhere(ROBOT, [Effect(name, (j,), {key: v}, {}, {key: error}) for j, v in named])


def test_one_gain_for_all_joints_is_told_with_its_size() -> None:
    (note,) = _told("armature", "armature", ALIKE)
    assert note.startswith("armature is 9.1 kg m^2 on 7 of 7 joints, whatever these carry")
    assert "controller" in note
    (one_off,) = _told("viscous_friction", "viscous_coefficient", (*ALIKE[:6], 3.0))
    assert "is 9 N m s/rad on 6 of 7 joints" in one_off


@pytest.mark.parametrize(
    ("values", "error"),
    [
        (ALIKE[:5], 0.3),  # on the other two nothing was found
        ((*ALIKE[:5], 3.0, 2.0), 0.3),  # two other drives
        ((8.0, 6.5, 5.0, 4.0, 3.0, 2.0, 1.0), 0.3),
        ((8.0, 6.5, 5.0, 4.0, 3.0, 2.0, 1.0), 9.0),  # alike for being unknown
        (tuple(-v for v in ALIKE), 0.3),  # less than the starting model has
    ],
)
def test_drives_that_differ_or_are_not_known_are_not_told(values: tuple[float, ...], error: float) -> None:
    assert _told("armature", "armature", values, error) == []


def test_parts_of_single_runs_are_no_joints_of_their_own() -> None:
    named = [(j, run) for run in ("one", "two") for j in ROBOT.joint_names[:4]]
    parts = [Effect("armature", (j,), {"armature": 9.0}, {"only_run": run}, {"armature": 0.3}) for j, run in named]
    assert same_everywhere(ROBOT, parts) == []


def test_dry_friction_and_offsets_of_one_size_are_no_gain() -> None:
    assert _told("coulomb_friction", "coulomb_torque", ALIKE) == []
    assert _told("torque_offset", "offset", ALIKE) == []
