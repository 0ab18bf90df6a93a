"""What a closed loop leaves behind: its page, its figures, its files."""

from hybrid_dynamics.loop_report.output import write_result
from hybrid_dynamics.loop_report.report import report_html

__all__ = ["report_html", "write_result"]
