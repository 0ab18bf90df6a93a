"""Stage train_<method>: fit one method on the training trajectories of one dataset."""

import argparse
import shutil

import numpy as np
import pandas as pd

from hybrid_dynamics.errors import run_main
from hybrid_dynamics.features import feature_matrix
from hybrid_dynamics.files import write_text
from hybrid_dynamics.models.base import Estimator
from hybrid_dynamics.models.expressions import complexity, format_expression
from hybrid_dynamics.models.factor import Factor
from hybrid_dynamics.models.methods import METHODS, Layer, build_estimator, fit_factor, is_reduced, layered
from hybrid_dynamics.models.storage import load_estimator, save_estimator
from hybrid_dynamics.study.config import load_params, section
from hybrid_dynamics.study.layout import DatasetFiles
from stages.common import dataset_files, measured, progress_bar, training_runs


def train(method: str, files: DatasetFiles, settings: dict[str, object]) -> Estimator:
    """Fit ``method``; what it is built on is read where another stage has trained it."""
    if is_reduced(method):
        factor = Factor.load(files.factor)
        print(f"{files.dataset}: train_{method}: {factor.rows} samples, {len(factor.powers)} library terms", flush=True)
        with measured(files.timing(method)):
            return fit_factor(method, settings, factor)
    runs = training_runs(files)
    features = np.concatenate([feature_matrix(run) for run in runs])
    torque = np.concatenate([run["tau"] for run in runs])
    print(f"{files.dataset}: train_{method}: {len(features)} samples x {features.shape[1]} features", flush=True)
    below = METHODS[method].learned_below
    base = load_estimator(files.model(below)) if below is not None else None
    with progress_bar(f"{files.dataset}: train_{method}") as progress:
        estimator = build_estimator(method, settings, base=base, progress=progress)
        with measured(files.timing(method)):
            estimator.fit(features, torque)
    return estimator


def write(estimator: Estimator, method: str, files: DatasetFiles) -> None:
    """Model, expressions and front into a folder that replaces the old one as a whole."""
    folder = files.model(method)
    temporary = folder.with_name(f".{folder.name}.tmp")
    shutil.rmtree(temporary, ignore_errors=True)
    save_estimator(estimator, temporary)
    expressions = estimator.expressions()
    if expressions is not None:
        rows = [
            {"joint": j, "engine": estimator.engine, "expression": format_expression(e), "complexity": complexity(e)}
            for j, e in enumerate(expressions, 1)
        ]
        write_text(temporary / "expressions.csv", pd.DataFrame(rows).to_csv(index=False))
    front = estimator.front()
    if front:
        write_text(temporary / "front.csv", pd.DataFrame(front).to_csv(index=False))
    shutil.rmtree(folder, ignore_errors=True)
    temporary.rename(folder)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("method", choices=sorted(layered()))
    parser.add_argument("dataset")
    arguments = parser.parse_args()
    method, files = arguments.method, dataset_files(arguments.dataset)
    write(train(method, files, {METHODS[method].section: settings_of(method)}), method, files)


def settings_of(method: str) -> object:
    """The section of ``params.yaml`` that shapes the method's own layer."""
    layer = METHODS[method].layer
    assert isinstance(layer, Layer)
    return section(load_params(), layer.section, layer.estimator().settings_type)


if __name__ == "__main__":
    run_main(main)
