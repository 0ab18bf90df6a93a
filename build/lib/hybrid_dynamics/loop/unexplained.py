"""What no effect explains, as the expression that symbolic regression finds for it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybrid_dynamics.loop.diagnosis import predict_run
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.process import Run

#: Operators beyond the paper's: friction needs sign and abs, springs and gravity sin and cos.
OPERATORS = ("add", "sub", "mul", "sign", "abs", "sin", "cos")
DIGITS = 5


def expression_of(model: Model, runs: Sequence[Run], joint: int, evaluations: int, rows: int = 4000) -> str:
    """Expression [N m] for what ``model`` leaves of the torque of ``joint`` (0-based), in q1 dq1 ddq1 ... (SI).

    Its variables are the joint's own position, speed and acceleration and the speeds of the others; at most ``rows``
    moving samples are used, evenly spaced. ``0`` where nothing but noise is found.
    """
    # Symbolic regression is rarely asked for, and its libraries take a second to import.
    import sympy as sp

    from hybrid_dynamics.models.symbolic import SymbolicSettings, symbolic_regression

    n = model.robot.n_joints
    keep = np.concatenate([run.mask[:, joint] for run in runs])
    left = np.concatenate([(run.tau - predict_run(model, run))[:, joint] for run in runs])[keep]
    q, dq, ddq = (np.concatenate([getattr(run, s) for run in runs])[keep] for s in ("q", "dq", "ddq"))
    if len(left) < 50:
        return "0"
    names = [f"q{joint + 1}", f"dq{joint + 1}", f"ddq{joint + 1}"]
    columns = [q[:, joint], dq[:, joint], ddq[:, joint]]
    for other in range(n):
        if other != joint:
            names.append(f"dq{other + 1}")
            columns.append(dq[:, other])
    thin = np.linspace(0, len(left) - 1, min(rows, len(left))).astype(int)
    settings = SymbolicSettings(
        operators=OPERATORS,
        batch=rows,
        evaluations=evaluations,
        max_length=20,
        max_rounds=2,
        min_gain=0.0,
        min_residual_gain=0.05,
        drop_residual_share=0.02,
        workers=1,
    )
    result = symbolic_regression(np.column_stack(columns)[thin], left[thin], names, settings, joint=joint + 1)
    if result.share_explained < 0.02:
        return "0"
    rounded = result.expression.xreplace({f: sp.Float(f, DIGITS) for f in result.expression.atoms(sp.Float)})
    return str(rounded)
