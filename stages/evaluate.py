"""Stage evaluate: errors of every method on every trajectory of one dataset, and the predictions the figures show."""

import json
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from hybrid_dynamics.errors import run_main
from hybrid_dynamics.features import feature_matrix
from hybrid_dynamics.files import atomic_path
from hybrid_dynamics.identification import LeastSquares
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.models.base import RigidBody
from hybrid_dynamics.models.storage import load_estimator
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.study.config import load_params, section
from hybrid_dynamics.study.datasets import TwinSettings, true_torque
from hybrid_dynamics.study.evaluation import EvaluationSettings, Predictor, evaluate_predictions
from hybrid_dynamics.trajectory import SIMULATED_TWIN, Trajectory, iter_trajectories, read_metadata
from hybrid_dynamics.types import Array
from stages.common import dataset_argument


def predictor(method: str, folder: Path, robot: Robot) -> Predictor:
    """Trajectory → predicted torque (T, n) [N m] of one trained method."""
    if method == "least_squares":
        document = json.loads((folder / "model.json").read_text(encoding="utf-8"))
        return LeastSquares.from_json(document, robot).predict
    if method == "loop":
        model = Model.load(folder / "model.json", robot)
        return lambda t: model.predict(t["q"], t["dq"], t["ddq"], t.time)
    estimator = RigidBody() if method == "rigid_body" else load_estimator(folder)

    def predict(trajectory: Trajectory) -> Array:
        return estimator.predict(feature_matrix(trajectory))

    return predict


def main() -> None:
    files = dataset_argument(__doc__)
    params = load_params()
    settings = section(params, "evaluate", EvaluationSettings)
    robot = Robot.from_urdf(files.robot)
    methods = ["rigid_body", *sorted(path.name for path in files.model("").iterdir() if path.is_dir())]
    predictors = {method: predictor(method, files.model(method), robot) for method in methods}
    provenance = read_metadata(files.features)["provenance"]
    if provenance == SIMULATED_TWIN:
        friction = section(params, f"dataset.{files.dataset}.twin", TwinSettings).friction
        predictors["true_model"] = lambda run: true_torque(robot, friction, run)
    result = evaluate_predictions(predictors, iter_trajectories(files.features), files.dataset, provenance, settings)
    for path, table in ((files.errors, result.errors), (files.predictions, result.predictions)):
        with atomic_path(path) as temporary:
            pq.write_table(pa.Table.from_pandas(table, preserve_index=False), temporary, compression="zstd")
    print(f"{files.dataset}: {len(methods)} methods evaluated")


if __name__ == "__main__":
    run_main(main)
