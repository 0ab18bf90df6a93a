"""Kill the pipeline at random moments of one small pass: the next run completes, and its results are the same bytes.

    python -m tests.kill_repro --kills 10

Every other kill ends all of its processes at once (a power failure), the rest only the stage that runs (memory ran
out). Compared with an undisturbed pass: all of data/ and reports/ but durations, and MLflow's records.
"""

import argparse
import contextlib
import hashlib
import os
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil
from stages.compose import compose
from tests.test_pipeline import SMALL, clone

#: Longest time from the first stage of a pass that works to its kill [s].
LONGEST = 30.0
#: Results that show durations.
DURATIONS = ("reports/timing.csv", "reports/index.html", "reports/tables.txt")


def content(folder: Path) -> dict[str, str]:
    """Digest of every file that must not depend on what happened on the way."""
    files = (p for part in ("data", "reports") for p in (folder / part).rglob("*") if p.is_file())
    names = {p.relative_to(folder).as_posix(): p for p in files}
    return {
        name: hashlib.sha256(p.read_bytes()).hexdigest()
        for name, p in names.items()
        if name not in DURATIONS and p.parent.name != "timing"
    }


def start(folder: Path) -> subprocess.Popen[bytes]:
    """One pass through the pipeline of ``folder``, as ``make repro`` does it."""
    environment = {k: v for k, v in os.environ.items() if k not in ("HYBRID_DYNAMICS_MIRROR", "DVC_ROOT")}
    environment |= {"PYTHONPATH": f"{folder / 'src'}{os.pathsep}{folder}", "OMP_NUM_THREADS": "1"}
    environment["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{environment['PATH']}"
    command = [sys.executable, "-m", "stages.lanes"]
    with (folder / "run.log").open("ab") as log:
        return subprocess.Popen(command, cwd=folder, env=environment, stdout=log, stderr=log, start_new_session=True)


def works(process: subprocess.Popen[bytes]) -> bool:
    """Whether a stage runs that does more than look whether its source is still the same."""
    with contextlib.suppress(psutil.NoSuchProcess):
        for one in psutil.Process(process.pid).children(recursive=True):
            words = one.cmdline() if one.is_running() else []
            if any(w.startswith("stages.") and w != "stages.fetch" for w in words):
                return True
    return False


def kill_all(process: subprocess.Popen[bytes]) -> str:
    """All processes of a pass at once."""
    everyone = [*psutil.Process(process.pid).children(recursive=True), psutil.Process(process.pid)]
    for one in everyone:
        one.suspend()
    running = [" ".join(p.cmdline()[-3:]) for p in everyone if "-m" in p.cmdline()]
    for one in everyone:
        one.kill()
    process.wait()
    return f"all {len(everyone)} processes, {running[0] if running else 'between stages'}"


def kill_stage(process: subprocess.Popen[bytes]) -> str:
    """The stage that runs; the pass ends by itself."""
    while process.poll() is None:
        for one in psutil.Process(process.pid).children(recursive=True):
            words = one.cmdline() if one.is_running() else []
            stage = next((w for w in words if w.startswith("stages.")), None)
            if stage and words[0].endswith(("python", "python3", "python3.11")):
                one.kill()
                process.wait()
                return f"{' '.join(words[2:])}, the pass ended with code {process.returncode}"
        time.sleep(0.05)
    return "nothing: it had ended"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--longest", type=float, default=LONGEST, help="of a stage's work before a kill [s]")
    parser.add_argument("--study", nargs="+", default=SMALL, metavar="NAME=VALUE", help="what is run, as for -S")
    wanted = parser.parse_args()
    moments = random.Random(wanted.seed)
    with tempfile.TemporaryDirectory() as base:
        folders = {name: Path(base) / name for name in ("undisturbed", "killed")}
        for folder in folders.values():
            folder.mkdir()
            clone(folder)
            compose(folder / "params.yaml", wanted.study)
        undisturbed = start(folders["undisturbed"])
        for k in range(wanted.kills):
            process = start(folders["killed"])
            after = moments.uniform(0.0, wanted.longest)
            while process.poll() is None and not works(process):
                time.sleep(0.1)
            try:
                process.wait(after)
                print(f"{k + 1}: complete before it was killed (code {process.returncode})", flush=True)
                break
            except subprocess.TimeoutExpired:
                how = kill_all if k % 2 == 0 else kill_stage
                print(f"{k + 1}: after {after:.1f} s of work killed {how(process)}", flush=True)
        codes = {"killed": start(folders["killed"]).wait(), "undisturbed": undisturbed.wait()}
        found = {name: content(folder) for name, folder in folders.items()}
        tail = (folders["killed"] / "run.log").read_text("utf-8", "replace").splitlines()[-3:]
    a, b = found["undisturbed"], found["killed"]
    different = sorted(name for name in a.keys() | b.keys() if a.get(name) != b.get(name))
    print(f"codes {codes}; {len(a)} files, different: {different or 'none'}")
    if any(codes.values()):
        print("\n".join(tail))
    return 1 if different or any(codes.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
