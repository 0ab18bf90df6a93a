"""Stage close_loop: find what the dataset's rigid-body model lacks, name it, add it (trace ⇄ augment)."""

from hybrid_dynamics.errors import run_main
from hybrid_dynamics.files import write_text
from hybrid_dynamics.loop import LoopSettings, close_loop
from hybrid_dynamics.loop.provenance import provenance_of
from hybrid_dynamics.loop_report.output import write_result
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.study.config import load_params, section
from hybrid_dynamics.study.steps import step_table
from hybrid_dynamics.trajectory import SIMULATED, read_metadata, read_trajectories
from stages.common import dataset_argument, measured, progress_bar


def main() -> None:
    files = dataset_argument(__doc__)
    settings = section(load_params(), "loop", LoopSettings)
    provenance = read_metadata(files.trajectories)["provenance"]
    # Simulated torque is held over the control period; differentiate has moved state and torque to one instant.
    runs = read_trajectories(files.derivatives if provenance == SIMULATED else files.trajectories)
    train, test = ([run for run in runs if run.split == split] for split in ("train", "test"))
    folder, robot = files.model("loop"), Robot.from_urdf(files.robot)
    with progress_bar(f"{files.dataset}: close_loop") as progress, measured(files.timing("loop")):
        result = close_loop(robot, train, test, settings, progress=progress)
    log = files.derivatives if provenance == SIMULATED else files.trajectories
    command = {"stage": f"close_loop@{files.dataset}"}
    origin = provenance_of(robot, settings, command=command, urdf=files.robot, train=[log])
    write_result(folder, result, origin, provenance, keep_content=True)
    write_text(folder / "steps.csv", step_table(result, files.dataset, provenance).to_csv(index=False))
    print(f"{files.dataset}: {result.diagnosis.verdict}, {len(result.diagnosis.effects)} effects named")


if __name__ == "__main__":
    run_main(main)
