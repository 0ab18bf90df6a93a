"""MLflow from result files: one run per dataset and method, none where nothing changed."""

from hybrid_dynamics.study.tracking.location import Store, git_revision, root, store
from hybrid_dynamics.study.tracking.park import park_records
from hybrid_dynamics.study.tracking.records import RunRecord, StepRecord, collect
from hybrid_dynamics.study.tracking.upsert import known_digests, upsert

__all__ = [
    "RunRecord",
    "StepRecord",
    "Store",
    "collect",
    "git_revision",
    "known_digests",
    "park_records",
    "root",
    "store",
    "upsert",
]
