"""Stage train_<method>: fit one method on the training trajectories of one dataset."""

import argparse
import json
import resource
import shutil
import time

import numpy as np

from hybrid_dynamics.config import load_params
from hybrid_dynamics.errors import run_main
from hybrid_dynamics.features import feature_matrix
from hybrid_dynamics.files import write_json
from hybrid_dynamics.layout import DatasetFiles
from hybrid_dynamics.models import METHODS, build_estimator, save_estimator
from hybrid_dynamics.trajectory import read_trajectories
from stages.common import dataset_files


def fit(method: str, files: DatasetFiles) -> None:
    """Fit and save one estimator; wall time and peak memory go to a file of their own."""
    trajectories = read_trajectories(files.features, split="train")
    features = np.concatenate([feature_matrix(t) for t in trajectories])
    torque = np.concatenate([t["tau"] for t in trajectories])
    print(f"{files.dataset}: train_{method}: {len(features)} samples x {features.shape[1]} features", flush=True)
    started = time.perf_counter()
    estimator = build_estimator(method, method_settings(load_params(), method))
    estimator.fit(features, torque)
    elapsed = time.perf_counter() - started
    folder = files.model(method)
    temporary = folder.with_name(f".{folder.name}.tmp")
    shutil.rmtree(temporary, ignore_errors=True)
    save_estimator(estimator, temporary)
    shutil.rmtree(folder, ignore_errors=True)
    temporary.rename(folder)
