"""Stage close_added: what changed since the calibration? Reads URDF, calibrated model and logs, nothing else."""

import shutil

from hybrid_dynamics.errors import run_main
from hybrid_dynamics.loop import LoopSettings, close_loop, load_model
from hybrid_dynamics.loop_report.output import write_result
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.study.config import load_params, section
from hybrid_dynamics.study.layout import AddedFiles
from hybrid_dynamics.trajectory import read_trajectories
from stages.common import dataset_argument, progress_bar


def main() -> None:
    files = dataset_argument(__doc__)
    added = AddedFiles(files.dataset)
    settings = section(load_params(), "loop", LoopSettings)
    shutil.rmtree(added.diagnoses, ignore_errors=True)
    added.diagnoses.mkdir(parents=True)
    logs = sorted(added.logs.glob("*.parquet"))
    if not logs:
        return
    robot = Robot.from_urdf(files.park / "robot.urdf")
    base = load_model(files.park / "loop" / "model.json", robot)
    with progress_bar(f"{files.dataset}: asking what changed") as progress:
        for done, log in enumerate(logs, 1):
            result = close_loop(robot, read_trajectories(log), [], settings, base)
            write_result(added.diagnoses / log.stem, result)
            progress(done / len(logs), log.stem)


if __name__ == "__main__":
    run_main(main)
