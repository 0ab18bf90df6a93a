"""MLflow's model-from-code script: the saved estimator behind MLflow's uniform ``predict``.

MLflow copies this file into the model and runs it when the model is loaded; the estimator comes from its own files
(``model.json``, weights as safetensors).
"""

from pathlib import Path
from typing import Any

import pandas as pd
from mlflow.models import set_model
from mlflow.pyfunc.model import PythonModel, PythonModelContext

from hybrid_dynamics.features import feature_names
from hybrid_dynamics.models.storage import load_estimator


def load(folder: Path) -> Any:
    """The estimator saved in ``folder``."""
    return load_estimator(folder)


def predict_frame(estimator: Any, frame: pd.DataFrame) -> pd.DataFrame:
    """Torque columns ``tau1 ..`` [N m] for feature columns ``q1 .. tau_gravity n`` (SI units), in any column order."""
    features = frame[list(feature_names(frame.shape[1] // 7))].to_numpy(float)
    torque = estimator.predict(features)
    return pd.DataFrame(torque, columns=[f"tau{j + 1}" for j in range(torque.shape[1])], index=frame.index)


class TorqueModel(PythonModel):
    """Joint torque [N m] from the 7 n features."""

    def load_context(self, context: PythonModelContext) -> None:
        """Read the estimator from MLflow's copy of its files."""
        self._estimator = load(Path(context.artifacts["model"]))

    def predict(self, context: PythonModelContext, model_input: pd.DataFrame, params: Any = None) -> pd.DataFrame:
        """Torque for a table of features."""
        return predict_frame(self._estimator, model_input)


set_model(TorqueModel())
