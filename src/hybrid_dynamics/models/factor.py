"""The triangular factor of [library, torque]: computed once per dataset, it serves every SINDy model.

The rigid-body torque is linear in the library (its terms tau_inertia, tau_coriolis, tau_gravity), so the factor for the
residual ``tau - tau_rbd`` follows from that for ``tau`` without another pass over the data.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.features import feature_names
from hybrid_dynamics.files import atomic_path
from hybrid_dynamics.types import Array


@dataclass(frozen=True)
class Factor:
    """``theta`` (p + n, p) and ``torque`` (p + n, n): the columns of R in [Theta tau] = Q R.

    ``rows`` samples went in; ``powers`` (p, 7n) are the library's exponents, the first row is the constant;
    ``variance`` (n,) [N^2 m^2] is that of the whole torque.
    """

    theta: Array
    torque: Array
    rows: int
    powers: NDArray[np.int64]
    variance: Array

    @property
    def n_joints(self) -> int:
        """Number of joints."""
        return int(self.torque.shape[1])

    def spread(self) -> tuple[Array, Array]:
        """Standard deviations of the library's columns (p,) and of the torque (n,).

        The first column of the library is the constant, so the rows of R below the first hold what varies.
        """
        root = np.sqrt(self.rows)
        return np.linalg.norm(self.theta[1:], axis=0) / root, np.linalg.norm(self.torque[1:], axis=0) / root

    def less_rigid_body(self) -> Factor:
        """The factor whose torque is what the rigid body leaves: tau - tau_inertia - tau_coriolis - tau_gravity."""
        names = feature_names(self.n_joints)
        degree = self.powers.sum(axis=1)
        rigid = np.zeros_like(self.torque)
        for j in range(self.n_joints):
            for part in ("inertia", "coriolis", "gravity"):
                feature = names.index(f"tau_{part}{j + 1}")
                term = np.flatnonzero((self.powers[:, feature] == 1) & (degree == 1))
                rigid[:, j] += self.theta[:, int(term[0])]
        return replace(self, torque=self.torque - rigid)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write to ``path`` (safetensors), atomically."""
        arrays = {"theta": self.theta, "torque": self.torque, "powers": self.powers, "variance": self.variance}
        with atomic_path(path) as temporary:
            rows = {k: np.ascontiguousarray(v) for k, v in arrays.items()}
            temporary.write_bytes(save(rows, {"rows": str(self.rows)}))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Factor:
        """Read what :meth:`save` wrote; raises :class:`InputError` where the file is missing or damaged."""
        if not Path(path).is_file():
            raise InputError(f"{path}: no such file; run the stage factorize (dvc repro)")
        try:
            with safe_open(path, framework="numpy") as file:
                arrays = {name: file.get_tensor(name) for name in ("theta", "torque", "powers", "variance")}
                return cls(rows=int(file.metadata()["rows"]), **arrays)
        except (SafetensorError, KeyError, TypeError, ValueError) as error:
            raise InputError(f"{path}: not a readable factor ({error}); run the stage factorize again") from None
