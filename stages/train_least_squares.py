"""Stage train_least_squares: the classical baseline, identified on the training trajectories of one dataset."""

from hybrid_dynamics.errors import run_main
from hybrid_dynamics.files import write_json
from hybrid_dynamics.identification import LeastSquares, LeastSquaresSettings
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.study.config import load_params, section
from hybrid_dynamics.trajectory import iter_trajectories
from stages.common import dataset_argument, measured


def main() -> None:
    files = dataset_argument(__doc__)
    settings = section(load_params(), "least_squares", LeastSquaresSettings)
    model = LeastSquares(Robot.from_urdf(files.robot), settings)
    with measured(files.timing("least_squares")):
        model.fit(iter_trajectories(files.features, split="train"))
    write_json(files.model("least_squares") / "model.json", model.to_json())
    print(f"{files.dataset}: {model.base.size} base parameters, condition number {model.condition_number_:.0f}")


if __name__ == "__main__":
    run_main(main)
