"""The park: recorded arms of other labs, judged alike: what a model leaves, where, and how honest its errors are."""

from hybrid_dynamics.study.park.added import AddedSettings, add_effects, draw_added, generate_added, score_added
from hybrid_dynamics.study.park.arm import ParkResult, ParkSettings, judge_arm
from hybrid_dynamics.study.park.tables import COLUMNS, PARAMETER_COLUMNS, REGIME_COLUMNS

__all__ = [
    "COLUMNS",
    "PARAMETER_COLUMNS",
    "REGIME_COLUMNS",
    "AddedSettings",
    "ParkResult",
    "ParkSettings",
    "add_effects",
    "draw_added",
    "generate_added",
    "judge_arm",
    "score_added",
]
