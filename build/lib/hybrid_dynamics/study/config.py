"""Reading ``params.yaml``: one section at a time, each checked against the dataclass that uses it.

``params.yaml`` is the composition of ``conf/`` (``make params``); Hydra composes it, OmegaConf reads it (so that a
hand-written ``1e-5`` is a number) and pydantic checks the types. Ranges are checked by the dataclasses themselves.
"""

from __future__ import annotations

import dataclasses
import os
import typing
from pathlib import Path
from typing import Any, TypeVar

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from pydantic import TypeAdapter, ValidationError
from yaml import YAMLError

from hybrid_dynamics.errors import ConfigError

T = TypeVar("T")
PARAMS = Path("params.yaml")


def load_params(path: str | os.PathLike[str] = PARAMS) -> dict[str, Any]:
    """``params.yaml`` as plain containers."""
    file = Path(path)
    if not file.is_file():
        raise ConfigError(f"{file}: no such file; compose it from conf/ (make params)")
    try:
        content = OmegaConf.to_container(OmegaConf.load(file), resolve=True)
    except (OmegaConfBaseException, YAMLError, UnicodeDecodeError) as error:
        raise ConfigError(f"{file}: not readable ({error}); compose it anew from conf/ (make params)") from None
    if not isinstance(content, dict):
        raise ConfigError(f"{file}: expected a mapping of sections; compose it anew from conf/ (make params)")
    return typing.cast(dict[str, Any], content)


def section(params: dict[str, Any], name: str, kind: type[T]) -> T:
    """Section ``name`` (dotted) of ``params`` as a ``kind`` (a dataclass or a plain type).

    Raises :class:`ConfigError` naming the parameter, its value and what was expected.
    """
    value: Any = params
    for key in name.split("."):
        if not isinstance(value, dict) or key not in value:
            raise ConfigError(f"params.yaml: section {name!r} is missing; compose it from conf/ (make params)")
        value = value[key]
    return convert(value, name, kind)


def convert(value: Any, name: str, kind: type[T]) -> T:
    """``value``, found under the dotted ``name``, checked and converted to ``kind``."""
    _refuse_unknown(value, name, kind)
    try:
        return TypeAdapter(kind).validate_python(value)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join([name, *(str(part) for part in first["loc"])])
        shown = first["input"] if first["type"] != "missing" else "missing"
        raise ConfigError(f"params.yaml: {where} is {shown!r}: {_lower(first['msg'])}; change it in conf/") from None
    except ConfigError as error:
        raise ConfigError(f"params.yaml: {name}: {error}") from None


def _lower(message: str) -> str:
    return message[:1].lower() + message[1:]


def _refuse_unknown(value: Any, name: str, kind: Any) -> None:
    """pydantic ignores unknown keys of a dataclass; a misspelt parameter must not pass in silence."""
    if dataclasses.is_dataclass(kind) and isinstance(value, dict):
        hints = typing.get_type_hints(kind)
        known = [field.name for field in dataclasses.fields(kind)]
        for key, item in value.items():
            if key not in known:
                raise ConfigError(f"params.yaml: {name}.{key} is unknown; {name} knows {', '.join(known)}")
            _refuse_unknown(item, f"{name}.{key}", hints[key])
        return
    arguments = [a for a in typing.get_args(kind) if a is not type(None)]
    if isinstance(value, dict) and typing.get_origin(kind) is dict:
        for key, item in value.items():
            _refuse_unknown(item, f"{name}.{key}", arguments[1])
    elif isinstance(value, list | tuple) and arguments:
        for index, item in enumerate(value):
            _refuse_unknown(item, f"{name}.{index}", arguments[0])
    elif len(arguments) == 1:
        _refuse_unknown(value, name, arguments[0])
