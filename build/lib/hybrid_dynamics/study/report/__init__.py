"""From result files to tables, figures and the report."""

from hybrid_dynamics.study.report.report import write_report
from hybrid_dynamics.study.report.sections import blind_section, derivative_section, loop_section, study_sections

__all__ = ["blind_section", "derivative_section", "loop_section", "study_sections", "write_report"]
