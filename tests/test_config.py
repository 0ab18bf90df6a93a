"""Parameters: wrong types, unknown keys and values out of range are refused by name."""

from dataclasses import dataclass, field

import pytest

from hybrid_dynamics.errors import ConfigError, require
from hybrid_dynamics.study.config import load_params, section


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
