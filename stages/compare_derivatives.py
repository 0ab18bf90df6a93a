"""Stage compare_derivatives: every differentiator on a noisy run of the twin, whose true derivatives are known."""

from dataclasses import dataclass, replace

import pandas as pd

from hybrid_dynamics.differentiate import derivative_errors
from hybrid_dynamics.errors import require, run_main
from hybrid_dynamics.files import write_text
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.study.config import load_params, section
from hybrid_dynamics.study.datasets import RecordedRun, RobotSettings, TwinSettings, robot_description, twin_runs
from stages.common import dataset_argument, progress_bar

WORKERS = 2


@dataclass(frozen=True)
class StudySettings:
    """``duration`` [s] of the run; ``tuned``: also find the best parameters on the truth."""

    duration: float
    tuned: bool

    def __post_init__(self) -> None:
        require(1 <= self.duration <= 60, f"duration is {self.duration}; expected 1 to 60 s")


def main() -> None:
    files = dataset_argument(__doc__)
    params = load_params()
    dataset = f"dataset.{files.dataset}"
    study = section(params, "derivative_study", StudySettings)
    twin = section(params, f"{dataset}.twin", TwinSettings)
    run = section(params, f"{dataset}.runs", list[RecordedRun])[0]
    robot = Robot.from_text(robot_description(section(params, f"{dataset}.robot", RobotSettings)), files.dataset)
    with progress_bar("derivatives: simulating") as progress:
        one = replace(twin, follow=twin.follow[:1])
        recording = twin_runs(robot, one, [run], files.source, section(params, "seed", int), progress)[0]
    rows = slice(0, round(study.duration / recording.recorded.dt))
    truth, noisy = recording.truth.rows(rows), recording.recorded.rows(rows)
    errors = derivative_errors(truth, noisy, tuned=study.tuned, workers=WORKERS)
    table = pd.DataFrame(errors)
    write_text(files.derivative_errors, table.to_csv(index=False, float_format="%.10g"))
    print(table[table["joint"] == "all"].to_string(index=False))


if __name__ == "__main__":
    run_main(main)
