"""Resimulation on the study's page: a right model moves as the robot did, a wrong one does not, and both are shown."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from tests.small_arm import HIDDEN, URDF, arm, runs

from hybrid_dynamics.effects import Effect
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.loop import Model
from hybrid_dynamics.loop.model import save_model
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.study.layout import RESIMULATION_COLUMNS
from hybrid_dynamics.study.report.resimulation import resimulation_section


def test_the_right_model_follows_the_robot_and_a_wrong_one_does_not(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    from hybrid_dynamics.study.resimulation import state_errors

    urdf, model = tmp_path / "robot.urdf", tmp_path / "model.json"
    urdf.write_text(URDF, "utf-8")
    held_out = runs(train=1, test=1, duration=4.0)[1]
    save_model(model, Model(arm(), HIDDEN))
    right = state_errors("arm", "recorded", model, urdf, held_out)
    assert list(right.columns) == list(RESIMULATION_COLUMNS)
    assert list(right["joint"]) == ["shoulder", "elbow"]
    # Torque noise of 0.3 % and the filter leave far less over half a second than the friction that is missing.
    assert (right["position_after"] < 0.2 * right["position_before"]).all()
    other = Effect("viscous_friction", ("shoulder",), {"viscous_coefficient": 12.0})
    save_model(model, Model(arm(), (other,)))
    wrong = state_errors("arm", "recorded", model, urdf, held_out)
    assert np.allclose(wrong["position_before"], right["position_before"])
    assert (wrong["position_after"] > 3 * right["position_after"]).all()
    assert state_errors("arm", "recorded", model, urdf, []).empty


def test_a_link_without_inertia_moves_only_once_completed(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    from hybrid_dynamics.study.resimulation import state_errors

    urdf, model = tmp_path / "robot.urdf", tmp_path / "model.json"
    inertia = 'ixx="0.02" iyy="0.02" izz="0.004" ixy="0" ixz="0" iyz="0"'
    assert inertia in URDF
    urdf.write_text(URDF.replace(inertia, 'ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"'), "utf-8")
    body = {"mass": 2.0, "com_x": 0.0, "com_y": 0.0, "com_z": 0.15}
    own = {"inertia_xx": 0.02, "inertia_xy": 0.0, "inertia_yy": 0.02}
    own |= {"inertia_xz": 0.0, "inertia_yz": 0.0, "inertia_zz": 0.004}
    held_out = runs(train=1, test=1, duration=4.0)[1]
    bare = Robot.from_urdf(urdf)
    save_model(model, Model(bare, (*HIDDEN, Effect("link_inertia", ("elbow",), body | own))))
    errors = state_errors("arm", "recorded", model, urdf, held_out)
    assert errors["position_before"].isna().all()
    assert errors["velocity_before"].isna().all()
    urdf.write_text(URDF, "utf-8")
    save_model(model, Model(arm(), HIDDEN))
    right = state_errors("arm", "recorded", model, urdf, held_out)
    assert np.allclose(errors["position_after"], right["position_after"], rtol=1e-6)
    # What no engine can simulate even completed is told.
    urdf.write_text(URDF.replace(inertia, 'ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"'), "utf-8")
    save_model(model, Model(bare, HIDDEN))
    with pytest.raises(InputError, match="MuJoCo does not take the completed model"):
        state_errors("arm", "recorded", model, urdf, held_out)


def rows(**changed: float) -> pd.DataFrame:
    values = {"position_before": 0.4, "position_after": 0.1, "velocity_before": 2.0, "velocity_after": 3.0} | changed
    return pd.DataFrame(
        [("panda", "recorded", f"joint{j}", 12, 0.5, *values.values()) for j in (1, 2, 3)],
        columns=list(RESIMULATION_COLUMNS),
    )


def test_the_section_gives_every_arm_and_marks_what_is_better(tmp_path: Path) -> None:
    path = tmp_path / "resimulation.csv"
    assert resimulation_section(path) is None
    rows().iloc[:0].to_csv(path, index=False)
    assert resimulation_section(path) is None
    table = rows()
    table.loc[2, "position_after"] = 0.5
    table.to_csv(path, index=False)
    section = resimulation_section(path)
    assert section is not None
    assert "0.4 → <b>0.1</b>" in section.html
    assert "2 → <b>3</b>" in section.html
    assert "2 of 3" in section.html
    assert "windows of 0.5 s" in section.html
    # Where the model is worse, the better number is that of before.
    joint3 = section.html.split("joint3")[1].split("</tr>")[0]
    assert '<td class="best">0.4</td>' in joint3
    assert '<td class="best">0.5</td>' not in joint3


def test_an_arm_that_could_not_move_before_says_so(tmp_path: Path) -> None:
    path = tmp_path / "resimulation.csv"
    other = rows(position_before=np.nan, velocity_before=np.nan)
    other["dataset"] = "tx40"
    pd.concat([rows(), other]).to_csv(path, index=False)
    section = resimulation_section(path)
    assert section is not None
    assert "– → <b>0.1</b>" in section.html
    assert "all: none moved" in section.html
    assert "No number before: tx40 as its URDF describes it cannot be simulated" in section.html
    assert '<td class="best">0.1</td>' in section.html.split("tx40, joint by joint")[1]
    assert "nan" not in section.html
