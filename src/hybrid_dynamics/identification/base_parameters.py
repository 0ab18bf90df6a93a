"""Base parameters: which combinations of inertial parameters a torque measurement can determine at all.

The rigid-body torque is linear in the inertial parameters, ``tau = Y(q, dq, ddq) pi``, but the columns of Y are
linearly dependent for every motion (Gautier and Khalil, IEEE T-RA 6(3), 1990; numerically by QR: Gautier, ICRA
1990). The columns are read in the order xx xy xz yy yz zz, first moments, mass, rotor inertia, link by link from the
base; a column that the earlier ones span is grouped into them. On a planar arm this gives the textbook's grouping.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array

#: A column counts as dependent where this share of it, or less, is new beside the earlier columns. Exact descriptions
#: leave 1e-15 of a dependent column and over 0.5 of an independent one; descriptions with rounded angles (1.5708) or
#: CAD exports leave 1e-7 to 3e-4, which no torque measurement resolves.
RANK_TOLERANCE = 1e-3
#: Coefficients below this are rounding of the description's angles and are not printed.
_PRINTED = 2e-5
#: Names of Pinocchio's ten parameters of a link, in its order (mass, first moments, inertia about the joint origin).
LINK_PARAMETERS = ("m", "lx", "ly", "lz", "Lxx", "Lxy", "Lyy", "Lxz", "Lyz", "Lzz")
UNITS = {"m": "kg", "l": "kg m", "L": "kg m^2", "I": "kg m^2"}
#: The order in which columns are kept: positions in LINK_PARAMETERS.
_READING_ORDER = (4, 5, 7, 6, 8, 9, 1, 2, 3, 0)
_SAMPLES_PER_PARAMETER = 8


@dataclass(frozen=True)
class BaseParameters:
    """Grouping of the 11 n full parameters ``[pi (10 n), Ia (n)]`` of a robot into p base parameters.

    ``names`` (11 n) of the full parameters; ``independent`` (p,) the columns kept; ``grouping`` (p, 11 n) with
    ``base = grouping @ full`` and ``Y_full = Y_full[:, independent] @ grouping``; ``rank_gap``: the share that is new
    beside earlier columns, least among those kept and largest among those dropped.
    """

    names: tuple[str, ...]
    independent: NDArray[np.intp]
    grouping: Array
    rank_gap: tuple[float, float]

    @property
    def size(self) -> int:
        """Number of base parameters."""
        return len(self.independent)

    @property
    def base_names(self) -> tuple[str, ...]:
        """Short names (p,): the leading parameter of each group."""
        return tuple(self.names[i] for i in self.independent)

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each base parameter."""
        return tuple(UNITS[name[0]] for name in self.base_names)

    @property
    def expressions(self) -> tuple[str, ...]:
        """Readable groups (p,), for example ``Lyy1 + 0.25 m2 + Ia1`` (lengths in m)."""
        return tuple(self._expression(row, lead) for row, lead in zip(self.grouping, self.independent, strict=True))

    def _expression(self, row: Array, lead: np.intp) -> str:
        order = [int(lead)] + [i for i in np.flatnonzero(np.abs(row) > _PRINTED) if i != lead]
        text = ""
        for i in order:
            size = f"{abs(row[i]):.4g}"
            sign = "-" if row[i] < 0 else "+"
            text += f" {sign} " + (self.names[i] if size == "1" else f"{size} {self.names[i]}")
        return text[3:] if text.startswith(" + ") else text.strip()

    def table_rows(self) -> list[dict[str, str]]:
        """Rows ``parameter, expression, unit`` of a table that shows the grouping."""
        return [
            {"parameter": name, "expression": expression, "unit": unit}
            for name, expression, unit in zip(self.base_names, self.expressions, self.units, strict=True)
        ]

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Full parameters that no motion of this robot can show."""
        return tuple(name for name, column in zip(self.names, self.grouping.T, strict=True) if not column.any())


def full_parameter_names(n_joints: int) -> tuple[str, ...]:
    """Names of ``[pi, Ia]``: ``m1 lx1 ... Lzz1 m2 ... Ia1 ... Ian`` (numbered from 1)."""
    links = [f"{name}{j}" for j in range(1, n_joints + 1) for name in LINK_PARAMETERS]
    return tuple(links + [f"Ia{j}" for j in range(1, n_joints + 1)])


def full_regressor(robot: Robot, q: Array, dq: Array, ddq: Array) -> Array:
    """``[Y, diag(ddq)]`` (T, n, 11 n): Pinocchio's inertial regressor and the rotor inertias."""
    n = robot.n_joints
    inertial = robot.regressor(q, dq, ddq)
    rotor = np.zeros((len(inertial), n, n))
    rotor[:, np.arange(n), np.arange(n)] = np.atleast_2d(ddq)
    return np.concatenate([inertial, rotor], axis=2)


def base_parameters(robot: Robot, seed: int = 0, tolerance: float = RANK_TOLERANCE) -> BaseParameters:
    """Group the parameters of ``robot`` from its regressor at random states (deterministic in ``seed``)."""
    n = robot.n_joints
    rng = np.random.default_rng(seed)
    samples = _SAMPLES_PER_PARAMETER * 11 * n
    q = rng.uniform(-np.pi, np.pi, (samples, n))
    dq, ddq = rng.uniform(-2, 2, (2, samples, n))
    regressor = full_regressor(robot, q, dq, ddq).reshape(samples * n, 11 * n)
    columns = scipy.linalg.qr(regressor, mode="r", overwrite_a=True)[0][: 11 * n]  # same lengths and angles, fewer rows

    length = np.linalg.norm(columns, axis=0)
    alive = length > 1e-10 * length.max()
    order = [10 * j + k for j in range(n) for k in _READING_ORDER] + [10 * n + j for j in range(n)]
    basis = np.empty((len(columns), 0))
    kept, new = [], np.zeros(11 * n)
    for k in order:
        if not alive[k]:
            continue
        rest = columns[:, k] / length[k]
        for _ in range(2):  # Gram-Schmidt, repeated once: orthogonal to rounding
            rest = rest - basis @ (basis.T @ rest)
        new[k] = np.linalg.norm(rest)
        if new[k] > tolerance:
            kept.append(k)
            basis = np.column_stack([basis, rest / new[k]])
    independent = np.sort(np.array(kept, dtype=np.intp))
    scaled = columns[:, independent] / length[independent]
    grouping = np.linalg.lstsq(scaled, columns, rcond=None)[0] / length[independent, None]
    # What is left is rounding: coefficients are products of lengths [m] and sines of fixed angles.
    grouping[np.abs(grouping) < 1e-7] = 0.0
    grouping[:, ~alive] = 0.0
    grouping[:, independent] = np.eye(len(independent))
    gap = (float(new[independent].min()), float(np.delete(new, independent).max(initial=0.0)))
    return BaseParameters(full_parameter_names(n), independent, grouping, gap)
