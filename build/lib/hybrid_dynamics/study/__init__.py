"""The study: data sets, blind cases, evaluation, report and tracking. Nothing outside imports it (tested)."""
