"""Single wrong samples in the logs of a small arm, of any size and number: the loop must find what the clean logs give.

    python -m tests.glitch_sweep --seeds 1 --out docs/glitches.csv

writes a row a case and ends with code 1 where a verdict, a name or a parameter (beyond one standard error) changed, or
samples were missed. The suite does a few of the cases (``test_glitches.py``).
"""

from __future__ import annotations

import argparse
import csv
import itertools
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tests.small_arm import arm, runs

from hybrid_dynamics.loop.close import close_loop
from hybrid_dynamics.loop.diagnosis import Diagnosis
from hybrid_dynamics.trajectory import Trajectory

#: Share of the samples, their departure in standard deviations of the signal.
SHARES, TIMES = (1e-4, 1e-3, 1e-2), (3.0, 30.0, 1000.0)
JOINTS, SPLITS, SIGNALS = ("one", "all", "message"), ("train", "test"), ("q", "dq", "tau")
#: Of the logs' samples (400 Hz) every so many are kept.
STEPS = (1, 4)


@dataclass(frozen=True)
class Case:
    """Glitches of ``signal`` in ``joints`` (one, all, or all at once: a whole message) of every run of ``split``.

    Every ``step``-th sample of the logs is kept.
    """

    signal: str
    split: str
    joints: str
    share: float
    times: float
    step: int = 1
    seed: int = 0

    @property
    def velocity(self) -> bool:
        """Whether the logs have a measured velocity."""
        return self.signal == "dq"


def measured(run: Trajectory) -> Trajectory:
    """``run`` with a measured velocity."""
    return run.with_signals(dq=np.gradient(run["q"], run.dt, axis=0))


def spoil(run: Trajectory, case: Case, rng: np.random.Generator) -> tuple[Trajectory, int]:
    """``run`` with the glitches of ``case``, and their number."""
    x, put = run[case.signal].copy(), 0
    rows = np.empty(0, int)
    for j in (1,) if case.joints == "one" else range(x.shape[1]):
        if case.joints != "message" or not len(rows):
            # The first and the last samples have neighbours on one side only.
            rows = rng.choice(np.arange(3, len(x) - 3), max(round(case.share * len(x)), 1), replace=False)
        x[rows, j] += case.times * x[:, j].std() * rng.choice([-1.0, 1.0], len(rows))
        put += len(rows)
    return run.with_signals(**{case.signal: x}), put


def logs(velocity: bool = False, step: int = 1) -> tuple[list[Trajectory], list[Trajectory]]:
    """Clean logs of the small arm, at 400 Hz over ``step``."""
    train, test = ([run.rows(slice(None, None, step)) for run in part] for part in runs())
    return ([measured(r) for r in train], [measured(r) for r in test]) if velocity else (train, test)


def closed(train: Sequence[Trajectory], test: Sequence[Trajectory]) -> Diagnosis:
    return close_loop(arm(), train, test).diagnosis


def told(found: Diagnosis, signal: str) -> int:
    """How many samples of ``signal`` the diagnosis says it left out."""
    return sum(int(n) for note in found.notes for n in re.findall(rf"(\d+) samples? of {signal} \(", note))


def outcome(case: Case, clean: Diagnosis) -> dict[str, object]:
    """One row of the table: what was put in and told, and what changed against ``clean``."""
    rng = np.random.default_rng([case.seed, *case.signal.encode(), round(1e4 * case.share), round(case.times)])
    train, test = logs(case.velocity, case.step)
    put = 0
    for part, split in ((train, "train"), (test, "test")):
        for k, run in enumerate(part if split == case.split else ()):
            part[k], count = spoil(run, case, rng)
            put += count
    found = closed(train, test)
    own, theirs = ({(e.effect.effect, e.effect.joints): e.effect for e in d.effects} for d in (found, clean))
    same = found.verdict == clean.verdict and own.keys() == theirs.keys()
    off = 0.0
    if same:
        off = max(
            abs(own[key].parameters[name] - value) / effect.std_errors[name]
            for key, effect in theirs.items()
            for name, value in effect.parameters.items()
        )
    errors = [d.error["test"].after.relative_error or 0.0 for d in (found, clean)]
    return {
        "signal": case.signal,
        "split": case.split,
        "joints": case.joints,
        "share": case.share,
        "times": case.times,
        "rate": 400 // case.step,
        "seed": case.seed,
        "put": put,
        "told": told(found, case.signal),
        "verdict": found.verdict,
        "same_names_and_verdict": same,
        "parameters_off_in_std_errors": round(off, 3),
        "test_error_over_clean": round(errors[0] / errors[1], 3),
    }


def holds(row: dict[str, object]) -> bool:
    """Same verdict and names, parameters within one standard error, all but one in fifty samples found."""
    put, found = int(str(row["put"])), int(str(row["told"]))
    near = float(str(row["parameters_off_in_std_errors"])) <= 1.0
    return bool(row["same_names_and_verdict"]) and near and 0.98 * put <= found <= 1.02 * put + 1


def summary(rows: Sequence[Mapping[str, object]]) -> str:
    """What a table says, in a sentence."""
    good = sum(str(row["holds"]) == "True" for row in rows)
    put, found = (sum(int(str(row[key])) for row in rows) for key in ("put", "told"))
    off = max(float(str(row["parameters_off_in_std_errors"])) for row in rows)
    error = max(float(str(row["test_error_over_clean"])) for row in rows)
    return (
        f"{good} of {len(rows)} cases give the verdict and the names of the clean logs; {found} of {put} wrong samples "
        f"are told; no parameter moves by more than {off:.2f} standard errors; the held-out error is {error:.2f} times "
        "that of the clean logs at most"
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--steps", type=int, nargs="+", default=list(STEPS), help="of 400 Hz every so many samples")
    parser.add_argument("--joints", nargs="+", default=list(JOINTS), choices=JOINTS)
    parser.add_argument("--signals", nargs="+", default=list(SIGNALS), choices=SIGNALS)
    parser.add_argument("--out", type=Path, required=True)
    wanted = parser.parse_args()
    clean = {(v, step): closed(*logs(v, step)) for v in (False, True) for step in wanted.steps}
    rows = []
    grid = itertools.product(wanted.signals, SPLITS, wanted.joints, SHARES, TIMES, wanted.steps, range(wanted.seeds))
    with wanted.out.open("w", newline="", encoding="utf-8") as stream:
        table: csv.DictWriter[str] | None = None
        for values in grid:
            case = Case(*values)
            row = outcome(case, clean[case.velocity, case.step])
            row["holds"] = holds(row)
            rows.append(row)
            if table is None:
                table = csv.DictWriter(stream, list(row), lineterminator="\n")
                table.writeheader()
            table.writerow(row)
            stream.flush()
    print(f"{wanted.out}: {summary(rows)}")
    return 0 if all(row["holds"] for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
