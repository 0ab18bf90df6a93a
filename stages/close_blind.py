"""Stage close_blind: close the loop on every blind case, two at a time; reads the URDF and the logs, nothing else."""

import shutil
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

from hybrid_dynamics.errors import InputError, run_main
from hybrid_dynamics.files import write_json
from hybrid_dynamics.loop import LoopSettings, close_loop, write_diagnosis
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.study.config import load_params, section
from hybrid_dynamics.study.layout import REFUSED, BlindFiles
from hybrid_dynamics.trajectory import read_trajectories
from stages.common import dataset_argument, progress_bar

WORKERS = 2


def close(log: Path, urdf: Path, out: Path, settings: LoopSettings) -> tuple[str, float]:
    """Diagnose one case; returns a line for the person who watches, and processor seconds."""
    started = time.process_time()
    runs = {split: read_trajectories(log, split=split) for split in ("train", "test")}
    try:
        result = close_loop(Robot.from_urdf(urdf), runs["train"], runs["test"], settings)
        write_diagnosis(out, result.diagnosis)
        said = result.diagnosis.verdict
    except InputError as refusal:
        # Also an answer, and no reason to lose those of all other cases.
        write_json(out, {REFUSED: str(refusal)})
        said = REFUSED
    return f"{log.stem}: {said}", time.process_time() - started


def main() -> None:
    files = dataset_argument(__doc__)
    blind = BlindFiles(files.dataset)
    settings = section(load_params(), "loop", LoopSettings)
    logs = sorted(blind.logs.glob("*.parquet"))
    if not logs:
        raise InputError(f"{blind.logs}: no blind case; run the stage generate_blind (dvc repro)")
    shutil.rmtree(blind.diagnoses, ignore_errors=True)
    blind.diagnoses.mkdir(parents=True)
    with (
        progress_bar(f"{files.dataset}: closing the loop") as progress,
        ProcessPoolExecutor(WORKERS, mp_context=get_context("spawn")) as pool,
    ):
        lines: Iterator[tuple[str, float]] = pool.map(
            close,
            logs,
            [files.robot] * len(logs),
            [blind.diagnoses / f"{log.stem}.json" for log in logs],
            [settings] * len(logs),
        )
        seconds = {}
        for done, (log, (line, took)) in enumerate(zip(logs, lines, strict=True), 1):
            seconds[log.stem] = round(took, 2)
            progress(done / len(logs), line)
    write_json(blind.timing, seconds)


if __name__ == "__main__":
    run_main(main)
