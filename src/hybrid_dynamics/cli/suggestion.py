"""Descriptions of logs as plain values: those that options give, and those that a check writes."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hybrid_dynamics.readers.description import LogDescription, describe


def read_plain(args: argparse.Namespace) -> dict[str, Any]:
    """What ``--log --columns --units --torque`` say, without the keys that say nothing."""
    from hybrid_dynamics.cli.options import log_form

    form = log_form(args)
    if form is None:
        return {}
    empty = dataclasses.asdict(LogDescription())
    return {key: _plain(value) for key, value in dataclasses.asdict(form).items() if value != empty[key]}


def as_yaml(values: Mapping[str, Any], told: Sequence[str]) -> str:
    """``values`` as the text of a ``log.yaml``: one key a line, and what each cure mends as a comment above them."""
    import yaml

    lines = [f"# {line}" for line in ("written by hybrid-dynamics check", *told)]
    # Short lists stay on their key's line, as a person would write them.
    body = yaml.safe_dump(dict(values), sort_keys=False, allow_unicode=True, default_flow_style=None, width=1000)
    return "\n".join([*lines, body])


def write_description(path: Path, values: Mapping[str, Any], told: Sequence[str]) -> LogDescription:
    """Write ``values`` as a ``log.yaml`` (whole or not at all) and return what it says."""
    from hybrid_dynamics.files import atomic_path

    form = describe(values, str(path))
    with atomic_path(path) as temporary:
        Path(temporary).write_text(as_yaml(values, told), encoding="utf-8")
    return form


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items() if v not in ((), [], {}, None)}
    return [_plain(v) for v in value] if isinstance(value, list | tuple) else value
