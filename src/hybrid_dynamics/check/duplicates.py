"""The same samples in two runs, whatever the files are called: a held-out run must not be one that was learnt from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from hybrid_dynamics.check.findings import Finding
from hybrid_dynamics.trajectory import Trajectory

#: Rows count as the same where they agree to these shares of the signal's spread (a copy may be rounded).
POSITION, TORQUE = 1e-4, 1e-3
#: Rows at rest are alike in any run; only those count in which some joint moves by more than this a sample.
STEP = 1e-5
#: Share of the shorter run's rows that are in the other one too, and that from which it is a copy of it.
SHARE, COPY = 0.3, 0.9


def check_duplicates(train: Sequence[Trajectory], test: Sequence[Trajectory]) -> list[Finding]:
    """Hard where a test run holds samples of a training run, or one training run is a copy of another or of a part.

    What repeats from run to run counts as the motion's, what does not as noise: with a copy noise repeats too, and the
    noise floor and all standard errors are told too small.
    """
    runs = [*train, *test]
    if len(runs) < 2:
        return []
    scale = {s: np.maximum(np.max([run[s].std(axis=0) for run in runs], axis=0), 1e-9) for s in ("q", "tau")}
    rows = [_rows(run, scale) for run in runs]
    shared = _shared(rows)
    out = []
    for b in range(1, len(runs)):
        for a in range(b):
            shorter = min(len(rows[a]), len(rows[b]))
            if shorter < 10:
                continue
            share = float(shared[a, b]) / shorter
            if share < SHARE:
                continue
            held_out = a < len(train) <= b
            copied = b < len(train) and share >= COPY
            remedy = (
                "held-out logs must not be learnt from: give another run to --test"
                if held_out
                else "with a copy noise repeats, and passes for what the robot does: leave one out"
                if copied
                else "the same samples twice are not two runs: leave one out"
            )
            text = f"holds the same samples as run {runs[a].name} ({share:.0%} of them); {remedy}"
            out.append(Finding("duplicate", "hard" if held_out or copied else "warning", text, run=runs[b].name))
    return out


def _shared(rows: Sequence[NDArray[np.void]]) -> NDArray[np.int_]:
    """(R, R) how many of the unique ``rows`` of one run are in another: all are sorted once, not pair by pair."""
    sizes = [len(own) for own in rows]
    if not any(sizes):
        return np.zeros((len(rows), len(rows)), int)
    _, value = np.unique(np.concatenate([own for own in rows if len(own)]), return_inverse=True)
    held = csr_array((np.ones(len(value), int), (np.repeat(np.arange(len(rows)), sizes), value.ravel())))
    return np.asarray((held @ held.T).toarray())


def _rows(run: Trajectory, scale: dict[str, NDArray[np.float64]]) -> NDArray[np.void]:
    """Rounded rows in motion, each as one value, unique."""
    moving = np.abs(np.diff(run["q"], axis=0, prepend=run["q"][:1])).max(axis=1) > STEP
    table = np.concatenate(
        [np.round(run[s][moving] / (scale[s] * t)) for s, t in (("q", POSITION), ("tau", TORQUE))], axis=1
    )
    # Both zeros are the same number, but not the same bytes.
    table = np.ascontiguousarray(table + 0.0)
    return np.unique(table.view([("", table.dtype)] * table.shape[1]).ravel()) if len(table) else np.empty(0, np.void)
