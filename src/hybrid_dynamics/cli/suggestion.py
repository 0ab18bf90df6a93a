"""Descriptions of logs as plain values: those that options give, and those that a check writes."""

from __future__ import annotations

import argparse
import dataclasses
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


def write_description(path: Path, values: dict[str, Any]) -> LogDescription:
    """Write ``values`` as a ``log.yaml`` (whole or not at all) and return what it says."""
    import yaml

    from hybrid_dynamics.files import atomic_path

    form = describe(values, str(path))
    with atomic_path(path) as temporary:
        text = yaml.safe_dump(values, sort_keys=False, allow_unicode=True)
        Path(temporary).write_text(f"# written by hybrid-dynamics check\n{text}", encoding="utf-8")
    return form


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items() if v not in ((), [], {}, None)}
    return [_plain(v) for v in value] if isinstance(value, list | tuple) else value
