"""MLflow's model-from-code script of a closed loop: rigid body and named effects behind MLflow's uniform ``predict``.

MLflow copies this file into the model and runs it when the model is loaded; all else is ``model.json`` and the URDF.
"""

from typing import Any

import numpy as np
import pandas as pd
from mlflow.models import set_model
from mlflow.pyfunc.model import PythonModel, PythonModelContext

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.loop.model import Model, load_model
from hybrid_dynamics.loop.prediction import predict
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory


def torque_frame(model: Model, frame: pd.DataFrame) -> pd.DataFrame:
    """Torque columns ``tau1 ..`` [N m] along one log with columns ``time``, ``q1 ..``, perhaps ``dq1 ..`` (SI units).

    Raises :class:`InputError` where a column is missing or the log is too short to filter.
    """
    joints = range(1, model.robot.n_joints + 1)
    signals = {}
    for name in ("q", "dq"):
        columns = [f"{name}{j}" for j in joints]
        absent = [column for column in columns if column not in frame]
        if absent and (name == "q" or len(absent) < len(columns)):
            raise InputError(f"column {absent[0]!r} is missing; expected time, {columns[0]} to {columns[-1]}")
        if not absent:
            signals[name] = frame[columns].to_numpy(float)
    log = Trajectory("input", "test", frame["time"].to_numpy(float), signals)
    torque = predict(model, log).tau
    return pd.DataFrame(np.asarray(torque), columns=[f"tau{j}" for j in joints], index=frame.index)


class LoopModel(PythonModel):
    """Joint torque [N m] along a log."""

    def load_context(self, context: PythonModelContext) -> None:
        """Read the model from MLflow's copy of its files."""
        self._model = load_model(context.artifacts["model"], Robot.from_urdf(context.artifacts["robot"]))

    def predict(self, context: PythonModelContext, model_input: pd.DataFrame, params: Any = None) -> pd.DataFrame:
        """Torque for a table of motion."""
        return torque_frame(self._model, model_input)


set_model(LoopModel())
