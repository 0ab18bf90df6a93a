"""Stage park_arm: a recorded arm under rigid body, least squares, the loop and a black box on top of it."""

import shutil

from hybrid_dynamics.errors import run_main
from hybrid_dynamics.files import write_json, write_text
from hybrid_dynamics.identification import LeastSquaresSettings
from hybrid_dynamics.loop import LoopSettings, close_loop
from hybrid_dynamics.loop_report.output import write_result
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.study.config import load_params, section
from hybrid_dynamics.study.datasets import ReaderSettings, RecordedRun, RobotSettings, read_run, robot_description
from hybrid_dynamics.study.park import ParkSettings, judge_arm
from hybrid_dynamics.study.sources import read_source
from hybrid_dynamics.trajectory import RECORDED, write_trajectories
from stages.common import dataset_argument, progress_bar


def main() -> None:
    files = dataset_argument(__doc__)
    params = load_params()
    name = f"dataset.{files.dataset}"
    source = read_source(files.source)
    folder = files.park
    temporary = folder.with_name(f".{folder.name}.tmp")
    shutil.rmtree(temporary, ignore_errors=True)
    summary = {key: source[key] for key in ("dataset", "provenance", "repository", "licence")}
    write_json(temporary / "summary.json", {**summary, "title": section(params, f"{name}.title", str)})
    if source["provenance"] == RECORDED:
        text = robot_description(section(params, f"{name}.robot", RobotSettings), files.source)
        write_text(temporary / "robot.urdf", text)
        robot = Robot.from_urdf(temporary / "robot.urdf")
        reader = section(params, f"{name}.reader", ReaderSettings)
        runs = section(params, f"{name}.runs", list[RecordedRun])
        logs = [part for run in runs for part in read_run(reader, run, files.source, robot, print)]
        write_trajectories(temporary / "trajectories.parquet", logs, summary)
        train, test = ([log for log in logs if log.split == split] for split in ("train", "test"))
        loop = section(params, "loop", LoopSettings)
        with progress_bar(f"{files.dataset}: park_arm") as progress:
            result = close_loop(robot, train, test, loop, progress=progress)
        write_result(temporary / "loop", result)
        least_squares = section(params, "least_squares", LeastSquaresSettings)
        tables = judge_arm(
            files.dataset, robot, logs, result, loop, least_squares, section(params, "park_settings", ParkSettings)
        )
        for table in ("joints", "regimes", "parameters"):
            write_text(temporary / f"{table}.csv", getattr(tables, table).to_csv(index=False, float_format="%.6g"))
    else:
        print(f"{files.dataset}: left out of the park, provenance {source['provenance']}")
    shutil.rmtree(folder, ignore_errors=True)
    temporary.rename(folder)


if __name__ == "__main__":
    run_main(main)
