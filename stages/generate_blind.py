"""Stage generate_blind: hide effects in simulated logs; the truth goes where only score_blind reads it."""

import shutil
from itertools import chain

from hybrid_dynamics.errors import run_main
from hybrid_dynamics.files import write_json
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.study.blind import BlindSettings, generate_blind, plan
from hybrid_dynamics.study.config import load_params, section
from hybrid_dynamics.study.foreign_cases import generate_foreign, plan_foreign
from hybrid_dynamics.study.layout import BlindFiles
from hybrid_dynamics.study.mixed_cases import generate_mixed, plan_mixed
from hybrid_dynamics.trajectory import SIMULATED, write_trajectories
from stages.common import dataset_argument, progress_bar


def main() -> None:
    files = dataset_argument(__doc__)
    blind = BlindFiles(files.dataset)
    robot = Robot.from_urdf(files.robot)
    settings = section(load_params(), "blind", BlindSettings)
    shutil.rmtree(blind.logs, ignore_errors=True)
    truth = []
    plans = plan(robot, settings), plan_mixed(robot, settings), plan_foreign(settings, robot.name)
    total = sum(len(own) for own in plans)
    text = files.robot.read_text("utf-8")
    cases = chain(generate_blind(robot, settings), generate_mixed(robot, settings), generate_foreign(text, settings))
    with progress_bar(f"{files.dataset}: hiding effects") as progress:
        for case in cases:
            metadata = {"dataset": f"blind_{files.dataset}", "provenance": SIMULATED}
            write_trajectories(blind.logs / f"{case.name}.parquet", [*case.train, *case.test], metadata)
            truth.append(case.truth)
            progress(len(truth) / total, f"{len(truth)} of {total} cases")
    write_json(blind.truth, truth)


if __name__ == "__main__":
    run_main(main)
