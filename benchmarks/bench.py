"""Ours and what a user would pick instead, on the same data, in one run on one machine: ``make bench [QUICK=1]``.

Each measurement is a process of its own; sides take turns, so that a machine that gets slower hits both. Times are CPU
seconds, medians over the repetitions. Writes ``reports/benchmarks.csv`` (name, ours, peer, ratio, goal, met) and, with
every measurement and the machine, ``reports/benchmarks.json``.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import platform
import statistics
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
COLUMNS = ("name", "ours", "peer", "ratio", "goal", "met")
WIDTHS = (62, 10, 10, 8, 26, 12)
#: Quantities of a measurement that a row may compare, and their units.
UNITS = {"cpu_s": "s", "peak_mb": "MB", "error": ""}


@dataclass(frozen=True)
class Row:
    """One line of the table. ``size`` and ``quick`` are the case's sizes (``quick`` None: left out of a quick run).

    With a ``peer``, ``goal`` is the least ratio peer / ours (None: told, not judged); without one it is the most that
    ours may take. ``quantity`` is what is compared; ``check`` names the check it stands for where it is ``error``.
    """

    name: str
    case: str
    size: int
    quick: int | None
    goal: float | None
    peer: str | None = None
    quantity: str = "cpu_s"
    repeats: int = 3
    check: str = ""


@dataclass(frozen=True)
class Growth:
    """Exponent of CPU time against ``sizes``: the slope between the smallest and the largest on a log-log scale."""

    name: str
    case: str
    sizes: tuple[int, ...]
    quick: tuple[int, ...] | None
    goal: float | None


ROWS: tuple[Row, ...] = (
    Row("SINDy, {} rows", "sindy", 96_000, 12_000, 8.0, "PySINDy"),
    Row("SINDy memory, {} rows", "sindy", 96_000, 12_000, 5.0, "PySINDy", "peak_mb"),
    Row("rigid-body torque, {} samples", "rigid_body", 200_000, 100_000, 1 / 1.1, "pinocchio rneaInParallel"),
    Row("regressor, {} samples", "regressor_loop", 40_000, 20_000, 1.5, "loop over pinocchio"),
    Row("regressor bound, {} samples", "regressor_call", 40_000, 20_000, 1 / 1.3, "pinocchio's calls alone"),
    Row("total variation, {} samples", "total_variation", 10_000, 10_000, 300.0, "pynumdiff tvrdiff"),
    Row("symbolic regression, 7 joints, {} evaluations", "symbolic", 100_000, 5_000, None, "pyoperon"),
    *(
        row
        for effect in ("viscous_friction", "coulomb_friction", "payload")
        for row in (
            Row(effect.replace("_", " ") + ", {} s", effect, 60, 20, 3.0, "mujoco.sysid, told which"),
            Row(
                f"error of {effect.replace('_', ' ')}, {{}} s", effect, 60, 20, 1.0, "mujoco.sysid", "error",
                check="parameter_error",
            ),
        )
    ),
    Row("--help", "help", 0, 0, 0.7),
    Row("close-loop, small", "small", 0, 0, 3.0),
    Row("close-loop, 7 joints, 4 x {} s at 500 Hz", "arm_500_hz", 16, None, 30.0, repeats=1),
    Row("memory of close-loop, 7 joints, 4 x {} s at 500 Hz", "arm_500_hz", 16, None, 1000.0, None, "peak_mb", 1),
    Row("close-loop, 7 joints, 4 x {} s at 1 kHz", "arm_1_khz", 60, None, 45.0, repeats=1),
    Row("memory of close-loop, 7 joints, 4 x {} s at 1 kHz", "arm_1_khz", 60, None, 1000.0, None, "peak_mb", 1),
    Row("exported C, 7 joints, 20 effects, {} calls (2 us each)", "c_torque", 1_000_000, 1_000_000, 2.0),
    Row("predict, {} samples", "predict", 1_000_000, 100_000, None),
    Row("memory of close-loop, {} hours of 7 joints at 500 Hz", "many_hours", 10, None, 2000.0, None, "peak_mb", 1),
)  # fmt: skip
GROWTHS: tuple[Growth, ...] = (
    Growth("growth of close-loop with samples", "loop_samples", (10_000, 100_000, 1_000_000), (10_000, 40_000), 1.05),
    Growth("growth of close-loop with runs", "loop_runs", (4, 20, 100), (4, 16), 1.05),
    Growth("growth of close-loop with joints", "loop_joints", (2, 7, 14), None, None),
)


class Measurements:
    """Runs children and keeps what they measured; the same case, side and size is measured once."""

    def __init__(self, peers: str, limit: float) -> None:
        self.peers, self.limit = peers, limit
        self.kept: dict[str, list[dict[str, Any]]] = {}

    def of(self, case: str, size: int, sides: tuple[str, ...], repeats: int) -> dict[str, list[dict[str, Any]]]:
        """``repeats`` measurements of each side, in turn; an empty list where a side cannot be run."""
        keys = {side: f"{case}/{side}/{size}" for side in sides}
        if any(key not in self.kept for key in keys.values()):
            for key in keys.values():
                self.kept[key] = []
            for _ in range(repeats):
                for side, key in keys.items():
                    found = self._child(case, side, size)
                    if found is not None:
                        self.kept[key].append(found)
        return {side: self.kept[key] for side, key in keys.items()}

    def _child(self, case: str, side: str, size: int) -> dict[str, Any] | None:
        python = self.peers if side == "peer" else sys.executable
        command = [python, "-W", "ignore", "-m", "benchmarks.child", case, side, str(size)]
        environment = os.environ | dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
        environment["PYTHONPATH"] = os.pathsep.join([str(ROOT / "src"), str(ROOT)])
        try:
            done = subprocess.run(
                command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=self.limit, check=False
            )
        except subprocess.TimeoutExpired:
            print(f"  {case} ({side}): not done within {self.limit:g} s", flush=True)
            return None
        if done.returncode:
            last = (done.stderr.strip().splitlines() or ["killed"])[-1]
            lacking = side == "peer" and python == sys.executable
            remedy = "; peers are installed by: make bench-peers" if lacking else ""
            print(f"  {case} ({side}): not measured: {last}{remedy}", flush=True)
            return None
        return dict(json.loads(done.stdout.strip().splitlines()[-1]))


def value(row: Row, found: list[dict[str, Any]]) -> float | None:
    """Median of the row's quantity; of memory the largest (a peak is not made smaller by a second run)."""
    if not found:
        return None
    if row.quantity == "error":
        return statistics.median(float(m["checks"][row.check]) for m in found)
    values = [float(m[row.quantity]) for m in found]
    return max(values) if row.quantity == "peak_mb" else statistics.median(values)


