"""Expressions, figures and the picture of the arm."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from PIL import Image
from tests.reporting_study import write_dataset

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.files import write_text
from hybrid_dynamics.robots import find_description
from hybrid_dynamics.study.expressions import number_of_terms, terms, to_latex, to_mathml
from hybrid_dynamics.study.report import figures
from hybrid_dynamics.study.report.arm import camera_for, posed_surface, render_arm
from hybrid_dynamics.study.report.render import Camera, Surface, render, shadow
from hybrid_dynamics.study.results import read_dataset
from hybrid_dynamics.trajectory import read_trajectories


def test_terms_are_expanded_and_summed() -> None:
    assert terms("2*dq1 + dq1 - 3.0e-05*q1*dq2 + 1.5") == {"dq1": 3.0, "dq2*q1": -3e-5, "1": 1.5}
    assert terms("(q1 - 1)*(q1 + 1)") == {"q1**2": 1.0, "1": -1.0}
    assert terms("dq1 - dq1") == {}
    assert number_of_terms("a - b + c*d") == 3
    assert number_of_terms("0") == 0


def test_expressions_are_typeset_in_the_papers_notation() -> None:
    text = "1.0002*tau_inertia1 + 6.75*dq1 - 3e-05*ddq12*sign(dddq3)"
    latex = to_latex(text)
    for part in (r"1.0002 \tau_{i,1}", r"6.75 \dot{q}_{1}", r"\ddot{q}_{12}", r"\dddot{q}_{3}"):
        assert part in latex
    mathml = to_mathml(text)
    assert mathml.startswith("<math>")
    assert "tau" not in mathml
    assert "InvisibleTimes" not in mathml
    assert "<mn>6.75</mn>" in mathml


def test_nothing_in_an_expression_is_run() -> None:
    for text in ("__import__('os').system('true')", "q1.real", "[q1]", "q1 if q2 else q3"):
        with pytest.raises(InputError):
            to_latex(text)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("figures") / "panda")


def test_figures_have_units_and_the_same_bytes_every_time(dataset: Path) -> None:
    result = read_dataset(dataset)
    run = read_trajectories(dataset / "derivatives.parquet")[0]
    drawn = figures.derivatives(run, "title")
    assert [axis.get_ylabel() for axis in drawn.axes] == [
        "position q [rad]",
        "velocity dq [rad/s]",
        "acceleration ddq [rad/s²]",
        "jerk dddq [rad/s³]",
    ]
    assert drawn.axes[-1].get_xlabel() == "time [s]"
    fronts = [figures.to_bytes(figures.fronts(result.fronts, ["sr", "r_sr"], "t"), "svg") for _ in range(2)]
    assert fronts[0] == fronts[1]
    assert b"<dc:date>" not in fronts[0]
    torque = [figures.to_bytes(figures.predictions(result.predictions, "test", ["sr"], "t")) for _ in range(2)]
    assert torque[0] == torque[1]


def test_every_method_has_a_mark_of_its_own() -> None:
    drawn = figures.error_bars(pd.DataFrame({f"m{k}": [0.1 * (k + 1)] for k in range(15)}, index=[1]), "t")
    lines = [line for line in drawn.axes[0].get_lines() if line.get_marker() not in ("None", None)]
    marks = [(line.get_marker(), line.get_color(), line.get_fillstyle()) for line in lines]
    assert len(set(marks)) == len(marks) == 15


def test_a_prediction_that_leaves_the_axis_is_said_to(dataset: Path) -> None:
    table = read_dataset(dataset).predictions.copy()
    table.loc[table["method"] == "sr", "tau_hat3"] *= 100
    titles = [axis.get_title(loc="left") for axis in figures.predictions(table, "test", ["sr"], "t").axes]
    assert [("leaves the axis" in title) for title in titles[:4]] == [False, False, True, False]


def test_the_residual_figure_shows_rigid_body_and_model(dataset: Path) -> None:
    drawn = figures.residuals(read_dataset(dataset).predictions, "test", "sr", "t")
    before, after = drawn.axes[0].get_lines()
    assert np.abs(before.get_ydata()).max() > 100 * np.abs(after.get_ydata()).max()


def test_a_front_shows_the_first_round_and_the_refitted_expression() -> None:
    columns = ["method", "joint", "round", "kind", "complexity", "loss"]
    rows = [(1, "search", 3, 1.0), (2, "search", 5, 0.1), (2, "refit", 9, 0.01)]
    table = pd.DataFrame([("sr", 1, *row) for row in rows], columns=columns)
    first, final = figures.fronts(table, ["sr"], "t").axes[0].get_lines()
    assert np.asarray(first.get_xdata()).tolist() == [3]
    assert np.asarray(final.get_ydata()).tolist() == [0.01]


def triangle(z: float, colour: tuple[float, float, float]) -> Surface:
    corners = np.array([[[0.0, -0.5, z], [0.0, 0.5, z], [0.0, 0.0, z + 1.0]]])
    return Surface(corners, np.tile([1.0, 0.0, 0.0], (1, 3, 1)), np.array([colour]))


def joined(*parts: Surface) -> Surface:
    return Surface(*(np.concatenate([getattr(p, name) for p in parts]) for name in ("corners", "normals", "colours")))


def test_the_renderer_covers_what_it_should_and_hides_what_is_behind() -> None:
    camera = Camera((4.0, 0.0, 1.5), (0.0, 0.0, 1.5), 30.0)
    red, blue = triangle(1.0, (1, 0, 0)), triangle(1.0, (0, 0, 1))
    image = render(red, camera, 120, 120).astype(int)
    redness = image[..., 0] - image[..., 2]
    red_pixels = (redness > redness.max() / 2).sum()
    # 0.5 m^2 seen from 4 m: pixels per metre = 60 / tan(15 deg) / 4
    assert red_pixels == pytest.approx(0.5 * (60 / np.tan(np.deg2rad(15)) / 4) ** 2, rel=0.03)
    behind = Surface(blue.corners - [0.5, 0.0, 0.0], blue.normals, blue.colours)
    for order in ((red, behind), (behind, red)):
        middle = render(joined(*order), camera, 120, 120)[50, 60].astype(int)
        assert middle[0] > middle[2]


def test_the_shadow_lies_on_the_ground() -> None:
    corners = triangle(1.0, (1, 1, 1)).corners
    assert (shadow(corners)[..., 2] == 0).all()
    assert (shadow(shadow(corners)) == shadow(corners)).all()


@pytest.mark.slow
def test_the_arm_is_drawn_in_its_pose(tmp_path: Path) -> None:
    urdf = find_description("panda_description/urdf/panda.urdf")
    pose = {f"panda_joint{k + 1}": v for k, v in enumerate((0.3, -0.5, 0.2, -1.9, 0.1, 1.6, 0.5))}
    content = render_arm(urdf, pose, tmp_path / "arm.png", size=(155, 170))
    image = np.asarray(Image.open(tmp_path / "arm.png"))
    assert image.shape[0] <= 170
    assert image.shape[1] <= 155
    drawn = (image < 200).any(axis=2)
    assert 0.05 < drawn.mean() < 0.5
    edge = np.concatenate([image[0], image[-1], image[:, 0], image[:, -1]])
    assert (edge > 240).all()
    other = render_arm(urdf, {**pose, "panda_joint4": -2.6}, tmp_path / "other.png", size=(155, 170))
    assert other != content


@pytest.mark.slow
def test_the_surface_follows_the_joints() -> None:
    urdf = find_description("panda_description/urdf/panda.urdf")
    up = posed_surface(urdf, {"panda_joint4": -0.07}).corners.reshape(-1, 3)
    turned = posed_surface(urdf, {"panda_joint4": -0.07, "panda_joint1": np.pi / 2}).corners.reshape(-1, 3)
    moved = np.abs(up - turned).max(axis=1) > 1e-6
    rotated = np.column_stack([-up[:, 1], up[:, 0], up[:, 2]])
    np.testing.assert_allclose(turned[moved], rotated[moved], atol=1e-9)
    assert moved.mean() > 0.5
    camera = camera_for(up, (100, 100))
    assert np.linalg.norm(np.subtract(camera.eye, camera.target)) > up[:, 2].max()


def test_what_cannot_be_drawn_is_named(tmp_path: Path) -> None:
    urdf = find_description("panda_description/urdf/panda.urdf")
    with pytest.raises(InputError, match="no movable joint 'elbow' to pose"):
        render_arm(urdf, {"elbow": 1.0}, tmp_path / "x.png")
    inertia = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    link = f'<link name="{{}}"><inertial><mass value="1"/>{inertia}</inertial>{{}}</link>'
    joint = (
        '<joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
    )
    bare = f"<robot name='r'>{link.format('a', '')}{link.format('b', '')}{joint}</robot>"
    write_text(tmp_path / "bare.urdf", bare)
    with pytest.raises(InputError, match="no visual mesh"):
        render_arm(tmp_path / "bare.urdf", {}, tmp_path / "x.png")
    visual = '<visual><geometry><mesh filename="package://nowhere/x.stl"/></geometry></visual>'
    write_text(tmp_path / "lost.urdf", bare.replace(link.format("b", ""), link.format("b", visual)))
    with pytest.raises(InputError, match=r"x\.stl not found"):
        render_arm(tmp_path / "lost.urdf", {}, tmp_path / "x.png")
    assert not (tmp_path / "x.png").exists()
