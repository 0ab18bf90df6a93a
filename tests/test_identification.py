"""Base parameters against the textbook, physical consistency, and the settings' refusals."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hybrid_dynamics.errors import ConfigError, HybridDynamicsError
from hybrid_dynamics.identification import LeastSquaresSettings, base_parameters, is_physical, pseudo_inertia
from hybrid_dynamics.identification import physical as physical_module
from hybrid_dynamics.identification.base_parameters import full_parameter_names, full_regressor
from hybrid_dynamics.identification.physical import feasible_prior, physical_least_squares
from hybrid_dynamics.robots import Robot

LENGTH = 0.5


def arm_urdf(axes: list[str], angles: str) -> str:
    """A serial arm of boxes, one joint per axis, each next joint at the end of the link, turned by ``angles``."""
    links = ['<link name="base"/>']
    joints = []
    for j, axis in enumerate(axes, start=1):
        links.append(
            f'<link name="l{j}"><inertial><origin xyz="{0.2 / j} 0.02 0.01"/><mass value="{4.0 / j}"/>'
            f'<inertia ixx="{0.02 / j}" iyy="{0.05 / j}" izz="{0.06 / j}" ixy="0.001" ixz="0" iyz="0.002"/>'
            "</inertial></link>"
        )
        joints.append(
            f'<joint name="j{j}" type="revolute"><parent link="{"base" if j == 1 else f"l{j - 1}"}"/>'
            f'<child link="l{j}"/><origin xyz="{0 if j == 1 else LENGTH} 0 0" rpy="{angles}"/><axis xyz="{axis}"/>'
            '<limit lower="-3" upper="3" velocity="5" effort="100"/></joint>'
        )
    return '<?xml version="1.0"?><robot name="arm">' + "".join(links + joints) + "</robot>"


def make_arm(tmp_path_factory: pytest.TempPathFactory, axes: list[str], angles: str = "0 0 0") -> Robot:
    path = tmp_path_factory.mktemp("robot") / "arm.urdf"
    path.write_text(arm_urdf(axes, angles))
    return Robot.from_urdf(path)


@pytest.fixture(scope="module")
def vertical(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    """Two links that swing in a vertical plane."""
    return make_arm(tmp_path_factory, ["0 1 0", "0 1 0"])


@pytest.fixture(scope="module")
def spatial(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return make_arm(tmp_path_factory, ["0 0 1", "0 1 0", "1 0 0"])


def test_grouping_of_the_planar_arm_is_the_textbooks(vertical: Robot) -> None:
    # Khalil and Dombre, Modeling, Identification and Control of Robots, 2002, section 9.4: ZZR1 = ZZ1 + Ia1 + M2 D^2,
    # MXR1 = MX1 + M2 D, MY1, ZZ2, MX2, MY2, Ia2 (here the axis is y and gravity acts along z).
    base = base_parameters(vertical)
    assert dict(zip(base.base_names, base.expressions, strict=True)) == {
        "Lyy1": "Lyy1 + 0.25 m2 + Ia1",
        "lx1": "lx1 + 0.5 m2",
        "lz1": "lz1",
        "Lyy2": "Lyy2",
        "lx2": "lx2",
        "lz2": "lz2",
        "Ia2": "Ia2",
    }
    assert {row["unit"] for row in base.table_rows()} == {"kg m", "kg m^2"}


def test_without_gravity_in_the_plane_the_first_moments_of_the_first_link_vanish(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    base = base_parameters(make_arm(tmp_path_factory, ["0 0 1", "0 0 1"]))
    assert set(base.expressions) == {"Lzz1 + 0.25 m2 + Ia1", "lx2", "ly2", "Lzz2", "Ia2"}
    assert {"m1", "lx1", "ly1", "lz1"} <= set(base.undetermined)


def test_rank_is_clear(spatial: Robot) -> None:
    smallest_kept, largest_dropped = base_parameters(spatial).rank_gap
    assert smallest_kept > 1e-3
    assert largest_dropped < 1e-12


def test_rounded_angles_of_a_description_do_not_invent_parameters(tmp_path_factory: pytest.TempPathFactory) -> None:
    axes = ["0 0 1"] * 4
    exact = base_parameters(make_arm(tmp_path_factory, axes, f"{np.pi / 2} 0 0"))
    rounded = base_parameters(make_arm(tmp_path_factory, axes, "1.5708 0 0"))
    assert rounded.base_names == exact.base_names
    assert rounded.rank_gap[1] > exact.rank_gap[1]
    # Control: the tolerance is not so wide that it swallows what a skew of three degrees makes visible.
    assert base_parameters(make_arm(tmp_path_factory, axes, f"{np.pi / 2 + 0.05} 0 0")).size > exact.size


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**31 - 1))
def test_base_parameters_give_the_same_torque(spatial: Robot, seed: int) -> None:
    """Holds for any parameters and any state, among them states that the grouping was not made from."""
    rng = np.random.default_rng(seed)
    base = base_parameters(spatial)
    full = rng.normal(size=len(full_parameter_names(3)))
    q, dq, ddq = rng.normal(0, 3, (3, 10, 3))
    regressor = full_regressor(spatial, q, dq, ddq)
    reduced = regressor[:, :, base.independent] @ (base.grouping @ full)
    np.testing.assert_allclose(reduced, regressor @ full, atol=1e-9 * np.abs(regressor).max())


def test_grouping_does_not_depend_on_the_sample(spatial: Robot) -> None:
    one, two = base_parameters(spatial, seed=1), base_parameters(spatial, seed=2)
    np.testing.assert_array_equal(one.independent, two.independent)
    np.testing.assert_allclose(one.grouping, two.grouping, atol=1e-9)


def test_pseudo_inertia_is_positive_definite_for_bodies_only(spatial: Robot) -> None:
    parameters = spatial.inertial_parameters
    assert is_physical(parameters)
    # Each breaks one law: a negative mass; a centre of mass that the inertia cannot hold; the triangle inequality.
    for index, value in ((0, -1.0), (1, 10.0), (4, 10.0)):
        wrong = parameters.copy()
        wrong[index] = value
        assert not is_physical(wrong)
    point_mass = np.array([1.0, *([0.0] * 9)])
    assert np.linalg.eigvalsh(pseudo_inertia(point_mass))[0] == 0.0


def test_prior_keeps_real_bodies_and_repairs_impossible_ones(spatial: Robot) -> None:
    parameters = spatial.inertial_parameters
    np.testing.assert_allclose(feasible_prior(parameters), parameters, atol=1e-12)
    wrong = parameters.copy()
    wrong[4:10] = 0.0
    wrong[10] = 0.0
    assert is_physical(feasible_prior(wrong))


def _system(robot: Robot, noise: float, samples: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weighted factor, target and true x of a robot with viscous friction 1, Coulomb 0.5, offset 0.1, armature 0.2."""
    rng = np.random.default_rng(seed)
    n = robot.n_joints
    base = base_parameters(robot)
    q, dq, ddq = rng.normal(size=(3, samples, n))
    regressor = full_regressor(robot, q, dq, ddq)[:, :, base.independent]
    eye = np.eye(n)
    columns = [regressor, dq[:, :, None] * eye, np.sign(dq)[:, :, None] * eye, np.tile(eye, (samples, 1, 1))]
    rows = np.concatenate(columns, axis=2).reshape(samples * n, -1)
    full = np.concatenate([robot.inertial_parameters, np.full(n, 0.2)])
    truth = np.concatenate([base.grouping @ full, np.full(n, 1.0), np.full(n, 0.5), np.full(n, 0.1)])
    scale = max(noise, 1e-4)
    return rows / scale, (rows @ truth + noise * rng.normal(size=len(rows))) / scale, truth


