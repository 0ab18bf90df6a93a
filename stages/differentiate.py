"""Stage differentiate: trajectories → q dq ddq dddq tau at the same instants and bandwidth."""

from hybrid_dynamics.differentiate import DifferentiateSettings, differentiate_trajectory
from hybrid_dynamics.errors import run_main
from hybrid_dynamics.files import write_json
from hybrid_dynamics.study.config import load_params, section
from hybrid_dynamics.trajectory import TrajectoryWriter, iter_trajectories, read_metadata
from stages.common import dataset_argument


def main() -> None:
    files = dataset_argument(__doc__)
    settings = section(load_params(), f"dataset.{files.dataset}.differentiate", DifferentiateSettings)
    reports = []
    with TrajectoryWriter(files.derivatives, read_metadata(files.trajectories)) as writer:
        for trajectory in iter_trajectories(files.trajectories, require=("q", "tau")):
            differentiated, report = differentiate_trajectory(trajectory, settings)
            writer.write(differentiated)
            reports.append({"trajectory": trajectory.name, **report})
            print(f"{files.dataset}: {trajectory.name}: {len(differentiated.time)} samples")
    write_json(files.folder / "differentiate.json", reports)


if __name__ == "__main__":
    run_main(main)
