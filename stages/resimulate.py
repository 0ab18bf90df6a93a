"""Stage resimulate: the loop's model in MuJoCo under the torque of held-out runs, state error before and after."""

from hybrid_dynamics.errors import run_main
from hybrid_dynamics.files import write_text
from hybrid_dynamics.study.resimulation import state_errors
from hybrid_dynamics.trajectory import SIMULATED, read_metadata, read_trajectories
from stages.common import dataset_argument


def main() -> None:
    files = dataset_argument(__doc__)
    provenance = read_metadata(files.trajectories)["provenance"]
    # As for close_loop: simulated torque is held over the control period, differentiate has moved both to one instant.
    runs = read_trajectories(files.derivatives if provenance == SIMULATED else files.trajectories, split="test")
    table = state_errors(files.dataset, provenance, files.model("loop") / "model.json", files.robot, runs)
    write_text(files.resimulation, table.to_csv(index=False, float_format="%.6g"))
    print(f"{files.dataset}: held-out runs simulated again in MuJoCo")


if __name__ == "__main__":
    run_main(main)
