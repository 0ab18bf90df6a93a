"""Columns of the park's tables. Torques are held-out root mean squares [N m] at the loop's bandwidth, all rows."""

from __future__ import annotations

#: Where the loop stands beside least squares: the first part of those columns' names.
AGAINST = "against_least_squares"

#: ``reports/park.csv``: one row per recorded arm and joint. ``explained_share`` = (rigid² - loop²) / (rigid² - best²),
#: best the smallest of floor, least squares and black box; ``_low`` and ``_high`` with the two ends of the floor.
#: ``black_box``: boosted trees on top of the loop's model, trained on the training runs. ``named``: effects on the
#: joint and on the whole robot, those that the test runs contradict in brackets. ``against_least_squares``: the loop's
#: mean square less that of least squares, as a share of the latter's, with its standard error and what that says
#: (:mod:`~hybrid_dynamics.study.park.compare`); ``arm_...`` the same of all joints together, in every row of the arm.
COLUMNS = (
    "dataset",
    "joint",
    "floor",
    "rigid_body",
    "least_squares",
    "loop",
    "black_box",
    "explained_share",
    "named",
    "floor_low",
    "floor_high",
    "explained_share_low",
    "explained_share_high",
    "loop_confirmed",
    "spread",
    "learnable_share",
    "motion_dependent",
    "verdict",
    "against_least_squares",
    "against_least_squares_error",
    "against_least_squares_verdict",
    "arm_against_least_squares",
    "arm_against_least_squares_error",
    "arm_against_least_squares_verdict",
)
#: ``reports/park_regimes.csv``: the same errors where the joint stands, turns round, creeps and runs.
REGIME_COLUMNS = ("dataset", "joint", "regime", "rows", "rigid_body", "least_squares", "loop", "black_box", "spread")
#: ``reports/park_parameters.csv``: every parameter of the loop's model fitted on each run alone, and how far the runs
#: are apart, in their standard errors (``scatter``: 1 where the errors are honest and nothing changes between runs).
PARAMETER_COLUMNS = (
    "dataset",
    "effect",
    "joint",
    "parameter",
    "unit",
    "value",
    "std_error",
    "runs",
    "run_spread",
    "run_std_error",
    "scatter",
)
