"""Stage generate_sim: simulate training and test rollouts of a robot with known dynamics and damping."""

from hybrid_dynamics.errors import run_main
from hybrid_dynamics.files import write_text
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.simulation import simulate_dataset
from hybrid_dynamics.study.config import load_params, section
from hybrid_dynamics.study.datasets import RobotSettings, StudySimulation, robot_description
from hybrid_dynamics.trajectory import SIMULATED, write_trajectories
from stages.common import dataset_argument, progress_bar


def main() -> None:
    files = dataset_argument(__doc__)
    params = load_params()
    settings = section(params, f"dataset.{files.dataset}.simulation", StudySimulation)
    write_text(files.robot, robot_description(section(params, f"dataset.{files.dataset}.robot", RobotSettings)))
    robot = Robot.from_urdf(files.robot)
    with progress_bar(f"{files.dataset}: simulating") as progress:
        rollouts = simulate_dataset(
            robot,
            settings.rollout,
            references=settings.reference,
            control=settings.controller,
            damping=settings.damping,
            n_train=settings.n_train,
            n_test=settings.n_test,
            seed=section(params, "seed", int),
            progress=progress,
        )
        metadata = {"dataset": files.dataset, "provenance": SIMULATED, "damping": list(settings.damping)}
        write_trajectories(files.trajectories, rollouts, metadata)


if __name__ == "__main__":
    run_main(main)
