"""A loop's model in another engine: MuJoCo under the recorded torque of held-out runs, state error before and after."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from hybrid_dynamics.export.resimulate import ResimulationSettings, before_and_after
from hybrid_dynamics.export.source import Source
from hybrid_dynamics.study.layout import RESIMULATION_COLUMNS
from hybrid_dynamics.trajectory import Trajectory

#: Windows are spread evenly over the held-out runs; so many tell as much as all of them.
MOST_WINDOWS = 60


def state_errors(dataset: str, provenance: str, model: Path, urdf: Path, runs: Sequence[Trajectory]) -> pd.DataFrame:
    """A row a joint (:data:`RESIMULATION_COLUMNS`) of the robot ``urdf`` without effects and of ``model`` (model.json).

    Before is NaN where the robot without effects cannot move (a link without inertia). Empty where no run is held out.
    Raises :class:`InputError` where MuJoCo does not take ``model``, or every run is shorter than a window.
    """
    if not runs:
        return pd.DataFrame(columns=list(RESIMULATION_COLUMNS))
    source = Source.read(model, urdf)
    window = ResimulationSettings().window
    stride = max(window, sum(float(run.time[-1] - run.time[0]) for run in runs) / MOST_WINDOWS)
    before, after = before_and_after(source, runs, ResimulationSettings(stride=stride))
    none = np.full(source.robot.n_joints, np.nan)
    old = (none, none) if before is None else (before.position, before.velocity)
    errors = zip(old[0], after.position, old[1], after.velocity, strict=True)
    rows = [
        (dataset, provenance, joint, after.windows, window, *error)
        for joint, error in zip(source.robot.joint_names, errors, strict=True)
    ]
    return pd.DataFrame(rows, columns=list(RESIMULATION_COLUMNS))
