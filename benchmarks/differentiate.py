"""Differentiators side by side: total variation against other packages, scaling with N, errors against the truth.

    python benchmarks/differentiate.py [--rows 10000] [--limit 60] [--skip-errors]

Every foreign routine runs in its own process with a time limit; one that does not finish is listed as slower than that.
Times are the best of three runs for ours and of one for the others, single-threaded.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"

import numpy as np  # noqa: E402

from hybrid_dynamics.types import Array  # noqa: E402

DT = 1e-3
#: Encoder counts per turn: a fine one (16 bit) and a coarse one.
COUNTS = (65536, 4096)


def motion(time_axis: Array, order: int, joints: int = 1) -> Array:
    """The ``order``-th derivative (T, joints) of a multi-sine joint motion [rad]."""
    w = 2 * np.pi * np.array([0.1, 0.3, 0.7, 1.3])
    size = np.array([0.8, 0.3, 0.1, 0.04])
    phase = np.outer(np.arange(1, joints + 1), [0.3, 1.0, 2.0, 4.0])
    return np.asarray(
        np.stack([(size * w**order * np.sin(w * time_axis[:, None] + p + order * np.pi / 2)).sum(1) for p in phase], 1),
        float,
    )


def measured(rows: int, counts: int = COUNTS[0], joints: int = 1) -> Array:
    """The motion as an encoder with ``counts`` per turn reads it."""
    step = 2 * np.pi / counts
    return np.asarray(np.round(motion(DT * np.arange(rows, dtype=float), 0, joints) / step) * step)


def ours(x: Array, alpha: float) -> Array:
    from hybrid_dynamics.differentiate.total_variation import solve

    return solve(x, DT, alpha).xi


def pynumdiff_tvrdiff(x: Array, alpha: float) -> Array:
    import pynumdiff

    # Its objective is |y - xi|^2 + gamma |D xi|_1 with y = x / scale.
    scale = pynumdiff.utils.utility.robust_data_scale(x)
    return np.asarray(pynumdiff.tvrdiff(x, DT, order=1, gamma=2 * alpha / DT**2 / scale)[0])


def pynumdiff_iterative_velocity(x: Array, alpha: float) -> Array:
    import pynumdiff

    return np.asarray(
        pynumdiff.iterative_velocity(x, DT, num_iterations=10, gamma=alpha, cg_maxiter=1000, scale="large")[0]
    )


def derivative_trend_filtered(x: Array, alpha: float) -> Array:
    import derivative

    return np.asarray(derivative.TrendFiltered(order=0, alpha=alpha / DT, max_iter=1000).x(x, DT * np.arange(len(x))))


ROUTINES = {f.__name__: f for f in (ours, pynumdiff_tvrdiff, pynumdiff_iterative_velocity, derivative_trend_filtered)}


def run_one(name: str, rows: int, counts: int, alpha: float) -> None:
    """Child process: time one routine and print seconds and our objective as JSON."""
    from hybrid_dynamics.differentiate.total_variation import objective

    routine = ROUTINES[name]
    routine(measured(200)[:, 0], alpha)  # imports and warm-up do not count
    x = measured(rows, counts)[:, 0]
    seconds = []
    for _ in range(3 if name == "ours" else 1):
        start = time.perf_counter()
        xi = routine(x, alpha)
        seconds.append(time.perf_counter() - start)
    print(json.dumps({"seconds": min(seconds), "objective": objective(np.asarray(xi), x, DT, alpha)}))


def chosen_alpha(rows: int, counts: int) -> float:
    """The alpha that the data choose for the velocity."""
    from hybrid_dynamics.differentiate import get_differentiator
    from hybrid_dynamics.differentiate.choice import Choice

    return Choice(measured(rows, counts)[:, 0], DT).next(get_differentiator("total_variation"))


def compare(rows: int, limit: float, counts: int) -> None:
    alpha = chosen_alpha(rows, counts)
    print(
        f"total variation, {rows} samples at {1 / DT:g} Hz, encoder {counts} counts, "
        f"alpha chosen from the data {alpha:.2e}"
    )
    print(f"{'routine':32}{'seconds':>12}{'times ours':>12}{'objective / ours':>18}")
    own: dict[str, float] = {}
    for name in ROUTINES:
        command = [sys.executable, "-W", "ignore", __file__, "--only", name, "--rows", str(rows)]
        command += ["--counts", str(counts), "--alpha", repr(alpha)]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=limit, check=False)
        except subprocess.TimeoutExpired:
            least = limit / own["seconds"]
            print(f"{name:32}{f'> {limit:g}':>12}{f'> {least:.0f}':>12}{'not finished':>18}")
            continue
        if done.returncode != 0:
            last = (done.stderr.strip().splitlines() or ["killed"])[-1]
            print(f"{name:32}{'failed':>12}  {last[:60]}")
            continue
        found = json.loads(done.stdout.strip().splitlines()[-1])
        own = own or found
        print(
            f"{name:32}{found['seconds']:12.4f}{found['seconds'] / own['seconds']:12.1f}"
            f"{found['objective'] / own['objective']:18.9f}"
        )


def scaling(alpha: float) -> None:
    from hybrid_dynamics.differentiate.total_variation import solve

    print("total variation, ours: growth with the number of samples (best of three)")
    print(f"{'samples':>10}{'seconds':>12}{'us / sample':>14}{'iterations':>12}{'relative gap':>14}")
    for rows in (10_000, 30_000, 60_000, 120_000, 240_000):
        x = measured(rows)[:, 0]
        seconds = []
        for _ in range(3):
            start = time.perf_counter()
            found = solve(x, DT, alpha)
            seconds.append(time.perf_counter() - start)
        best = min(seconds)
        print(f"{rows:10}{best:12.4f}{1e6 * best / rows:14.3f}{found.iterations:12}{found.gap / found.objective:14.1e}")


def errors(rows: int, joints: int) -> None:
    from hybrid_dynamics.differentiate import DIFFERENTIATORS, derivative_errors
    from hybrid_dynamics.trajectory import Trajectory

    axis = np.asarray(DT * np.arange(rows), float)
    names = ("q", "dq", "ddq", "dddq")
    truth = Trajectory("truth", "test", axis, {name: motion(axis, k, joints) for k, name in enumerate(names)})
    print(f"\nrelative RMSE against truth, {joints} joints, {rows} samples: automatic choice / best tuned on the truth")
    print(f"{'encoder':>10} {'method':16}" + "".join(f"{name:>26}" for name in names[1:]) + f"{'seconds':>10}")
    for counts in COUNTS:
        noisy = Trajectory("noisy", "test", axis, {"q": measured(rows, counts, joints)})
        for method in DIFFERENTIATORS:
            start = time.perf_counter()
            table = [row for row in derivative_errors(truth, noisy, [method]) if row["joint"] == "all"]
            cells = "".join(
                f"{row['relative_rmse']:10.2e} /{row['best_relative_rmse']:9.2e}{row['ratio']:5.2f}" for row in table
            )
            print(f"{counts:>10} {method:16}{cells}{time.perf_counter() - start:10.1f}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, default=10_000, help="samples of the comparison with other packages")
    parser.add_argument("--limit", type=float, default=60.0, help="seconds after which a foreign routine is stopped")
    parser.add_argument("--skip-errors", action="store_true", help="leave out the table of errors against the truth")
    parser.add_argument("--only", choices=tuple(ROUTINES), help=argparse.SUPPRESS)
    parser.add_argument("--counts", type=int, default=COUNTS[0], help=argparse.SUPPRESS)
    parser.add_argument("--alpha", type=float, default=1e-9, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.only:
        run_one(args.only, args.rows, args.counts, args.alpha)
        return
    for counts in COUNTS:
        compare(args.rows, args.limit, counts)
        print()
    scaling(chosen_alpha(args.rows, COUNTS[0]))
    if not args.skip_errors:
        errors(20_000, 2)


if __name__ == "__main__":
    main()
