"""Where a result comes from: version, command, settings, digests of robot and logs. Nothing in it depends on the day or
the place: the same inputs give the same bytes.
"""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from glob import escape
from importlib import metadata
from pathlib import Path
from typing import Any

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.loop.settings import LoopSettings
from hybrid_dynamics.readers.delimited import STANDARD_INPUT, read_bytes
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.robots.identity import differences, digest_of, dynamics_of

PathLike = str | os.PathLike[str]


def provenance_of(
    robot: Robot,
    settings: LoopSettings,
    *,
    command: Mapping[str, Any],
    urdf: PathLike,
    train: Sequence[PathLike] = (),
    test: Sequence[PathLike] = (),
    model: PathLike | None = None,
) -> dict[str, Any]:
    """The block ``provenance`` of ``diagnosis.json`` and ``model.json``, as JSON values.

    :class:`InputError` where a test log has the bytes of a training log: nothing would be held out.
    """
    logs = {"train": [file_digest(p) for p in train], "test": [file_digest(p) for p in test]}
    learnt = {entry["sha256"]: entry["name"] for entry in logs["train"]}
    for path, entry in zip(test, logs["test"], strict=True):
        if entry["sha256"] in learnt:
            raise InputError(
                f"{path}: is a copy of the training log {learnt[entry['sha256']]}; "
                "held-out logs must not be learnt from"
            )
    out: dict[str, Any] = {
        "version": _version(),
        "command": dict(command),
        "settings": plain(asdict(settings)),
        "robot": {"urdf": file_digest(urdf), "dynamics_sha256": digest_of(dynamics_of(robot))},
        "logs": logs,
    }
    if model is not None:
        out["model"] = file_digest(model)
    return out


def file_digest(path: PathLike) -> dict[str, Any]:
    """Name and SHA-256 of a file, or of standard input (``-``).

    Of a folder (a ROS 2 bag), and of a run in several files that is given by what their names begin with, the digest of
    the files' names and contents.
    """
    place = Path(path)
    if str(path) == STANDARD_INPUT:
        return {"name": "standard input", "sha256": hashlib.sha256(read_bytes(path)).hexdigest()}
    digest = hashlib.sha256()
    several = place.rglob("*") if place.is_dir() else place.parent.glob(f"{escape(place.name)}*")
    for file in [place] if place.is_file() else sorted(several):
        if not file.is_file():
            continue
        if place.is_dir():
            digest.update(f"{file.relative_to(place).as_posix()}\0".encode(errors="surrogateescape"))
        with open(file, "rb") as stream:
            while chunk := stream.read(1 << 20):
                digest.update(chunk)
    return {"name": place.name, "sha256": digest.hexdigest()}


def identity_of(robot: Robot) -> dict[str, Any]:
    """What ``model.json`` says of the robot it was made for."""
    dynamics = dynamics_of(robot)
    return {"robot_digest": digest_of(dynamics), "dynamics": dynamics}


def check_identity(value: Mapping[str, Any], robot: Robot, path: PathLike) -> None:
    """Raise :class:`InputError` that says what differs where the model ``value`` was not made for ``robot``."""
    if value["robot"] != robot.name:
        raise InputError(
            f"{path}: made for robot {value['robot']!r}; the URDF describes {robot.name!r}: give the URDF the model "
            "was made with, or run close-loop for this robot"
        )
    if "dynamics" not in value:
        return  # written before models carried it
    found = differences(value["dynamics"], robot)
    if found:
        more = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
        raise InputError(
            f"{path}: made for another robot: in this URDF {found[0]}{more}: give the URDF the model was made with, or "
            "run close-loop for this robot"
        )


def _version() -> str:
    try:
        return metadata.version("hybrid-dynamics")
    except metadata.PackageNotFoundError:
        return "unknown"


def plain(value: Any) -> Any:
    """Settings as JSON values: tuples become lists, numbers that JSON does not have become text."""
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, Mapping):
        return {k: plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    return value
