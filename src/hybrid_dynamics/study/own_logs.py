"""The logs and URDF of one's own robot, copied into the study so that a change of them re-runs it."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.files import write_json
from hybrid_dynamics.study.datasets import RecordedRun, RobotSettings, taken_in
from hybrid_dynamics.study.sources.fetch import SOURCE_FILE
from hybrid_dynamics.trajectory import RECORDED


def take_in(dataset: str, robot: RobotSettings, runs: Sequence[RecordedRun], target: Path) -> None:
    """Copy the URDF and the log of every run into ``target`` (replaced as a whole) with a ``source.json``.

    Raises :class:`InputError` for a path that is no file (a ROS 2 bag may be a folder), for runs without one to train
    on and for a name or file that stands twice; nothing is written then.
    """
    places = {name: Path(name) for name in (robot.urdf, *(run.file for run in runs))}
    mend = f"correct conf/dataset/{dataset}.yaml and run make params"
    for name, path in places.items():
        # A ROS 2 bag is a folder; anything else that is one would be copied as a whole.
        bag = name != robot.urdf and (path / "metadata.yaml").is_file()
        if not (path.is_file() or bag):
            raise InputError(f"{name or 'empty path'}: {'is a folder' if path.is_dir() else 'no such file'}; {mend}")
    if not any(run.split == "train" for run in runs):
        raise InputError(f"dataset {dataset}: no run with split 'train'; {mend}")
    for kind, values in (("name", [run.name for run in runs]), ("file", [run.file for run in runs])):
        twice = [value for value in values if values.count(value) > 1]
        if twice:
            raise InputError(f"dataset {dataset}: {kind} {twice[0]!r} stands twice among its runs; {mend}")
    temporary = target.with_name(f".{target.name}.tmp")
    shutil.rmtree(temporary, ignore_errors=True)
    for path in places.values():
        copy = temporary / taken_in(str(path))
        copy.parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir():
            shutil.copytree(path, copy)
        else:
            shutil.copyfile(path, copy)
    write_json(
        temporary / SOURCE_FILE,
        {"dataset": dataset, "provenance": RECORDED, "repository": "your logs", "licence": "yours", "notice": ""},
    )
    shutil.rmtree(target, ignore_errors=True)
    temporary.rename(target)
