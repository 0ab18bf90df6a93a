"""Stage trajectories: the recorded runs of a dataset, or its simulated twin, on a uniform grid."""

from hybrid_dynamics.errors import InputError, run_main
from hybrid_dynamics.files import write_text
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.study.config import load_params, section
from hybrid_dynamics.study.datasets import (
    ReaderSettings,
    RecordedRun,
    RobotSettings,
    TwinSettings,
    read_run,
    robot_description,
    twin_runs,
)
from hybrid_dynamics.study.sources import read_source
from hybrid_dynamics.trajectory import RECORDED, write_trajectories
from stages.common import dataset_argument, progress_bar


def main() -> None:
    files = dataset_argument(__doc__)
    params = load_params()
    name = f"dataset.{files.dataset}"
    source = read_source(files.source)
    runs = section(params, f"{name}.runs", list[RecordedRun])
    write_text(files.robot, robot_description(section(params, f"{name}.robot", RobotSettings), files.source))
    robot = Robot.from_urdf(files.robot)
    if source["provenance"] == RECORDED:
        reader = section(params, f"{name}.reader", ReaderSettings)
        trajectories = (part for run in runs for part in read_run(reader, run, files.source, robot, print))
    else:
        described: type[TwinSettings | None] = TwinSettings | None  # type: ignore[assignment]
        twin = section(params, f"{name}.twin", described)
        if twin is None:
            raise InputError(
                f"dataset {files.dataset}: the recording cannot be had and {name}.twin is null; provide the recording "
                "(stage fetch says where it was looked for), or describe a twin in conf/dataset/"
            )
        with progress_bar(f"{files.dataset}: simulating the twin") as progress:
            recordings = twin_runs(robot, twin, runs, files.source, section(params, "seed", int), progress)
        trajectories = (recording.recorded for recording in recordings)
    metadata = {key: source[key] for key in ("provenance", "repository", "licence", "notice")}
    write_trajectories(files.trajectories, trajectories, {"dataset": files.dataset, **metadata})


if __name__ == "__main__":
    run_main(main)
