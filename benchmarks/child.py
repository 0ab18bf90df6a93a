"""One measurement, in a process of its own: ``python -m benchmarks.child CASE SIDE SIZE`` prints it as JSON."""

from __future__ import annotations

import json
import resource
import sys
import time


def cpu_seconds() -> float:
    """CPU time of this process and of the programs it has run [s]: what a busy machine changes least."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in used)


def peak_mb() -> float:
    return max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)) / 1024


def main() -> None:
    case, side, size = sys.argv[1:]
    from benchmarks.cases import CASES

    run = CASES[case](side, int(size))
    before, memory, wall = cpu_seconds(), peak_mb(), time.perf_counter()
    checks = run()
    measured = {
        "cpu_s": cpu_seconds() - before,
        "wall_s": time.perf_counter() - wall,
        "peak_mb": peak_mb(),
        "peak_before_mb": memory,
        "checks": checks,
    }
    print(json.dumps(measured))


if __name__ == "__main__":
    main()
