"""Stage resimulate: the loop's model in MuJoCo under the torque of held-out runs, state error before and after."""

import pandas as pd

from hybrid_dynamics.errors import run_main
from hybrid_dynamics.export.resimulate import ResimulationSettings, before_and_after
from hybrid_dynamics.export.source import Source
from hybrid_dynamics.files import write_text
from hybrid_dynamics.study.layout import RESIMULATION_COLUMNS
from hybrid_dynamics.trajectory import SIMULATED, read_metadata, read_trajectories
from stages.common import dataset_argument

#: Windows are spread evenly over the held-out runs; so many tell as much as all of them.
MOST_WINDOWS = 60


def main() -> None:
    files = dataset_argument(__doc__)
    provenance = read_metadata(files.trajectories)["provenance"]
    # As for close_loop: simulated torque is held over the control period, differentiate has moved both to one instant.
    runs = read_trajectories(files.derivatives if provenance == SIMULATED else files.trajectories, split="test")
    source = Source.read(files.model("loop") / "model.json", files.robot)
    window = ResimulationSettings().window
    stride = max(window, sum(run.time[-1] - run.time[0] for run in runs) / MOST_WINDOWS)
    before, after = before_and_after(source, runs, ResimulationSettings(stride=stride))
    errors = zip(before.position, after.position, before.velocity, after.velocity, strict=True)
    rows = [
        (files.dataset, provenance, joint, after.windows, window, *error)
        for joint, error in zip(source.robot.joint_names, errors, strict=True)
    ]
    table = pd.DataFrame(rows, columns=list(RESIMULATION_COLUMNS))
    write_text(files.resimulation, table.to_csv(index=False, float_format="%.6g"))
    print(f"{files.dataset}: {after.windows} windows of held-out runs simulated again in MuJoCo")


if __name__ == "__main__":
    run_main(main)
