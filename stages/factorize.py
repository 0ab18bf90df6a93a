"""Stage factorize: reduce the training trajectories to the triangular factor that all SINDy methods share."""

import numpy as np

from hybrid_dynamics.errors import require, run_main
from hybrid_dynamics.features import feature_matrix
from hybrid_dynamics.models.sindy import SindySettings, factorize
from hybrid_dynamics.study.config import load_params, section
from stages.common import dataset_argument, measured, training_runs


def main() -> None:
    files = dataset_argument(__doc__)
    params = load_params()
    settings = section(params, "sindy", SindySettings)
    degree = section(params, "sindy_scaled", SindySettings).degree
    require(
        degree == settings.degree,
        f"sindy_scaled.degree is {degree} and sindy.degree is {settings.degree}; expected the same (one library)",
    )
    runs = training_runs(files)
    features = np.concatenate([feature_matrix(run) for run in runs])
    torque = np.concatenate([run["tau"] for run in runs])
    print(f"{files.dataset}: factorize: {len(features)} samples x {features.shape[1]} features", flush=True)
    with measured(files.timing("factorize")):
        factor = factorize(features, torque, settings)
    factor.save(files.factor)


if __name__ == "__main__":
    run_main(main)
