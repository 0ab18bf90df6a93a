"""Stage score_blind: compare what was named with what was hidden; the only stage that reads the truth."""

import json

from hybrid_dynamics.errors import run_main
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.study.blind_score import score_blind, write_blind
from hybrid_dynamics.study.layout import BlindFiles
from hybrid_dynamics.trajectory import read_trajectories
from stages.common import dataset_argument


def main() -> None:
    files = dataset_argument(__doc__)
    blind = BlindFiles(files.dataset)
    robot = Robot.from_urdf(files.robot)
    rows = []
    for truth in json.loads(blind.truth.read_text(encoding="utf-8")):
        log = blind.logs / f"{truth['case']}.parquet"
        diagnosis = json.loads((blind.diagnoses / f"{truth['case']}.json").read_text(encoding="utf-8"))
        runs = {split: read_trajectories(log, split=split) for split in ("train", "test")}
        row = score_blind(truth, diagnosis, robot, runs["train"], runs["test"])
        rows.append(row | {"robot": files.dataset})
    write_blind(blind.scores, rows)
    right = sum(bool(row["named_right"] and row["nothing_wrong_named"]) for row in rows)
    print(f"{files.dataset}: {right} of {len(rows)} blind cases named right and nothing else")


if __name__ == "__main__":
    run_main(main)
