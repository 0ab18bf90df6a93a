"""The QR factor of a tall matrix, chunk by chunk: least squares in the memory of one chunk."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import lapack

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.types import Array


def triangular_factor(X: Array, y: Array, library: Callable[[Array], Array], width: int, chunk_rows: int) -> Array:
    """R of the QR factorisation of [library(X) y], (width + n, width + n), ``chunk_rows`` samples at a time.

    Each step factorises the R so far stacked on the next chunk: [R; A_k] = Q_k R'.
    """
    columns = width + y.shape[1]
    rows = min(chunk_rows, len(X))
    work = np.zeros((columns + rows, columns), order="F")
    size = int(lapack.dgeqrf_lwork(*work.shape)[0])
    lower = np.tril_indices(columns, -1)
    for start in range(0, len(X), rows):
        chunk = slice(start, start + rows)
        count = len(X[chunk])
        work[columns : columns + count, :width] = library(X[chunk])
        work[columns : columns + count, width:] = y[chunk]
        work[columns + count :] = 0.0
        work, _, _, info = lapack.dgeqrf(work, lwork=size, overwrite_a=1)
        if info != 0:
            raise InputError(f"the factorisation failed at sample {start + 1} (LAPACK {info}); check the data")
        work[lower] = 0.0
    return np.ascontiguousarray(work[:columns])
