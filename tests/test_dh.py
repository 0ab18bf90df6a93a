"""A DH table written as URDF gives the dynamics of an independent computation by homogeneous transforms."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.tests_support_simulation import passive_controller

from hybrid_dynamics.errors import ConfigError
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.robots.dh import (
    DHLimit,
    DHLink,
    DHRow,
    dh_to_urdf,
    limits_from_config,
    links_from_config,
    rows_from_config,
)
from hybrid_dynamics.simulation import Reference, Rollout, simulate

G = 9.81
LIMIT = DHLimit(-100.0, 100.0, 1e4, 1e4)


def transform(row: DHRow, q: float) -> np.ndarray:
    """T_{i-1,i} of the standard convention, written out (Spong, Hutchinson, Vidyasagar, eq. 3.10)."""
    ct, st_, ca, sa = np.cos(q + row.theta_offset), np.sin(q + row.theta_offset), np.cos(row.alpha), np.sin(row.alpha)
    return np.array(
        [
            [ct, -st_ * ca, st_ * sa, row.a * ct],
            [st_, ct * ca, -ct * sa, row.a * st_],
            [0, sa, ca, row.d],
            [0, 0, 0, 1],
        ]
    )


def frames(rows: list[DHRow], q: np.ndarray) -> list[np.ndarray]:
    out = [np.eye(4)]
    for row, angle in zip(rows, q, strict=True):
        out.append(out[-1] @ transform(row, float(angle)))
    return out


def potential(rows: list[DHRow], links: list[DHLink], q: np.ndarray) -> float:
    chain = frames(rows, q)[1:]
    return sum(link.mass * G * float((t @ [*link.com, 1.0])[2]) for t, link in zip(chain, links, strict=True))


def kinetic(rows: list[DHRow], links: list[DHLink], q: np.ndarray, dq: np.ndarray) -> float:
    chain, total = frames(rows, q), 0.0
    for i, link in enumerate(links):
        com = (chain[i + 1] @ [*link.com, 1.0])[:3]
        velocity, omega = np.zeros(3), np.zeros(3)
        for k in range(i + 1):  # joint k turns about z of frame k
            axis, origin = chain[k][:3, 2], chain[k][:3, 3]
            omega += axis * dq[k]
            velocity += np.cross(axis, com - origin) * dq[k]
        rotation = chain[i + 1][:3, :3]
        tensor = rotation @ link.tensor() @ rotation.T
        total += 0.5 * link.mass * velocity @ velocity + 0.5 * omega @ tensor @ omega
    return total


def random_robot(seed: int, n: int = 5) -> tuple[list[DHRow], list[DHLink]]:
    rng = np.random.default_rng(seed)
    rows, links = [], []
    right = [-np.pi / 2, np.pi / 2, 0.0]
    for _ in range(n):
        alpha = rng.choice(right) if rng.random() < 0.7 else rng.uniform(-3, 3)
        offset = rng.choice([*right, rng.uniform(-3, 3)])
        rows.append(DHRow(float(alpha), *map(float, rng.uniform(-0.5, 0.5, 2)), float(offset)))  # type: ignore[call-arg]
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        spread = np.diag(rng.uniform(0.01, 0.2, 3))  # second moments of the mass distribution
        moments = turn @ (np.trace(spread) * np.eye(3) - spread) @ turn.T
        com = tuple(map(float, rng.uniform(-0.2, 0.2, 3)))
        inertia = tuple(float(moments[i]) for i in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)))
        links.append(DHLink(float(rng.uniform(0.2, 5)), com, inertia))
    return rows, links


def build(rows: list[DHRow], links: list[DHLink], path: Path) -> Robot:
    names = [f"j{i}" for i in range(1, len(rows) + 1)]
    path.write_text(dh_to_urdf("dh", names, rows, links, [LIMIT] * len(rows)))
    return Robot.from_urdf(path)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_gravity_torque_is_the_slope_of_the_potential(seed: int, tmp_path_factory: pytest.TempPathFactory) -> None:
    rows, links = random_robot(seed)
    robot = build(rows, links, tmp_path_factory.mktemp("dh") / "r.urdf")
    poses = np.random.default_rng(seed + 1).uniform(-3, 3, (3, len(rows)))
    torque = robot.rigid_body_torques(poses, 0 * poses, 0 * poses).gravity
    step = 1e-5
    for q, g in zip(poses, torque, strict=True):
        slope = [
            (potential(rows, links, q + step * e) - potential(rows, links, q - step * e)) / (2 * step)
            for e in np.eye(len(rows))
        ]
        assert np.abs(g - slope).max() < 1e-7


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_kinetic_energy_is_the_mass_matrix(seed: int, tmp_path_factory: pytest.TempPathFactory) -> None:
    rows, links = random_robot(seed)
    robot = build(rows, links, tmp_path_factory.mktemp("dh") / "r.urdf")
    rng = np.random.default_rng(seed + 2)
    q, dq = rng.uniform(-3, 3, (2, 4, len(rows)))
    momentum = robot.rigid_body_torques(q, 0 * q, dq).inertia
    for k in range(4):
        assert 0.5 * dq[k] @ momentum[k] == pytest.approx(kinetic(rows, links, q[k], dq[k]), rel=1e-9)


def test_a_wrong_sign_of_the_products_of_inertia_is_seen(tmp_path: Path) -> None:
    rows, links = random_robot(3)
    wrong = [
        DHLink(x.mass, x.com, (x.inertia[0], -x.inertia[1], -x.inertia[2], x.inertia[3], -x.inertia[4], x.inertia[5]))
        for x in links
    ]
    robot = build(rows, wrong, tmp_path / "r.urdf")
    q, dq = np.random.default_rng(5).uniform(-3, 3, (2, 1, len(rows)))
    energy = 0.5 * float(dq[0] @ robot.rigid_body_torques(q, 0 * q, dq).inertia[0])
    assert energy != pytest.approx(kinetic(rows, links, q[0], dq[0]), rel=1e-3)


def test_free_fall_conserves_energy_computed_independently(tmp_path: Path) -> None:
    rows, links = random_robot(11)
    robot = build(rows, links, tmp_path / "r.urdf")
    start = np.tile(np.array([0.4, 1.0, -0.5, 0.3, 0.8]), (200, 1))
    drift = []
    for substep in (1e-4, 5e-5):
        run = simulate(robot, [Reference(start, 0 * start)], passive_controller(robot, 1e-3), substep)[0]
        assert isinstance(run, Rollout)
        moving = np.array([kinetic(rows, links, q, v) for q, v in zip(run.q[::5], run.dq[::5], strict=True)])
        total = moving + [potential(rows, links, q) for q in run.q[::5]]
        drift.append(np.ptp(total) / np.ptp(moving))
    assert drift[0] < 0.02
    assert drift[0] / drift[1] == pytest.approx(2.0, rel=0.15), "a first-order integrator's drift halves with the step"


def test_config_forms_and_errors() -> None:
    rows = rows_from_config([{"alpha": 0.0, "a": 0.1, "d": 0.2}])
    assert rows == [DHRow(0.0, 0.1, 0.2, 0.0)]
    links = links_from_config([{"mass": 1, "com": [0, 0, 0.1], "inertia": [0.1, 0, 0, 0.1, 0, 0.1]}])
    limits = limits_from_config([{"lower": -1, "upper": 1, "velocity": 2, "effort": 3}])
    assert "<robot" in dh_to_urdf("one", ["a"], rows, links, limits)
    with pytest.raises(ConfigError, match=r"dh row 1: \['d'\] missing"):
        rows_from_config([{"alpha": 0.0, "a": 0.1}])
    with pytest.raises(ConfigError, match=r"unknown key \['theta'\]"):
        rows_from_config([{"alpha": 0.0, "a": 0.1, "d": 0.0, "theta": 1.0}])
    with pytest.raises(ConfigError, match="com has 2"):
        links_from_config([{"mass": 1, "com": [0, 0], "inertia": [0.1, 0, 0, 0.1, 0, 0.1]}])
    with pytest.raises(ConfigError, match="lower = 1"):
        limits_from_config([{"lower": 1, "upper": -1, "velocity": 2, "effort": 3}])
    with pytest.raises(ConfigError, match="2 DH rows for 1 joints"):
        dh_to_urdf("one", ["a"], rows * 2, links, limits)
    impossible = DHLink(1.0, (0.0, 0.0, 0.0), (0.1, 0.0, 0.0, 0.1, 0.0, 0.5))
    with pytest.raises(ConfigError, match=r"link a_link.*triangle"):
        dh_to_urdf("one", ["a"], rows, [impossible], limits)


@pytest.fixture(scope="module")
def wam() -> tuple[list[DHRow], list[DHLink], list[DHLimit], list[str]]:
    config = yaml.safe_load((Path(__file__).parents[1] / "conf" / "robot" / "wam.yaml").read_text())["dh"]
    limits = limits_from_config(config["limits"])
    return rows_from_config(config["rows"]), links_from_config(config["links"]), limits, config["joint_names"]


def test_wam_inertias_are_tensor_elements(wam: tuple[list[DHRow], list[DHLink], list[DHLimit], list[str]]) -> None:
    """Against inertias about the frame's origin as Sousa and Cortesao print them (the source's products: minus)."""
    printed = {  # link: (row, column, kg m^2)
        2: [(0, 1, 1.347e-5), (0, 2, 1.170e-4), (1, 2, -3.659e-5)],
        3: [(0, 2, -5.098e-6), (1, 2, 5.295e-6)],
        4: [(0, 2, -8.193e-5), (1, 2, 9.417e-5)],
        6: [(0, 1, -1.483e-6), (1, 2, 2.216e-4)],
        7: [(0, 1, 1.909e-7), (2, 2, 7.408e-5)],
    }
    for number, elements in printed.items():
        link = wam[1][number - 1]
        com = np.array(link.com)
        about_origin = link.tensor() + link.mass * (com @ com * np.eye(3) - np.outer(com, com))
        for i, j, value in elements:
            assert about_origin[i, j] == pytest.approx(value, rel=1e-3)


def test_wam_gravity_and_free_fall(
    wam: tuple[list[DHRow], list[DHLink], list[DHLimit], list[str]], tmp_path: Path
) -> None:
    rows, links, limits, names = wam
    path = tmp_path / "wam.urdf"
    path.write_text(dh_to_urdf("wam", names, rows, links, limits))
    robot = Robot.from_urdf(path)
    low, high = robot.position_limits
    for q in np.random.default_rng(2).uniform(low, high, (5, 7)):
        torque = robot.rigid_body_torques(q[None], np.zeros((1, 7)), np.zeros((1, 7))).gravity[0]
        slope = [
            (potential(rows, links, q + 1e-5 * e) - potential(rows, links, q - 1e-5 * e)) / 2e-5 for e in np.eye(7)
        ]
        assert np.abs(torque - slope).max() < 1e-6
        assert abs(torque[0]) < 1e-12, "joint 1 is vertical"
    free = robot.copy()
    free.model.lowerPositionLimit, free.model.upperPositionLimit = np.full(7, -1e3), np.full(7, 1e3)
    free.model.upperVelocityLimit = np.full(7, 1e4)
    start = np.tile([0.3, 1.2, -0.4, 0.8, 0.2, -0.5, 0.1], (150, 1))
    run = simulate(free, [Reference(start, 0 * start)], passive_controller(free, 1e-3), 2e-5)[0]
    assert isinstance(run, Rollout)
    moving = np.array([kinetic(rows, links, q, v) for q, v in zip(run.q[::5], run.dq[::5], strict=True)])
    total = moving + [potential(rows, links, q) for q in run.q[::5]]
    assert moving[-1] > 1.0
    assert np.ptp(total) < 2e-3 * moving[-1]
