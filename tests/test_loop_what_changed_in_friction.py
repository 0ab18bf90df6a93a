"""Asked what has changed of friction with numbers of its own (a displacement, a speed): the same law, more or less."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.small_arm import arm, noisy_log

from hybrid_dynamics.effects import Effect
from hybrid_dynamics.loop import Model, close_loop, load_model

ROBOT = arm()
ELBOW = ROBOT.joint_names[1:2]
LAWS = ("dahl", "stribeck", "lugre")


def _friction(law: str, size: float) -> Effect:
    """Its numbers lie on no grid of the search."""
    levels = {"coulomb_torque": size, "static_torque": 1.6 * size, "stribeck_velocity": 0.13}
    if law == "stribeck":
        return Effect("stribeck_friction", ELBOW, levels)
    if law == "dahl":
        return Effect("hysteresis_friction", ELBOW, {"presliding_stiffness": size / 0.033, "coulomb_torque": size})
    own = {"presliding_stiffness": size / 0.027, "micro_damping": 0.5 * size}
    return Effect("hysteresis_friction", ELBOW, {**levels, **own}, {"law": "lugre"})


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("now", [0.7, 1.3])
def test_friction_that_became_less_or_more_is_told_as_that_and_its_model_is_read_back(
    law: str, now: float, tmp_path: Path
) -> None:
    hidden = [_friction(law, now)]
    runs = [noisy_log(hidden, k, split, 0.05) for k, split in ((1, "train"), (2, "train"), (3, "test"))]
    result = close_loop(ROBOT, runs[:2], runs[2:], start=Model(ROBOT, (_friction(law, 1.0),)))
    assert result.diagnosis.verdict == "explained"
    (found,) = result.diagnosis.effects
    assert found.effect.effect == hidden[0].effect
    for name, ends in found.in_all.items():
        # Micro-damping acts within the displacement alone, where few rows are.
        assert ends["now"] == pytest.approx(hidden[0].parameters[name], rel=0.2 if name == "micro_damping" else 0.02)
    assert "coulomb_torque" in found.in_all
    result.model.save(tmp_path / "model.json")
    assert load_model(tmp_path / "model.json", ROBOT).effects[1].effect == hidden[0].effect


@pytest.mark.parametrize("law", LAWS)
def test_nothing_has_changed_where_nothing_did(law: str) -> None:
    hidden = [_friction(law, 1.0)]
    runs = [noisy_log(hidden, k, split, 0.05) for k, split in ((1, "train"), (2, "train"), (3, "test"))]
    diagnosis = close_loop(ROBOT, runs[:2], runs[2:], start=Model(ROBOT, tuple(hidden))).diagnosis
    assert (diagnosis.verdict, diagnosis.effects) == ("nothing_missing", ())
