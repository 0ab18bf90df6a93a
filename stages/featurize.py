"""Stage featurize: add tau_inertia, tau_coriolis, tau_gravity; one trajectory in memory at a time."""

from hybrid_dynamics.errors import run_main
from hybrid_dynamics.features import add_features
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import TrajectoryWriter, iter_trajectories, read_metadata
from stages.common import dataset_argument


def main() -> None:
    files = dataset_argument(__doc__)
    robot = Robot.from_urdf(files.robot)
    with TrajectoryWriter(files.features, read_metadata(files.derivatives)) as writer:
        for trajectory in iter_trajectories(files.derivatives, require=("q", "dq", "ddq", "dddq", "tau")):
            writer.write(add_features(robot, trajectory))
    print(f"{files.dataset}: {7 * robot.n_joints} features written")


if __name__ == "__main__":
    run_main(main)
