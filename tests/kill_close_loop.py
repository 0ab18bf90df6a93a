"""Kill ``close-loop`` at random moments and fill its disk: the old results or the new ones are there, never a mixture.

    python -m tests.kill_close_loop --kills 50 --full 20

Every other kill comes while the results are being written, which is a small part of the time.
Prints a line a trial and ends with code 1 where anything was lost. The suite does a handful (``test_faults.py``).
"""

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from tests.two_links import write_recordings

CODE = "from hybrid_dynamics.cli import main; main()"
LIMITED = "import resource, sys; n = int(sys.argv.pop(1)); resource.setrlimit(resource.RLIMIT_FSIZE, (n, n)); " + CODE


def content(folder: Path) -> dict[str, bytes]:
    """Every file below ``folder`` by its name."""
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@dataclass
class Trial:
    """A small arm's logs in ``folder``, and two results that ``out`` may hold: ``old`` and ``new``."""

    folder: Path

    def __post_init__(self) -> None:
        write_recordings(self.folder)
        self.old = self._result("old")
        started = time.monotonic()
        self.new = self._result("new")
        #: Wall time of one run [s].
        self.lasts = time.monotonic() - started
        assert self.old != self.new

    def _result(self, which: str) -> dict[str, bytes]:
        assert self.start(which).wait() == 0
        return content(self.folder / "out")

    def start(self, which: str, limit: int | None = None) -> subprocess.Popen[str]:
        """``close-loop`` into ``out``; ``limit`` bounds the size of every file it writes [bytes]."""
        arguments = ["close-loop", "--robot", "robot.urdf", "--train", "train_1.parquet", "train_2.parquet", "--test"]
        arguments += ["test_1.parquet", "--out", "out", "--quiet", "--set", f"evaluations={20_000 + (which == 'new')}"]
        program = ["-c", CODE] if limit is None else ["-c", LIMITED, str(limit)]
        return subprocess.Popen(
            [sys.executable, *program, *arguments],
            cwd=self.folder,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )

    def killed(self, after: float, writing: bool = False) -> str:
        """What ``out`` holds where the run that writes ``new`` is killed ``after`` [s], with ``writing`` counted from
        the moment at which it begins to write its results."""
        before = set(self.leftovers())
        process = self.start("new")
        while writing and process.poll() is None and set(self.leftovers()) <= before:
            time.sleep(0.0005)
        try:
            process.wait(after)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL)
        process.communicate()
        return self.state()

    def full(self, limit: int) -> str:
        """The same where no file can be larger than ``limit`` [bytes]; anything but one clear line is told."""
        process = self.start("new", limit)
        said = process.communicate()[1]
        clear = process.returncode == 0 or (process.returncode == 2 and len(said.splitlines()) == 1)
        return self.state() if clear else f"unclear end, code {process.returncode}: {said}"

    def state(self) -> str:
        """``old``, ``new``, or what is wrong."""
        found = content(self.folder / "out")
        return "old" if found == self.old else "new" if found == self.new else f"a mixture: {sorted(found)}"

    def reset(self) -> None:
        """Put the old results back, by hand."""
        for name, value in self.old.items():
            (self.folder / "out" / name).write_bytes(value)

    def leftovers(self) -> list[str]:
        """What is beside the results and not an input."""
        return sorted(p.name for p in self.folder.iterdir() if p.name.startswith("."))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--full", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    wanted = parser.parse_args()
    moments = random.Random(wanted.seed)
    with tempfile.TemporaryDirectory() as folder:
        trial = Trial(Path(folder))
        largest = max(len(value) for value in trial.new.values())
        states = []
        for k in range(wanted.kills + wanted.full):
            trial.reset()
            if k < wanted.kills:
                writing = k % 2 == 1
                # Writing takes a tenth of a second to half of one; most of it is the page.
                after = 10 ** moments.uniform(-3.0, 0.0) if writing else moments.uniform(0.0, 1.05 * trial.lasts)
                states.append(trial.killed(after, writing))
                since = " of writing" if writing else ""
                print(f"killed after {after:.3f} s{since}: {states[-1]}", flush=True)
            else:
                limit = round(largest * 10 ** moments.uniform(-4.0, 0.2))
                states.append(trial.full(limit))
                print(f"no file beyond {limit} bytes: {states[-1]}", flush=True)
        process = trial.start("new")
        process.communicate()
        end = (process.returncode, trial.state(), trial.leftovers())
        print(f"the next run: code {end[0]}, {end[1]} results, left beside them: {end[2] or 'nothing'}")
    lost = [s for s in states if s not in ("old", "new")]
    print(f"{len(states)} trials: {states.count('old')} old, {states.count('new')} new, {len(lost)} lost")
    return 1 if lost or end != (0, "new", []) else 0


if __name__ == "__main__":
    sys.exit(main())
