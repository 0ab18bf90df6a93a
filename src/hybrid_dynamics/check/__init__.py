"""Plausibility before physics: is the log what it claims to be, does it fit the robot, and what can it show?"""

from __future__ import annotations

from hybrid_dynamics.check.before_fit import Checked, check_before_fit, checked, checked_log
from hybrid_dynamics.check.findings import Finding, refuse_hard
from hybrid_dynamics.check.known import told_by_model

__all__ = ["Checked", "Finding", "check_before_fit", "checked", "checked_log", "refuse_hard", "told_by_model"]
