"""Where recorded data comes from: named, verified, looked for in three places; a twin where it cannot be had."""

from hybrid_dynamics.study.sources.fetch import SourceReport, fetch, read_source
from hybrid_dynamics.study.sources.settings import SourceFile, SourceSettings
from hybrid_dynamics.study.sources.source import DataSource, Located

__all__ = ["DataSource", "Located", "SourceFile", "SourceReport", "SourceSettings", "fetch", "read_source"]
