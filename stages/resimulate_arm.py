"""Stage resimulate_arm: a recorded arm's model in MuJoCo under the torque of its held-out runs."""

import pandas as pd

from hybrid_dynamics.errors import InputError, run_main
from hybrid_dynamics.files import write_text
from hybrid_dynamics.study.layout import RESIMULATION_COLUMNS
from hybrid_dynamics.study.resimulation import state_errors
from hybrid_dynamics.trajectory import RECORDED, read_trajectories
from stages.common import dataset_argument


def main() -> None:
    files = dataset_argument(__doc__)
    logs = files.park / "trajectories.parquet"
    table = pd.DataFrame(columns=list(RESIMULATION_COLUMNS))
    if logs.is_file():
        model, urdf = files.park / "loop" / "model.json", files.park / "robot.urdf"
        try:
            table = state_errors(files.dataset, RECORDED, model, urdf, read_trajectories(logs, split="test"))
            print(f"{files.dataset}: held-out runs simulated again in MuJoCo")
        except InputError as error:
            # A maker's URDF may have links that no simulator takes; torque does not need them, so the arm stays.
            print(f"{files.dataset}: cannot be simulated again, and has no row in the table: {error}")
    else:
        # Its recording could not be had: park_arm left it out, and so does this.
        print(f"{files.dataset}: left out of the park")
    write_text(files.park_resimulation, table.to_csv(index=False, float_format="%.6g"))


if __name__ == "__main__":
    run_main(main)
