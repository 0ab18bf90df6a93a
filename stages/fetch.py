"""Stages fetch_<dataset> and fetch@<dataset>: verify and copy recorded files, or say that the simulated twin stands in.

A dataset without a ``source`` is made of one's own logs: its files are where ``robot`` and ``runs`` say.
"""

import os
from pathlib import Path

from hybrid_dynamics.errors import run_main
from hybrid_dynamics.study.config import load_params, section
from hybrid_dynamics.study.datasets import RecordedRun, RobotSettings
from hybrid_dynamics.study.layout import RAW
from hybrid_dynamics.study.own_logs import take_in
from hybrid_dynamics.study.sources import DataSource, SourceSettings, fetch
from hybrid_dynamics.trajectory import RECORDED, read_metadata
from stages.common import dataset_argument


def raw_folder() -> Path:
    """``data/raw`` of the repository, also for queued and ``--temp`` experiments, which run in a copy without it."""
    named = Path(os.environ.get("DVC_ROOT", ""))
    return named / RAW if (named / ".dvc").is_dir() else RAW


def main() -> None:
    files = dataset_argument(__doc__)
    params = load_params()
    name = f"dataset.{files.dataset}"
    if "source" in section(params, name, dict):
        settings = section(params, f"{name}.source", SourceSettings)
        # DVC may have removed the folder of the source already; what was made from it is still there.
        was_recorded = files.trajectories.exists() and read_metadata(files.trajectories).get("provenance") == RECORDED
        source = DataSource(settings, raw_dir=raw_folder())
        fetch(source, files.source, mode=section(params, "source", str), was_recorded=was_recorded)
        return
    runs = section(params, f"{name}.runs", list[RecordedRun])
    take_in(files.dataset, section(params, f"{name}.robot", RobotSettings), runs, files.source)
    print(f"{files.dataset}: {len(runs)} logs taken in")


if __name__ == "__main__":
    run_main(main)