def line(row: Row, size: int, ours: float | None, peer: float | None) -> dict[str, Any]:
    """The table's line of what was measured; what was not measured stays empty and is not met."""
    unit = UNITS[row.quantity]
    out: dict[str, Any] = dict.fromkeys(COLUMNS, "")
    out["name"] = row.name.format(f"{size:,}") + (f" [{unit}]" if unit else "")
    out["ours"], out["peer"] = (f"{x:.4g}" if x is not None else "" for x in (ours, peer))
    if row.peer is None:
        if row.goal is not None:
            out["goal"] = f"at most {row.goal:g} {unit}"
            out["met"] = "yes" if ours is not None and ours <= row.goal else "no"
        return out
    if row.goal is not None:
        out["goal"] = f"peer / ours at least {row.goal:.3g}"
        out["met"] = "no" if ours is not None and peer is not None else "not measured"
    if ours is not None and peer is not None:
        ratio = peer / ours if ours > 0 else float("inf")
        out["ratio"] = f"{ratio:.3g}"
        if row.goal is not None and ratio >= row.goal:
            out["met"] = "yes"
    return out


def exponent(sizes: list[int], seconds: list[float]) -> float:
    """Growth between the two largest sizes: fixed costs hide it in the smaller ones."""
    (a, b), (s, t) = sizes[-2:], seconds[-2:]
    return float(np.log(t / s) / np.log(b / a))


def growth_line(growth: Growth, sizes: tuple[int, ...], seconds: list[float | None]) -> dict[str, Any]:
    out: dict[str, Any] = dict.fromkeys(COLUMNS, "")
    out["name"] = f"{growth.name}, {sizes[0]:,} to {sizes[-1]:,} [exponent]"
    measured = [s for s in seconds if s is not None]
    if growth.goal is not None:
        out["goal"], out["met"] = f"at most {growth.goal:g}", "not measured"
    if len(measured) == len(sizes):
        found = exponent(list(sizes), measured)
        out["ours"] = f"{found:.3g}"
        if growth.goal is not None:
            out["met"] = "yes" if found <= growth.goal else "no"
    return out


def machine() -> dict[str, Any]:
    """What the figures depend on."""
    cpu = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [x.partition(":")[2].strip() for x in info.read_text().splitlines() if x.startswith("model name")]
        cpu = names[0] if names else cpu
    load = [round(x, 2) for x in os.getloadavg()]
    return {"cpu": cpu, "cores": os.cpu_count(), "system": platform.platform(), "load_average": load}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="small sizes, one repetition: at most three minutes")
    parser.add_argument("--only", default="", help="only rows whose case holds this text")
    parser.add_argument("--peers", default=sys.executable, help="Python with the peers of benchmarks/peers.txt")
    parser.add_argument("--limit", type=float, default=1800.0, help="seconds after which a measurement is given up")
    parser.add_argument("--out", type=Path, default=ROOT / "reports", help="folder of benchmarks.csv")
    args = parser.parse_args()
    started = time.monotonic()
    measurements = Measurements(args.peers, 60.0 if args.quick else args.limit)
    before, lines = machine(), []

    def tell(found: dict[str, Any]) -> None:
        lines.append(found)
        print("  ".join(f"{found[c]!s:<{w}}" for c, w in zip(COLUMNS, WIDTHS, strict=True)), flush=True)

    tell(dict(zip(COLUMNS, COLUMNS, strict=True)))
    for row in ROWS:
        size = row.quick if args.quick else row.size
        if size is None or args.only not in row.case:
            continue
        sides = ("ours", "peer") if row.peer else ("ours",)
        found = measurements.of(row.case, size, sides, 1 if args.quick else row.repeats)
        tell(line(row, size, value(row, found["ours"]), value(row, found.get("peer", []))))
    for growth in GROWTHS:
        sizes = growth.quick if args.quick else growth.sizes
        if sizes is None or args.only not in growth.case:
            continue
        seconds = []
        for size in sizes:
            once = measurements.of(growth.case, size, ("ours",), 1)["ours"]
            seconds.append(once[0]["cpu_s"] if once else None)
        tell(growth_line(growth, sizes, seconds))
    write(args.out, lines[1:], {"quick": args.quick, "machine": before, "measurements": measurements.kept})
    print(f"{args.out / 'benchmarks.csv'}: {len(lines) - 1} rows, {time.monotonic() - started:.0f} s")


def write(folder: Path, lines: list[dict[str, Any]], details: dict[str, Any]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    with open(folder / "benchmarks.csv", "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(lines)
    (folder / "benchmarks.json").write_text(json.dumps(details, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
