"""Stage generate_blind: hide effects in simulated logs; the truth goes where only score_blind reads it."""

import shutil
from itertools import chain

from hybrid_dynamics.errors import run_main
from hybrid_dynamics.files import write_json
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.study.blind import BlindSettings, generate_blind, plan
from hybrid_dynamics.study.config import load_params, section
from hybrid_dynamics.study.foreign_cases import generate_foreign
from hybrid_dynamics.study.layout import BlindFiles
from hybrid_dynamics.trajectory import SIMULATED, write_trajectories
from stages.common import dataset_argument, progress_bar


def main() -> None:
    files = dataset_argument(__doc__)
    blind = BlindFiles(files.dataset)
    robot = Robot.from_urdf(files.robot)
    settings = section(load_params(), "blind", BlindSettings)
    shutil.rmtree(blind.logs, ignore_errors=True)
    truth = []
    total = len(plan(robot, settings)) + settings.foreign
    cases = chain(generate_blind(robot, settings), generate_foreign(files.robot.read_text("utf-8"), settings))
    with progress_bar(f"{files.dataset}: hiding effects") as progress:
        for case in cases:
            metadata = {"dataset": f"blind_{files.dataset}", "provenance": SIMULATED}
            write_trajectories(blind.logs / f"{case.name}.parquet", [*case.train, *case.test], metadata)
            truth.append(case.truth)
            progress(len(truth) / total, f"{len(truth)} of {total} cases")
    write_json(blind.truth, truth)


if __name__ == "__main__":
    run_main(main)
