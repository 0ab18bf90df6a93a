"""Friction that the URDF gives belongs to the starting model: what is found is told in totals."""

import json

import pytest
from tests.small_arm import HIDDEN, URDF, write_logs

from hybrid_dynamics.cli.words import headline, notes
from hybrid_dynamics.close_files import LoopFiles, close_files
from hybrid_dynamics.effects.urdf_dynamics import urdf_dynamics
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.loop import LoopSettings
from hybrid_dynamics.loop_report.words import told_first
from hybrid_dynamics.robots import Robot

TRUE = ('<dynamics damping="3.0" friction="0"/>', '<dynamics damping="0.0" friction="1.5"/>')
SETTINGS = LoopSettings(effects=("viscous_friction", "coulomb_friction", "torque_offset"))


def described(folder, shoulder: str, elbow: str):
    """The small arm with <dynamics> at both joints; its logs hold viscous friction of 3 and Coulomb friction of 1.5."""
    first, second = URDF.split("</joint>", 1)
    text = f"{first}{shoulder}</joint>{second.replace('</joint>', f'{elbow}</joint>', 1)}"
    path = folder / "described.urdf"
    path.write_text(text)
    return path


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    return write_logs(tmp_path_factory.mktemp("arm"))


def diagnosis(logs, urdf, out, **options):
    files = LoopFiles(
        urdf,
        (logs / "train_1.parquet", logs / "train_2.parquet"),
        out,
        (logs / "test_1.parquet",),
        settings=SETTINGS,
        **options,
    )
    return close_files(files)


def test_the_urdfs_friction_is_read_and_bad_values_are_refused(tmp_path):
    path = described(tmp_path, *TRUE)
    effects = urdf_dynamics(path, Robot.from_urdf(path))
    assert [(e.effect, e.joints, dict(e.parameters)) for e in effects] == [
        (h.effect, h.joints, dict(h.parameters)) for h in HIDDEN
    ]
    for value, complaint in (
        ("-1", "damping is -1; expected 0 or more"),
        ("much", "damping is 'much'; expected a fin"),
    ):
        path = described(tmp_path, f'<dynamics damping="{value}"/>', "")
        with pytest.raises(InputError, match=complaint):
            Robot.from_urdf(path)


def test_friction_that_the_urdf_has_right_is_not_found_again(logs, tmp_path):
    path = described(tmp_path, *TRUE)
    found = diagnosis(logs, path, tmp_path / "out")
    assert found["verdict"] == "nothing_missing"
    assert found["notes"][0].startswith(
        "the URDF's <dynamics> belongs to the starting model (damping shoulder 3 N m s/rad"
    )
    model = json.loads((tmp_path / "out" / "model.json").read_text())
    assert [e["effect"] for e in model["effects"]] == ["viscous_friction", "coulomb_friction"]
    # Without it the loop finds what the logs hold.
    bare = diagnosis(logs, path, tmp_path / "bare", ignore_dynamics=True)
    assert {(e["effect"], *e["joints"]) for e in bare["effects"]} == {(h.effect, *h.joints) for h in HIDDEN}


def test_a_placeholder_is_told_first_and_values_are_totals(logs, tmp_path):
    path = described(tmp_path, '<dynamics damping="20"/>', '<dynamics friction="1.0"/>')
    found = diagnosis(logs, path, tmp_path / "out")
    assert found["notes"][0].startswith("the URDF's <dynamics> makes the training error larger: shoulder ")
    values = {(e["effect"], *e["joints"]): e["parameters"][0]["value"] for e in found["effects"]}
    assert values[("viscous_friction", "shoulder")] == pytest.approx(3.0, rel=0.02)
    assert values[("coulomb_friction", "elbow")] == pytest.approx(1.5, rel=0.02)
    assert any("in all, of which the URDF gives 20" in note for note in found["notes"])
    shoulder = next(e for e in found["effects"] if e["joints"] == ["shoulder"])
    assert shoulder["in_all"]["viscous_coefficient"]["urdf"] == 20
    assert shoulder["in_all"]["viscous_coefficient"]["now"] == shoulder["parameters"][0]["value"]
    # On the console and on the page the harm comes before the numbers, and is told once.
    assert "missing or wrong in the URDF: " in headline(found)
    assert "viscous friction 3" in headline(found)
    assert "(URDF: 20)" in headline(found)
    assert told_first(found) == found["notes"][:1]
    assert not [n for n in notes(found) if "in all, of which" in n or n in told_first(found)]
    page = (tmp_path / "out" / "report.html").read_text()
    assert page.index("The URDF&#39;s &lt;dynamics&gt; makes") < page.index(
        "What is missing, or wrong in the URDF, where"
    )
