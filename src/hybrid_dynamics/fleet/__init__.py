"""Many loops: over robots, or over the days of one robot. A manifest in, a folder of results and tables out."""

from hybrid_dynamics.fleet.manifest import Entry, read_manifest
from hybrid_dynamics.fleet.run import FleetResult, run_fleet

__all__ = ["Entry", "FleetResult", "read_manifest", "run_fleet"]
