"""From result files to tables, figures and the report."""

from hybrid_dynamics.study.report.blind import blind_section
from hybrid_dynamics.study.report.campaign import benchmark_section, campaign_sections
from hybrid_dynamics.study.report.park import park_section
from hybrid_dynamics.study.report.report import write_report
from hybrid_dynamics.study.report.sections import derivative_section, loop_section, study_sections

__all__ = [
    "benchmark_section",
    "blind_section",
    "campaign_sections",
    "derivative_section",
    "loop_section",
    "park_section",
    "study_sections",
    "write_report",
]
