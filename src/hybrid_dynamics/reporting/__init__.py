"""From result files to tables, figures and the report."""

from hybrid_dynamics.reporting.evaluation import Evaluation, EvaluationSettings, PooledErrors, evaluate_predictions
from hybrid_dynamics.reporting.report import write_report
from hybrid_dynamics.reporting.results import Section, StudyInputs
from hybrid_dynamics.reporting.sections import blind_section, derivative_section, loop_section, study_sections

__all__ = [
    "Evaluation",
    "EvaluationSettings",
    "PooledErrors",
    "Section",
    "StudyInputs",
    "blind_section",
    "derivative_section",
    "evaluate_predictions",
    "loop_section",
    "study_sections",
    "write_report",
]
