"""Parameters: wrong types, unknown keys and values out of range are refused by name."""

import shutil
from dataclasses import dataclass, field
from pathlib import Path

import pytest
import yaml
from stages.compose import ELSEWHERE, complete, compose, defaults, missing, plain, studies

from hybrid_dynamics.cli.settings import settings_from
from hybrid_dynamics.errors import ConfigError, require
from hybrid_dynamics.loop.process import ProcessSettings
from hybrid_dynamics.loop.settings import LoopSettings
from hybrid_dynamics.study.config import load_params, section

ROOT = Path(__file__).parents[1]
CONF = ROOT / "conf"


@dataclass(frozen=True)
class Inner:
    gain: float = 1.0

    def __post_init__(self):
        require(self.gain > 0, f"gain is {self.gain}; expected > 0")


@dataclass(frozen=True)
class Outer:
    threshold: float
    names: tuple[str, ...] = ()
    inner: Inner = field(default_factory=Inner)
    many: dict[str, Inner] = field(default_factory=dict)


def test_hand_written_exponent_is_a_number(tmp_path):
    (tmp_path / "params.yaml").write_text("sindy:\n  threshold: 1e-5\n  names: [a, b]\n")
    params = load_params(tmp_path / "params.yaml")
    assert section(params, "sindy", Outer) == Outer(1e-5, ("a", "b"))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"threshold": "abc"}, r"sindy.threshold is 'abc'"),
        ({"threshold": 1, "treshold": 2}, r"sindy.treshold is unknown"),
        ({"threshold": 1, "inner": {"gian": 2}}, r"sindy.inner.gian is unknown"),
        ({"threshold": 1, "many": {"x": {"gian": 2}}}, r"sindy.many.x.gian is unknown"),
        ({"threshold": 1, "inner": {"gain": -1}}, r"gain is -1.0; expected > 0"),
        ({}, r"sindy.threshold is 'missing'"),
    ],
)
def test_wrong_parameters_are_named(content, message):
    with pytest.raises(ConfigError, match=message):
        section({"sindy": content}, "sindy", Outer)


def test_missing_section_names_the_remedy():
    with pytest.raises(ConfigError, match=r"section 'nn' is missing.*make params"):
        section({}, "nn", Outer)


@pytest.mark.parametrize("name", defaults())
def test_every_setting_stands_in_conf(name):
    """So that `dvc exp run -S` can override it: Hydra refuses to set what is not there."""
    wanted = {key: value for key, value in defaults()[name].items() if key not in ELSEWHERE.get(name, ())}
    lacking = missing(yaml.safe_load((CONF / name).read_text("utf-8")), wanted)
    assert not lacking, f"conf/{name} lacks {lacking}; run make params"


def test_the_study_closes_the_loop_as_the_command_line_does():
    assert section(load_params(ROOT / "params.yaml"), "loop", LoopSettings) == LoopSettings()


def test_what_is_missing_is_added_and_nothing_else_is_touched(tmp_path):
    shutil.copytree(CONF, tmp_path / "conf")
    file = tmp_path / "conf/loop/default.yaml"
    text = file.read_text("utf-8")
    file.write_text(text.replace("alike_share: 0.03 ", "#").replace("max_effects: 60", "max_effects: 7"), "utf-8")
    assert complete(tmp_path / "conf") == ["conf/loop/default.yaml: alike_share"]
    content = yaml.safe_load(file.read_text("utf-8"))
    assert content["alike_share"] == LoopSettings().alike_share
    assert content["max_effects"] == 7
    assert "# s, shortest held-out block" in file.read_text("utf-8")
    assert complete(tmp_path / "conf") == []


def test_the_group_of_a_new_method_is_named_in_the_study(tmp_path):
    """A method is one module and one entry of the table: no line of conf/config.yaml is written by hand."""
    shutil.copytree(CONF, tmp_path / "conf")
    file = tmp_path / "conf/config.yaml"
    text = file.read_text("utf-8")
    file.write_text(text.replace("  - nn: paper\n", ""), "utf-8")
    assert complete(tmp_path / "conf") == ["conf/config.yaml: nn"]
    again = yaml.safe_load(file.read_text("utf-8"))["defaults"]
    assert sorted(again, key=str) == sorted(yaml.safe_load(text)["defaults"], key=str)
    assert again.index({"nn": "paper"}) < again.index("_self_")
    assert "# last: it overrides" in file.read_text("utf-8")
    assert complete(tmp_path / "conf") == []


