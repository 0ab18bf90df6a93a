"""Stage generate_added: add known effects to recorded runs; the truth goes where only score_added reads it."""

import json
import shutil
from dataclasses import replace

import numpy as np

from hybrid_dynamics.errors import run_main
from hybrid_dynamics.files import write_json
from hybrid_dynamics.loop import load_model
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.study.config import load_params, section
from hybrid_dynamics.study.layout import AddedFiles
from hybrid_dynamics.study.park import AddedSettings, generate_added
from hybrid_dynamics.trajectory import read_trajectories, write_trajectories
from stages.common import dataset_argument


def main() -> None:
    files = dataset_argument(__doc__)
    added = AddedFiles(files.dataset)
    settings = section(load_params(), "added", AddedSettings)
    shutil.rmtree(added.logs, ignore_errors=True)
    added.logs.mkdir(parents=True)
    truth = []
    recorded = files.park / "trajectories.parquet"
    if recorded.is_file():
        robot = Robot.from_urdf(files.park / "robot.urdf")
        base = load_model(files.park / "loop" / "model.json", robot)
        diagnosis = json.loads((files.park / "loop" / "diagnosis.json").read_text(encoding="utf-8"))
        runs = [replace(run, split="train") for run in read_trajectories(recorded, split="test")]
        for case in generate_added(robot, base, runs, np.array(diagnosis["noise_floor"]), settings, files.dataset):
            write_trajectories(added.logs / f"{case.name}.parquet", case.logs, {"dataset": f"added_{files.dataset}"})
            truth.append(case.truth)
    write_json(added.truth, truth)
    print(f"{files.dataset}: {len(truth)} cases of known effects added to recorded runs")


if __name__ == "__main__":
    run_main(main)
