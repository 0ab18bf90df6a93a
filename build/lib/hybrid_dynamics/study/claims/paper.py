"""The numbers of the paper the study repeats, as data: Tables I to V and the WAM equations.

Source: C. E. Mower, R. Zong, H. Bou-Ammar, "Data-driven Interpretable Hybrid Robot Dynamics". Table numbers are the
paper's; "RMSE" there is ``relative_rmse`` here. Expressions are written with the columns of ``features.parquet``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

#: Column order of Tables I, II, IV and V.
COLUMNS = ("sr", "sindy", "r_sr", "r_sindy", "r_sindy_sr", "nn", "r_nn")
#: Which of the paper's columns a variant of ours is set beside.
COUNTERPART = {"sindy_scaled": "sindy", "r_sindy_scaled": "r_sindy", "r_sindy_sr_published": "r_sindy_sr"}


@dataclass(frozen=True)
class ErrorTable:
    """Relative RMSE per joint and method: ``rows[joint - 1][column]``, columns as :data:`COLUMNS`."""

    number: str
    caption: str
    dataset: str
    split: str
    rows: tuple[tuple[float, ...], ...]

    def value(self, method: str, joint: int) -> float | None:
        """The paper's value for ``method`` (or its :data:`COUNTERPART`); None for what the table does not hold.

        ``joint`` counts from 1.
        """
        column = COUNTERPART.get(method, method)
        if column not in COLUMNS or not 1 <= joint <= len(self.rows):
            return None
        return self.rows[joint - 1][COLUMNS.index(column)]


TABLE_I = ErrorTable(
    "I",
    "Training set RMSE per joint for the Franka simulation.",
    "panda",
    "train",
    (
        (0.002, 0.002, 0.002, 0.002, 0.002, 0.072, 0.041),
        (0.001, 0.001, 0.001, 0.001, 0.001, 0.092, 0.025),
        (0.002, 0.002, 0.002, 0.002, 0.002, 0.084, 0.062),
        (0.002, 0.002, 0.002, 0.002, 0.002, 0.065, 0.041),
        (0.002, 0.003, 0.003, 0.003, 0.003, 0.138, 0.071),
        (0.002, 0.003, 0.003, 0.003, 0.003, 0.163, 0.087),
        (0.003, 0.003, 0.003, 0.003, 0.003, 0.168, 0.111),
    ),
)
TABLE_II = ErrorTable(
    "II",
    "Test set RMSE per joint for the Franka simulation.",
    "panda",
    "test",
    (
        (0.002, 0.002, 0.002, 0.002, 0.002, 0.687, 0.994),
        (0.001, 0.001, 0.001, 0.001, 0.001, 0.267, 0.244),
        (0.002, 0.002, 0.002, 0.002, 0.002, 0.388, 0.628),
        (0.002, 0.002, 0.002, 0.002, 0.002, 0.300, 0.251),
        (0.003, 0.003, 0.003, 0.003, 0.003, 0.679, 0.624),
        (0.003, 0.003, 0.003, 0.003, 0.003, 1.111, 0.424),
        (0.004, 0.004, 0.004, 0.004, 0.004, 1.356, 0.986),
    ),
)
TABLE_IV = ErrorTable(
    "IV",
    "WAM training set RMSE per joint.",
    "wam",
    "train",
    (
        (0.410, 0.103, 0.477, 0.103, 0.103, 0.121, 0.132),
        (0.143, 0.027, 0.182, 0.027, 0.027, 0.030, 0.030),
        (0.437, 0.057, 0.570, 0.057, 0.057, 0.081, 0.081),
        (0.423, 0.039, 0.422, 0.039, 0.039, 0.056, 0.058),
        (0.621, 0.177, 0.645, 0.177, 0.177, 0.329, 0.330),
        (0.487, 0.076, 0.556, 0.076, 0.076, 0.213, 0.213),
        (0.403, 0.090, 0.558, 0.090, 0.090, 0.322, 0.324),
    ),
)
TABLE_V = ErrorTable(
    "V",
    "WAM test set RMSE per joint.",
    "wam",
    "test",
    (
        (0.410, 18.566, 0.441, 18.566, 18.566, 0.733, 0.681),
        (0.183, 4.106, 0.230, 4.106, 4.106, 0.470, 0.472),
        (0.483, 7.782, 0.540, 7.463, 7.463, 0.876, 0.773),
        (0.453, 9.423, 0.458, 9.423, 9.423, 0.805, 0.854),
        (0.476, 60.189, 0.475, 59.389, 59.388, 0.942, 1.243),
        (0.548, 13.280, 0.547, 13.160, 13.160, 0.822, 0.967),
        (0.437, 27.754, 0.580, 27.905, 27.905, 1.246, 1.282),
    ),
)
ERROR_TABLES = (TABLE_I, TABLE_II, TABLE_IV, TABLE_V)

#: Nominal viscous damping of the simulated arm [N m s/rad] (caption of Table III).
PANDA_DAMPING = (6.75, 6.00, 5.25, 4.50, 3.75, 3.00, 2.25)


def _torque(joint: int, inertia: float, coriolis: float, gravity: float | None, damping: float) -> dict[str, float]:
    terms = {f"tau_inertia{joint}": inertia, f"tau_coriolis{joint}": coriolis}
    if gravity is not None:
        terms[f"tau_gravity{joint}"] = gravity
    return {**terms, f"dq{joint}": damping}


#: Table III: method -> joint -> {term: coefficient}. For ``r_sindy_sr`` the paper prints the second layer alone.
TABLE_III: Mapping[str, Mapping[int, Mapping[str, float]]] = {
    "sr": {
        1: _torque(1, 1, 1, None, 6.721),
        2: _torque(2, 1, 1, 1, 5.962),
        3: _torque(3, 1, 1, 1, 5.235),
        4: _torque(4, 1, 1, 1, 4.486),
        5: {**_torque(5, 1.001, 1, 1, 3.741), "dddq5": 5.2e-5},
        6: {**_torque(6, 1.001, 1, 1, 2.993), "dddq6": 1.0e-4},
        7: _torque(7, 1, 1, None, 2.244),
    },
    "sindy": {
        1: _torque(1, 1.001, 1.001, None, 6.721),
        2: _torque(2, 1, 1.001, 1, 5.962),
        3: _torque(3, 1.001, 1.002, 1, 5.234),
        4: _torque(4, 1, 1.001, 1, 4.486),
        5: _torque(5, 1.001, 1, 0.9997, 3.741),
        6: _torque(6, 1.001, 1.001, 1, 2.991),
        7: _torque(7, 1.001, 1.001, None, 2.244),
    },
    "r_sr": {
        1: {"dq1": 6.721},
        2: {"dq2": 5.962},
        3: {"dq3": 5.235},
        4: {"dq4": 4.486},
        5: {"dq5": 3.742, "dddq5": 5.2e-5},
        6: {"dq6": 2.994, "dddq6": 1.0e-4},
        7: {"dq7": 2.244},
    },
    "r_sindy": {
        1: {"dq1": 6.721},
        2: {"dq2": 5.962},
        3: {"dq3": 5.235},
        4: {"dq4": 4.486},
        5: {"dq5": 3.741},
        6: {"dq6": 2.991},
        7: {"dq7": 2.244},
    },
    "r_sindy_sr": {
        1: {"ddq1": 2.92e-3},
        2: {"ddq2": 2.38e-3},
        3: {"ddq3": 2.74e-3, "dq1": -2.74e-3},
        4: {"dddq4": 9.62e-5},
        5: {"ddq5": 2.04e-3},
        6: {"ddq6": 1.53e-3},
        7: {"ddq7": 1.03e-3},
    },
}
#: The WAM equations (after Table V) with their constants put in: method -> joint -> expression.
WAM_EQUATIONS: Mapping[str, Mapping[int, str]] = {
    "sr": {
        1: "ddq1 + dq1*(4.723089 - dq1**2)",
        2: "ddq2 - ddq3 + dq2*(dq5 + 2.9080215) - dq3**2 - ((7.1627355 - q4)*q2*4.039454 - q6 + tau_gravity3)",
        3: "dq3 + (ddq1 + q3*q4*(0.47727528*ddq1 + 1.7755635))*(q2 + 0.11157574)",
        4: "(q4 - 3.4464025)*1.9739965*q4 + dq4 + 1.8875742",
        5: "0.14579542*dq5",
        6: "(0.26862046 - tau_gravity6)*(dq6 + (ddq6 + dq3)*(-0.12590475))",
        7: "dq7*(dq7**2*(0.05014042*dq7**2 - 0.17362133) + 0.19907075)",
    },
    "r_sr": {
        1: "-ddq1 - tau_gravity1 + 3.2723246*dq1",
        2: "(dq2 + (0.016012268 - q2)*(-1.023108*q4 + 8.626232) - 0.50142884)*3.391348",
        3: "q2*q3*2.58501 - tau_gravity3 + dq3",
        4: "dq4 + (q4 - 3.1465542)*(1.9603553*q4 - 0.58640337)",
        5: "-tau_gravity5 + 0.14822637*dq5",
        6: "0.24277882*dq6",
        7: "0.07425557*dq7",
    },
}


def error_table(dataset: str, split: str) -> ErrorTable | None:
    """The paper's error table for ``dataset`` and ``split``, if it has one."""
    for table in ERROR_TABLES:
        if table.dataset == dataset and table.split == split:
            return table
    return None
