"""From result files to tables, figures and the report."""

from hybrid_dynamics.reporting.evaluation import Evaluation, EvaluationSettings, PooledErrors, evaluate_predictions
from hybrid_dynamics.reporting.report import write_report
from hybrid_dynamics.reporting.results import Section, StudyInputs

__all__ = [
    "Evaluation",
    "EvaluationSettings",
    "PooledErrors",
    "Section",
    "StudyInputs",
    "evaluate_predictions",
    "write_report",
]
