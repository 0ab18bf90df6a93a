"""Centres of mass that a description gives in another frame than that of their links."""

from __future__ import annotations

import numpy as np
import pytest

from hybrid_dynamics import Robot
from hybrid_dynamics.check.before_fit import checked
from hybrid_dynamics.check.centres import check_centres
from hybrid_dynamics.trajectory import Trajectory

LENGTH, JOINTS = 0.3, 5


def _arm(centres: list[float]) -> Robot:
    """An upright arm of five links of 0.3 m about the axes y and x in turn, with centres of mass at these heights."""
    axes = ("0 1 0", "1 0 0")
    links = "".join(
        f'<link name="l{k}"><inertial><origin xyz="0 0 {z}"/><mass value="1.0"/>'
        '<inertia ixx="0.01" iyy="0.01" izz="0.004" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        f'<joint name="j{k}" type="revolute"><parent link="{f"l{k - 1}" if k else "base"}"/><child link="l{k}"/>'
        f'<origin xyz="0 0 {LENGTH if k else 0.0}"/><axis xyz="{axes[k % 2]}"/>'
        '<limit lower="-2.5" upper="2.5" velocity="3" effort="60"/></joint>'
        for k, z in enumerate(centres)
    )
    return Robot.from_text(f'<robot name="upright"><link name="base"/>{links}</robot>', "test")


OWN = [0.5 * LENGTH] * JOINTS
IN_BASE = [z + k * LENGTH for k, z in enumerate(OWN)]


def test_centres_of_mass_in_the_base_frame_are_told_with_the_worst_link() -> None:
    (found,) = check_centres(_arm(IN_BASE))
    assert found.severity == "warning"
    assert "up to 1.35 m" in found.text
    assert "the link of j4" in found.text
    assert "within 0.15 m" in found.text


@pytest.mark.parametrize(
    "centres",
    [OWN, [*OWN[:-1], 0.9], [10 * z for z in OWN], [10 * z for z in IN_BASE]],
    ids=["right", "a long tool", "another unit", "another unit and frame"],
)
def test_other_centres_of_mass_are_no_matter_of_the_frame(centres: list[float]) -> None:
    assert check_centres(_arm(centres)) == []


def test_a_last_link_that_is_longer_than_all_others_is_no_matter_of_the_frame() -> None:
    """Of the last link nobody knows how long it is; the way from the base to the first joint is one, too."""
    axes = [((0, 0, 0.6), "0 0 1", 0.5), ((0, 0, 0.1), "0 1 0", 0.6), ((0, 0, 0.2), "1 0 0", 0.63)]
    links = "".join(
        f'<link name="l{k}"><inertial><origin xyz="0 0 {z}"/><mass value="2"/>'
        '<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        f'<joint name="j{k}" type="prismatic"><parent link="{f"l{k - 1}" if k else "base"}"/><child link="l{k}"/>'
        f'<origin xyz="{at[0]} {at[1]} {at[2]}"/><axis xyz="{axis}"/>'
        '<limit lower="-1" upper="1" velocity="3" effort="60"/></joint>'
        for k, (at, axis, z) in enumerate(axes)
    )
    assert check_centres(Robot.from_text(f'<robot name="gantry"><link name="base"/>{links}</robot>', "test")) == []


def test_whoever_checks_a_log_is_told() -> None:
    time = np.arange(1000) / 100.0
    q = 0.8 * np.sin(np.outer(time, 0.7 + 0.3 * np.arange(JOINTS)))
    dq = np.gradient(q, time, axis=0)
    for centres, told in ((OWN, 0), (IN_BASE, 1)):
        tau = _arm(OWN).inverse_dynamics(q, dq, np.gradient(dq, time, axis=0))
        log = Trajectory("run", "train", time, {"q": q, "tau": tau})
        found = checked(_arm(centres), [log], [], refuse=False).findings
        assert sum(f.code == "centres_in_base" for f in found) == told
