"""``--config file.yaml``: the options of a command from a file, by the same names as on the command line."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from itertools import takewhile
from pathlib import Path
from typing import Any

from hybrid_dynamics.errors import ConfigError

_TRUE, _FALSE = ("true", "yes", "on"), ("false", "no", "off")
_MAX_BYTES = 1_000_000


def with_config(parser: argparse.ArgumentParser, arguments: Sequence[str]) -> list[str]:
    """``arguments`` with those of the config file they name put in front, but for options that they hold themselves:
    the command line wins.

    An option of one value that stands twice is refused (:class:`ConfigError`): one of the two would be lost. Paths in
    the file mean what they mean on the command line: relative to the working folder.
    """
    arguments = list(arguments)
    commands = _commands(parser)
    if not arguments or arguments[0] not in commands:
        return arguments
    command = commands[arguments[0]]
    given = _given(arguments)
    _demand_once(command, given)
    path = _named(arguments)
    return arguments if path is None else [arguments[0], *_tokens(path, command, given), *arguments[1:]]


def _given(arguments: Sequence[str]) -> list[str]:
    """The options among ``arguments``, without their dashes."""
    before = takewhile(lambda word: word != "--", arguments)
    return [word.partition("=")[0].removeprefix("--") for word in before if word.startswith("--")]


def _demand_once(command: argparse.ArgumentParser, given: Sequence[str]) -> None:
    for action in command._actions:
        if action.nargs in (0, "+", "*"):
            continue
        for option in action.option_strings:
            if given.count(option.removeprefix("--")) > 1:
                raise ConfigError(f"{option} stands twice; keep one")


def _named(arguments: Sequence[str]) -> str | None:
    found = None
    for k, word in enumerate(takewhile(lambda word: word != "--", arguments)):
        if word == "--config" and k + 1 < len(arguments):
            found = arguments[k + 1]
        elif word.startswith("--config="):
            found = word.partition("=")[2]
    return found


def _commands(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            return dict(action.choices)
    return {}


def _tokens(path: str, command: argparse.ArgumentParser, given: Sequence[str]) -> list[str]:
    """What the file at ``path`` says of options that are not ``given``, as on the command line."""
    values = _read(path)
    options = {
        option.removeprefix("--"): action
        for action in command._actions
        for option in action.option_strings
        if option.startswith("--") and option not in ("--help", "--config", "--version")
    }
    out: list[str] = []
    for key, value in values.items():
        name = str(key).replace("_", "-")
        if name not in options:
            raise ConfigError(f"{path}: option {key!r} is unknown; known are {', '.join(sorted(options))}")
        # What the file says is looked at also where the command line says it, too.
        tokens = _option(path, name, value, options[name])
        out += [] if name in given else tokens
    return out


def _option(path: str, key: str, value: Any, action: argparse.Action) -> list[str]:
    flag = f"--{key}"
    if action.nargs == 0:
        if not isinstance(value, str) or value.lower() not in (*_TRUE, *_FALSE):
            raise ConfigError(f"{path}: {key} is {value!r}; expected true or false")
        return [flag] if value.lower() in _TRUE else []
    if isinstance(value, dict):
        # NAME=VALUE options, written as a mapping.
        value = [f"{name}={_text(path, key, inner)}" for name, inner in value.items()]
    several = action.nargs in ("+", "*")
    words = value if isinstance(value, list) else [value]
    texts = [_text(path, key, word) for word in words]
    if not several:
        if len(texts) != 1:
            raise ConfigError(f"{path}: {key} holds {len(texts)} values; expected one")
        return [f"{flag}={texts[0]}"]
    if not texts:
        return []
    dashed = [text for text in texts if text.startswith("-")]
    if dashed:
        raise ConfigError(f"{path}: {key} holds {dashed[0]!r}; a value cannot begin with '-': write ./{dashed[0]}")
    return [flag, *texts]


def _text(path: str, key: str, value: Any) -> str:
    if isinstance(value, list):
        return f"[{', '.join(_text(path, key, v) for v in value)}]"
    if not isinstance(value, str) or not value:
        raise ConfigError(f"{path}: {key} is {value!r}; expected text, a number or a list of them")
    return value


def _read(path: str) -> dict[str, Any]:
    import yaml

    file = Path(path)
    if not file.is_file():
        raise ConfigError(f"{path}: no such file; give a YAML file to --config")
    if file.stat().st_size > _MAX_BYTES:
        raise ConfigError(f"{path}: has more than {_MAX_BYTES} bytes; give a YAML file with options to --config")
    try:
        # The base loader leaves every value the text it is: `on`, 1e3 and 2026-01-01 mean what the flag makes of them.
        root = yaml.compose(file.read_text(encoding="utf-8"), Loader=yaml.BaseLoader)
        value = _plain(path, root, 0)
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
        raise ConfigError(f"{path}: not readable as YAML ({' '.join(str(error).split())})") from None
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise ConfigError(f"{path}: holds no options; expected lines such as 'robot: robot.urdf'")
    return value


def _plain(path: str, node: Any, depth: int) -> Any:
    """A YAML node as lists, dicts and text; a key twice is refused, and depth is bounded (aliases may be cyclic)."""
    import yaml

    if node is None:
        return None
    if depth > 3:
        raise ConfigError(f"{path}: nested too deeply; expected options with values or lists of values")
    if isinstance(node, yaml.ScalarNode):
        return str(node.value)
    if isinstance(node, yaml.SequenceNode):
        return [_plain(path, child, depth + 1) for child in node.value]
    out: dict[str, Any] = {}
    for key, child in node.value:
        name = str(key.value)
        if name in out:
            raise ConfigError(f"{path}: option {name!r} stands twice; keep one")
        out[name] = _plain(path, child, depth + 1)
    return out
