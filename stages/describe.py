"""Stage describe: the description of a robot that has no data of its own, for the blind cases."""

from hybrid_dynamics.errors import run_main
from hybrid_dynamics.files import write_text
from hybrid_dynamics.study.config import load_params, section
from hybrid_dynamics.study.datasets import RobotSettings, robot_description
from stages.common import dataset_argument


def main() -> None:
    files = dataset_argument(__doc__)
    settings = section(load_params(), f"dataset.{files.dataset}.robot", RobotSettings)
    write_text(files.robot, robot_description(settings))


if __name__ == "__main__":
    run_main(main)