def test_a_family_is_hidden_without_a_line_by_hand(tmp_path):
    """A new effect takes part in the full blind study: make params writes its name, where it belongs."""
    shutil.copytree(CONF, tmp_path / "conf")
    file = tmp_path / "conf/blind/full.yaml"
    text = file.read_text("utf-8")
    file.write_text(text.replace("    - gravity_tilt\n", ""), "utf-8")
    assert complete(tmp_path / "conf") == ["conf/blind/full.yaml: gravity_tilt under families"]
    assert yaml.safe_load(file.read_text("utf-8")) == yaml.safe_load(text)
    assert file.read_text("utf-8").count("#") == text.count("#")
    assert complete(tmp_path / "conf") == []


SMALL_ARM = """\
title: Small arm
studies: {{paper: [{lists}]}}
robot: {{urdf: logs/robot.urdf}}
reader: {{format: log}}
runs: [{{name: first, split: train, file: logs/first.csv}}, {{name: second, split: test, file: logs/second.csv}}]
twin: null
"""


def test_a_data_set_is_one_file(tmp_path):
    """It says itself where it stands: no other line of conf/ is written by hand."""
    shutil.copytree(CONF, tmp_path / "conf")
    (tmp_path / "conf/dataset/arm_of_a_test.yaml").write_text(SMALL_ARM.format(lists="recorded, park"), "utf-8")
    before = {file: file.read_text("utf-8") for file in tmp_path.rglob("*.yaml")}
    written = [
        "conf/config.yaml: arm_of_a_test",
        "conf/study/paper.yaml: arm_of_a_test under recorded",
        "conf/study/paper.yaml: arm_of_a_test under park",
    ]
    assert complete(tmp_path / "conf") == written
    again = {file: file.read_text("utf-8") for file in tmp_path.rglob("*.yaml")}
    assert {file.name for file in again if again[file] != before[file]} == {"config.yaml", "paper.yaml"}
    for file in (tmp_path / "conf/config.yaml", tmp_path / "conf/study/paper.yaml"):
        took = [line for line in again[file].splitlines() if line not in before[file].splitlines()]
        assert all("arm_of_a_test" in line for line in took)  # the rest and the comments as they were
    compose(tmp_path / "params.yaml", [], tmp_path / "conf")
    params = load_params(tmp_path / "params.yaml")
    assert "arm_of_a_test" in params["recorded"]
    assert params["dataset"]["arm_of_a_test"]["title"] == "Small arm"
    assert complete(tmp_path / "conf") == []


def test_a_list_that_is_not_there_is_refused(tmp_path):
    shutil.copytree(CONF, tmp_path / "conf")
    file = tmp_path / "conf/dataset/arm_of_a_test.yaml"
    written = [tmp_path / "conf" / name for name in ("study/paper.yaml", "config.yaml")]
    before = [path.read_text("utf-8") for path in written]
    file.write_text(SMALL_ARM.format(lists="recorded, parks"), "utf-8")
    with pytest.raises(ConfigError, match=r"arm_of_a_test.yaml: paper.yaml has no list 'parks'; it has datasets,"):
        complete(tmp_path / "conf")
    assert [path.read_text("utf-8") for path in written] == before  # nothing half-written


def test_every_data_set_stands_where_its_file_says():
    told = studies(CONF)
    for study in ("paper", "park"):
        lists = yaml.safe_load((CONF / "study" / f"{study}.yaml").read_text("utf-8"))
        stands = {n: [k for k, v in lists.items() if isinstance(v, list) and n in v] for n in told}
        assert stands == {n: told[n].get(study, []) for n in told}


def leaves(values, path=""):
    for name, value in values.items():
        if isinstance(value, dict):
            yield from leaves(value, f"{path}{name}.")
        else:
            yield f"{path}{name}", value


@pytest.mark.parametrize(("name", "value"), list(leaves(plain(LoopSettings()))))
def test_every_setting_of_the_loop_can_be_set_on_the_command_line(name, value):
    assert settings_from([f"{name}={value}"]) == LoopSettings()


def test_a_setting_on_the_command_line_counts():
    assert settings_from(["process.cutoff=30", "alike_share=0.05"]) == LoopSettings(
        alike_share=0.05, process=ProcessSettings(cutoff=30.0)
    )


def test_a_switch_is_true_or_false():
    assert not settings_from(["process.own_bandwidth=false"]).process.own_bandwidth
    with pytest.raises(ConfigError, match=r"own_bandwidth is 3; expected true or false"):
        settings_from(["process.own_bandwidth=3"])


@pytest.mark.parametrize(
    "override", ["loop.process.cutoff=30.0", "blind.duration=5.0", "dataset.wam.twin.rollout.lockstep=3"]
)
def test_a_setting_can_be_overridden_in_an_experiment(tmp_path, override):
    compose(tmp_path / "params.yaml", [override])
    value = load_params(tmp_path / "params.yaml")
    name, _, text = override.partition("=")
    for key in name.split("."):
        value = value[key]
    assert value == float(text)  # type: ignore[comparison-overlap]
