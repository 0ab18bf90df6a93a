"""What no effect explains, as a short law that symbolic regression finds for it and the test runs bear out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hybrid_dynamics.loop.diagnosis import predict_run
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.loop.trace import block_error
from hybrid_dynamics.types import Array

#: Operators beyond the paper's: friction needs sign and abs, springs and gravity sin and cos.
OPERATORS = ("add", "sub", "mul", "sign", "abs", "sin", "cos")
#: Nodes of an expression that a person still reads, and digits of its constants.
LENGTH, DIGITS = 12, 3
#: Standard errors by which it must lower the error of the test runs, and of that error the least share.
SURE, SHARE = 2.0, 0.02
#: Rows that the search sees: a law of so few nodes is as plain in twice as many, in twice the time.
ROWS = 2000
#: Length [s] of the blocks of the test runs.
_BLOCK = 0.5


def expression_of(model: Model, train: Sequence[Run], test: Sequence[Run], joint: int, evaluations: int) -> str:
    """Expression [N m] for what ``model`` leaves of the torque of ``joint`` (0-based), in q1 dq1 ddq1 ... (SI).

    Found on moving rows of ``train``; ``0`` unless it lowers the error of ``test``, whole runs that it has not seen, by
    more than its uncertainty. Its variables are the joint's own position, speed and acceleration and the speeds of the
    others.
    """
    # Symbolic regression is rarely asked for, and its libraries take a second to import.
    import sympy as sp

    from hybrid_dynamics.models.expressions import CompiledExpressions
    from hybrid_dynamics.models.symbolic import SymbolicSettings, symbolic_regression

    names, parts, left = _data(model, train, joint)
    x, y = np.vstack(parts), np.concatenate(left)
    if len(y) < 50:
        return "0"
    thin = np.linspace(0, len(y) - 1, min(ROWS, len(y))).astype(int)
    settings = SymbolicSettings(
        operators=OPERATORS,
        batch=ROWS,
        evaluations=evaluations,
        max_length=LENGTH,
        max_rounds=1,
        min_gain=0.0,
        min_residual_gain=0.05,
        drop_residual_share=0.02,
        workers=1,
    )
    found = symbolic_regression(x[thin], y[thin], names, settings, joint=joint + 1).expression
    law: Any = found.xreplace({f: sp.Float(f, DIGITS) for f in found.atoms(sp.Float)})
    compiled = CompiledExpressions([law], names)
    _, unseen, rest = _data(model, test, joint)
    return str(law) if _holds([compiled(p)[:, 0] for p in unseen], rest, test, joint) else "0"


def _data(model: Model, runs: Sequence[Run], joint: int) -> tuple[list[str], list[Array], list[Array]]:
    """Names of the variables; per run their values (M, p) and what is left (M,) [N m], moving rows alone."""
    others = [j for j in range(model.robot.n_joints) if j != joint]
    names = [*(f"{s}{joint + 1}" for s in ("q", "dq", "ddq")), *(f"dq{j + 1}" for j in others)]
    parts, left = [], []
    for run in runs:
        keep = run.mask[:, joint]
        parts.append(np.column_stack([run.q[:, joint], run.dq[:, joint], run.ddq[:, joint], run.dq[:, others]])[keep])
        left.append((run.tau - predict_run(model, run))[keep, joint])
    return names, parts, left


def _holds(law: Sequence[Array], left: Sequence[Array], runs: Sequence[Run], joint: int) -> bool:
    """Whether ``law`` (M,) lowers the error ``left`` (M,) [N m] of unseen runs by more than its uncertainty."""
    sums, owner = [], []
    gain = size = 0.0
    for r, (run, torque, error) in enumerate(zip(runs, law, left, strict=True)):
        if not len(error):
            continue
        after = error - torque
        gain += float(np.sum(error**2 - after**2))
        size += float(np.sum(error**2))
        block = (run.time[run.mask[:, joint]] / _BLOCK).astype(int)
        edges = np.flatnonzero(np.diff(block, prepend=block[0] - 1))
        sums.append(np.add.reduceat(torque * after, edges))
        owner.append(np.full(len(edges), r))
    if not sums or size <= 0:
        return False
    spread, _ = block_error(np.concatenate(sums), np.concatenate(owner))
    return gain > max(SURE * 2.0 * spread, SHARE * size)