def _solve(robot: Robot, factor: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The physical estimate with a description that is wrong by a factor of two."""
    base = base_parameters(robot)
    n = robot.n_joints
    prior = 2 * robot.inertial_parameters
    return physical_least_squares(
        factor, target, len(factor), base.grouping, prior, np.zeros(n), np.ones(n), prior_weight=1e-5
    )


def test_constraints_do_not_move_a_feasible_truth(spatial: Robot) -> None:
    factor, target, truth = _system(spatial, 0.0, 200, seed=0)
    inertial, armature, friction = _solve(spatial, factor, target)
    found = np.concatenate([base_parameters(spatial).grouping @ np.append(inertial, armature), friction])
    assert is_physical(inertial)
    np.testing.assert_allclose(found, truth, atol=1e-5)


def test_a_body_that_cannot_exist_is_no_solution_and_the_next_stronger_prior_is_asked(
    spatial: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A single slow move of a real arm: what the solver called optimal had a body of negative inertia."""
    factor, target, _ = _system(spatial, 0.0, 200, seed=0)
    answers = iter([False, False, True])
    asked: list[bool] = []

    def exists(parameters: np.ndarray, tolerance: float = 0.0) -> bool:
        asked.append(next(answers))
        return asked[-1]

    monkeypatch.setattr(physical_module, "is_physical", exists)
    assert is_physical(_solve(spatial, factor, target)[0])
    assert asked == [False, False, True]
    # Where no prior helps that is told, with the remedy.
    monkeypatch.setattr(physical_module, "is_physical", lambda *_: False)
    with pytest.raises(HybridDynamicsError, match=r"not positive definite.*prior_weight larger than 0\.01"):
        _solve(spatial, factor, target)


def test_infeasible_ordinary_estimate_becomes_feasible(vertical: Robot) -> None:
    base = base_parameters(vertical)
    own = base.base_names.index("Lyy2")
    fresh = _system(vertical, 0.0, 500, seed=1000)[0]
    errors = []
    for seed in range(12):
        factor, target, truth = _system(vertical, 1.0, 20, seed)
        ordinary = np.linalg.lstsq(factor, target, rcond=None)[0]
        # The moment of inertia of a link about its own joint and a friction coefficient cannot be negative.
        if ordinary[own] > 0 and (ordinary[base.size : base.size + 4] > 0).all():
            continue
        inertial, armature, friction = _solve(vertical, factor, target)
        assert is_physical(inertial)
        assert (armature >= 0).all()
        assert (friction[:4] >= 0).all()
        found = np.concatenate([base.grouping @ np.append(inertial, armature), friction])
        errors.append([np.linalg.norm(fresh @ (found - truth)), np.linalg.norm(fresh @ (ordinary - truth))])
    assert len(errors) >= 3
    physical, plain = np.mean(errors, axis=0)
    # Constraints that are true bring the estimate nearer to the truth, measured in torque.
    assert physical < plain


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("prior_weight", 0.0),
        ("sign_widths", ()),
        ("sign_widths", (-0.1,)),
        ("min_speed", -1.0),
        ("filter_cutoff", -1.0),
        ("block_seconds", 0.0),
        ("max_rows", 10),
        ("reweightings", -1),
        ("seed", -1),
    ],
)
def test_settings_out_of_range_are_refused_by_name(name: str, value: object) -> None:
    with pytest.raises(ConfigError, match=rf"least_squares\.{name} is .*expected"):
        LeastSquaresSettings(**{name: value})
