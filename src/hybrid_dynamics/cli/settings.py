"""Settings of the loop from the command line's ``--set name=value``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from hybrid_dynamics.errors import ConfigError
from hybrid_dynamics.loop.process import ProcessSettings
from hybrid_dynamics.loop.settings import LoopSettings

Settings = TypeVar("Settings", LoopSettings, ProcessSettings)


def settings_from(pairs: Sequence[str]) -> LoopSettings:
    """Settings from ``name=value`` pairs; :class:`ConfigError` names what is unknown or of the wrong type."""
    values: dict[str, Any] = {}
    for pair in pairs:
        name, sign, text = pair.partition("=")
        if not sign:
            raise ConfigError(f"--set {pair}: expected NAME=VALUE")
        values[name] = _value(name, text)
    if "process" in values:
        raise ConfigError("--set process: is a group; set one value of it, such as process.cutoff=25")
    own = {k: v for k, v in values.items() if not k.startswith("process.")}
    process_values = {k.removeprefix("process."): v for k, v in values.items() if k.startswith("process.")}
    process_settings = _typed(ProcessSettings, process_values)
    return _typed(LoopSettings, {**own, "process": process_settings})


def _value(name: str, text: str) -> Any:
    try:
        value = OmegaConf.to_container(OmegaConf.from_dotlist([f"value={text}"]))
    except (OmegaConfBaseException, YAMLError) as error:
        reason = str(error).splitlines()[0]
        raise ConfigError(f"--set {name}={text}: cannot be read ({reason}); expected such as 1 or [0, 1]") from None
    assert isinstance(value, dict)
    return value["value"]


def _typed(cls: type[Settings], values: dict[str, Any]) -> Settings:
    defaults = cls()
    for name, value in values.items():
        if name not in vars(defaults):
            known = ", ".join(k for k in vars(defaults) if k != "process")
            raise ConfigError(f"setting {name!r} is unknown; known are {known}")
        default = getattr(defaults, name)
        if isinstance(default, tuple):
            if not isinstance(value, list | tuple):
                example = "[viscous_friction, armature]" if name == "effects" else "[0, 0.05]"
                raise ConfigError(f"{name} is {value!r}; expected a list such as {example}")
            values[name] = tuple(value)
            if any(isinstance(v, str) != (name == "effects") for v in value):
                raise ConfigError(
                    f"{name} is {value!r}; expected a list of {'names' if name == 'effects' else 'numbers'}"
                )
        elif isinstance(default, bool):
            if not isinstance(value, bool):
                raise ConfigError(f"{name} is {value!r}; expected true or false")
        elif isinstance(default, int | float):
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise ConfigError(f"{name} is {value!r}; expected a number")
            if isinstance(default, int) and value != int(value):
                raise ConfigError(f"{name} is {value!r}; expected a whole number")
            values[name] = type(default)(value)
    return cls(**values)
