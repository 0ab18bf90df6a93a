"""Stage train_<method>: fit one method on the training trajectories of one dataset."""

import argparse
import shutil
from typing import get_type_hints

import numpy as np
import pandas as pd

from hybrid_dynamics.errors import run_main
from hybrid_dynamics.features import feature_matrix
from hybrid_dynamics.files import write_text
from hybrid_dynamics.models import (
    METHODS,
    Factor,
    MethodSettings,
    build_estimator,
    complexity,
    estimator_expressions,
    estimator_front,
    fit_factor,
    format_expression,
    load_estimator,
    save_estimator,
)
from hybrid_dynamics.models.base import Estimator
from hybrid_dynamics.study.config import load_params, section
from hybrid_dynamics.study.layout import DatasetFiles
from stages.common import dataset_files, measured, progress_bar, training_runs

SINDY = ("sindy", "sindy_scaled", "r_sindy", "r_sindy_scaled")


def settings_of(params: dict) -> MethodSettings:
    """The sections of ``params.yaml`` that shape the methods."""
    return MethodSettings(
        **{name: section(params, name, kind) for name, kind in get_type_hints(MethodSettings).items()}
    )


def train(method: str, files: DatasetFiles, settings: MethodSettings) -> Estimator:
    """Fit ``method``; what it is built on is read where another stage has trained it."""
    if method in SINDY:
        factor = Factor.load(files.factor)
        print(f"{files.dataset}: train_{method}: {factor.rows} samples, {len(factor.powers)} library terms", flush=True)
        with measured(files.timing(method)):
            return fit_factor(method, settings, factor)
    runs = training_runs(files)
    features = np.concatenate([feature_matrix(run) for run in runs])
    torque = np.concatenate([run["tau"] for run in runs])
    print(f"{files.dataset}: train_{method}: {len(features)} samples x {features.shape[1]} features", flush=True)
    below = METHODS[method]
    base = load_estimator(files.model(below)) if below not in (None, "rigid_body") else None
    with progress_bar(f"{files.dataset}: train_{method}") as progress:

        def report(done: int, total: int, loss: float | None = None) -> None:
            progress(done / total, f"{done} of {total}" if loss is None else f"mean squared error {loss:.3g} N²m²")

        estimator = build_estimator(method, settings, base=base, progress=report)
        with measured(files.timing(method)):
            estimator.fit(features, torque)
    return estimator


def write(estimator: Estimator, method: str, files: DatasetFiles, engine: str) -> None:
    """Model, expressions and front into a folder that replaces the old one as a whole."""
    folder = files.model(method)
    temporary = folder.with_name(f".{folder.name}.tmp")
    shutil.rmtree(temporary, ignore_errors=True)
    save_estimator(estimator, temporary)
    expressions = estimator_expressions(estimator)
    if expressions is not None:
        rows = [
            {"joint": j, "engine": engine, "expression": format_expression(e), "complexity": complexity(e)}
            for j, e in enumerate(expressions, 1)
        ]
        write_text(temporary / "expressions.csv", pd.DataFrame(rows).to_csv(index=False))
    front = estimator_front(estimator)
    if front:
        write_text(temporary / "front.csv", pd.DataFrame(front).to_csv(index=False))
    shutil.rmtree(folder, ignore_errors=True)
    temporary.rename(folder)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("method", choices=sorted(METHODS))
    parser.add_argument("dataset")
    arguments = parser.parse_args()
    files = dataset_files(arguments.dataset)
    settings = settings_of(load_params())
    engine = settings.sr.engine if arguments.method.endswith(("sr", "sr_published")) else "stlsq"
    write(train(arguments.method, files, settings), arguments.method, files, engine)


if __name__ == "__main__":
    run_main(main)
